"""The single figures of ``gpusim lens``: which lenses they show, and where they are written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gpusim.cli.files import staging, whole_file
from gpusim.errors import UserError
from gpusim.formats.lens_file import KINDS as LENS_KINDS
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.ready import is_ready
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build

if TYPE_CHECKING:
    from gpusim.report.lens.study import Study


@dataclass(frozen=True)
class Setting:
    """What the options change of a lens; all but the last may also stand in ``--with``."""

    focal_length: float | None = None
    f_number: float | None = None
    object_distance: float | None = None
    focus_distance: float | None = None
    focus_shift: float | None = None
    nearest_glasses: bool = False

    @property
    def given(self) -> dict[str, object]:
        """The options that were given, by their names on the command line."""
        return {
            "--" + name.replace("_", "-"): value
            for name, value in vars(self).items()
            if value is not None and value is not False
        }

    def of(self, lens: Prescription) -> Prescription:
        """Return the lens with these changes; model glasses are the caller's."""
        if self.focal_length is not None:
            lens = lens.scaled(self.focal_length)
        if self.f_number is not None:
            lens = lens.stopped(self.f_number)
        distances = self.object_distance, self.focus_distance
        if any(one is not None for one in distances):
            lens = lens.looking(*distances)
        if self.focus_shift is not None:
            lens = lens.defocused(self.focus_shift)
        return lens

    def label(self, name: str) -> str:
        """Return what figures call the lens."""
        parts = [Path(name).stem]
        if self.focal_length is not None:
            parts.append(f"f = {self.focal_length:g} mm")
        if self.f_number is not None:
            parts.append(f"f/{self.f_number:g}")
        if self.object_distance is not None:
            parts.append(f"object at {self.object_distance:g} m")
        if self.focus_distance is not None:
            parts.append(f"focus at {self.focus_distance:g} m")
        if self.focus_shift is not None:
            parts.append(f"image plane {self.focus_shift:+g} \N{MICRO SIGN}m")
        if self.nearest_glasses:
            parts.append("nearest glasses")
        return ", ".join(parts)


SETTINGS = {
    "focal-length": "MM",
    "f-number": "N",
    "object-distance": "M",
    "focus-distance": "M",
    "focus-shift": "UM",
}
FORM = f"LENS, a setting ({', '.join(f'{k}={v}' for k, v in SETTINGS.items())}), or both by commas"


def second(text: str, name: str, setting: Setting) -> tuple[str, Setting]:
    """Return the lens and setting that ``--with`` asks for.

    A lens of its own has no setting but its own; a setting alone changes the first lens's.
    """
    lenses, values = [], {}
    for part in text.split(","):
        key, equals, value = part.strip().partition("=")
        if not equals or key not in SETTINGS:
            lenses.append(part.strip())
            continue
        try:
            values[key.replace("-", "_")] = float(value)
        except ValueError:
            raise UserError(
                "this is no number", field=f"--with {key}", value=value, allowed=SETTINGS[key]
            ) from None
    if len(lenses) > 1 or not text.strip():
        raise UserError("one second lens is drawn", field="--with", value=text, allowed=FORM)
    if lenses:
        if is_ready(lenses[0]):
            raise no_surfaces(lenses[0], "--with")
        return lenses[0], Setting(**values)
    return name, replace(setting, **values)


def no_surfaces(name: str, option: str, value: object = None) -> UserError:
    """Return the error of a ready-made lens that an option would have to trace."""
    return UserError(
        "a ready-made lens is used as it is: it has no surfaces to trace again",
        file=name,
        field=option,
        value=value,
        allowed=f"a {LENS_KINDS} file, or a preset, for a lens that is traced",
    )


@dataclass(frozen=True)
class Wanted:
    """What is asked for of the single figures.

    Attributes
    ----------
    beside : str, optional
        ``--with``: the second lens or setting.
    frequency : float, optional
        Cycles/mm of the curves at one frequency.
    figures, csv : Path, optional
        Folders for a picture of each figure, and for its numbers.
    json : Path, optional
        File for the numbers of all figures.
    page : bool
        Whether the page that ``--out`` asks for shows them.
    """

    beside: str | None = None
    frequency: float | None = None
    figures: Path | None = None
    csv: Path | None = None
    json: Path | None = None
    page: bool = False

    @property
    def given(self) -> dict[str, object]:
        """The options that were given, by their names on the command line."""
        named = {
            "--with": self.beside,
            "--frequency": self.frequency,
            "--figures": self.figures,
            "--csv": self.csv,
            "--json": self.json,
        }
        return {name: value for name, value in named.items() if value is not None}

    @property
    def files(self) -> bool:
        """Whether figures or their numbers are written beside the page."""
        return any(one is not None for one in (self.figures, self.csv, self.json))

    def check(self) -> None:
        """Refuse what would do nothing, and a frequency that is none."""
        if self.frequency is not None and not (
            math.isfinite(self.frequency) and self.frequency > 0
        ):
            raise UserError(
                "a spatial frequency must be greater than 0",
                field="--frequency",
                value=self.frequency,
                allowed="> 0 cycles/mm",
            )
        if self.beside is not None and not (self.files or self.page):
            raise UserError(
                "a second lens is drawn in figures, and none are asked for",
                field="--with",
                value=self.beside,
                allowed="with --out FILE.html, --figures, --csv or --json",
            )


@contextmanager
def places(wanted: Wanted) -> Iterator[dict[str, Path]]:
    """Yield where to write, by option; what is written takes its place at the end or not at all."""
    with ExitStack() as stack:
        found = {}
        for option, folder in (("--figures", wanted.figures), ("--csv", wanted.csv)):
            if folder is not None:
                found[option] = stack.enter_context(staging(folder, option))
        if wanted.json is not None:
            file = stack.enter_context(whole_file(wanted.json, (".json",), "--json"))
            found["--json"] = file
        yield found


def studied(
    lens: Prescription,
    name: str,
    setting: Setting,
    other: tuple[str, Setting] | None,
    wanted: Wanted,
) -> list[Study]:
    """Return the lenses that the figures show.

    Parameters
    ----------
    lens : Prescription
        The first, with its setting.
    name : str
        What the user calls it.
    setting : Setting
    other : tuple of str and Setting, optional
        The second.
    wanted : Wanted
    """
    from gpusim.report.lens.study import Study, aligned

    studies = [Study(setting.label(name), build(lens), wanted.frequency)]
    if other is not None:
        name, setting = other
        lens = load_prescription(name)
        lens = setting.of(lens.with_nearest_glasses() if setting.nearest_glasses else lens)
        studies.append(Study(setting.label(name), build(lens)))
        aligned(studies)
    return studies


def write_plots(
    studies: list[Study], at: dict[str, Path], progress: Callable[[str, int, int], None]
) -> None:
    """Write what ``places`` has a place for: pictures, tables, numbers."""
    from gpusim.report import drawing
    from gpusim.report.lens.plots import PLOTS, csv_text, draw_plot, json_text, tables

    for number, plot in enumerate(PLOTS, start=1):
        if "--figures" in at:
            picture = drawing.png(draw_plot(plot, studies))
            (at["--figures"] / f"{plot.name}.png").write_bytes(picture)
        if "--csv" in at:
            for name, columns in tables(plot, studies).items():
                text = csv_text(columns)
                (at["--csv"] / f"{name}.csv").write_text(text, encoding="utf-8")
        progress("figures", number, len(PLOTS))
    if "--json" in at:
        at["--json"].write_text(json_text(studies), encoding="utf-8")
