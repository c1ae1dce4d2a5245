"""Colours of a ColorChecker on one page: the picture, patches side by side, chromaticities."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from gpusim.metrics.colour import ColourReport, Colours
from gpusim.metrics.picture import Plane
from gpusim.report.drawing import INK, LINE, SOFT, STYLE, panel, titles, write
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, adaptation, encode_srgb, rgb_to_xyz
from gpusim.scene.spectra import colour_matching

_FOOT = (
    "The chart's colours: measured reflectances under the illuminant (CIE 1931 observer). Matrix: "
    "least squares in XYZ over the 24 patches. Shown as sRGB; what lies outside is clipped."
)


def draw_colour(found: ColourReport, planes: dict[str, Plane], title: str) -> Figure:
    """Return the page.

    Parameters
    ----------
    found : ColourReport
    planes : dict of str to Plane
        The picture.
    title : str
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 9.4))
        order = [f"chart under {found.light}"]
        for name, one in (("as it is", found.as_is), ("through the matrix", found.fitted)):
            if one is not None:
                mean = one.delta_e["2000"].mean()
                order.append(f"mean \N{GREEK CAPITAL LETTER DELTA}E2000 {name} {mean:.2f}")
        titles(figure, title, order, top=9.35)
        _picture(panel(figure, 0.6, 5.0, 4.9, 3.2), found, planes)
        _sides(panel(figure, 6.2, 5.0, 5.4, 3.2), found)
        _chromaticities(panel(figure, 0.6, 0.95, 4.2, 3.35), found)
        _differences(panel(figure, 5.8, 1.55, 5.9, 2.75), found)
        write(figure, 0.55, 0.25, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _shown(found: ColourReport, xyz: np.ndarray) -> np.ndarray:
    """Return sRGB of colours under the illuminant, adapted to D65."""
    to_xyz = rgb_to_xyz(REC709_CHROMATICITIES)
    adapted = xyz @ adaptation(found.white_xyz, to_xyz.sum(axis=1)).T
    return encode_srgb(adapted @ np.linalg.inv(to_xyz).T)


def _picture(axes: Axes, found: ColourReport, planes: dict[str, Plane]) -> None:
    values = planes["G"].values
    step = max(1, max(values.shape) // 900)
    seen = np.nan_to_num(values[::step, ::step].astype(np.float64))
    low, high = np.quantile(seen, (0.005, 0.995))
    light = np.clip((seen - low) / max(high - low, 1e-30), 0, 1) ** (1 / 2.2)
    axes.imshow(light, cmap="gray", extent=(0, values.shape[1], values.shape[0], 0))
    colours = _shown(found, found.fitted.xyz)
    for at, corners in enumerate(found.patches.corners):
        axes.add_patch(Polygon(corners, facecolor=colours[at], edgecolor="#ff8c1a", linewidth=0.9))
    axes.grid(False)
    axes.set(title="Where the patches were measured", xlabel="x [px]", ylabel="y [px]")


def _sides(axes: Axes, found: ColourReport) -> None:
    """Show each patch in the chart's colour, and in it the picture's."""
    inner = found.fitted if found.as_is is None else found.as_is
    outer, own = _shown(found, found.chart_xyz), _shown(found, inner.xyz)
    fitted = _shown(found, found.fitted.xyz)
    for at in range(len(outer)):
        row, col = divmod(at, 6)
        box = np.array([[0.04, 0.04], [0.96, 0.04], [0.96, 0.96], [0.04, 0.96]])
        axes.add_patch(Polygon(box + np.array([col, row]), facecolor=outer[at]))
        left = np.array([[0.22, 0.25], [0.5, 0.25], [0.5, 0.75], [0.22, 0.75]])
        axes.add_patch(Polygon(left + np.array([col, row]), facecolor=own[at]))
        axes.add_patch(Polygon(left + np.array([col + 0.28, row]), facecolor=fitted[at]))
        dark = found.chart_xyz[at, 1] < 0.25
        axes.text(
            col + 0.93,
            row + 0.91,
            f"{inner.delta_e['2000'][at]:.1f}",
            fontsize=7,
            ha="right",
            va="bottom",
            color="white" if dark else INK,
        )
    axes.set_xlim(0, 6)
    axes.set_ylim(4, 0)
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    what = "through the matrix" if found.as_is is None else "left as it is, right by the matrix"
    axes.set_title(f"Around: the chart; within: {what}; \N{GREEK CAPITAL LETTER DELTA}E2000")


def _xy(xyz: np.ndarray) -> np.ndarray:
    return xyz[..., :2] / xyz.sum(axis=-1, keepdims=True)


def _chromaticities(axes: Axes, found: ColourReport) -> None:
    locus = _xy(colour_matching().T)
    axes.plot(*np.concatenate([locus, locus[:1]]).T, color=SOFT, linewidth=0.9)
    triangle = np.reshape(REC709_CHROMATICITIES, (4, 2))[[0, 1, 2, 0]]
    axes.plot(*triangle.T, color=LINE, linewidth=0.9)
    chart, colours = _xy(found.chart_xyz), _shown(found, found.chart_xyz)
    one: Colours
    for one, mark, name in (
        (found.as_is, "o", "as it is"),
        (found.fitted, "x", "through the matrix"),
    ):
        if one is None:
            continue
        axes.plot(*one.xy.T, mark, color=INK, markersize=3, fillstyle="none", label=name)
        for a, b in zip(chart, one.xy, strict=True):
            axes.plot([a[0], b[0]], [a[1], b[1]], color=INK, linewidth=0.6)
    axes.scatter(*chart.T, c=colours, s=34, edgecolors=SOFT, linewidths=0.4, label="chart")
    axes.plot(*_xy(found.white_xyz), "+", color="#c0342b", markersize=8, label=found.light)
    axes.set(title="Chromaticities", xlabel="x", ylabel="y", aspect="equal")
    axes.set_xlim(0, 0.75)
    axes.set_ylim(0, 0.87)
    axes.legend(loc="upper right")


def _differences(axes: Axes, found: ColourReport) -> None:
    at = np.arange(len(found.names))
    colours = _shown(found, found.chart_xyz)
    shown = [("as it is", found.as_is), ("through the matrix", found.fitted)]
    shown = [(name, one) for name, one in shown if one is not None]
    for number, (name, one) in enumerate(shown):
        hatch = "" if number == len(shown) - 1 else "////"
        axes.bar(
            at + (number - (len(shown) - 1) / 2) * 0.4,
            one.delta_e["2000"],
            0.38,
            color=colours,
            edgecolor=SOFT,
            linewidth=0.5,
            hatch=hatch,
            label=f"{name}: mean {one.delta_e['2000'].mean():.2f}, "
            f"largest {one.delta_e['2000'].max():.2f}",
        )
    axes.set_xticks(at, found.names, rotation=60, ha="right", fontsize=6.5)
    axes.set_ylim(0, 1.25 * max(float(one.delta_e["2000"].max()) for _, one in shown) + 0.01)
    axes.grid(False, axis="x")
    axes.set(title="Differences from the chart", ylabel="\N{GREEK CAPITAL LETTER DELTA}E2000")
    axes.legend(loc="upper right")
