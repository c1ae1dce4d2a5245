"""The page of a batch: contact sheet, figures over the sweep's axes, failures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from PIL import Image

from gpusim.batch.files import NOT_MEASURED
from gpusim.isp.develop import develop
from gpusim.metrics.summary import MEASURES
from gpusim.report.template import filled

if TYPE_CHECKING:
    from gpusim.batch.run import Outcome

SHOWN, THUMBNAIL_PX = 24, 240
MOST_FAILURES = 50
COUNTS = (".edges", ".marks", ".farthest")  # say how good a figure is, and are none


def batch_page(outcome: Outcome) -> str:
    """Return the page as HTML."""
    total, done = len(outcome.sweep), len(outcome.done)
    rate = f", {outcome.new / outcome.seconds:.3g} frames/s" if outcome.new else ""
    return filled(
        "batch/page.html",
        title="Batch",
        summary=f"{outcome.sweep.camera}: {done} of {total} frames, {len(outcome.failed)} failed; "
        f"{outcome.new} rendered by the last run in {outcome.seconds:.1f} s{rate}",
        done=done,
        pictures=_pictures(outcome),
        plots=_plots(outcome),
        failed=outcome.failed[:MOST_FAILURES],
    )


def _pictures(outcome: Outcome) -> list[tuple[int, Image.Image, str]]:
    """Return frames spread evenly over the sweep: number, developed picture and settings."""
    step = max(1, -(-len(outcome.done) // SHOWN))
    found = []
    for one in outcome.done[::step]:
        picture = _picture(outcome, one["files"])
        if picture is None:
            continue
        picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX))
        said = ", ".join(f"{name} {_short(value)}" for name, value in one["settings"].items())
        found.append((one["number"], picture.convert("RGB"), said))
    return found


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


def _plots(outcome: Outcome) -> list[tuple[str, Figure]]:
    """Return signal and measures over each axis that has several numbers, by title."""
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
            figures.append((f"{label} over {axis}", drawing))
    return figures
