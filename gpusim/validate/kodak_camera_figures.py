"""Figures of the Kodak report's camera: squares, PSFs, effects, hues, noise, and what N costs."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gpusim.report.drawing import COLOURS, INK, LINE, SOFT, STYLE, panel, titles, write
from gpusim.validate.kodak import BANDS
from gpusim.validate.kodak_cost import EDGES, Costs
from gpusim.validate.kodak_effects import Effects
from gpusim.validate.kodak_figures import NAMES
from gpusim.validate.kodak_noise import INEFFICIENCIES, PATCHES, Hues, Noises
from gpusim.validate.kodak_psf import BAR, PITCH_UM, WAVELENGTH_NM, PointSpreads

# About as their names; of the patches but the neutral one, in their order.
PATCH_COLOURS = ("#b5322f", "#d97a26", "#c9a800", "#3f8f4a", "#1f8fa8", "#2f4fb0")
DECADES = 4  # of PSFs
EFFECTS_ACROSS = 3


def draw_squares(effects: Effects) -> Figure:
    """Return the two-level target in grey (figure 7), and the bands of a corner (figure 8)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 7.0))
        told = [
            "640 x 480 pixels, filters binned two by two",
            "right: 80 x 64 pixels of the corner",
        ]
        titles(figure, "Squares before the stand-in lens, no effect of the sensor", told, top=6.95)
        rows, cols = effects.picture.shape
        grey = effects.picture.reshape(rows // 2, 2, cols // 2, 2).mean(axis=(1, 3))
        _shown(panel(figure, 0.55, 0.45, 7.1, 5.3), grey, 0, grey.max())
        for number, name in enumerate(BANDS):
            band = effects.bands[..., number]
            axes = panel(figure, 8.15, 4.15 - 1.95 * number, 2.1, 1.68)
            _shown(axes, band, 0, band.max())
            axes.set_title(NAMES[name], color=COLOURS[name])
    return figure


def draw_psfs(psfs: PointSpreads) -> Figure:
    """Return PSFs at three image points (figure 6): ours, the tracer's, and a cut through both."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 9.8))
        told = (
            f"{WAVELENGTH_NM:g} nm, {DECADES} decades, samples of {PITCH_UM:g} um; outwards right"
        )
        titles(figure, "PSFs at three image points", [told], top=9.75)
        half = PITCH_UM * len(psfs.found[0].own) / 2
        for col, one in enumerate(psfs.found):
            left = 0.9 + 3.5 * col
            for row, (name, values) in enumerate((("ours", one.own), ("traced", one.predicted))):
                axes = panel(figure, left, 5.65 - 3.0 * row, 2.75, 2.75)
                seen = np.log10(np.maximum(values / values.max(), 10.0**-DECADES))
                axes.imshow(seen, cmap="magma", vmin=-DECADES, vmax=0, extent=(-half, half) * 2)
                axes.grid(False)
                axes.set(xticks=[], yticks=[])
                axes.set_title(f"{one.where}, {one.field_deg:.1f} deg: {name}")
            axes = panel(figure, left, 0.65, 2.75, 1.6)
            at = (np.arange(len(one.own)) - len(one.own) / 2) * PITCH_UM
            for values, look in ((one.predicted, {"color": INK}), (one.own, _dots("#c0342b"))):
                axes.plot(at, values.sum(axis=0) / values.sum(), **look)
            axes.set(xlim=(-12, 12), xlabel="along the radius [um]", yticks=[])
            axes.set_title(f"line spread; misplaced {one.elsewhere:.2%}, bar {BAR:.0%}")
    return figure


def draw_effects(effects: Effects) -> Figure:
    """Return each effect off and on, side by side, and what it changed."""
    rows = -(-len(effects.found) // EFFECTS_ACROSS)
    height = 1.4 + 1.75 * rows
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, height))
        told = "lower right corner: off, on, and what that changed, on a scale of its own"
        titles(figure, "Effects of the camera, each alone", [told], top=height - 0.05)
        for number, one in enumerate(effects.found):
            row, col = divmod(number, EFFECTS_ACROSS)
            left, bottom = 0.55 + 3.5 * col, height - 2.55 - 1.75 * row
            part = np.s_[-40:, -48:]
            off, on = one.off[part], one.on[part]
            top = max(off.max(), on.max())
            _shown(panel(figure, left, bottom, 1.06, 0.88), off, 0, top)
            _shown(panel(figure, left + 1.1, bottom, 1.06, 0.88), on, 0, top)
            change = on - off
            size = np.abs(change).max()
            axes = panel(figure, left + 2.2, bottom, 1.06, 0.88)
            _shown(axes, change, -size, size, "RdBu_r")
            write(figure, left, bottom + 1.14, one.name, fontweight="bold")
            write(figure, left, bottom + 0.97, one.told, fontsize=7, color=SOFT)
            unit = "DN" if one.name == "ADC" else "e-"
            write(figure, left + 2.2, bottom - 0.14, f"\N{PLUS-MINUS SIGN}{size:.3g} {unit}",
                  fontsize=7, color=SOFT)  # fmt: skip
            told = f"law: {one.bar.value:.2g} {one.bar.unit} (bar {one.bar.bound:.2g})"
            write(figure, left, bottom - 0.14, told, fontsize=7, color=SOFT)
    return figure


def draw_hues(hues: Hues) -> Figure:
    """Return how charge that is left behind shifts colours along a row."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.9))
        told = "share left behind in each transfer of the serial register, read out at column 0"
        titles(figure, "Hue shift across the array", [told], top=4.85)
        left, right = panel(figure, 0.75, 0.75, 4.6, 2.95), panel(figure, 6.2, 0.75, 3.4, 2.95)
        for number, share in enumerate(INEFFICIENCIES):
            for which, name in ((0, "R"), (1, "B")):
                percent = [100 * (one[number, which] - 1) for one in (hues.ratios, hues.expected)]
                label = f"{name}/G, {share:g}"
                width = 0.8 + 0.5 * number
                left.plot(hues.columns, percent[1], color=COLOURS[name], lw=width, label=label)
                step = slice(10 * number, None, 40)
                left.plot(hues.columns[step], percent[0][step], **_dots(INK))
        left.set(xlabel="column", ylabel="shift of the ratio [%]", xlim=(0, 640))
        left.set_title("A grey: closed form (lines), read out (dots)")
        left.legend(loc="upper left", ncol=3)
        middle = len(INEFFICIENCIES) // 2
        for patch, color in enumerate(PATCH_COLOURS):
            name = PATCHES[patch + 1]
            shift = hues.hue_deg[middle, patch]
            right.plot(hues.columns, shift, color=color, label=f"{name} {shift[-1]:+.1f}")
        right.set(xlabel="column", ylabel="shift of the hue angle, CIELAB [deg]", xlim=(0, 640))
        right.set_title(f"Patches, {INEFFICIENCIES[middle]:g} left behind")
        right.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def draw_noises(noises: Noises) -> Figure:
    """Return variance and skewness of physical and parametric noise."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.9))
        told = "electrons are counted (physical), or a normal law has two numbers (the paper's)"
        titles(figure, "Temporal noise, physical and parametric", [told], top=4.85)
        left, right = panel(figure, 0.85, 0.75, 4.5, 2.95), panel(figure, 6.4, 0.75, 4.4, 2.95)
        signal = np.array([one.signal_e for one in noises.levels])
        fine = np.geomspace(signal[0], signal[-1], 200)
        read_e2 = noises.levels[0].expected_variance - noises.levels[0].signal_e
        left.plot(fine, fine + read_e2, color=INK, label="closed form, of both")
        right.plot(fine, fine / (fine + read_e2) ** 1.5, color=COLOURS["B"], label="closed form")
        right.axhline(0, color=COLOURS["R"])
        for number, (name, color) in enumerate((("physical", "B"), ("parametric", "R"))):
            dots = {**_dots(COLOURS[color]), "label": name}
            at = signal * (1.04 if number else 0.96)
            left.plot(signal, [one.variance[name] for one in noises.levels], **dots)
            dots.pop("marker"), dots.pop("markersize")
            skewness = [one.skewness[name] for one in noises.levels]
            bars = [np.sqrt(6 / one.pixels) for one in noises.levels]
            right.errorbar(at, skewness, bars, fmt="o", markersize=3, elinewidth=0.8, **dots)
        left.set(xscale="log", yscale="log", xlabel="mean [e-]", ylabel="variance [e-^2]")
        right.set(xscale="log", xlabel="mean [e-]", ylabel="skewness")
        left.legend(loc="upper left")
        right.legend(loc="upper left")
        note = (
            "Both have one variance; only counting is skewed, and least where read-out noise rules."
        )
        write(figure, 0.85, 0.22, note, fontsize=7.5, color=SOFT, va="center")
    return figure


def draw_costs(costs: Costs) -> Figure:
    """Return error against run time at N samples a pixel."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.9))
        told = "in the dots: N; a region of 64 x 64 pixels, one band; the paper works with N = 2"
        titles(figure, "Error against run time at N samples a pixel", [told], top=4.85)
        panels = [panel(figure, 0.85 + 3.55 * k, 0.75, 2.8, 2.95) for k in range(3)]
        seconds = [one.median_s for one in costs.found]
        spread = np.array([(min(one.seconds), max(one.seconds)) for one in costs.found])
        within = np.abs(spread.T - np.array(seconds))
        parts = {
            "grid_rms": "signal against N = 16, RMS",
            "mtf": "MTF to 1 cycle/px, largest",
            "position_px": "edge's position [px]",
        }
        for axes, (part, title) in zip(panels, parts.items(), strict=True):
            for edge, color in zip(EDGES, ("#c0342b", "#2456b8"), strict=True):
                errors = [abs(getattr(one.errors[edge], part)) for one in costs.found]
                look = {"color": color, "marker": "o", "markersize": 9, "linestyle": "none"}
                axes.errorbar(seconds, errors, xerr=within, label=f"edge {edge}", **look)
                for one, x, y in zip(costs.found, seconds, errors, strict=True):
                    axes.annotate(f"{one.samples}", (x, y), ha="center", va="center_baseline",
                                  fontsize=7, color="white")  # fmt: skip
            axes.set(yscale="log", xlabel="run time [s]", title=title)
            axes.set_xlim(0, 1.2 * spread.max())
            axes.margins(y=0.15)
        panels[0].legend(loc="lower left")
    return figure


def _shown(axes: Axes, values: np.ndarray, low: float, high: float, cmap: str = "gray") -> None:
    axes.imshow(values, cmap=cmap, vmin=low, vmax=high, interpolation="nearest", aspect="auto")
    axes.grid(False)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(True)
    axes.spines[:].set_color(LINE)


def _dots(color: str) -> dict[str, object]:
    return {"color": color, "marker": "o", "markersize": 2.6, "linestyle": "none"}
