"""``gpusim measure distortion``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gpusim.cli.measured import deliver, numbers, print_table, say
from gpusim.cli.sfr import channels_of
from gpusim.metrics.distortion import measure_distortion
from gpusim.metrics.picture import read_picture
from gpusim.report.distortion_facts import distortion_facts, distortion_rows
from gpusim.report.distortion_figure import draw_distortion
from gpusim.report.distortion_html import distortion_html


def distortion(
    path: Path,
    channels: str | None,
    centre: str | None,
    out: Path | None,
    *,
    linear: bool,
    as_json: bool,
) -> None:
    """Measure the distortion of a picture of a checkerboard or of dots."""
    planes = read_picture(path, linear=linear)
    middle = None
    if centre is not None:
        middle = numbers(centre, 2, "--centre", "x,y in pixels, such as 320,240")
    names = None if channels is None else channels_of(planes, channels, path)
    found = measure_distortion(planes, middle, names)
    deliver(
        "distortion",
        path,
        out,
        distortion_facts(found),
        distortion_rows(found),
        draw=lambda: draw_distortion(found, planes[found.reference].values, path.name),
        html=distortion_html,
        show=show,
        as_json=as_json,
    )


def show(facts: dict[str, Any]) -> None:
    """Print LGD, the models and lateral colour."""
    say(
        f"{facts['marks']} {facts['kind']}, out to {facts['farthest_mark']:.2f} of the way to the "
        f"corner; {facts['left_out']} left out"
    )
    print_table(
        ("r_d", "LGD, %", "u"),
        [
            (f"{one['radius']:.1f}", f"{one['value']:.4f}", f"{one['u']:.4f}")
            for one in facts["lgd_percent"]
        ],
    )
    say("")
    print_table(
        ("model", "misses, px RMS", "worst, px", "coefficients"),
        [
            (
                name,
                f"{one['rms_px']:.4f}",
                f"{one['worst_px']:.4f}",
                ", ".join(f"{value:.5g}" for value in one["coefficients"]),
            )
            for name, one in facts["models"].items()
        ],
    )
    for one in facts["lateral_colour"]:
        say(
            f"lateral colour {one['channel']} against {facts['reference']}: {one['rms_px']:.4f} px "
            f"RMS, {one['largest_radial_px']:+.4f} px outwards at most "
            f"({one['largest_radial_percent']:+.4f} % of the way to the corner)"
        )
    say(facts["units"])
