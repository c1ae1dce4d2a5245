"""``gpusim labels``: a map of labels on the pixels that see them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from gpusim.camera import load_camera
from gpusim.cli.files import whole_file
from gpusim.errors import UserError
from gpusim.formats.label_map import read_labels
from gpusim.library.labels import labels_on_sensor

FORMATS = (".npy", ".png")


def run(camera_name: str, labels: Path, out: Path, beyond: float, projection: str) -> None:
    """Bring the labels of a file onto a camera's sensor, into another."""
    camera = load_camera(camera_name)
    with whole_file(out, FORMATS) as file:
        found = labels_on_sensor(camera, read_labels(labels), beyond, projection)
        if file.suffix.lower() == ".npy":
            np.save(file, found)
        else:
            try:
                Image.fromarray(found).save(file)
            except (TypeError, OSError) as error:
                raise UserError(
                    f"a PNG cannot hold these labels: {error}", field="--out", allowed=".npy"
                ) from None
    print(out)
