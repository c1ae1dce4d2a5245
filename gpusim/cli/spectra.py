"""``gpusim measure spectra``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gpusim.cli.measured import deliver, print_table, say
from gpusim.cli.sfr import channels_of, region_of
from gpusim.metrics.picture import read_picture
from gpusim.metrics.sinusoid import measure_sinusoid
from gpusim.report.spectra_page import (
    draw_spectra,
    harmonic_of,
    spectra_facts,
    spectra_html,
    spectra_rows,
)


def spectra(
    path: Path,
    boxes: Sequence[str],
    channels: str | None,
    out: Path | None,
    *,
    linear: bool,
    as_json: bool,
) -> None:
    """Measure the wave in each region of a picture, of all of it where none is given."""
    planes = read_picture(path, linear=linear)
    names = list(planes) if channels is None else channels_of(planes, channels, path)
    rows, cols = planes[names[0]].values.shape
    regions = [region_of(box) for box in boxes] or [(0, 0, cols, rows)]
    found = [
        (number, name, measure_sinusoid(planes[name], box))
        for number, box in enumerate(regions, start=1)
        for name in names
    ]
    deliver(
        "spectra",
        path,
        out,
        spectra_facts(found),
        spectra_rows(found),
        draw=lambda: draw_spectra(found, planes[names[0]].values, path.name),
        html=spectra_html,
        show=show,
        as_json=as_json,
    )


def show(facts: dict[str, Any]) -> None:
    """Print a line for each wave."""
    print_table(
        ("region", "channel", "frequency, c/px", "u", "amplitude", "modulation", "2nd harmonic"),
        [
            (
                str(one["region"]),
                one["channel"],
                f"{one['frequency_cy_px']['value']:.6f}",
                f"{one['frequency_cy_px']['u']:.1e}",
                f"{one['amplitude']['value']:.5g}",
                f"{one['modulation']['value']:.5f}",
                harmonic_of(one),
            )
            for one in facts["waves"]
        ],
    )
    say(facts["units"])
