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
from gpusim.report.words import duration, error, exposure, is_whole, saturated, tolerance

_OVERVIEW_PX = 1400
_CROP_PX = 320
# Where on the way from the centre to the upper right corner each crop lies, in a whole frame and in
# a rectangle of one.
_CROPS = {"Centre": 0.0, "Half field": 0.5, "Corner": 1.0}
_OF_RECTANGLE = {"Middle": 0.0, "Half way to its corner": 0.5, "Its corner": 1.0}
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
        **_pictures(developed, _CROPS if is_whole(facts) else _OF_RECTANGLE),
        saturated=saturated(facts),
        tolerance=tolerance(capture),
        rim=RIM,
        qe=_quantum_efficiency(facts["qe_by_place"]),
        parameters=_parameters(facts),
        patches=patches_html(facts.get("patches")),
        psfs="" if psfs is None else psfs_html(psfs, facts),
        histogram=histogram_html(facts["histogram"]),
        **_certificate(facts),
        **_times(facts),
    )


def _place(facts: Mapping[str, Any]) -> str:
    """Return where a rectangle lies in its frame; nothing for a whole frame."""
    capture = facts["capture"]
    if is_whole(facts):
        return ""
    return f" at ({capture['first_col']}, {capture['first_row']}) of a larger frame"


def _pictures(developed: np.ndarray, ways: Mapping[str, float]) -> dict[str, Any]:
    """Return the overview and the crops, each of another place."""
    rows, cols = developed.shape[:2]
    scale = min(1.0, _OVERVIEW_PX / max(rows, cols))
    size = (max(1, round(cols * scale)), max(1, round(rows * scale)))
    height, width = min(rows, _CROP_PX), min(cols, _CROP_PX)
    crops: list[dict[str, Any]] = []
    for name, way in ways.items():
        top = max(0, round(rows / 2 * (1 - way) - height / 2))
        left = min(cols - width, round(cols / 2 * (1 + way) - width / 2))
        if any((top, left) == (one["top"], one["left"]) for one in crops):
            continue
        crop = Image.fromarray(developed[top : top + height, left : left + width])
        crops.append({"name": name, "top": top, "left": left, "picture": crop})
    overview = Image.fromarray(developed).resize(size, Image.Resampling.BOX)
    return {"rows": rows, "cols": cols, "overview": overview, "crops": crops}


def _certificate(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the certificate, the parts of its error, its worst probes and their map."""
    certificate = facts["certificate"]
    if certificate is None:
        return {"certificate": None}
    probes = sorted(certificate["points"], key=lambda probe: -(probe["relative"] or 0.0))
    worst = [
        (
            str(one["row"]), str(one["col"]), f"{one['truth']:.6g}", f"{one['render']:.6g}",
            error(one["relative"]), error(one["sigma"]),
        )
        for one in probes[:_WORST_SHOWN]
    ]  # fmt: skip
    parts = [
        (what, error(certificate[f"{part}_rms"]), error(certificate[f"{part}_worst"]))
        for part, what in _PARTS.items()
    ]
    parts.insert(-1, ("window: light that no PSF holds", error(certificate["window"]), ""))
    drawn = probe_map(probes, facts["capture"])
    return {"certificate": certificate, "parts": parts, "worst": worst, "probe_map": drawn}


def _times(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the longest time of a stage, and what went before."""
    times = facts["times_s"]
    prepared = ", ".join(f"{name} {duration(s)}" for name, s in facts["prepare_s"].items())
    if "kernels" in times:
        prepared += f"; kernels within the render, tile by tile: {duration(times['kernels'])}"
    return {"longest": max(times.values(), default=0.0) or 1.0, "prepared": prepared}


def _quantum_efficiency(found: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the quantum efficiency over the field; None where it is the same everywhere."""
    if found is None:
        return None
    from gpusim.report.qe_figure import draw, labels

    shown = f"Quantum efficiency over the field: {', '.join(labels(found).values())}"
    return {"figure": draw(found), "shown": shown}


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
