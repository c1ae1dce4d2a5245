"""The EMVA 1288 data sheet as one HTML file: verdicts, figures with uncertainties, plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from gpusim.metrics.emva import Characterisation
from gpusim.metrics.figure import Figure
from gpusim.metrics.loop import COVERAGE, Row
from gpusim.report.drawing import card
from gpusim.report.noise_facts import IN_THE_DARK, OF_A_CHANNEL, number, two_digits
from gpusim.report.noise_figure import draw_noise
from gpusim.report.page import document


def noise_html(found: Characterisation, rows: Sequence[Row] | None, title: str, how: str) -> str:
    """Return the data sheet as an HTML document that needs no other file.

    Parameters
    ----------
    found : Characterisation
    rows : sequence of Row, optional
        For a simulated sensor: what its file says beside what was found.
    title, how : str
        What was measured, and on which frames.
    """
    sections = [] if rows is None else [_verdicts(rows)]
    for channel in found.channels:
        light = "" if channel.wavelength_nm is None else f", light of {channel.wavelength_nm:g} nm"
        sections.append(
            f"<h2>Channel {escape(channel.name)}{light}</h2>"
            + _sheet(channel.figures, OF_A_CHANNEL)
        )
    sections.append("<h2>All pixels, in the dark</h2>" + _sheet(found.figures, IN_THE_DARK))
    sections += [f"<p>{escape(note)}.</p>" for note in found.notes]
    shown = "Photon transfer, SNR, linearity, dark current, spectrograms, histograms, profiles"
    drawn = draw_noise(found, title, how, titled=False)
    plots = f"<h2>Plots</h2><figure>{card(drawn, shown)}</figure>"
    summary = f"{how}. EMVA 1288 R3.1; rows, columns and pixels by R4.0 Linear."
    return document(escape(title), escape(summary), *sections, plots)


def _verdicts(rows: Sequence[Row]) -> str:
    """Return parameter, data sheet, recovered, uncertainty and verdict."""
    outside = sum(not row.within for row in rows)
    body = "".join(
        f"<tr><td>{escape(row.parameter)}</td>"
        f'<td class="number">{row.data_sheet:.6g}</td>'
        f'<td class="number">{number(row.expected, row.uncertainty)}</td>'
        f'<td class="number">{number(row.recovered, row.uncertainty)}</td>'
        f'<td class="number">{two_digits(row.uncertainty)}</td>'
        f"<td>{_unit(row.unit)}</td>"
        f'<td class="{"good" if row.within else "bad"}">'
        f"{'within' if row.within else 'outside'}</td>"
        f'<td class="reason">{escape(row.reason)}</td></tr>'
        for row in rows
    )
    return f"""<section class="cards"><div class="card">
<b class="{"bad" if outside else "good"}">{len(rows) - outside} of {len(rows)}</b>
<span>parameters of the sensor file recovered within their uncertainty, k = {COVERAGE}</span>
</div></section>
<h2>The sensor file and what was measured</h2><div class="scroll"><table>
<thead><tr><th>Parameter</th><th class="number">Data sheet</th><th class="number">Expected</th>
<th class="number">Recovered</th><th class="number">U (k = {COVERAGE})</th><th>Unit</th>
<th>Verdict</th><th>Why another is expected</th></tr></thead><tbody>{body}</tbody></table></div>"""


def _sheet(figures: Mapping[str, Figure], names: Mapping[str, tuple[str, str, str]]) -> str:
    """Return figures with their standard uncertainties."""
    body = "".join(
        f"<tr><td>{escape(name)}</td><td>{escape(symbol)}</td>"
        f'<td class="number">{number(figures[key].value, figures[key].u)}</td>'
        f'<td class="number">{two_digits(figures[key].u)}</td><td>{_unit(unit)}</td></tr>'
        for key, (name, symbol, unit) in names.items()
        if key in figures
    )
    return (
        '<div class="scroll"><table><thead><tr><th>Figure</th><th>Symbol</th>'
        '<th class="number">Value</th><th class="number">u (k = 1)</th><th>Unit</th></tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _unit(unit: str) -> str:
    return "" if unit == "1" else escape(unit)
