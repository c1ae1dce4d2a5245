"""What a study shows: yield curve, MTF50 by place, worst offenders, agreement."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gpusim.report.drawing import STYLE
from gpusim.report.template import filled
from gpusim.tolerance.found import Found
from gpusim.tolerance.rendered import Rendered

Raws = tuple[Rendered, Rendered]  # of the design, and of the camera below which five percent lie
OFFENDERS_SHOWN = 15


def facts_of(found: Found, raws: Raws | None) -> dict[str, Any]:
    """Return the study as plain data for JSON."""
    study, worst = found.study, found.worst
    percentiles = (0, 5, 25, 50, 75, 95, 100)
    need = study.budget.required_cy_px
    facts: dict[str, Any] = {
        "camera": study.camera.title,
        "digest": study.digest,
        "budget": study.budget.model_dump(mode="json", exclude_none=True),
        "channel": study.channel.name,
        "places_px": [[one.x_px, one.y_px] for one in study.places],
        "design_mtf50_cy_px": found.design.round(5).tolist(),
        "worst_edge_mtf50_cy_px": {
            f"p{p}": round(float(np.percentile(worst, p)), 5) for p in percentiles
        },
        "focus_um": {
            "mean": round(1e3 * float(found.focus_mm.mean()), 3),
            "standard_deviation": round(1e3 * float(found.focus_mm.std()), 3),
        },
        "offenders": [
            {"number": name, "worst_edge_loses_cy_px": round(lost, 6)}
            for name, lost in found.offenders
        ],
        "agreement": found.agreement,
        "fifth_percentile_sample": found.fifth,
        "seconds": round(found.seconds, 1),
    }
    if need is not None:
        facts["yield"] = {"required_cy_px": need, "share": round(float((worst >= need).mean()), 4)}
    if raws is not None:
        facts["raws"] = [
            {
                "camera": name,
                "mtf50_cy_px": one.mtf50.round(5).tolist(),
                "studied_mtf50_cy_px": studied.round(5).tolist(),
                "apart_most_cy_px": round(float(np.abs(one.mtf50 - studied).max()), 5),
                "certificate_total_rms": one.total_rms,
            }
            for name, studied, one in _named(found, raws)
        ]
    return facts


def _named(found: Found, raws: Raws) -> list[tuple[str, np.ndarray, Rendered]]:
    """Return what is rendered by name, beside the MTF50 of the study."""
    studied = found.design, found.mtf50[found.fifth]
    return list(zip(("design", f"camera {found.fifth}"), studied, raws, strict=True))


def raws_figure(found: Found, raws: Raws) -> Figure:
    """Return the developed pieces of both cameras, and their MTF50 against the study's."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.6), layout="constrained")
        *pictures, scatter = figure.subplots(1, 3)
        for axes, (name, studied, one) in zip(pictures, _named(found, raws), strict=True):
            axes.imshow(one.picture)
            axes.set(title=f"{name}: nine places", xticks=[], yticks=[])
            scatter.plot(studied.ravel(), one.mtf50.ravel(), "o", ms=3.5, label=name)
        ends = [f(one) for one in [scatter.get_xlim(), scatter.get_ylim()] for f in (min, max)]
        scatter.plot([min(ends), max(ends)], [min(ends), max(ends)], color="#5d6773", linewidth=0.8)
        scatter.set(
            title="Edges in the raw against the study",
            xlabel="MTF50 of the study [cycles/px]",
            ylabel="MTF50 measured in the raw [cycles/px]",
        )
        scatter.legend()
    return figure


def rows_of(found: Found) -> list[dict[str, Any]]:
    """Return a row for each sample: changes, focus, MTF50 of each edge and of the worst."""
    rows = []
    for k, moves in enumerate(found.study.draws):
        edges = {
            f"mtf50_{place}_{way}_cy_px": float(found.mtf50[k, place, number])
            for place in range(9)
            for number, way in enumerate(("upright", "level"))
        }
        changed = {f"set.{name}": value for name, value in moves.items()}
        own = {"sample": k, "worst_edge_cy_px": float(found.worst[k])}
        rows.append({**own, "focus_um": 1e3 * float(found.focus_mm[k]), **edges, **changed})
    return rows


def figure_of(found: Found) -> Figure:
    """Return yield curve, MTF50 by place and worst offenders as one figure."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 6.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.remove()
        right.remove()
        grid = figure.add_gridspec(2, 2, width_ratios=(1, 1))
        _yield(figure.add_subplot(grid[0, 0]), found)
        _places(figure.add_subplot(grid[1, 0]), found)
        _offenders(figure.add_subplot(grid[:, 1]), found)
    return figure


def _yield(axes: Axes, found: Found) -> None:
    worst = np.sort(found.worst)
    share = 100 * (1 - np.arange(len(worst)) / len(worst))
    axes.step(worst, share, where="pre", color="#1f6feb")
    axes.axvline(found.design.min(), color="#5d6773", linewidth=0.8, linestyle=":")
    axes.annotate("design", (found.design.min(), 3), fontsize=7.5, ha="right", rotation=90)
    if (need := found.study.budget.required_cy_px) is not None:
        axes.axvline(need, color="#d1242f", linewidth=0.9)
    axes.set(
        title="Yield",
        xlabel="MTF50 of the worst edge, at least [cycles/px]",
        ylabel="cameras [%]",
        ylim=(0, 102),
    )


def _places(axes: Axes, found: Found) -> None:
    names = ["upper left", "top", "upper right", "left", "middle", "right"]
    names += ["lower left", "bottom", "lower right"]
    for number, (way, colour) in enumerate((("upright", "#1f6feb"), ("level", "#e16f24"))):
        at = np.arange(9) + (number - 0.5) * 0.3
        values = found.mtf50[:, :, number]
        low, middle, high = np.percentile(values, (5, 50, 95), axis=0)
        bars = [middle - low, high - middle]
        axes.errorbar(at, middle, bars, fmt="o", ms=3.5, color=colour, label=f"{way} edges")
        axes.plot(at, found.design[:, number], "_", color="#1b1f24", ms=8)
    axes.set_xticks(range(9), names, rotation=35, ha="right")
    axes.set(
        title="Places: median, 5 to 95 %, design (-)",
        ylabel="MTF50 [cycles/px]",
        ylim=(0, 1.1 * max(found.mtf50.max(), found.design.max())),
    )
    axes.legend()


def _offenders(axes: Axes, found: Found) -> None:
    shown = found.offenders[:OFFENDERS_SHOWN][::-1]
    axes.barh([name for name, _ in shown], [lost for _, lost in shown], color="#8250df")
    axes.set(title="Worst offenders, one standard deviation", xlabel="worst edge loses [cycles/px]")


def page_of(found: Found, raws: Raws | None) -> str:
    """Return the page as HTML."""
    facts = facts_of(found, raws)
    budget = found.study.budget
    passed = f"; yield {facts['yield']['share']:.1%}" if "yield" in facts else ""
    return filled(
        "tolerance/page.html",
        title="Tolerances",
        summary=f"{found.study.camera.title}: {budget.samples} lenses, {len(found.study.names)} "
        f"tolerances; MTF50 of the worst edge: design {found.design.min():.3f}, median "
        f"{facts['worst_edge_mtf50_cy_px']['p50']:.3f}, 5th percentile "
        f"{facts['worst_edge_mtf50_cy_px']['p5']:.3f} cycles/px{passed}",
        cameras=figure_of(found),
        raws=None if raws is None else raws_figure(found, raws),
        facts=facts,
    )
