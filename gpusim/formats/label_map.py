"""Maps of labels in files: depth, albedo, classes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from PIL import Image

from gpusim.config.arrays import read_npy
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
        return np.asarray(Image.open(path))
    except (OSError, ValueError) as error:
        raise UserError(f"no map of labels: {error}", file=path, allowed=allowed) from None
