"""Shading on one page, and as facts: maps of the channels and of their ratios."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gpusim.metrics.shading import Shading
from gpusim.report.drawing import COLOURS, INK, SOFT, STYLE, panel, titles, write
from gpusim.report.sheet import Table, sheet

CORNERS = ("upper left", "upper right", "lower left", "lower right")
UNITS = "means of 15 x 21 blocks over that of the middle one; standard uncertainties (k = 1)"


def ratios(found: Sequence[Shading]) -> dict[str, np.ndarray]:
    """Return colour shading: maps of red and blue over green, where there are these channels."""
    by_name = {one.channel: one.relative for one in found}
    if "G" not in by_name:
        return {}
    return {f"{name}/G": by_name[name] / by_name["G"] for name in "RB" if name in by_name}


def shading_facts(found: Sequence[Shading]) -> dict[str, Any]:
    """Return the figures."""
    return {
        "units": UNITS,
        "channels": [
            {
                "channel": one.channel,
                "middle": one.middle,
                "corners_percent": dict(
                    zip(CORNERS, (100 * value for value in one.corners), strict=True)
                ),
                "unevenness_percent": 100 * one.unevenness,
                "u_percent": 100 * one.u,
                "clipped": one.clipped,
                "map": one.relative.tolist(),
            }
            for one in found
        ],
        "colour_shading": [
            {
                "ratio": name,
                "lowest_percent": 100 * float(values.min()) - 100,
                "highest_percent": 100 * float(values.max()) - 100,
                "map": values.tolist(),
            }
            for name, values in ratios(found).items()
        ],
    }


def shading_rows(found: Sequence[Shading]) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: one for each block."""
    yield ["row", "column", *(one.channel for one in found)]
    for at in np.ndindex(found[0].relative.shape):
        yield [*at, *(f"{one.relative[at]:.6f}" for one in found)]


def draw_shading(found: Sequence[Shading], size: tuple[int, int], title: str) -> Figure:
    """Return the page; `size` is that of the picture, columns and rows."""
    of_colours = ratios(found)
    maps = {one.channel: 100 * one.relative for one in found}
    maps |= {name: 100 * values for name, values in of_colours.items()}
    down = -(-len(maps) // 3)
    with matplotlib.rc_context(STYLE):
        height = 2.9 * down + 4.6
        figure = Figure(figsize=(12.2, height))
        order = [f"{one.channel}: corners {100 * np.mean(one.corners):.1f} %" for one in found]
        titles(figure, title, order, top=height - 0.05)
        for number, (name, values) in enumerate(maps.items()):
            row, column = divmod(number, 3)
            axes = panel(figure, 0.6 + 3.9 * column, height - 3.6 - 2.9 * row, 3.2, 2.2)
            _map(figure, axes, name, values, size)
        _profiles(panel(figure, 0.8, 0.75, 10.8, 2.2), found, size)
        write(figure, 0.55, 0.2, UNITS, fontsize=7, color=SOFT, va="center")
    return figure


def _map(figure: Figure, axes: Axes, name: str, values: np.ndarray, size: tuple[int, int]) -> None:
    drawn = axes.imshow(values, extent=(0, size[0], size[1], 0), cmap="cividis")
    figure.colorbar(drawn, ax=axes)
    axes.grid(False)
    axes.set(title=f"{name} [% of the middle]", xlabel="x [px]", ylabel="y [px]")


def _profiles(axes: Axes, found: Sequence[Shading], size: tuple[int, int]) -> None:
    """Show all blocks by their distance from the middle."""
    rows, cols = found[0].relative.shape
    y, x = np.mgrid[:rows, :cols]
    x, y = (x + 0.5) / cols - 0.5, (y + 0.5) / rows - 0.5
    r = np.hypot(x * size[0], y * size[1]) / np.hypot(*size) * 2
    for one in found:
        colour = COLOURS.get(one.channel[0], INK)
        axes.plot(r.ravel(), 100 * one.relative.ravel(), ".", color=colour, label=one.channel)
    axes.set(
        title="Blocks over the radius",
        xlabel="share of the way from the middle to the corner",
        ylabel="% of the middle",
    )
    axes.legend(loc="lower left")


def shading_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    tables = [
        Table(
            "Shading, % of the middle",
            ("Channel", *CORNERS, "Unevenness, %", "u of a block, %", ""),
            [
                (
                    one["channel"], *one["corners_percent"].values(), one["unevenness_percent"],
                    one["u_percent"], "clipped" if one["clipped"] else "",
                )
                for one in facts["channels"]
            ],
        )
    ]  # fmt: skip
    if facts["colour_shading"]:
        tables.append(
            Table(
                "Colour shading, % from the middle's",
                ("Ratio", "Lowest", "Highest"),
                [
                    (one["ratio"], one["lowest_percent"], one["highest_percent"])
                    for one in facts["colour_shading"]
                ],
            )
        )
    said = f"Shading by gpusim {facts['gpusim']}; {facts['units']}."
    return sheet(facts["picture"], said, drawn, "Maps of shading, blocks over the radius", *tables)
