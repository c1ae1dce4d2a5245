"""The report as one HTML file, a function of the facts and of the developed picture alone.

Pictures are embedded, so the file can be sent and kept; its loupe shows developed.png where that
lies beside it, and else the overview.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import Image

from gpusim.plan.stages import RIM
from gpusim.psf.local import LocalPsfs
from gpusim.report.histogram import histogram_html
from gpusim.report.patches import patches_html
from gpusim.report.probes import probe_map
from gpusim.report.psfs import psfs_html
from gpusim.report.template import filled
from gpusim.report.words import duration, error, exposure, saturated, sigmas, tolerance

# The overview shows no single pixel, so a JPEG serves: 0.3 MB where a PNG of a noisy capture has 3.
_OVERVIEW_PX = 1400
_OVERVIEW_QUALITY = 88
_CROP_PX = 320
# Where on the way from the centre to the upper right corner each crop lies.
_CROPS = {"Centre": 0.0, "Half field": 0.5, "Corner": 1.0}
_WORST_SHOWN = 10
# Parts of the error budget: see gpusim.certify.budget.
_PARTS = {
    "engine": "engine: the render against the exact model on its bank of PSFs",
    "bank": "bank: its PSFs against PSFs traced anew",
    "sensor": "sensor: from light to mean electrons",
    "total": "total",
}


def page(facts: Mapping[str, Any], developed: np.ndarray, psfs: LocalPsfs | None = None) -> str:
    """Return the report as an HTML document.

    Parameters
    ----------
    facts : mapping
        What :func:`gpusim.report.facts` returned.
    developed : ndarray of uint8, shape (rows, cols, 3)
        The developed capture, sRGB.
    psfs : LocalPsfs, optional
        For the place that is clicked.
    """
    capture = facts["capture"]
    return filled(
        "report/templates/report.html",
        title=f"{facts['scene']['name']}: {facts['camera']['title']}",
        summary=f"{capture['cols']} x {capture['rows']} px{_place(facts)}, "
        f"{exposure(capture['exposure_s'])}, seed {capture['seed']}, frame {capture['frame']}. "
        f"Made {facts['created']} by gpusim {facts['gpusim']}.",
        facts=facts,
        **_pictures(developed),
        saturated=saturated(facts),
        rim=RIM,
        patches=patches_html(facts.get("patches")),
        psfs="" if psfs is None else psfs_html(psfs, facts),
        histogram=histogram_html(facts["histogram"]),
        cards=_cards(facts),
        **_certificate(facts),
        **_quantum_efficiency(facts),
        parameters=_parameters(facts),
    )


def _place(facts: Mapping[str, Any]) -> str:
    """Return where a rectangle lies in its frame; nothing for a whole frame."""
    capture, sensor = facts["capture"], facts["camera"]["sensor"]
    if (capture["rows"], capture["cols"]) == (sensor["rows"], sensor["cols"]):
        return ""
    return f" at ({capture['first_col']}, {capture['first_row']}) of a larger frame"


def _cards(facts: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return the four figures that matter most: style, value, text."""
    capture, certificate = facts["capture"], facts["certificate"]
    if certificate is None:
        cards = [("", "not certified", "no probes were asked for")]
    else:
        style, met = ("good", "within") if certificate["met"] else ("bad", "beyond")
        unit = capture["tolerance_unit"]
        say = sigmas if unit == "sigma" else error
        of = "in sigmas of the noise" if unit == "sigma" else "of the local signal"
        row, col = certificate["worst_position"]
        cards = [
            (
                style,
                say(certificate["total_rms"]),
                f"RMS error {of}, all parts, {met} the tolerance of {tolerance(capture)}",
            ),
            (
                style,
                say(certificate["total_worst"]),
                f"worst of {certificate['probes']} probes, at row {row}, column {col}",
            ),
        ]
    cards += [
        ("", duration(capture["wall_s"]), "for the render, wall clock"),
        ("", facts["device"]["adapter"], "adapter"),
    ]
    return cards


def _pictures(developed: np.ndarray) -> dict[str, Any]:
    """Return the overview and the crops."""
    rows, cols = developed.shape[:2]
    scale = min(1.0, _OVERVIEW_PX / max(rows, cols))
    size = (max(1, round(cols * scale)), max(1, round(rows * scale)))
    height, width = min(rows, _CROP_PX), min(cols, _CROP_PX)
    crops = []
    for name, way in _CROPS.items():
        top = max(0, round(rows / 2 * (1 - way) - height / 2))
        left = min(cols - width, round(cols / 2 * (1 + way) - width / 2))
        crop = Image.fromarray(developed[top : top + height, left : left + width])
        crops.append({"name": name, "top": top, "left": left, "picture": crop})
    overview = Image.fromarray(developed).resize(size, Image.Resampling.BOX)
    return {
        "rows": rows,
        "cols": cols,
        "overview": overview,
        "overview_quality": _OVERVIEW_QUALITY,
        "crops": crops,
    }


def _certificate(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of the certificate's error, its worst probes, and its map of probes."""
    certificate = facts["certificate"]
    if certificate is None:
        return {}
    probes = sorted(certificate["points"], key=lambda probe: -(probe["relative"] or 0.0))
    worst = [
        (
            str(probe["row"]),
            str(probe["col"]),
            f"{probe['truth']:.6g}",
            f"{probe['render']:.6g}",
            error(probe["relative"]),
            error(probe["sigma"]),
        )
        for probe in probes[:_WORST_SHOWN]
    ]
    parts = [
        (what, error(certificate[f"{part}_rms"]), error(certificate[f"{part}_worst"]))
        for part, what in _PARTS.items()
    ]
    parts.insert(-1, ("window: light that no PSF holds", error(certificate["window"]), ""))
    drawn = probe_map(probes, facts["capture"])
    told = tolerance(facts["capture"])
    return {"tolerance": told, "parts": parts, "worst": worst, "probe_map": drawn}


def _quantum_efficiency(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the quantum efficiency over the field; nothing where it is the same everywhere."""
    found = facts["qe_by_place"]
    if found is None:
        return {}
    from gpusim.report.qe_figure import draw, labels

    shown = f"Quantum efficiency over the field: {', '.join(labels(found).values())}"
    return {"qe": {"figure": draw(found), "shown": shown}}


def _parameters(facts: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return the parameters that are one number or one line, by what they are of."""
    sections = {
        "Lens": facts["camera"]["lens"],
        "Sensor": facts["camera"]["sensor"],
        "Scene": facts["scene"],
        "Wavelengths": facts["wavelengths"],
        "Capture": facts["capture"],
        **{f"Grid: {scale['name']}": scale for scale in facts["plan"]["scales"]},
        "Device": facts["device"],
        "Versions": {**facts["versions"], "shaders_sha256": facts["shaders_sha256"]},
    }
    return {name: _lines(entry) for name, entry in sections.items()}


def _lines(entry: Mapping[str, Any]) -> dict[str, str]:
    """Return those entries that fit a line, as text: neither tables nor what is not known."""
    lines = {}
    for key, value in entry.items():
        parts = value if isinstance(value, list) else [value]
        if parts and not any(isinstance(part, Mapping | list | None) for part in parts):
            lines[key] = ", ".join(
                f"{part:g}" if isinstance(part, float) else str(part) for part in parts
            )
    return lines
