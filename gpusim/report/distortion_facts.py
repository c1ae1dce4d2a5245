"""Distortion and lateral colour as plain data for JSON, CSV, screen and page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gpusim.metrics.distortion import RADII, Distortion, Fit

SHOWN_RADII = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def distortion_facts(found: Distortion) -> dict[str, Any]:
    """Return the figures."""
    farthest = float(found.radius.max())
    chosen = found.fits["chosen"]
    inside = [r for r in SHOWN_RADII if r <= farthest]
    return {
        "units": "LGD = (r_d - r_u) / r_u, the quantity of ISO 17850:2015, in per cent; radii r_d "
        "in shares of the way from the centre to the corner; lateral colour in pixels of the "
        "reference channel (ISO 19084:2015)",
        "kind": found.marks.kind,
        "marks": len(found.cell),
        "left_out": found.left_out,
        "reference": found.reference,
        "centre_px": list(found.centre),
        "corner_px": found.corner_px,
        "farthest_mark": farthest,
        "lgd_percent": [
            {"radius": r, "value": value, "u": u}
            for r, value, u in zip(
                inside,
                (100 * chosen.lgd(np.array(inside))).tolist(),
                (100 * chosen.u_lgd(np.array(inside))).tolist(),
                strict=True,
            )
        ],
        "models": {name: _model(one, farthest) for name, one in found.fits.items()},
        "lateral_colour": [
            {
                "channel": one.channel,
                "rms_px": one.rms_px,
                "largest_radial_px": one.largest_px,
                "largest_radial_percent": 100 * one.largest_px / found.corner_px,
                "slope_px": one.slope_px,
                "cubic_px": one.cubic_px,
            }
            for one in found.shifts
        ],
    }


def _model(fit: Fit, farthest: float) -> dict[str, Any]:
    r = RADII[RADII <= farthest]
    return {
        "coefficients": fit.coefficients.tolist(),
        "u": np.sqrt(np.diag(fit.covariance)).tolist(),
        "rms_px": fit.rms_px,
        "worst_px": fit.worst_px,
        "radius": r.tolist(),
        "lgd_percent": (100 * fit.lgd(r)).tolist(),
    }


def distortion_rows(found: Distortion) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: one for each mark."""
    beside = [f"{kind}_{one.channel}_px" for one in found.shifts for kind in ("dx", "dy")]
    yield ["column", "row", "x_px", "y_px", "r_d", "lgd_percent", "miss_x", "miss_y", *beside]
    miss = found.fits["chosen"].miss_px
    radius, lgd = found.radius, found.lgd
    for at, (column, row) in enumerate(found.cell):
        yield [
            column,
            row,
            f"{found.marks.x[at]:.5f}",
            f"{found.marks.y[at]:.5f}",
            f"{radius[at]:.6f}",
            f"{100 * lgd[at]:.5f}",
            *(f"{value:.5f}" for value in miss[at]),
            *(f"{value:.5f}" for one in found.shifts for value in one.away_px[at]),
        ]
