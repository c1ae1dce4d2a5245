"""Labels of a sweep's scenes (depth, classes), on the pixels of its frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gpusim.errors import UserError
from gpusim.formats.label_map import read_labels
from gpusim.library.labels import in_raw, labels_on_sensor

if TYPE_CHECKING:
    import numpy as np

    from gpusim.batch.frame import Frame
    from gpusim.library import frame as library

SCENE = "{scene}"  # in a file's name: the scene's own, without its suffix


def label_file(folder: Path, pattern: str, scene: str) -> Path:
    """Return the file that has a scene's labels: beside the sweep's, or as it is named.

    Raises
    ------
    UserError
        There is none.
    """
    name = pattern.replace(SCENE, Path(scene).stem)
    for path in (folder / name, Path(name)):
        if path.is_file():
            return path
    raise UserError(
        "a scene has no such file of labels",
        file=folder / name,
        field="labels",
        value=pattern,
        allowed=f"a .npy or .png file for each scene; {SCENE} stands for the scene's name",
    )


def labels_of(frame: Frame) -> dict[str, np.ndarray]:
    """Return the labels of a frame's scene on all lit pixels of its sensor, by name."""
    camera, sweep = frame.camera(), frame.sweep
    return {
        name: labels_on_sensor(camera, read_labels(label_file(sweep.folder, pattern, frame.scene)))
        for name, pattern in sweep.labels.items()
    }


def in_frame(labels: dict[str, np.ndarray], taken: library.Frame) -> dict[str, np.ndarray]:
    """Return labels on the pixels of a raw; shielded pixels, which see nothing, have 0."""
    return {name: in_raw(seen, taken.areas, taken.raw.shape) for name, seen in labels.items()}
