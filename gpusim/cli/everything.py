"""``gpusim measure all``: whatever a picture shows that can be measured, on one page."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from gpusim.cli.colour import colour
from gpusim.cli.distortion import distortion
from gpusim.cli.files import staging
from gpusim.cli.glare import glare
from gpusim.cli.measured import say
from gpusim.cli.sfr import region_of, sfr
from gpusim.cli.shading import shading
from gpusim.cli.snr import snr
from gpusim.cli.spectra import spectra
from gpusim.cli.texture import texture
from gpusim.errors import UserError
from gpusim.metrics.picture import read_picture
from gpusim.report.template import filled

ILLUMINANT = "D65"
Measure = Callable[[Path, Path], object]


def everything(
    path: Path, out: Path, *, waves: Sequence[str], leaves: str | None, linear: bool
) -> int:
    """Measure a picture in every way that it allows; return the exit code: 1 where none does.

    Glare in black spots, or the shading of an even field, is measured of pictures that show nothing
    else: a chart's black is no light trap. Sinusoids and dead leaves are measured where regions of
    them are given: noise has the spectrum of either.
    """
    given = {"linear": linear, "as_json": False}
    on_charts: dict[str, Measure] = {
        "sfr": lambda file, to: sfr(
            file, [], None, to, pitch_um=None, f_number=None, wavelength_nm=550.0, **given
        ),
        "distortion": lambda file, to: distortion(file, None, None, to, **given),
        "colour": lambda file, to: colour(file, ILLUMINANT, None, to, **given),
        "snr": lambda file, to: snr(file, [], None, to, **given),
    }
    if waves:
        on_charts["spectra"] = lambda file, to: spectra(
            file, waves, None, to, distortion=None, **given
        )
    if leaves is not None:
        on_charts["texture"] = lambda file, to: texture(
            file,
            roi=leaves,
            leaves=None,
            second=None,
            even=None,
            channels=None,
            out=to,
            **given,
        )
    on_fields: dict[str, Measure] = {
        "glare": lambda file, to: glare(file, None, to, **given),
        "shading": lambda file, to: shading(file, None, to, **given),
    }
    for option, boxes in (("--wave", waves), ("--texture", [leaves] if leaves else [])):
        for box in boxes:
            region_of(box, option)
    read_picture(path, linear=linear)  # one that cannot be read is told once
    left_out = {name: _done(name, one, path, out) for name, one in on_charts.items()}
    for name, one in on_fields.items():
        if all(left_out.values()):
            left_out[name] = _done(name, one, path, out)
    shown = [name for name, why in left_out.items() if why is None]
    missing = {name: why for name, why in left_out.items() if why is not None}
    facts = {name: json.loads((out / f"{name}.json").read_text()) for name in shown}
    with staging(out) as folder:
        (folder / "all.html").write_text(_page(path.name, out, shown, missing))
        text = json.dumps({**facts, "left_out": missing}, indent=1, allow_nan=False)
        (folder / "all.json").write_text(text + "\n")
    for name in ("all.html", "all.json"):
        say(str(out / name))
    return 0 if shown else 1


def _page(title: str, out: Path, shown: list[str], missing: dict[str, str]) -> str:
    pages = {name: _body((out / f"{name}.html").read_text()) for name in shown}
    return filled("cli/everything.html", title=title, shown=pages, missing=missing)


def _body(page: str) -> str:
    """Return what a page shows below its title: to stand in another one."""
    return page.partition("</h1>")[2].partition("</body>")[0]


def _done(name: str, measure: Measure, path: Path, folder: Path) -> str | None:
    """Measure a picture one way; return why not, or None."""
    say(f"-- {name}")
    try:
        measure(path, folder)
    except UserError as error:
        say(f"left out: {error.problem}")
        return error.problem
    return None
