"""Tables of the Ansys report's sharpness and electrons."""

from __future__ import annotations

import numpy as np

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.validate.ansys_electrons import EvenScene
from gpusim.validate.ansys_models import SHOWN
from gpusim.validate.ansys_mtf import Sharpness
from gpusim.validate.ansys_noise import pooled
from gpusim.validate.report import Rows

TABLED_CY_PX = (0.1, 0.25, 0.5)  # at which models are compared


def edges(sharp: list[Sharpness]) -> Rows:
    """Return what measured edges miss."""
    rows = []
    for one in sharp:
        for (name, number), edge in one.found.items():
            first = (name, number) == ("electrons", SHOWN)
            last = (f"{one.q:.3f}", f"{one.area:.3f}") if first else ("", "")
            rows.append([
                one.reading.name, name, f"ROI {number}", f"{edge.mtf_error:.4f}",
                f"{edge.error_px:+.4f}", *last,
            ])  # fmt: skip
    head = "reading", "map", "edge", "MTF off by", "place off by [px]", "sampling Q", "area"
    return Rows(head, rows)


def noises(sharp: list[Sharpness]) -> Rows:
    """Return noise over its closed form, by edge and of the edges of a reading together."""
    rows = []
    for one in sharp:
        for number, noise in one.noise.items():
            ratio = np.sqrt(noise.ratios.mean())
            rows.append([
                one.reading.name, f"ROI {number}", str(noise.judged.size), str(noise.outside),
                f"{ratio:.3f}", "",
            ])  # fmt: skip
        both = list(one.noise.values())
        ratio, ends = pooled(both)
        low, high = np.sqrt(ends)
        rows.append([
            one.reading.name, "both", str(sum(noise.judged.size for noise in both)),
            str(sum(noise.outside for noise in both)), f"{np.sqrt(ratio):.3f}",
            f"{low:.3f} to {high:.3f}",
        ])  # fmt: skip
    ratio = "sigma over the closed form (RMS)"
    head = "reading", "edge", "frequencies", "outside", ratio, "its interval"
    return Rows(head, rows)


def losses(sharp: list[Sharpness]) -> Rows:
    """Return what shifts of the image plane take."""
    rows = []
    for one in sharp:
        for shift, (measured, predicted) in one.losses().items():
            at = np.searchsorted(FREQUENCIES_CY_PX, 0.25)
            seen, off = ("", "") if measured is None else (
                f"{measured[at]:.4f}", f"{np.abs(measured - predicted).max():.4f}",
            )  # fmt: skip
            rows.append([one.reading.name, f"{shift:+g}", seen, f"{predicted[at]:.4f}", off])
    head = "reading", "shift [um]", "lost at 1/4 cycle/px", "by rays", "off by, to 1 cycle/px"
    return Rows(head, rows)


def models(sharp: list[Sharpness]) -> Rows:
    """Return what simpler models say more."""
    rows = []
    for one in sharp:
        at = np.searchsorted(FREQUENCIES_CY_PX, np.array(TABLED_CY_PX) - 1e-9)
        true = one.models["lens and pixel"][at]
        rows.append([one.reading.name, "as it is", *(f"{value:.3f}" for value in true)])
        for name in ("Gaussian", "no colour", "Gaussian, no colour"):
            off = one.models[name][at] - true
            rows.append([one.reading.name, name, *(f"{value:+.3f}" for value in off)])
    return Rows(("reading", "model", *(f"{f:g} cycles/px" for f in TABLED_CY_PX)), rows)


def openings(sharp: list[Sharpness]) -> Rows:
    """Return what the stand-in's spots are at f-numbers."""
    rows = [
        [one.reading.name, way.name, f"{way.f_number:.2f}", f"{way.spot_um:.2f}",
         f"{way.spot_um / one.reading.pitch_um:.2f}"]
        for one in sharp
        for way in one.opened
    ]  # fmt: skip
    head = "reading", "stand-in", "works at f/", "RMS spot on the axis, 550 nm [um]", "in px"
    return Rows(head, rows)


def electrons(even: EvenScene) -> Rows:
    """Return an even scene's electrons at places, and how efficient the pixels are there."""
    rows = [
        [
            f"{place.x_mm:+.3f}, {place.y_mm:+.3f}", f"{place.lean_deg:.2f}",
            f"{place.efficiency:.4f}", f"{100 * place.past_rim:.3f}",
            f"{place.measured:.1f}", f"{place.predicted:.1f}",
            f"{100 * (place.measured / place.predicted - 1):+.3f}",
        ]
        for place in even.places
    ]  # fmt: skip
    head = (
        "x, y [mm]",
        "cone leans [deg]",
        "efficiency",
        "bent over the rim [%]",
        "rendered",
        "predicted",
        "off by [%]",
    )
    return Rows(head, rows)
