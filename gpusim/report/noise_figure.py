"""The plots of an EMVA 1288 data sheet on one page."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, NullFormatter
from scipy.ndimage import uniform_filter

from gpusim.metrics.emva import Channel, Characterisation
from gpusim.metrics.nonuniformity import Pattern, spectrogram
from gpusim.metrics.photon_transfer import FIT_SHARE
from gpusim.report.drawing import INK, SOFT, STYLE, absent, panel, titles, write

# By the colour of the filter, dark enough to read on white, and told apart by lightness too.
COLOURS = {
    "R": "#c0342b",
    "G": "#1b8a6b",
    "B": "#2456b8",
    "C": "#1596a8",
    "M": "#a0348f",
    "Y": "#b08a00",
    "W": "#1b1f24",
}
_DARK = "#5d6773"
_SECOND_STYLE = (0, (4, 2))  # of a second channel of one colour
BINS = 256  # of a histogram at most, as in the standard
SMOOTHING_PX = 5  # side of the mean that is taken off before the histogram of PRNU
_WIDTH, _HEIGHT = 5.0, 2.05
_LEFT = (0.8, 6.7)
_PITCH = 2.95
_FOOT = (
    "EMVA 1288 R3.1. Lines are fitted up to 70 % of saturation, those of the linearity from 5 to "
    "95 %. Spectrograms and histograms: averaged frames, temporal noise subtracted from the former."
)


def draw_noise(found: Characterisation, title: str, how: str, *, titled: bool = True) -> Figure:
    """Return the page as a figure, with its title or without.

    Parameters
    ----------
    found : Characterisation
    title, how : str
        What was measured, and on which frames.
    """
    rows = 6
    tall = 0.75 + rows * _PITCH + (0.75 if titled else 0.0)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, tall))
        if titled:
            titles(figure, title, [how], top=tall - 0.05)
        axes = [
            panel(figure, left, 0.95 + (rows - 1 - row) * _PITCH, _WIDTH, _HEIGHT)
            for row in range(rows)
            for left in _LEFT
        ]
        _photon_transfer(axes[0], found)
        _snr(axes[1], found)
        _sensitivity(axes[2], found)
        _deviation(axes[3], found)
        _against_time(axes[4], found, "mean", "Dark signal: its slope is the dark current", "DN")
        _against_time(axes[5], found, "variance", "Dark variance", "DN$^2$")
        for panel_axes, axis in zip(axes[6:8], (1, 0), strict=True):
            _spectrogram(panel_axes, found, axis)
        _offsets(axes[8], found)
        _responses(axes[9], found)
        for panel_axes, axis in zip(axes[10:12], (1, 0), strict=True):
            _profile(panel_axes, found, axis)
        write(figure, 0.55, 0.25, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _styles(found: Characterisation) -> list[tuple[Channel, dict]]:
    """Return the channels with the look of their lines."""
    seen, styled = set(), []
    for channel in found.channels:
        colour = COLOURS.get(channel.name[0], INK)
        style = _SECOND_STYLE if colour in seen else "-"
        seen.add(colour)
        styled.append((channel, {"color": colour, "linestyle": style}))
    return styled


def _name(channel: Channel) -> str:
    if channel.wavelength_nm is None:
        return channel.name
    return f"{channel.name}, {channel.wavelength_nm:g} nm"


def _photon_transfer(axes: Axes, found: Characterisation) -> None:
    for channel, style in _styles(found):
        transfer = channel.transfer
        signal, variance = transfer.signal, transfer.variance - transfer.dark_variance
        colour = style["color"]
        axes.plot(signal, variance, ".", color=colour, markersize=4)
        gain = channel.figures["system_gain_dn_per_e"].value
        full = signal[transfer.saturation]
        ends = np.array([0.0, FIT_SHARE * full])
        axes.plot(ends, gain * ends, **style, label=f"{channel.name}: K = {gain:.4g} DN/e-")
        axes.plot(full, variance[transfer.saturation], "o", color=colour, markerfacecolor="none")
    axes.set(
        title="Photon transfer",
        xlabel="signal less dark signal [DN]",
        ylabel="variance less dark [DN$^2$]",
    )
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left", title="ring: saturation", title_fontsize=7)


def _snr(axes: Axes, found: Characterisation) -> None:
    for channel, style in _styles(found):
        figures, transfer = channel.figures, channel.transfer
        seen = transfer.variance > 0
        ratio = transfer.signal[seen] / np.sqrt(transfer.variance[seen])
        colour = style["color"]
        upto = np.arange(transfer.photons.size)[seen] <= transfer.saturation
        axes.plot(transfer.photons[seen][upto], ratio[upto], ".", color=colour, markersize=4)
        least = figures["sensitivity_threshold_photons"].value
        photons = np.geomspace(least, transfer.photons[transfer.saturation], 200)
        charge = figures["quantum_efficiency"].value * photons
        gain = figures["system_gain_dn_per_e"].value
        dark = found.figures["temporal_dark_noise_dn"].value / gain
        variance = dark**2 + charge
        axes.plot(photons, charge / np.sqrt(variance), **style, label=_name(channel))
        if "prnu_percent" in figures and "dsnu_e" in found.figures:
            uneven = found.figures["dsnu_e"].value ** 2
            uneven += (figures["prnu_percent"].value / 100 * charge) ** 2
            axes.plot(
                photons, charge / np.sqrt(variance + uneven), ":", color=colour, linewidth=1.1
            )
        axes.plot(least, 1.0, "|", color=colour, markersize=9)
    axes.plot([], [], ":", color=INK, linewidth=1.1, label="with PRNU and DSNU")
    axes.set(title="Signal-to-noise ratio", xlabel="photons per pixel", ylabel="SNR")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.legend(loc="upper left")


def _sensitivity(axes: Axes, found: Characterisation) -> None:
    for channel, style in _styles(found):
        transfer, line = channel.transfer, channel.linearity
        axes.plot(transfer.photons, transfer.signal, ".", color=style["color"], markersize=4)
        ends = np.array([0.0, transfer.photons[line.fitted].max()])
        axes.plot(ends, line.offset_dn + line.slope_dn * ends, **style, label=_name(channel))
    axes.set(title="Linearity", xlabel="photons per pixel", ylabel="signal less dark signal [DN]")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower right")


def _deviation(axes: Axes, found: Characterisation) -> None:
    reach = 0.0
    for channel, style in _styles(found):
        transfer, line = channel.transfer, channel.linearity
        fitted = line.fitted
        share = 100 * transfer.signal / transfer.signal[transfer.saturation]
        axes.plot(share, line.deviation_percent, ".", color=style["color"], markersize=3)
        axes.plot(share[fitted], line.deviation_percent[fitted], **style, label=channel.name)
        reach = max(reach, np.abs(line.deviation_percent[fitted]).max())
    axes.axhline(0, color=SOFT, linewidth=0.7)
    axes.set(
        title="Deviation from the line",
        xlabel="signal [% of saturation]",
        ylabel="deviation [%]",
        xlim=(0, 104),
        ylim=(-2.5 * reach, 2.5 * reach) if reach else None,
    )
    axes.legend(loc="upper right", ncols=len(found.channels))


def _against_time(axes: Axes, found: Characterisation, what: str, title: str, unit: str) -> None:
    series = found.series
    values, u = getattr(series, what), np.sqrt(getattr(series, f"{what}_u2"))
    axes.errorbar(series.exposure_s, values, 3 * u, fmt=".", color=INK, elinewidth=0.8)
    if np.unique(series.exposure_s).size >= 3:
        slope, offset = np.polyfit(series.exposure_s, values, 1, w=1 / np.maximum(u, 1e-15))
        ends = np.array([0.0, series.exposure_s.max()])
        axes.plot(ends, offset + slope * ends, color=COLOURS["B"])
        gain = found.figures["system_gain_dn_per_e"].value
        current = slope / (gain if what == "mean" else gain**2)
        axes.text(0.03, 0.9, f"{current:.4g} e-/s", transform=axes.transAxes, color=COLOURS["B"])
    axes.set(title=title, xlabel="exposure time [s]", ylabel=f"{what} [{unit}], bars 3 u")


def _spectrogram(axes: Axes, found: Characterisation, axis: int) -> None:
    """Draw the horizontal (axis 1) or vertical spectrogram of the dark and the bright stack."""
    title = ("Vertical", "Horizontal")[axis] + " spectrogram"
    if found.dark is None:
        absent(axes, title, "no dark level has more than two frames")
        return
    gain = found.figures["system_gain_dn_per_e"].value
    _power(axes, found.dark, axis, gain, color=_DARK, label="dark [e-]")
    for channel, style in _styles(found):
        bright = channel.bright
        if bright is not None:
            scale = (bright.mean - found.dark.mean) / 100
            _power(axes, bright, axis, scale, **style, label=f"{channel.name} at half [%]")
    axes.set(title=title, xlabel="cycles per photosite of the channel", ylabel="amplitude")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.tick_params(axis="y", which="minor", labelsize=6.5)
    axes.legend(loc="upper right", ncols=4)
    low, high = axes.get_ylim()
    # Within one decade the ticks between tell the scale; over more they would not fit.
    few = high / low < 4
    axes.yaxis.set_minor_formatter(FormatStrFormatter("%g") if few else NullFormatter())
    axes.set_ylim(low, high * (high / low) ** 0.35)


def _power(axes: Axes, pattern: Pattern, axis: int, unit_dn: float, **style: object) -> None:
    power = spectrogram(pattern.images, pattern.residual_dn2, axis)[1:]
    frequency = np.arange(1, power.size + 1) / pattern.images[0].shape[axis]
    positive = power > 0
    amplitude = np.sqrt(power[positive]) / unit_dn
    axes.plot(frequency[positive], amplitude, linewidth=0.9, **style)


def _offsets(axes: Axes, found: Characterisation) -> None:
    title = "Histogram of the offsets (DSNU)"
    if found.dark is None:
        absent(axes, title, "no dark level has more than two frames")
        return
    gain = found.figures["system_gain_dn_per_e"].value
    values = np.concatenate([(one - one.mean()).ravel() for one in found.dark.images]) / gain
    # Averages are multiples of a step: bins that are not would have some of them twice.
    _histogram(axes, values, {"color": _DARK}, "", step=1 / found.dark.frames / gain)
    axes.set(title=title, xlabel="offset from the mean [e-]", ylabel="pixels")


def _responses(axes: Axes, found: Characterisation) -> None:
    title = "Histogram of the responses (PRNU)"
    known = [(channel, style) for channel, style in _styles(found) if channel.bright is not None]
    if found.dark is None or not known:
        absent(axes, title, "no level near half of saturation has more than two frames")
        return
    for channel, style in known:
        signal = channel.bright.mean - found.dark.mean
        smooth = [one - uniform_filter(one, SMOOTHING_PX) for one in channel.bright.images]
        values = 100 * np.concatenate([one.ravel() for one in smooth]) / signal
        _histogram(axes, values, style, channel.name)
    axes.set(title=title, xlabel="deviation from the neighbours' mean [%]", ylabel="pixels")
    if len(known) > 1:
        axes.legend(loc="upper right")


def _histogram(axes: Axes, values: np.ndarray, style: dict, label: str, step: float = 0.0) -> None:
    """Draw a logarithmic histogram and the normal law of the same width."""
    bins = min(BINS, max(16, int(np.sqrt(values.size) / 2)))
    if step:
        reach = values.max() - values.min()
        width = step * max(1, round(reach / bins / step))
        bins = np.arange(values.min() - step / 2, values.max() + width, width)
    counts, edges = np.histogram(values, bins)
    middle = (edges[1:] + edges[:-1]) / 2
    axes.stairs(counts, edges, color=style["color"], linewidth=1.0, label=label)
    spread = values.std()
    if spread:
        width = edges[1] - edges[0]
        normal = values.size * width / spread / np.sqrt(2 * np.pi)
        law = normal * np.exp(-((middle / spread) ** 2) / 2)
        shown = law > 0.3
        axes.plot(middle[shown], law[shown], "--", color=style["color"], linewidth=0.8)
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.5)


def _profile(axes: Axes, found: Characterisation, axis: int) -> None:
    """Draw means over columns (axis 1: the horizontal profile over x) or rows, less their mean."""
    title = ("Vertical", "Horizontal")[axis] + " profile"
    if found.dark is None:
        absent(axes, title, "no dark level has more than two frames")
        return
    gain = found.figures["system_gain_dn_per_e"].value
    curves = [(found.dark, gain, {"color": _DARK, "linestyle": "-"}, "dark [e-]")]
    for channel, style in _styles(found):
        if channel.bright is not None:
            scale = (channel.bright.mean - found.dark.mean) / 100
            curves.append((channel.bright, scale, style, f"{channel.name} at half [%]"))
    for pattern, scale, style, label in curves:
        line = np.mean([one.mean(axis=1 - axis) - one.mean() for one in pattern.images], axis=0)
        line = line / scale
        style = {**style, "linewidth": 0.9, "label": label}
        axes.plot(np.arange(line.size) + 0.5, line, **style)
    way = "x" if axis else "y"
    axes.set(title=title, xlabel=f"{way} [photosites of the channel]", ylabel="from the mean")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.35 * (high - low))
    axes.legend(loc="upper right", ncols=4)
