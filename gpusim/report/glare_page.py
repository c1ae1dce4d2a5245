"""Veiling glare on one page, and as facts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from gpusim.metrics.glare import Spot
from gpusim.report.drawing import COLOURS, INK, SOFT, STYLE, panel, titles, write
from gpusim.report.sheet import Table, sheet

UNITS = (
    "veiling glare index (ISO 9358, integral method): the middle of a black spot over the field "
    "around it; standard uncertainties (k = 1)"
)


def glare_facts(found: Mapping[str, tuple[Spot, ...]]) -> dict[str, Any]:
    """Return the figures, by channel."""
    return {
        "units": UNITS,
        "channels": [
            {
                "channel": name,
                "spots": [
                    {
                        "spot": spot.number,
                        "place_px": list(spot.place_px),
                        "radius_px": spot.radius_px,
                        "dark": spot.dark.value,
                        "field": spot.field.value,
                        "index_percent": 100 * spot.index.value,
                        "u_percent": 100 * spot.index.u,
                    }
                    for spot in spots
                ],
            }
            for name, spots in found.items()
        ],
    }


def glare_rows(facts: Mapping[str, Any]) -> Iterator[list[object]]:
    """Yield the lines of the CSV file: one for each spot and channel."""
    parts = ("spot", "radius_px", "dark", "field", "index_percent", "u_percent")
    yield ["channel", "x_px", "y_px", *parts]
    for one in facts["channels"]:
        for spot in one["spots"]:
            yield [one["channel"], *spot["place_px"], *(spot[part] for part in parts)]


def draw_glare(found: Mapping[str, tuple[Spot, ...]], values: np.ndarray, title: str) -> Figure:
    """Return the page: (rows, cols) `values` is what is shown as the picture."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 4.9))
        order = [
            f"{name}: {100 * np.mean([one.index.value for one in spots]):.2f} %"
            for name, spots in found.items()
        ]
        titles(figure, title, order, top=4.85)
        axes = panel(figure, 0.6, 0.9, 4.4, 2.8)
        light = np.clip(values / max(float(np.quantile(values, 0.99)), 1e-30), 0, 1) ** (1 / 2.2)
        axes.imshow(light, cmap="gray", extent=(0, values.shape[1], values.shape[0], 0))
        for spot in next(iter(found.values())):
            axes.add_patch(Circle(spot.place_px, spot.radius_px / 2, fill=False, ec="#ff8c1a"))
            axes.text(*spot.place_px, str(spot.number), color="#ff8c1a", fontsize=7)
        axes.grid(False)
        axes.set(title="Spots: where they are read", xlabel="x [px]", ylabel="y [px]")
        axes = panel(figure, 5.9, 0.9, 5.7, 2.8)
        for name, spots in found.items():
            axes.errorbar(
                [one.number for one in spots],
                [100 * one.index.value for one in spots],
                [100 * one.index.u for one in spots],
                fmt="o",
                color=COLOURS.get(name[0], INK),
                label=name,
                markersize=4,
            )
        axes.set(title="Veiling glare index", xlabel="spot", ylabel="% of the field")
        axes.set_ylim(bottom=0)
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.legend(loc="lower right")
        write(figure, 0.55, 0.25, UNITS, fontsize=7, color=SOFT, va="center")
    return figure


def glare_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    rows = [
        (one["channel"], str(spot["spot"]), *spot["place_px"], spot["dark"], spot["field"],
         spot["index_percent"], spot["u_percent"])
        for one in facts["channels"]
        for spot in one["spots"]
    ]  # fmt: skip
    head = ("Channel", "Spot", "x, px", "y, px", "Dark", "Field", "Index, %", "u, %")
    return sheet(
        facts["picture"],
        f"Veiling glare by gpusim {facts['gpusim']}; {facts['units']}.",
        drawn,
        "Where the spots lie, and the veiling glare index of each",
        Table("Spots", head, rows),
    )
