"""Maps of labels in files: depth, albedo, classes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gpusim.config.arrays import read_npy, read_png
from gpusim.config.text import read_bytes
from gpusim.errors import UserError


def read_labels(path: Path) -> np.ndarray:
    """Return the labels (rows, cols) or (rows, cols, n) of a .npy or .png file.

    Raises
    ------
    UserError
        There is no such file, or it is neither.
    """
    allowed = "an array, .npy (rows, cols), or a .png"
    if not os.path.isfile(path):
        raise UserError("no such map of labels", file=path, allowed=allowed)
    try:
        if path.suffix.lower() == ".npy":
            return read_npy(path)
        return read_png(read_bytes(path, "the map of labels"), indices=True)
    except UserError:
        raise
    except Exception as error:  # whatever a broken file makes of NumPy and Pillow
        said = str(error) or type(error).__name__
        raise UserError(f"no map of labels: {said}", file=path, allowed=allowed) from None
