"""What the single figures of a lens share: a sheet as wide as a phone, names, looks of overlays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gpusim.report.drawing import INK, SOFT, write
from gpusim.report.lens.colours import PALETTE, wavelength_colour
from gpusim.report.lens.study import Study

# Shown 390 px wide, less margins of 24 px each, letters of 9 points are 9.3 px high.
WIDTH = 4.6
STYLE = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "normal",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "legend.fontsize": 8.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
}
DASHES = ("-", (0, (4, 2)))  # tangential, sagittal
# The first lens by lines, the second by thinner ones with circles.
LOOKS = (
    {"linewidth": 1.5},
    {
        "linewidth": 0.8,
        "marker": "o",
        "markersize": 3.2,
        "markerfacecolor": "white",
        "markeredgewidth": 0.8,
        "markevery": 0.12,
    },
)
MICRO, DEGREE = "\N{MICRO SIGN}", "\N{DEGREE SIGN}"
KEY_ROW_IN = 0.19  # inches from a row of a legend to the next
TITLE_IN = 0.62  # inches at the top: the title, and the names of the lenses
NAME_LETTERS = 66  # across the sheet


@dataclass(frozen=True)
class Sheet:
    """A figure that is being drawn, and the lenses on it."""

    figure: Figure
    studies: Sequence[Study]

    @property
    def top(self) -> float:
        """Inches from the bottom to where panels may begin."""
        return self.figure.get_size_inches()[1] - TITLE_IN - 0.2 * (len(self.studies) - 1)

    @property
    def looks(self) -> list[tuple[Study, dict]]:
        """Each lens with the look of its curves."""
        return list(zip(self.studies, LOOKS, strict=False))


def sheet(title: str, studies: Sequence[Study], body: float, *, stacked: bool = False) -> Sheet:
    """Return an empty sheet with its title; ``body`` is the height below it, in inches.

    ``stacked`` says that the second lens is drawn below the first, not over it.
    """
    tall = body + TITLE_IN + 0.2 * (len(studies) - 1)
    figure = Figure(figsize=(WIDTH, tall))
    write(figure, 0.12, tall - 0.2, title, fontsize=11, fontweight="bold", va="center")
    for number, study in enumerate(studies):
        up, left = tall - 0.44 - 0.2 * number, 0.12
        if len(studies) > 1 and stacked:
            left = 0.65
            where = ("above:", "below:")[number]
            write(figure, 0.12, up, where, fontsize=8.5, color=SOFT, va="center")
        elif len(studies) > 1:
            left = 0.56
            look = LOOKS[number] | {"markevery": 2}
            at = np.array([0.12, 0.3, 0.48]) / WIDTH
            across = [up / tall] * 3
            figure.add_artist(
                Line2D(at, across, color=INK, **look | {"markevery": [1]} if number else look)
            )
        write(figure, left, up, shortened(study.label), fontsize=8.5, color=SOFT, va="center")
    return Sheet(figure, studies)


def shortened(text: str) -> str:
    """Return a name that fits beside nothing else on the sheet."""
    return (
        text if len(text) <= NAME_LETTERS else text[: NAME_LETTERS - 1] + "\N{HORIZONTAL ELLIPSIS}"
    )


def field_name(study: Study, number: int) -> str:
    """Return what a field is called, with its angle."""
    field = study.fields[number]
    angle = f"{abs(field.degrees):.3g}{DEGREE}"
    return field.name if field.theta == 0 else f"{field.name} {angle}"


def field_handles(study: Study) -> list[Line2D]:
    """Return legend entries of the fields."""
    return [
        Line2D([], [], color=PALETTE[number], label=field_name(study, number))
        for number in range(len(study.fields))
    ]


def line_handles(studies: Sequence[Study]) -> list[Line2D]:
    """Return legend entries of the design wavelengths of all lenses."""
    lines = sorted({float(line) for study in studies for line in study.lines[0]})
    return [Line2D([], [], color=wavelength_colour(line), label=f"{line:.4g} nm") for line in lines]


def way_handles(study: Study) -> list[Line2D]:
    """Return legend entries of the two directions of the image."""
    return [
        Line2D([], [], color=INK, linestyle=dash, label=way)
        for way, dash in zip(study.ways, DASHES, strict=True)
    ]


def key(on: Sheet, up: float, handles: Sequence[Line2D], columns: int | None = None) -> None:
    """Write a legend across the sheet, ``up`` inches from the bottom: no curve is there.

    With several rows the first one lies there; each takes ``KEY_ROW_IN`` more below it.
    """
    rows = -(-len(handles) // (columns or len(handles)))
    up -= (rows - 1) * KEY_ROW_IN / 2
    tall = on.figure.get_size_inches()[1]
    legend = on.figure.legend(
        handles=list(handles),
        loc="center left",
        bbox_to_anchor=(0.02, up / tall),
        ncols=columns or len(handles),
        borderaxespad=0,
        columnspacing=1.1,
        handlelength=1.6,
        handletextpad=0.5,
    )
    legend.set_in_layout(False)


def against_field_up(axes: Axes, studies: Sequence[Study]) -> None:
    """Make the vertical axis that of the field, as of field curvature and distortion."""
    low = min(np.degrees(study.theta[0]) for study in studies)
    high = max(np.degrees(study.theta[-1]) for study in studies)
    axes.set(ylabel=f"field [{DEGREE}]", ylim=(low, high if high > low else 1.0))
    axes.axvline(0, color=SOFT, linewidth=0.7, zorder=0)


def against_field(axes: Axes, studies: Sequence[Study]) -> None:
    """Make the horizontal axis that of the field."""
    low = min(np.degrees(study.theta[0]) for study in studies)
    high = max(np.degrees(study.theta[-1]) for study in studies)
    axes.set(xlabel=f"field [{DEGREE}]", xlim=(low, high if high > low else 1.0))


def wide_enough(axes: Axes, *, up: bool = False, least: float = 0.0) -> None:
    """Give an axis limits about 0 that hold all curves with room to spare.

    ``least`` is the smallest half range: what is smaller is not worth a look.
    """
    low, high = axes.dataLim.intervaly if up else axes.dataLim.intervalx
    low, high = min(low, -least), max(high, least)
    pad = 0.07 * (high - low)
    (axes.set_ylim if up else axes.set_xlim)(low - pad, high + pad)


def unit_of(length_mm: float) -> tuple[float, str]:
    """Return factor and unit in which lengths of this size read well."""
    return (1.0, "mm") if length_mm >= 0.5 else (1e3, f"{MICRO}m")
