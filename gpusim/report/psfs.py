"""The PSF of the place that is clicked, on the report's page."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from PIL import Image

from gpusim.psf.local import LocalPsfs
from gpusim.report.template import filled

SHOWN_PX = 240
TINY = np.finfo(float).tiny


def psfs_html(found: LocalPsfs, facts: dict[str, Any]) -> str:
    """Return the panel: PSFs side by side in one picture, and where each one lies.

    Parameters
    ----------
    found : LocalPsfs
    facts : dict
        Those of the report.
    """
    brightest = np.maximum(found.light.reshape(len(found.light), -1).max(axis=1), TINY)
    # The fourth root shows light of a ten-thousandth as a tenth.
    each = brightest.reshape(-1, *[1] * (found.light.ndim - 1))
    toned = np.round(255 * np.clip(found.light / each, 0, 1) ** 0.25).astype(np.uint8)
    strip = Image.fromarray(np.concatenate(list(toned), axis=1))
    sensor, capture = facts["camera"]["sensor"], facts["capture"]
    data = {
        "places": found.places_um.round(3).tolist(),
        "turned": found.turned,
        "side": round(float(found.side_um), 4),
        "pitch": sensor["pixel_pitch_um"],
        "axis": [
            sensor["cols"] / 2 - capture["first_col"],
            sensor["rows"] / 2 - capture["first_row"],
        ],
    }
    return filled(
        "report/templates/psfs.html",
        data=json.dumps(data),
        strip=strip,
        shown_px=SHOWN_PX,
        count=len(found.light),
        turned=found.turned,
    )
