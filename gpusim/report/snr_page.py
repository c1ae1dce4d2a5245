"""Signal-to-noise ratio of patches on one page, and as facts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gpusim.metrics.snr import Range
from gpusim.report.drawing import COLOURS, INK, SOFT, STYLE, panel, titles, write
from gpusim.report.sheet import Table, sheet

UNITS = (
    "signal and noise in the picture's linear unit; the noise of one picture, temporal and fixed; "
    "dynamic range from SNR 1, by the law of the noise, to the highest signal; standard "
    "uncertainties (k = 1)"
)
_FOOT = "Lines: sigma^2 = r + g S + p S^2, fitted to the patches that are not clipped."


def snr_facts(found: Sequence[Range]) -> dict[str, Any]:
    """Return the figures."""
    return {"units": UNITS, "channels": [_channel(one) for one in found]}


def _channel(one: Range) -> dict[str, Any]:
    return {
        "channel": one.channel,
        "law_r_g_p": None if one.law is None else list(one.law),
        "signal_at_snr_1": one.least,
        "highest_signal": one.highest,
        "highest_is_the_scales_end": one.to_scale_end,
        "dynamic_range_db": one.decibels,
        "patches": [
            {
                "patch": patch.number,
                "region": list(patch.region),
                "signal": patch.signal.value,
                "u_signal": patch.signal.u,
                "noise": patch.noise.value,
                "u_noise": patch.noise.u,
                "snr_db": decibels(patch.snr.value),
                "clipped": patch.clipped,
            }
            for patch in one.patches
        ],
    }


def decibels(ratio: float) -> float | None:
    """Return a ratio in dB; None where it is none."""
    return 20 * math.log10(ratio) if 0 < ratio < math.inf else None


def snr_rows(facts: Mapping[str, Any]) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: one for each patch and channel."""
    parts = ("patch", "signal", "u_signal", "noise", "u_noise", "snr_db", "clipped")
    yield ["channel", *parts]
    for channel in facts["channels"]:
        for patch in channel["patches"]:
            yield [channel["channel"], *(patch[part] for part in parts)]


def draw_snr(found: Sequence[Range], values: np.ndarray, title: str) -> Figure:
    """Return the page: (rows, cols) `values` is what is shown as the picture."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 4.9))
        order = [
            f"{one.channel}: dynamic range {'' if one.to_scale_end else 'at least '}"
            f"{one.decibels:.1f} dB"
            for one in found
            if one.decibels is not None
        ]
        titles(figure, title, order or [f"{len(found)} channels"], top=4.85)
        _picture(panel(figure, 0.6, 0.9, 3.6, 2.7), found, values)
        _noise(panel(figure, 5.0, 0.9, 2.9, 2.7), found)
        _ratio(panel(figure, 8.8, 0.9, 2.9, 2.7), found)
        write(figure, 0.55, 0.25, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _picture(axes: Axes, found: Sequence[Range], values: np.ndarray) -> None:
    step = max(1, max(values.shape) // 900)
    seen = np.nan_to_num(values[::step, ::step].astype(np.float64))
    low, high = np.quantile(seen, (0.001, 0.999))
    light = np.clip((seen - low) / max(high - low, 1e-30), 0, 1) ** (1 / 2.2)
    axes.imshow(light, cmap="gray", extent=(0, values.shape[1], values.shape[0], 0), vmin=0, vmax=1)
    for patch in found[0].patches:
        x, y, width, height = patch.region
        axes.add_patch(Rectangle((x, y), width, height, fill=False, edgecolor="#ff8c1a"))
        axes.text(x, y, str(patch.number), color="#ff8c1a", fontsize=7, va="bottom")
    axes.grid(False)
    axes.set(title="Patches", xlabel="x [px]", ylabel="y [px]")


def _points(one: Range) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = [(p.signal.value, p.noise.value, p.clipped) for p in one.patches if p.signal.value > 0]
    signal, noise, clipped = np.array(rows, float).reshape(-1, 3).T
    return signal, noise, clipped.astype(bool)


def _noise(axes: Axes, found: Sequence[Range]) -> None:
    for one in found:
        colour = COLOURS.get(one.channel[0], INK)
        signal, noise, clipped = _points(one)
        axes.plot(signal[~clipped], noise[~clipped], "o", color=colour, markersize=4)
        axes.plot(signal[clipped], noise[clipped], "x", color=colour, markersize=4)
        if one.law is not None and signal.size:
            at = np.geomspace(max(signal.min() / 3, 1e-9 * signal.max()), signal.max(), 100)
            axes.plot(at, one.noise(at), color=colour, linewidth=0.9, label=one.channel)
    axes.set(title="Noise (crosses: clipped)", xlabel="signal", ylabel="noise")
    axes.set_xscale("log")
    axes.set_yscale("log")
    if any(one.law is not None for one in found):
        axes.legend(loc="upper left")


def _ratio(axes: Axes, found: Sequence[Range]) -> None:
    for one in found:
        colour = COLOURS.get(one.channel[0], INK)
        signal, noise, clipped = _points(one)
        good = ~clipped & (noise > 0)
        axes.plot(
            signal[good], 20 * np.log10(signal[good] / noise[good]), "o", color=colour, markersize=4
        )
        if one.law is not None and one.least:
            at = np.geomspace(one.least, max(one.highest, one.least), 100)
            axes.plot(at, 20 * np.log10(at / one.noise(at)), color=colour, linewidth=0.9)
    axes.axhline(0, color=SOFT, linewidth=0.7)
    axes.set(title="Signal-to-noise ratio", xlabel="signal", ylabel="SNR [dB]")
    axes.set_xscale("log")


def snr_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    ranges = [
        (
            one["channel"],
            "\N{EN DASH}" if one["dynamic_range_db"] is None else f"{one['dynamic_range_db']:.2f}",
            "the scale's end" if one["highest_is_the_scales_end"] else "the brightest patch",
        )
        for one in facts["channels"]
    ]
    patches = [
        (
            one["channel"], str(patch["patch"]), patch["signal"], patch["noise"], patch["u_noise"],
            "\N{EN DASH}" if patch["snr_db"] is None else f"{patch['snr_db']:.2f}",
            "clipped" if patch["clipped"] else "",
        )
        for one in facts["channels"]
        for patch in one["patches"]
    ]  # fmt: skip
    return sheet(
        facts["picture"],
        f"Signal-to-noise ratio by gpusim {facts['gpusim']}; {facts['units']}.",
        drawn,
        "Patches, noise over signal, SNR over signal",
        Table("Dynamic range", ("Channel", "dB", "From SNR 1 to"), ranges),
        Table("Patches", ("Channel", "Patch", "Signal", "Noise", "u", "SNR, dB", ""), patches),
    )
