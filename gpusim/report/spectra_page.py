"""Sinusoids on one page, and as facts: where they are, their spectra, their waves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gpusim.metrics import figure as figures
from gpusim.metrics.sinusoid import Sinusoid
from gpusim.report.drawing import INK, SOFT, STYLE, panel, titles, write
from gpusim.report.sheet import Table, sheet

COLOURS = ("#2456b8", "#d2691e", "#1b8a6b", "#7a3fa0", "#c0342b", INK)
UNITS = (
    "cycles per pixel along the normal of the crests; amplitude in the picture's unit, linear; "
    "standard uncertainties (k = 1)"
)
# Columns of pictures whose distortion is known.
STRAIGHT = {
    "undistorted_cy_px": "Undistorted, c/px",
    "over_undistorted": "Frequency over that",
}
Found = Sequence[tuple[int, str, Sinusoid]]
_FOOT = (
    "A wave over a plane by least squares on the region's pixels. Spectra: along the wave's "
    "normal, Hann window."
)


def spectra_facts(
    found: Found, undistorted: Callable[[Sinusoid], float] | None = None
) -> dict[str, Any]:
    """Return the figures: of region, channel and wave.

    Parameters
    ----------
    found : sequence of (int, str, Sinusoid)
    undistorted : callable, optional
        Gives a wave's frequency in the undistorted picture, cycles/px.
    """
    waves = [_wave(*one) for one in found]
    if undistorted is not None:
        for facts, (_, _, one) in zip(waves, found, strict=True):
            straight = undistorted(one)
            facts["undistorted_cy_px"] = straight
            facts["over_undistorted"] = one.frequency_cy_px.value / straight
    return {"units": UNITS, "waves": waves}


def _wave(number: int, channel: str, one: Sinusoid) -> dict[str, Any]:
    def pair(value: figures.Figure) -> dict[str, float]:
        return {"value": value.value, "u": value.u}

    return {
        "region": number,
        "box": list(one.region),
        "channel": channel,
        "frequency_cy_px": pair(one.frequency_cy_px),
        "frequency_x": pair(one.frequency_x),
        "frequency_y": pair(one.frequency_y),
        "amplitude": pair(one.amplitude),
        "mean": one.mean,
        "modulation": pair(one.modulation),
        "phase_deg": one.phase_deg,
        "noise": one.noise,
        "second_harmonic": one.harmonic,
        "spectrum": one.spectrum.tolist(),
    }


def spectra_rows(found: Found) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: spectra over the frequency."""
    yield ["cycles_per_px", *(f"amplitude {number} {channel}" for number, channel, _ in found)]
    for row, frequency in enumerate(found[0][2].spectrum_cy_px):
        yield [f"{frequency:.4f}", *(f"{one.spectrum[row]:.7g}" for _, _, one in found)]


def draw_spectra(found: Found, values: np.ndarray, title: str) -> Figure:
    """Return the page: (rows, cols) `values` is what is shown as the picture."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 8.6))
        order = [f"{len(found)} wave{'s' * (len(found) != 1)}"]
        titles(figure, title, order, top=8.55)
        _picture(panel(figure, 0.6, 4.35, 5.2, 2.95), found, values)
        _waves(panel(figure, 6.7, 4.35, 5.0, 2.95), found)
        _spectra(panel(figure, 0.9, 0.95, 10.8, 2.75), found)
        write(figure, 0.55, 0.25, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _picture(axes: Axes, found: Found, values: np.ndarray) -> None:
    step = max(1, max(values.shape) // 1200)
    seen = np.nan_to_num(values[::step, ::step].astype(np.float64))
    low, high = np.quantile(seen, (0.001, 0.999))
    axes.imshow(
        seen, cmap="gray", extent=(0, values.shape[1], values.shape[0], 0), vmin=low, vmax=high
    )
    for number, (x, y, width, height) in {one[0]: one[2].region for one in found}.items():
        colour = COLOURS[(number - 1) % len(COLOURS)]
        axes.add_patch(
            Rectangle((x, y), width, height, fill=False, edgecolor=colour, linewidth=1.5)
        )
        axes.text(x + 3, y + 3, str(number), color=colour, va="top", weight="bold")
    axes.grid(False)
    axes.set(title="Regions", xlabel="x [px]", ylabel="y [px]")


def _waves(axes: Axes, found: Found) -> None:
    """Show the pixels of all regions by their phase, and the fitted waves."""
    at = np.linspace(0, 2, 200)
    for number, channel, one in found:
        colour = COLOURS[(number - 1) % len(COLOURS)]
        phase = one.phase_deg / 360
        keep = np.s_[:: max(1, len(one.places) // 1500)]
        scale = one.amplitude.value
        folded = (one.places[keep] + phase) % 1
        axes.plot(folded, one.values[keep] / scale, ".", color=colour, markersize=1.5, alpha=0.5)
        axes.plot(
            folded + 1, one.values[keep] / scale, ".", color=colour, markersize=1.5, alpha=0.5
        )
        label = f"{number} {channel}: modulation {one.modulation.value:.4f}"
        axes.plot([], [], color=colour, label=label)
    axes.plot(at, np.cos(2 * np.pi * at), color=INK, linewidth=0.9)
    axes.set(title="Pixels by their phase", xlabel="waves", ylabel="of the amplitude")
    axes.set_ylim(-1.6, 1.9)
    axes.legend(loc="upper right", ncol=2)


def _spectra(axes: Axes, found: Found) -> None:
    for number, channel, one in found:
        colour = COLOURS[(number - 1) % len(COLOURS)]
        f = one.frequency_cy_px
        axes.plot(
            one.spectrum_cy_px,
            one.spectrum,
            color=colour,
            label=f"{number} {channel}: {f.value:.5f} \N{PLUS-MINUS SIGN} {f.u:.5f} c/px",
        )
        axes.plot(f.value, one.amplitude.value, "o", color=colour, fillstyle="none", markersize=6)
    axes.axvline(0.5, color=SOFT, linewidth=0.7, linestyle=(0, (2, 2)))
    axes.set(title="Spectra", xlabel="cycles per pixel", ylabel="amplitude")
    axes.set_xlim(0, 0.52)
    axes.set_ylim(0, None)
    axes.legend(loc="upper right")


def harmonic_of(wave: Mapping[str, Any]) -> str:
    """Return the second harmonic of a wave's facts as a text."""
    value = wave["second_harmonic"]
    return "\N{EN DASH}" if value is None else f"{value:.5f}"


def spectra_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    head = ("Region", "Channel", "x, y, width, height", "Frequency, c/px", "u", "Amplitude", "u")
    rows = [
        (
            str(one["region"]), one["channel"], ", ".join(map(str, one["box"])),
            one["frequency_cy_px"]["value"], one["frequency_cy_px"]["u"],
            one["amplitude"]["value"], one["amplitude"]["u"],
            one["modulation"]["value"], harmonic_of(one),
            *(one[key] for key in STRAIGHT if key in one),
        )
        for one in facts["waves"]
    ]  # fmt: skip
    said = f"Sinusoids by gpusim {facts['gpusim']}; {facts['units']}."
    more = [name for key, name in STRAIGHT.items() if key in facts["waves"][0]]
    waves = Table("Waves", (*head, "Modulation", "Second harmonic", *more), rows)
    return sheet(facts["picture"], said, drawn, "Regions, waves by phase, spectra", waves)
