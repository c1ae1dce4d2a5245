"""``gpusim measure spectra``."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gpusim.cli.measured import deliver, print_table, say
from gpusim.cli.sfr import channels_of, region_of
from gpusim.config.text import read_json
from gpusim.errors import UserError
from gpusim.metrics.picture import read_picture
from gpusim.metrics.sinusoid import Bend, Sinusoid, measure_sinusoid
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
    distortion: str | None,
    linear: bool,
    as_json: bool,
) -> None:
    """Measure the wave in each region of a picture, of all of it where none is given."""
    straight = None if distortion is None else _undistorted(distortion)
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
        spectra_facts(found, straight),
        spectra_rows(found),
        draw=lambda: draw_spectra(found, planes[names[0]].values, path.name),
        html=spectra_html,
        show=show,
        as_json=as_json,
    )


def _undistorted(text: str) -> Callable[[Sinusoid], float]:
    """Return what gives a wave's frequency without distortion: LGD in per cent, or a file of it."""
    try:
        percent = float(text)
    except ValueError:
        return _bend(Path(text)).undistorted
    if not -100 < percent < math.inf:
        raise UserError(
            "not a local geometric distortion",
            field="--distortion",
            value=text,
            allowed="per cent, above -100, or the file distortion.json",
        )
    return lambda one: one.frequency_cy_px.value * (1 + percent / 100)


def _bend(path: Path) -> Bend:
    """Read the file that `gpusim measure distortion` writes."""
    facts = read_json(path, "the distortion")
    try:
        x, y = facts["centre_px"]
        chosen = facts["models"]["chosen"]["coefficients"]
        return Bend(tuple(map(float, chosen)), (float(x), float(y)), float(facts["corner_px"]))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(
            "not what gpusim measure distortion writes",
            file=path,
            field="--distortion",
            allowed="its distortion.json, or LGD in per cent",
        ) from error


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
    for one in facts["waves"]:
        if "undistorted_cy_px" in one:
            say(
                f"region {one['region']}, {one['channel']}: "
                f"{one['undistorted_cy_px']:.6f} c/px without distortion; "
                f"found / that = {one['over_undistorted']:.6f}"
            )
    say(facts["units"])
