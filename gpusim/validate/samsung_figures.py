"""Figures of the Samsung report, after the paper's own."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from gpusim.report.drawing import INK, LINE, SOFT, STYLE, panel, titles
from gpusim.scene.spectra import colour_matching
from gpusim.validate.samsung_camera import LENSES, LINES_NM
from gpusim.validate.samsung_colour import PATCHES, XY_BAR, Colours, xy
from gpusim.validate.samsung_corners import CORNER_BAR_PX, Corners
from gpusim.validate.samsung_edges import ESF_BAR, PLACES, Edges
from gpusim.validate.samsung_noise import ISOS, Noise
from gpusim.validate.samsung_qe import CHANNELS, SHOWN_NM, Efficiency

RED, BLUE, GREEN = "#c0342b", "#2456b8", "#1b8a6b"
COLOURS = {"R": RED, "G": GREEN, "Gr": GREEN, "Gb": "#7a9a2e", "B": BLUE}
ARROWS, CHIEF_ARROWS = 5e4, 200.0  # how much longer than the errors of corners
SHOWN_PX = 6.0  # of the edges, on either side
TITLES = {
    "axis": "axis",
    "tangential": "0.5 field, along the radius",
    "sagittal": "0.5 field, across it",
}


def draw_edges(edges: Edges) -> Figure:
    """Return the edge spread functions of all lenses and places (figure 9 of the paper)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 10.2))
        told = "dots: measured in the render; lines: light as a wave; dashes: its rays alone"
        titles(figure, "Edge spread functions", [told, edges.tracer], top=10.15)
        for row, optics in enumerate(LENSES):
            for col, where in enumerate(PLACES):
                own = [o for o in edges.found if o.optics == optics and o.where == where]
                if not own:
                    continue
                axes = panel(figure, 0.75 + 3.55 * col, 6.75 - 3.05 * row, 3.0, 2.2)
                for one in own:
                    color, at = COLOURS[one.channel], one.distance_px
                    name = f"{LINES_NM[one.channel]:g} nm, {one.error:.4f}"
                    axes.plot(at, one.wave, color=color, label=name)
                    axes.plot(at, one.rays, color=color, linewidth=0.8, linestyle=(0, (4, 2)))
                    dots = {"marker": "o", "markersize": 2.5, "linestyle": "none", "color": INK}
                    axes.plot(at[::16], one.measured[::16], **dots)
                axes.set(title=f"{optics.full_deg:g} deg, {TITLES[where]}", ylim=(-0.05, 1.08))
                axes.set(xlim=(-SHOWN_PX, SHOWN_PX), xlabel="distance [px]", ylabel="ESF")
                axes.legend(loc="upper left", title=f"largest error (bar {ESF_BAR:g})",
                            title_fontsize=7.5)  # fmt: skip
    return figure


def draw_corners(corners: Corners) -> Figure:
    """Return where corners of a checkerboard are found, and their errors as arrows."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.4))
        told = f"red, {ARROWS:g} times as long: measured less predicted"
        chief = f"blue, {CHIEF_ARROWS:g} times: measured less chief ray"
        titles(figure, "Corners of a checkerboard", [told, chief], top=4.35)
        for col, optics in enumerate(LENSES):
            own = [one for one in corners.found if one.optics == optics]
            axes = panel(figure, 0.75 + 3.55 * col, 0.6, 3.0, 2.4)
            for one in own:
                x, y = one.measured
                axes.plot(x, y, "o", color=INK, markersize=3)
                for other, color, times in (
                    (one.chief, BLUE, CHIEF_ARROWS), (one.predicted, RED, ARROWS)
                ):  # fmt: skip
                    end = x + times * (x - other[0]), y + times * (y - other[1])
                    axes.annotate("", end, (x, y), arrowprops={"arrowstyle": "->", "color": color})
            title = f"{optics.full_deg:g} deg"
            if own:
                title += f": {corners.rms_px(optics):.4f} px RMS (bar {CORNER_BAR_PX:g})"
            axes.set(title=title, xlim=(-300, 2300), ylim=(1500, -300), xlabel="x [px]")
            axes.set_ylabel("y [px]" if col == 0 else "")
            axes.set_aspect("equal")
    return figure


def draw_efficiency(found: Efficiency) -> Figure:
    """Return quantum efficiency by field (figure 5 of the paper), and the Gr/Gb split."""
    last = len(found.places) - 1
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.9))
        told = "direct averages over the rays of an independent tracer; dots: rendered"
        titles(figure, "Quantum efficiency by field", [told], top=4.85)
        left = panel(figure, 0.75, 0.75, 4.6, 2.9)
        right = panel(figure, 6.2, 0.75, 4.6, 2.9)
        for name in CHANNELS:
            look = {"color": COLOURS[name]}
            left.plot(SHOWN_NM, found.curves[0, name], label=name, **look)
            left.plot(SHOWN_NM, found.curves[last, name], linestyle=(0, (4, 2)), **look)
        left.set(title="On the axis (lines) and in the corner (dashes)", xlabel="wavelength [nm]")
        left.set(ylabel="electrons per photon", ylim=(0, None))
        left.legend(loc="upper right", ncol=2)
        number = np.arange(len(found.places))
        splits = [[100 * p.split(of) for p in found.places for of in (getattr(p, side),)]
                  for side in ("predicted", "measured")]  # fmt: skip
        right.bar(number, splits[0], width=0.6, color=LINE, label="averaged directly")
        right.plot(number, splits[1], "o", color=INK, markersize=4, label="rendered")
        names = [f"{p.x_mm:.1f}\n{p.y_mm:.1f}" for p in found.places]
        right.set(title="Gr over Gb, by place", ylabel="Gr / Gb - 1 [%]")
        right.set_xticks(number, names)
        right.set_xlabel("x, y [mm]")
        right.legend(loc="best")
    return figure


def draw_colours(colours: Colours) -> Figure:
    """Return the chromaticities of the patches, the developed picture, and the misses."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 6.9))
        told = "crosses: developed by LibRaw; circles: the model's truth; grey squares: the chart"
        titles(figure, "ColorChecker through the chain", [told, "CIE 1931"], top=6.85)
        left = panel(figure, 0.75, 0.75, 4.9, 5.0)
        locus = xy(colour_matching().T)
        left.plot(*np.concatenate([locus, locus[:1]]).T, color=SOFT, linewidth=0.9)
        own = slice(0, PATCHES)
        bare = {"linestyle": "none", "fillstyle": "none"}
        for one, other in zip(colours.chart[own], colours.truth[own], strict=True):
            left.plot(*np.array([one, other]).T, color=SOFT, linewidth=0.6)
        left.plot(*colours.chart[own].T, "s", color=SOFT, markersize=4, label="chart", **bare)
        left.plot(*colours.truth[own].T, "o", color=BLUE, markersize=7, label="truth", **bare)
        left.plot(*colours.developed[own].T, "+", color=RED, markersize=7, label="developed")
        left.set(xlabel="x", ylabel="y", xlim=(0.1, 0.66), ylim=(0.1, 0.6), aspect="equal")
        left.set_title("18 patches (figure 13 of the paper)")
        left.legend(loc="upper right")
        shown = panel(figure, 6.2, 3.05, 4.6, 2.7)
        shown.imshow(colours.picture)
        shown.set(title="The picture (figure 12)", xticks=[], yticks=[])
        shown.grid(False)
        low = panel(figure, 6.6, 0.75, 4.2, 1.7)
        number = np.arange(1, PATCHES + 1)
        low.bar(number, colours.misses[own], color=RED, width=0.6)
        low.axhline(XY_BAR, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        low.annotate(f"bar {XY_BAR:g}", (PATCHES + 0.6, XY_BAR), (0, 3), ha="right",
                     textcoords="offset points")  # fmt: skip
        low.set(title="From the truth", xlabel="patch", ylabel="distance in xy")
        low.set(
            xlim=(0.4, PATCHES + 0.6),
            xticks=number[::2],
            ylim=(0, 1.3 * max(XY_BAR, colours.misses[own].max())),
        )
    return figure


def draw_noise(noise: Noise) -> Figure:
    """Return signal and SNR by exposure and ISO: dots measured, lines by the equations."""
    shades = matplotlib.colormaps["viridis"](np.linspace(0.05, 0.85, len(ISOS)))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.9))
        told = "dots: measured in pairs of frames; lines: equations"
        titles(figure, "Signal and noise of the green channel", [told], top=4.85)
        left, right = panel(figure, 0.75, 0.75, 4.6, 2.9), panel(figure, 6.2, 0.75, 4.6, 2.9)
        for iso, shade in zip(ISOS, shades, strict=True):
            own = [one for one in noise.readings if one.iso == iso and one.channel == "G"]
            at = [1e3 * one.exposure_s for one in own]
            dots = {"marker": "o", "markersize": 4, "linestyle": "none", "color": shade}
            left.plot(at, [one.expected_dn for one in own], color=shade, label=f"ISO {iso}")
            left.plot(at, [one.signal_dn for one in own], **dots)
            noisy = [one for one in own if one.snr is not None]
            at = [1e3 * one.exposure_s for one in noisy]
            right.plot(at, [one.expected_snr for one in noisy], color=shade)
            right.plot(at, [one.snr for one in noisy], **dots)
        given = {"xscale": "log", "yscale": "log", "xlabel": "exposure [ms]"}
        left.set(title="Signal (equations 2 and 3)", ylabel="signal [DN]", **given)
        right.set(title="Temporal signal-to-noise ratio", ylabel="SNR [1]", **given)
        left.legend(loc="upper left")
    return figure
