"""The report as one HTML file, a function of the facts and of the developed picture alone.

Pictures are embedded, so the file can be sent and kept; its loupe shows developed.png where that
lies beside it, and else the overview.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib import resources
from typing import Any

import numpy as np
from PIL import Image

from gpusim.plan.stages import RIM
from gpusim.psf.local import LocalPsfs
from gpusim.report.embedded import embedded
from gpusim.report.histogram import histogram_html
from gpusim.report.patches import patches_html
from gpusim.report.probes import probe_map
from gpusim.report.psfs import psfs_html
from gpusim.report.words import (
    duration,
    error,
    exposure,
    mebibytes,
    saturated,
    sigmas,
    tolerance,
)

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
    title = escape(f"{facts['scene']['name']}: {facts['camera']['title']}")
    summary = escape(
        f"{capture['cols']} x {capture['rows']} px{_place(facts)}, "
        f"{exposure(capture['exposure_s'])}, seed {capture['seed']}, frame {capture['frame']}. "
        f"Made {facts['created']} by gpusim {facts['gpusim']}."
    )
    return document(
        title,
        summary,
        _pictures(facts, developed),
        patches_html(facts.get("patches")),
        "" if psfs is None else psfs_html(psfs, facts),
        histogram_html(facts["histogram"]),
        _cards(facts),
        _certificate(facts),
        _quantum_efficiency(facts),
        _folded("What was done, and what was left out", _stages(facts)),
        _folded("Parameters, versions, files", _details(facts)),
        *(
            f"<script>{resources.files('gpusim.report').joinpath(name).read_text()}</script>"
            for name in ("loupe.js", "psf.js")
        ),
    )


def _folded(title: str, content: str) -> str:
    return f'<details class="part"><summary>{title}</summary>{content}</details>'


def _place(facts: Mapping[str, Any]) -> str:
    """Return where a rectangle lies in its frame; nothing for a whole frame."""
    capture, sensor = facts["capture"], facts["camera"]["sensor"]
    if (capture["rows"], capture["cols"]) == (sensor["rows"], sensor["cols"]):
        return ""
    return f" at ({capture['first_col']}, {capture['first_row']}) of a larger frame"


def document(title: str, summary: str, *sections: str) -> str:
    """Return a whole HTML document with the report's style.

    Parameters
    ----------
    title, summary, *sections : str
        HTML.
    """
    style = resources.files("gpusim.report").joinpath("style.css").read_text()
    body = "\n".join(sections)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<header><h1>{title}</h1><p class="soft">{summary}</p></header>
{body}
</body>
</html>
"""


def _cards(facts: Mapping[str, Any]) -> str:
    """Return the four figures that matter most."""
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
    shown = (
        f'<div class="card"><b class="{style}">{escape(value)}</b><span>{escape(text)}</span></div>'
        for style, value, text in cards
    )
    return f'<section class="cards">{"".join(shown)}</section>'


def _rim(facts: Mapping[str, Any]) -> str:
    """Return what of the sensor no light reaches, if any."""
    reasons = [
        one["reason"] for one in facts["plan"]["stages"] if one["name"] == RIM and one["runs"]
    ]
    return "".join(f"<p><strong>Black</strong>: {escape(reason)}.</p>\n" for reason in reasons)


def _no_data(facts: Mapping[str, Any]) -> str:
    """Return what of the light no data describe, if any."""
    missing = (escape(one["text"]) for one in facts["wavelengths"]["no_data"])
    return "".join(f"<p><strong>Light without data</strong>: {one}.</p>\n" for one in missing)


def _pictures(facts: Mapping[str, Any], developed: np.ndarray) -> str:
    """Return the overview with the frames of the crops, and the crops."""
    rows, cols = developed.shape[:2]
    scale = min(1.0, _OVERVIEW_PX / max(rows, cols))
    size = (max(1, round(cols * scale)), max(1, round(rows * scale)))
    overview = Image.fromarray(developed).resize(size, Image.Resampling.BOX)
    height, width = min(rows, _CROP_PX), min(cols, _CROP_PX)
    frames, crops = "", ""
    for name, way in _CROPS.items():
        top = max(0, round(rows / 2 * (1 - way) - height / 2))
        left = min(cols - width, round(cols / 2 * (1 + way) - width / 2))
        crop = Image.fromarray(developed[top : top + height, left : left + width])
        label = f"{name}: from row {top}, column {left}"
        frames += f'<rect x="{left}" y="{top}" width="{width}" height="{height}"/>'
        crops += (
            f'<figure><img src="{embedded(crop, "PNG")}" width="{width}" height="{height}" '
            f'alt="{label}"><figcaption>{label}</figcaption></figure>'
        )
    return f"""<h2>The picture</h2>
<figure><div class="overview" data-whole="developed.png" data-size="{cols},{rows}">
<img src="{embedded(overview, "JPEG", quality=_OVERVIEW_QUALITY)}" alt="The developed capture">
<svg viewBox="0 0 {cols} {rows}" fill="none">
<g stroke="#000" stroke-opacity=".6" stroke-width="{cols / 280:.1f}">{frames}</g>
<g stroke="#fff" stroke-width="{cols / 700:.1f}">{frames}</g></svg>
<canvas class="loupe" width="220" height="220"></canvas></div>
<p class="soft knobs"><button data-zoom="in" aria-label="zoom in">+</button>
<button data-zoom="out" aria-label="zoom out">&minus;</button>
<span class="loupe-at">Point at the picture for a loupe; the wheel zooms.</span></p>
<figcaption>The developed raw, at {size[0]} x {size[1]} px. {escape(saturated(facts))}.
The frames are the crops below, which show each pixel as it is.</figcaption></figure>
{_rim(facts)}{_no_data(facts)}<div class="crops">{crops}</div>"""


def _stages(facts: Mapping[str, Any]) -> str:
    """Return the plan and what became of it: one row a stage, in the order that light takes."""
    times, plan = facts["times_s"], facts["plan"]
    longest = max(times.values(), default=0.0) or 1.0
    rows = ""
    for stage in plan["stages"]:
        seconds = times.get(stage["name"])
        width = 0.0 if seconds is None else 100 * seconds / longest
        bar = f'<i style="width:{width:.1f}%"></i>' if width else ""
        rows += f"""<tr{"" if stage["runs"] else ' class="out"'}><td>{escape(stage["name"])}</td>
<td class="reason">{"" if stage["runs"] else "left out: "}{escape(stage["reason"])}</td>
<td class="number">{error(stage["predicted_error"])}</td>
<td class="number">{duration(stage["predicted_cost_s"])}</td>
<td class="number">{duration(seconds)}</td><td class="bar">{bar}</td></tr>"""
    prepared = ", ".join(f"{name} {duration(s)}" for name, s in facts["prepare_s"].items())
    if "kernels" in times:
        prepared += f"; kernels within the render, tile by tile: {duration(times['kernels'])}"
    memory = facts["memory"]
    held = f"{mebibytes(memory['peak_bytes'])} of a budget of {mebibytes(memory['budget_bytes'])}"
    return f"""<div class="scroll"><table>
<thead><tr><th>Stage</th><th>Reason</th><th class="number">Predicted error</th>
<th class="number">Predicted time</th><th class="number">Time</th><th></th></tr></thead>
<tbody>{rows}</tbody>
<tfoot><tr><td colspan="3">Render, wall clock</td>
<td class="number">{duration(plan["predicted_s"])}</td>
<td class="number">{duration(facts["capture"]["wall_s"])}</td><td></td></tr></tfoot>
</table></div>
<p class="soft">Before, and not again for further frames of this scene: {escape(prepared)}.
GPU memory at most {escape(held)}; {facts["work"]["tiles"]} tiles, {facts["work"]["blocks"]} blocks,
kernels at {facts["work"]["nodes"]} points of the field.</p>
{_runners_up(plan)}"""


def _runners_up(plan: Mapping[str, Any]) -> str:
    """Return how the convolution is done, and how else it could have been."""
    rows = "".join(
        f"""<tr><td>{escape(other["name"])}</td>
<td class="number">{error(other["predicted_error"])}</td>
<td class="number">{duration(other["predicted_cost_s"])}</td>
<td class="reason">{escape(other["lost"])}</td></tr>"""
        for other in plan["runners_up"]
    )
    short = plan["shortfall"]
    effort = f"<p><strong>Best effort</strong>: {escape(short)}.</p>\n" if short else ""
    return f"""<p>Convolved by {escape(plan["name"])}. Predicted times: {escape(plan["rates"])}.</p>
{effort}<details><summary>{len(plan["runners_up"])} other ways, and why each lost</summary>
<div class="scroll"><table>
<thead><tr><th>Way</th><th class="number">Predicted error</th>
<th class="number">Predicted time</th><th>Why it lost</th></tr></thead>
<tbody>{rows}</tbody></table></div></details>"""


def _certificate(facts: Mapping[str, Any]) -> str:
    """Return the certificate with its map of probes."""
    certificate = facts["certificate"]
    if certificate is None:
        return "<h2>Certificate</h2><p>None: no probes were asked for.</p>"
    probes = sorted(certificate["points"], key=lambda probe: -(probe["relative"] or 0.0))
    figures = {
        "engine's RMS error, relative": error(certificate["rms_relative"]),
        "its worst error, relative": error(certificate["worst_relative"]),
        "engine's RMS error, noise sigmas": error(certificate["rms_sigma"]),
        "its worst error, noise sigmas": error(certificate["worst_sigma"]),
        "probes": str(certificate["probes"]),
        "time, apart from the render's": duration(certificate["seconds"]),
    }
    columns = ("Row", "Column", "Exact [e-]", "Rendered [e-]", "Relative error", "Noise sigmas")
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
    met = "within" if certificate["met"] else "<strong>beyond</strong>"
    unit = "relative" if certificate["unit"] == "relative" else "noise sigmas"
    notes = "".join(f"<li>{escape(note)}</li>" for note in certificate["notes"])
    return f"""<h2>Certificate</h2>
<p>At each probe, the mean electrons of the render before noise are compared with the exact model,
evaluated for that one pixel in float64 by code that shares nothing with the shaders. The bank of
PSFs is compared with PSFs traced anew. The total is {met} the tolerance of
{escape(tolerance(facts["capture"]))}.</p>
{_numbers(("Part of the error", f"RMS, {unit}", "worst"), parts, named=True)}
<ul class="soft">{notes}</ul>
<div class="probes"><figure>{probe_map(probes, facts["capture"])}
<figcaption>The probes on the sensor by relative error. The worst is ringed.</figcaption></figure>
<div>{pairs(figures)}<p class="soft">{escape(certificate["confidence"])}</p></div></div>
<details><summary>The {len(worst)} worst probes</summary>{_numbers(columns, worst)}</details>"""


def _quantum_efficiency(facts: Mapping[str, Any]) -> str:
    """Return the quantum efficiency over the field; nothing where it is the same everywhere."""
    found = facts["qe_by_place"]
    if found is None:
        return ""
    from gpusim.report.drawing import card
    from gpusim.report.qe_figure import draw, labels

    shown = f"Quantum efficiency over the field: {', '.join(labels(found).values())}"
    return f"""<h2>Quantum efficiency over the field</h2>
<figure class="narrow">{card(draw(found), shown)}
<figcaption>Mean over the cone of light that the lens sends to each point of the row through the
middle, micro-lenses shifted as the sensor file says; each channel at the wavelength at which it
sees most in the middle.</figcaption></figure>"""


def _details(facts: Mapping[str, Any]) -> str:
    """Return the parameters that are one number or one line, and the command."""
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
    tables = "".join(
        f"<section><h2>{name}</h2>{pairs(_lines(entry))}</section>"
        for name, entry in sections.items()
    )
    files = "".join(
        f'<li><a href="{escape(name)}">{escape(name)}</a></li>' for name in facts["files"]
    )
    return f"""<div class="facts">{tables}<section><h2>Files</h2><ul>{files}</ul>
<p class="soft">report.json holds all of this and what takes more than a line.</p></section></div>
<h2>Command</h2><pre>{escape(" ".join(facts["command"]))}</pre>"""


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


def pairs(entries: Mapping[str, str]) -> str:
    """Return a table of names and texts."""
    rows = (
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in entries.items()
    )
    return f'<div class="scroll"><table>{"".join(rows)}</table></div>'


def _numbers(columns: Sequence[str], rows: Iterable[Sequence[str]], named: bool = False) -> str:
    """Return a table of numbers; `named`: the first column has words, which may take lines."""
    styles = ["words" if named and n == 0 else "number" for n in range(len(columns))]
    pairs = zip(styles, columns, strict=True)
    head = "".join(f'<th class="{style}">{escape(name)}</th>' for style, name in pairs)
    body = ""
    for row in rows:
        pairs = zip(styles, row, strict=True)
        cells = "".join(f'<td class="{style}">{escape(cell)}</td>' for style, cell in pairs)
        body += f"<tr>{cells}</tr>"
    return f"""<div class="scroll"><table><thead><tr>{head}</tr></thead>
<tbody>{body}</tbody></table></div>"""


def body_of(page: str) -> str:
    """Return what a document of `document` shows, without its title: to stand in another one."""
    body = page.partition("</h1>")[2].partition("</body>")[0]
    return f"<header>{body}"
