"""The page of a batch: contact sheet, figures over the sweep's axes, failures."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from PIL import Image

from gpusim.batch.files import NOT_MEASURED
from gpusim.isp.develop import develop
from gpusim.metrics.summary import MEASURES
from gpusim.report.drawing import card
from gpusim.report.page import document

if TYPE_CHECKING:
    from gpusim.batch.run import Outcome

SHOWN, THUMBNAIL_PX = 24, 240
MOST_FAILURES = 50
COUNTS = (".edges", ".marks", ".farthest")  # say how good a figure is, and are none


def batch_page(outcome: Outcome) -> str:
    """Return the page as HTML."""
    total, done = len(outcome.sweep), len(outcome.done)
    rate = f", {outcome.new / outcome.seconds:.3g} frames/s" if outcome.new else ""
    summary = (
        f"{escape(outcome.sweep.camera)}: {done} of {total} frames, {len(outcome.failed)} failed; "
        f"{outcome.new} rendered by the last run in {outcome.seconds:.1f} s{rate}"
    )
    return document("Batch", summary, _pictures(outcome), _plots(outcome), _failures(outcome))


def _pictures(outcome: Outcome) -> str:
    """Return frames spread evenly over the sweep, as developed pictures."""
    done = outcome.done
    step = max(1, -(-len(done) // SHOWN))
    cells = []
    for one in done[::step]:
        picture = _picture(outcome, one["files"])
        if picture is None:
            continue
        picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX))
        with io.BytesIO() as file:
            picture.convert("RGB").save(file, "JPEG", quality=85)
            data = base64.b64encode(file.getvalue()).decode("ascii")
        said = ", ".join(f"{name} {_short(value)}" for name, value in one["settings"].items())
        cells.append(
            f'<figure style="margin:0"><img src="data:image/jpeg;base64,{data}" '
            f'alt="frame {one["number"]}" style="width:100%"><figcaption class="soft">'
            f"{one['number']}: {escape(said)}</figcaption></figure>"
        )
    if not cells:
        return ""
    grid = "display:grid;gap:.6rem;grid-template-columns:repeat(auto-fill,minmax(150px,1fr))"
    shown = "" if len(cells) == len(done) else f" ({len(cells)} of {len(done)}, evenly spread)"
    return f'<section><h2>Frames{shown}</h2><div style="{grid}">{"".join(cells)}</div></section>'


def _picture(outcome: Outcome, files: list[str]) -> Image.Image | None:
    for name in files:
        if name.endswith(".png"):
            return Image.open(outcome.out / name)
    for name in files:
        if name.endswith((".dng", ".tif")):
            return Image.fromarray(develop(outcome.out / name).picture)
    return None


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _plots(outcome: Outcome) -> str:
    """Return signal and measures over each axis that has several numbers."""
    measured = dict.fromkeys(
        name for one in outcome.done for name in one if name.partition(".")[0] in MEASURES
    )
    shown = {"mean_dn": "mean of the raw [DN]"} | {
        name: name for name in measured if not name.endswith((NOT_MEASURED, *COUNTS))
    }
    figures = []
    for axis in outcome.sweep.axes:
        if axis in ("seed", "frame"):
            continue
        for figure, label in shown.items():
            pairs = [
                (one["settings"][axis], one[figure])
                for one in outcome.done
                if isinstance(one["settings"].get(axis), int | float) and figure in one
            ]
            if len({x for x, _ in pairs}) < 2:
                continue
            drawing = Figure(figsize=(4.6, 2.8), layout="constrained")
            axes = drawing.subplots()
            axes.plot(*zip(*pairs, strict=True), "o", markersize=3, alpha=0.6)
            axes.set(xlabel=axis, ylabel=label)
            figures.append(card(drawing, f"{label} over {axis}"))
    if not figures:
        return ""
    plots = f'<div class="plots">{"".join(figures)}</div>'
    return f"<section><h2>Signal and measures over the axes</h2>{plots}</section>"


def _failures(outcome: Outcome) -> str:
    if not outcome.failed:
        return ""
    rows = "".join(
        f"<tr><td>{one['number']}</td><td>{escape(str(one['settings']))}</td>"
        f"<td>{escape(one['error'])}</td></tr>"
        for one in outcome.failed[:MOST_FAILURES]
    )
    head = "<tr><th>frame</th><th>settings</th><th>what happened</th></tr>"
    table = f'<div class="scroll"><table>{head}{rows}</table></div>'
    return f"<section><h2>Failures</h2>{table}</section>"
