"""Lens files: those of the package by their names, and those of other programs."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from gpusim.config.names import perhaps
from gpusim.config.text import read_bytes, yaml_of
from gpusim.errors import UserError
from gpusim.formats.agf import with_file_catalogues
from gpusim.formats.imported import with_small_field
from gpusim.formats.pbrt import parse_pbrt
from gpusim.formats.seq import parse_seq
from gpusim.formats.zmx import parse_zmx
from gpusim.lens.prescription import Prescription, validated

KINDS = ".yaml, .zmx, .seq or .dat"


def presets() -> dict[str, Path]:
    """Return the lenses that come with the package: name to file."""
    folder = Path(str(resources.files("gpusim") / "data" / "lenses"))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_prescription(name_or_path: str | Path) -> Prescription:
    """Read a lens: a preset's name, or a file.

    Files are the project's own ``.yaml``, Zemax ``.zmx``, CODE V ``.seq`` and pbrt ``.dat``.

    Raises
    ------
    UserError
        Where there is no such lens, or the file is not a complete prescription: names the file,
        the field, its value and what is allowed. So it is for a glass that no catalogue has, or
        several have.
    """
    known = presets()
    path = known.get(str(name_or_path), Path(name_or_path))
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise UserError(
            f"no such lens{perhaps(name_or_path, known)}",
            field="lens",
            value=name_or_path,
            allowed=f"a {KINDS} file, or a preset: {', '.join(known)}",
        )
    content = read_bytes(
        path, "the lens file", allowed=f"a readable {KINDS} file, or a preset: {', '.join(known)}"
    )
    lens = reader(content, path)
    if lens.nearest_glasses:
        lens = lens.with_nearest_glasses()
    if lens.internal_transmission:
        lens = lens.absorbing()
    if lens.max_field_deg == 0:
        lens = with_small_field(lens)
    _ = lens.known  # finds every glass: one that is not known is told here, not at the first ray
    return lens


def _parse_yaml(content: bytes, path: Path) -> Prescription:
    data = yaml_of(content, path, "the lens file")
    lens = with_file_catalogues(validated(data, path))
    given = [name for name in data if name not in ("surfaces", "checks")]
    lens.import_log.read("file", ", ".join(given))
    for number, (row, surface) in enumerate(
        zip(data["surfaces"], lens.surfaces, strict=True), start=1
    ):
        printed = surface.glass not in (None, "model", "constant") and surface.nd is not None
        lens.import_log.read(
            number, ", ".join(key for key in row if not (printed and key in ("nd", "vd")))
        )
        if printed:
            lens.import_log.ignored(number, f"nd, vd: the index is that of glass {surface.glass}")
    return lens


READERS = {
    ".yaml": _parse_yaml,
    ".yml": _parse_yaml,
    ".zmx": parse_zmx,
    ".seq": parse_seq,
    ".dat": parse_pbrt,
}
