"""What slanted edges say, as plain data for JSON, screen and page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gpusim.metrics.figure import Figure
from gpusim.metrics.sfr import NYQUIST_CY_PX, Edge


def sfr_facts(
    found: Sequence[Edge], pitch_um: float | None, cutoff_cy_px: float | None
) -> dict[str, Any]:
    """Return the figures of all edges.

    Parameters
    ----------
    found : sequence of Edge
    pitch_um : float, optional
        Pixel pitch: figures then stand in line pairs per mm too.
    cutoff_cy_px : float, optional
        Where a diffraction-limited lens ends: the area ratio to Nyquist is then given.
    """
    units = (
        "cycles per pixel along the edge's normal, standard uncertainties (k = 1); "
        "the quantity of ISO 12233:2023 e-SFR"
    )
    if cutoff_cy_px is not None:
        units += (
            "; area ratio: the area under the SFR to 0.5 cycles per pixel over that of a "
            "diffraction-limited lens (no sampling Q, 2 lambda N over the pitch)"
        )
    return {"units": units, "edges": [_edge(one, pitch_um, cutoff_cy_px) for one in found]}


def _edge(one: Edge, pitch_um: float | None, cutoff_cy_px: float | None) -> dict[str, Any]:
    sfr, line = one.sfr, one.sfr.line
    figures = {
        "mtf50": sfr.falls_to(0.5),
        "mtf50p": sfr.falls_to(0.5, of_peak=True),
        "mtf30": sfr.falls_to(0.3),
        "nyquist": sfr.at(NYQUIST_CY_PX),
    }
    facts = {
        "edge": one.number,
        "region": list(one.region),
        "channel": one.channel,
        "place_px": list(line.place_px),
        "u_place_px": line.u_px,
        "nearer_to": "horizontal" if line.turned else "vertical",
        "angle_deg": _pair(Figure(abs(line.angle_deg), line.u_angle_deg)),
        "figures": {name: None if each is None else _pair(each) for name, each in figures.items()},
        "rise_px": sfr.rise_px,
        "noise_of_step": sfr.noise,
        "pixels": sfr.pixels,
        "polynomial_px": sfr.line.x_of_y.coef.tolist(),
        "frequency_cy_px": sfr.frequency_cy_px.round(6).tolist(),
        "sfr": sfr.sfr.round(7).tolist(),
        "u_sfr": sfr.u_sfr.round(7).tolist(),
    }
    if pitch_um is not None and figures["mtf50"] is not None:
        facts["mtf50_lp_mm"] = figures["mtf50"].value / pitch_um * 1e3
    if cutoff_cy_px is not None:
        facts["area_ratio"] = sfr.quality(cutoff_cy_px)
    return facts


def _pair(figure: Figure) -> dict[str, float]:
    return {"value": figure.value, "u": figure.u}
