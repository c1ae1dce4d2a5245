"""``gpusim develop``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gpusim.cli.files import whole_file
from gpusim.config.mistakes import checked
from gpusim.errors import UserError
from gpusim.isp.develop import develop
from gpusim.isp.files import TIFFS, write_picture
from gpusim.isp.libraw import develop_by_libraw
from gpusim.isp.settings import Settings, read_settings, settings_text

ENGINES = ("gpusim", "libraw")
BITS = (8, 16)


def run(
    raw: Path,
    out: Path,
    *,
    engine: str,
    binned: bool,
    bits: int | None,
    ev: float | None,
    settings_file: Path | None,
    options: dict[str, Any],
) -> None:
    """Develop a raw file into a picture.

    Parameters
    ----------
    raw, out : Path
    engine : str
        One of `ENGINES`.
    binned : bool
    bits : int, optional
        Bits of each colour, 8 or 16; by default 8 of a PNG and 16 of a TIFF.
    ev : float, optional
        Stops; by default the settings file's, or 0.
    settings_file : Path, optional
        File with the settings of our engine.
    options : dict
        Fields of `Settings` and their values, None where the user gave none: they go before the
        settings file's.
    """
    given = {name: value for name, value in options.items() if value is not None}
    ours = settings_file is not None or bool(given) or bits == 16 or out.suffix.lower() in TIFFS
    if engine not in ENGINES:
        raise UserError(
            "no such engine", field="--engine", value=engine, allowed=", ".join(ENGINES)
        )
    if bits not in (*BITS, None):
        raise UserError("no such number of bits", field="--bits", value=bits, allowed="8 or 16")
    if engine == "gpusim":
        more = {} if ev is None else {"ev": ev}
        _ours(raw, out, given | more, settings_file, binned=binned, bits=bits)
        return
    if ours:
        named = "--settings" if settings_file else next(iter(given), "--out")
        raise UserError(
            "LibRaw's engine takes --ev and --binned alone, and makes .png",
            field=named if named.startswith("--") else f"--{named.replace('_', '-')}",
            allowed="--engine gpusim",
        )
    with whole_file(out, (".png",)) as file:
        write_picture(file, develop_by_libraw(raw, ev or 0.0, binned=binned))
    print(out)


def _ours(
    raw: Path,
    out: Path,
    given: dict[str, Any],
    settings_file: Path | None,
    *,
    binned: bool,
    bits: int | None,
) -> None:
    settings = _settings(settings_file, given)
    wide = bits == 16 or (bits is None and out.suffix.lower() in TIFFS)
    with whole_file(out, (".png", *TIFFS)) as file:
        made = develop(raw, settings, binned=binned, bits=16 if wide else 8)
        write_picture(file, made.picture, settings.space)
        notes = [f"How {out.name} was developed; gpusim develop --settings reads it."]
        notes += [f"left out: {stage}: {why}" for stage, why in made.left_out.items()]
        file.with_suffix(".yaml").write_text(settings_text(settings, notes), encoding="utf-8")
    print(out)
    for stage, why in made.left_out.items():
        print(f"  left out  {stage}: {why}")


def _settings(file: Path | None, given: dict[str, Any]) -> Settings:
    """Return the settings of a file, with those that were given by options."""
    base = read_settings(file) if file else Settings()
    try:
        return checked(Settings, base.model_dump() | given, Path())
    except UserError as error:  # the file's own were right
        error.file, error.field = None, f"--{str(error.field).replace('_', '-')}"
        raise
