"""Colours of a ColorChecker as plain data for JSON, CSV, screen and page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gpusim.metrics.colour import METHODS, ColourReport, Colours


def colour_facts(found: ColourReport) -> dict[str, Any]:
    """Return the figures."""
    kinds = {"as_is": found.as_is, "through_matrix": found.fitted}
    chart_xy = found.chart_xyz[:, :2] / found.chart_xyz.sum(axis=1, keepdims=True)
    return {
        "units": "chromaticities x, y of CIE 1931; Delta E of CIELAB with the illuminant's white; "
        "the picture's exposure is fitted to the greys",
        "illuminant": found.light,
        "white_xy": None if found.white_xy is None else found.white_xy.tolist(),
        "illuminant_xy": (found.white_xyz[:2] / found.white_xyz.sum()).tolist(),
        "matrix_rgb_to_xyz": found.matrix.tolist(),
        "clipped": [
            name for name, bad in zip(found.names, found.patches.clipped, strict=True) if bad
        ],
        "summary": {
            kind: _summary(one, chart_xy) for kind, one in kinds.items() if one is not None
        },
        "patches": [
            {
                "name": name,
                "corners_px": found.patches.corners[at].tolist(),
                "rgb": found.patches.mean[at].tolist(),
                "noise": found.patches.noise[at].tolist(),
                "chart_xy": chart_xy[at].tolist(),
                **{
                    kind: {
                        "xyz": one.xyz[at].tolist(),
                        "xy": one.xy[at].tolist(),
                        **{f"delta_e_{key}": float(one.delta_e[key][at]) for key in METHODS},
                    }
                    for kind, one in kinds.items()
                    if one is not None
                },
            }
            for at, name in enumerate(found.names)
        ],
    }


def _summary(one: Colours, chart_xy: np.ndarray) -> dict[str, float]:
    far = np.hypot(*(one.xy - chart_xy)[:18].T)  # of the 18 chromatic patches
    return {
        **{f"mean_delta_e_{key}": float(one.delta_e[key].mean()) for key in METHODS},
        **{f"largest_delta_e_{key}": float(one.delta_e[key].max()) for key in METHODS},
        "mean_xy": float(far.mean()),
        "largest_xy": float(far.max()),
    }


def colour_rows(facts: dict[str, Any]) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: one for each patch."""
    kinds = list(facts["summary"])
    parts = ("x", "y", *(f"delta_e_{key}" for key in METHODS))
    yield [
        "patch", "R", "G", "B", "chart_x", "chart_y",
        *(f"{kind}_{part}" for kind in kinds for part in parts),
    ]  # fmt: skip
    for one in facts["patches"]:
        yield [
            one["name"],
            *(f"{value:.7g}" for value in (*one["rgb"], *one["chart_xy"])),
            *(
                f"{value:.6g}"
                for kind in kinds
                for value in (*one[kind]["xy"], *(one[kind][part] for part in parts[2:]))
            ),
        ]
