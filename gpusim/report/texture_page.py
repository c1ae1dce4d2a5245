"""Texture MTF on one page, and as facts: curves, spectra, the region."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from gpusim.metrics.texture import Texture
from gpusim.report.drawing import COLOURS, INK, SOFT, STYLE, panel, titles, write
from gpusim.report.sheet import Table, sheet

UNITS = "MTF of dead leaves, 1 at low frequencies; cycles per pixel; standard uncertainties (k = 1)"
SHOWN = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)  # cycles per pixel, in the table


def texture_facts(found: Sequence[Texture], radii_px: tuple[float, float]) -> dict[str, Any]:
    """Return the figures."""
    return {
        "units": UNITS,
        "leaves_px": list(radii_px),
        "noise": found[0].noise,
        "channels": [
            {
                "channel": one.channel,
                "roi": list(one.box),
                "mtf50": one.mtf50,
                "clipped": one.clipped,
                "frequency": one.frequency.tolist(),
                "mtf": one.mtf.tolist(),
                "u": one.u.tolist(),
            }
            for one in found
        ],
    }


def texture_rows(found: Sequence[Texture]) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: one for each channel and frequency."""
    yield ["channel", "frequency", "mtf", "u", "power", "target"]
    for one in found:
        columns = one.frequency, one.mtf, one.u, one.power, one.target
        for values in zip(*columns, strict=True):
            yield [one.channel, *(f"{value:.6g}" for value in values)]


def draw_texture(found: Sequence[Texture], picture: np.ndarray, title: str) -> Figure:
    """Return the page: MTF, spectra, and the region in the picture."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 5.6))
        said = [_said(one) for one in found]
        titles(figure, title, said, top=5.55)
        axes = panel(figure, 0.8, 0.85, 4.4, 3.5)
        spectra = panel(figure, 6.1, 0.85, 2.6, 3.5)
        region = panel(figure, 9.5, 0.85, 2.5, 3.5)
        for one in found:
            colour = COLOURS.get(one.channel[0], INK)
            axes.plot(one.frequency, one.mtf, color=colour, label=one.channel)
            axes.fill_between(
                one.frequency, one.mtf - one.u, one.mtf + one.u, color=colour, alpha=0.2, lw=0
            )
            lit = one.power > 0
            scale = one.power[lit][:3].sum() / one.target[lit][:3].sum()
            spectra.loglog(one.frequency[lit], one.power[lit] / scale, color=colour)
        spectra.loglog(found[0].frequency, found[0].target, color=SOFT, ls="--", label="target")
        spectra.set(title="Power spectra", xlabel="cycles/pixel", ylabel="px^2")
        spectra.legend(loc="lower left")
        axes.set(
            title="Texture MTF", xlabel="cycles/pixel", ylabel="MTF", ylim=(0, 1.3), xlim=(0, None)
        )
        axes.legend(loc="upper right")
        x, y, width, height = found[0].box
        seen = picture[y : y + height, x : x + width]
        region.imshow(seen, cmap="gray", extent=(x, x + width, y + height, y))
        region.grid(False)
        region.set(title="Region", xlabel="x [px]", ylabel="y [px]")
        write(figure, 0.55, 0.2, UNITS, fontsize=7, color=SOFT, va="center")
    return figure


def _said(one: Texture) -> str:
    at = "does not fall to 1/2" if one.mtf50 is None else f"MTF50 {one.mtf50:.3f} cycles/pixel"
    return f"{one.channel}: {at}"


def texture_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    rows = []
    for one in facts["channels"]:
        within = [f for f in SHOWN if f <= one["frequency"][-1]]
        values = np.interp(within, one["frequency"], one["mtf"])
        half = "-" if one["mtf50"] is None else one["mtf50"]
        blank = [""] * (len(SHOWN) - len(within))
        rows.append((one["channel"], half, *values.tolist(), *blank))
    head = ("Channel", "MTF50", *(f"at {f:g}" for f in SHOWN))
    low, high = facts["leaves_px"]
    said = f"Texture by gpusim {facts['gpusim']}: leaves of {low:g} to {high:g} pixels, noise "
    said += f"{facts['noise']}; {facts['units']}."
    shows = "Texture MTF, power spectra, the region"
    return sheet(facts["picture"], said, drawn, shows, Table("Texture MTF", head, rows))
