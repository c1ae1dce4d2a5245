"""``gpusim measure glare``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gpusim.cli.measured import deliver, print_table, say
from gpusim.cli.sfr import channels_of
from gpusim.metrics.glare import measure_glare
from gpusim.metrics.picture import read_picture
from gpusim.report.glare_page import draw_glare, glare_facts, glare_html, glare_rows


def glare(
    path: Path, channels: str | None, out: Path | None, *, linear: bool, as_json: bool
) -> None:
    """Measure the veiling glare in black spots of a picture."""
    planes = read_picture(path, linear=linear)
    names = list(planes) if channels is None else channels_of(planes, channels, path)
    found = {name: measure_glare(planes[name], name) for name in names}
    facts = glare_facts(found)
    deliver(
        "glare",
        path,
        out,
        facts,
        glare_rows(facts),
        draw=lambda: draw_glare(found, planes[names[0]].values, path.name),
        html=glare_html,
        show=show,
        as_json=as_json,
    )


def show(facts: dict[str, Any]) -> None:
    """Print a line for each spot and channel."""
    print_table(
        ("channel", "spot", "dark", "field", "index, %", "u"),
        [
            (
                one["channel"],
                str(spot["spot"]),
                f"{spot['dark']:.5g}",
                f"{spot['field']:.5g}",
                f"{spot['index_percent']:.3f}",
                f"{spot['u_percent']:.3f}",
            )
            for one in facts["channels"]
            for spot in one["spots"]
        ],
    )
    say(facts["units"])
