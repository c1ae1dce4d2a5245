"""Pictures to try demosaicing on, and how good it is."""

from __future__ import annotations

import numpy as np
from matplotlib import cbook
from PIL import Image


def photographs() -> dict[str, np.ndarray]:
    """Return pictures (rows, cols, 3), 0 to 1: one with fine detail; one halved, so sharper."""
    whole = Image.open(cbook.get_sample_data("grace_hopper.jpg")).convert("RGB")
    half = whole.resize((256, 300), Image.Resampling.LANCZOS)
    crop = np.asarray(whole)[100:400, 100:420]
    return {"whole": crop / 255, "half": np.asarray(half) / 255}


def mosaicked(picture: np.ndarray) -> np.ndarray:
    """Return the light of a Bayer array, red first."""
    light = picture[..., 1].copy()
    light[::2, ::2] = picture[::2, ::2, 0]
    light[1::2, 1::2] = picture[1::2, 1::2, 2]
    return light


def cpsnr_db(found: np.ndarray, picture: np.ndarray, rim: int = 12) -> float:
    """Return the peak signal-to-noise ratio over all three colours, without the rim."""
    error = np.clip(found, 0, 1) - picture
    return float(-10 * np.log10(np.mean(error[rim:-rim, rim:-rim] ** 2)))
