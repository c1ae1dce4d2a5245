"""``gpusim labels``: a map of labels on the pixels that see them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from gpusim.camera import Camera, load_camera
from gpusim.cli.files import whole_file
from gpusim.errors import UserError
from gpusim.formats.label_map import read_labels
from gpusim.library.labels import labels_on_sensor

FORMATS = (".npy", ".png")


def run(camera_name: str, labels: Path, out: Path, beyond: float, projection: str) -> None:
    """Bring the labels of a file onto a camera's sensor, into another."""
    camera = load_camera(camera_name)
    with whole_file(out, FORMATS) as file:
        write(file, labels_on_sensor(camera, read_labels(labels), beyond, projection), "--out")
    print(out)


def write(file: Path, labels: np.ndarray, option: str) -> None:
    """Write labels; ``option`` is what is to blame where a PNG cannot hold them."""
    if file.suffix.lower() == ".npy":
        np.save(file, labels)
    else:
        _picture(labels, option).save(file)


def _picture(labels: np.ndarray, option: str) -> Image.Image:
    try:
        return Image.fromarray(labels)
    except TypeError as error:
        raise UserError(
            f"a PNG cannot hold these labels: {error}", field=option, allowed=".npy"
        ) from None


def seen_maps(files: Sequence[Path], camera: Camera, projection: str) -> dict[str, np.ndarray]:
    """Return the maps of files on the lit pixels of a sensor, by the names beside a raw.

    Raises
    ------
    UserError
        Two would have one name; or as of `read_labels` and `labels_on_sensor`.
    """
    found: dict[str, np.ndarray] = {}
    for file in files:
        name = f"labels-{file.name}"
        if name in found:
            raise UserError(
                "two maps of one name", field="--labels", value=file, allowed="one of each name"
            )
        try:
            found[name] = labels_on_sensor(camera, read_labels(file), projection=projection)
            if file.suffix.lower() != ".npy":
                _picture(found[name], "--labels")  # refuses now, not after the render
        except UserError as error:
            error.file = error.file or file
            raise
    return found
