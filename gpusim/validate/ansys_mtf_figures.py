"""Figures of the Ansys report's sharpness, after the paper's figures 11 to 15."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.report.drawing import INK, LINE, SOFT, STYLE, panel, titles, write
from gpusim.validate.ansys_models import SHOWN
from gpusim.validate.ansys_mtf import FOCUS_BAR, REALISATIONS, SFR_BAR, Sharpness
from gpusim.validate.ansys_square import ROIS

BLUE, RED, GREEN, GOLD = "#2456b8", "#c0342b", "#1b8a6b", "#b8860b"
MAPS = {"electrons": BLUE, "irradiance": RED}
REGIONS = {1: BLUE, 3: RED}  # as in the paper's figures 12 and 13
DASHED = (0, (4, 2))
# How the reduced-order model is drawn, over what is true.
SIMPLER = {"Gaussian": GREEN, "no colour": GOLD, "Gaussian, no colour": RED}
FOCUS_CY_PX = (0.1, 0.25, 0.5)  # whose MTF is drawn over the position of the image plane


def _cycles(axes: Axes, title: str, **more: object) -> None:
    axes.set(title=title, xlabel="cycles per pixel", xlim=(0, 1), **more)


def draw_curves(found: list[Sharpness], charts: Sequence[np.ndarray]) -> Figure:
    """Return the charts, MTFs of ROI 3 and what measured ones miss (figures 11 and 15).

    Pictures (rows, cols) of the charts are given by reading.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 0.7 + 3.5 * len(found)))
        told = "points: renders, with one standard deviation of a frame; lines: rays and the pixel"
        titles(figure, "Sharpness of ROI 3", [told], top=0.65 + 3.5 * len(found))
        f = FREQUENCIES_CY_PX
        for row, (one, picture) in enumerate(zip(found, charts, strict=True)):
            bottom = 0.55 + 3.5 * (len(found) - 1 - row)
            board = panel(figure, 0.35, bottom, 2.3, 2.4)
            board.imshow(picture, cmap="gray", interpolation="nearest")
            for number, (x, y, width, height) in one.regions.items():
                look = {"fill": False, "edgecolor": REGIONS[number], "linewidth": 1.2}
                board.add_patch(Rectangle((x - 0.5, y - 0.5), width, height, **look))
                board.text(x, y - 2, f"ROI {number}", color=REGIONS[number], va="bottom")
            board.grid(False)
            board.set(title=one.reading.name, xticks=[], yticks=[])
            axes = panel(figure, 3.3, bottom, 4.1, 2.4)
            plain = {"color": SOFT, "linewidth": 1}
            axes.plot(f, one.models["diffraction limit"], label="diffraction limit", **plain)
            own = {"linestyle": (0, (1, 1.5)), "label": "rays alone"}
            axes.plot(f, one.models["rays alone"], **plain, **own)
            sigma = one.noise[SHOWN].sigma
            for name, colour in MAPS.items():
                if (name, SHOWN) not in one.found:
                    continue
                edge = one.found[name, SHOWN]
                axes.plot(f, edge.predicted_mtf, color=colour, linewidth=0.8)
                shown = slice(None, None, 8)
                axes.errorbar(
                    f[shown], edge.measured_mtf[shown],
                    yerr=sigma[shown] if name == "electrons" else None,
                    fmt=".", markersize=4, color=colour, elinewidth=0.7, label=f"{name} map",
                )  # fmt: skip
            model = one.models["Gaussian, no colour"]
            axes.plot(f, model, color=GREEN, linestyle=DASHED, label="Gaussian, no colour")
            _cycles(axes, "MTF", ylim=(0, 1.05))
            axes.legend(loc="best")
            rest = panel(figure, 8.1, bottom, 2.8, 2.4)
            for (name, number), edge in one.found.items():
                look = "-" if number == SHOWN else DASHED
                error = edge.measured_mtf - edge.predicted_mtf
                label = f"{name}, ROI {number}"
                rest.plot(f, error, color=MAPS[name], linestyle=look, linewidth=1, label=label)
            _bar(rest, SFR_BAR)
            _cycles(rest, "Measured less predicted", ylim=(-1.1 * SFR_BAR, 1.8 * SFR_BAR))
            rest.legend(loc="upper right")
    return figure


def _bar(axes: Axes, bound: float) -> None:
    for at in (-bound, bound):
        axes.axhline(at, color=INK, linewidth=0.9, linestyle=DASHED)


def draw_noise(found: list[Sharpness]) -> Figure:
    """Return SFRs of all realisations, and their standard deviation (figures 12 and 13)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 0.9 + 3.3 * len(found)))
        told = (
            f"{REALISATIONS} frames; band: 95 % interval of a standard deviation from so many, "
            "about the closed form (line); points: measured, filled where they are judged"
        )
        titles(figure, "Noise of the SFR", [told], top=0.85 + 3.3 * len(found))
        f = FREQUENCIES_CY_PX
        for row, one in enumerate(found):
            bottom = 0.55 + 3.3 * (len(found) - 1 - row)
            write(figure, 0.65, bottom + 2.6, one.reading.name, color=SOFT)
            for col, number in enumerate(ROIS):
                noise, colour = one.noise[number], REGIONS[number]
                axes = panel(figure, 0.65 + 2.75 * col, bottom, 2.2, 2.2)
                axes.plot(f, noise.curves.T, color=SOFT, linewidth=0.4)
                axes.plot(f, noise.curves.mean(axis=0), color=colour)
                _cycles(axes, f"SFR, ROI {number}", ylim=(0, 1.1))
                rest = panel(figure, 6.3 + 2.55 * col, bottom, 2.1, 2.2)
                low, high = noise.interval
                rest.fill_between(f, low, high, color=LINE, linewidth=0)
                rest.plot(f, noise.expected, color=INK, linewidth=1)
                look = {"linestyle": "none", "marker": "o", "markersize": 3, "color": colour}
                rest.plot(f[::5], noise.sigma[::5], markerfacecolor="none", **look)
                rest.plot(f[noise.judged], noise.sigma[noise.judged], **look)
                _cycles(rest, f"Standard deviation, ROI {number}")
                rest.set_ylim(0, None)
    return figure


def draw_focus(found: list[Sharpness]) -> Figure:
    """Return MTFs over the image plane's position, and what a shift takes (figure 14)."""
    colours = (BLUE, RED, GOLD, GREEN)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 0.7 + 3.3 * len(found)))
        told = "points: renders; lines: rays; the image plane moves away from the lens"
        titles(figure, "Through focus, ROI 3", [told], top=0.65 + 3.3 * len(found))
        f = FREQUENCIES_CY_PX
        for row, one in enumerate(found):
            bottom = 0.55 + 3.3 * (len(found) - 1 - row)
            first = panel(figure, 0.65, bottom, 2.9, 2.2)
            at_um = [at.shift_um for at in one.focus]
            seen = [at for at in one.focus if at.measured is not None]
            for colour, frequency in zip(colours, FOCUS_CY_PX, strict=False):
                predicted = [np.interp(frequency, f, at.predicted) for at in one.focus]
                measured = [np.interp(frequency, f, at.measured) for at in seen]
                first.plot(at_um, predicted, color=colour, label=f"{frequency:g}")
                places = [at.shift_um for at in seen]
                first.plot(places, measured, ".", markersize=6, color=colour)
            first.set(title=one.reading.name, xlabel="shift [um]", ylabel="MTF", ylim=(0, 1.25))
            first.legend(loc="upper right", ncol=3, title="cycles/px")
            loss = panel(figure, 4.4, bottom, 3.0, 2.2)
            for colour, (shift, (_, lost)) in zip(colours, one.losses().items(), strict=False):
                loss.plot(f, lost, color=colour, linewidth=1, label=f"{shift:+g} um")
            _cycles(loss, "Taken from the MTF")
            loss.legend(loc="upper right")
            if not seen:
                continue
            rest, shown = panel(figure, 8.1, bottom, 2.8, 2.2), slice(None, None, 8)
            for colour, (measured, lost) in zip(colours, one.losses().values(), strict=False):
                loss.plot(f[shown], measured[shown], ".", markersize=4, color=colour)
                rest.plot(f, measured - lost, color=colour, linewidth=1)
            _bar(rest, FOCUS_BAR)
            _cycles(rest, "Measured less predicted")
    return figure


def draw_models(found: list[Sharpness]) -> Figure:
    """Return what simpler models make of the MTF, and what they miss."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(0.6 + 5.4 * len(found), 4.4))
        told = "solid grey: as it is; coloured: what a model says more"
        titles(figure, "Simpler models of ROI 3", [told], top=4.35)
        f = FREQUENCIES_CY_PX
        for col, one in enumerate(found):
            axes = panel(figure, 0.7 + 5.4 * col, 0.65, 4.7, 2.6)
            true = one.models["lens and pixel"]
            for name, colour in SIMPLER.items():
                axes.plot(f, one.models[name] - true, color=colour, label=name)
            axes.axhline(0, color=SOFT, linewidth=0.9)
            _cycles(axes, one.reading.name, ylabel="MTF, model less lens" if col == 0 else "")
            axes.legend(loc="best")
    return figure
