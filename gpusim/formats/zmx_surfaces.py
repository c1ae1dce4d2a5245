"""The surfaces of a Zemax lens file: shape, glass and clear aperture."""

from __future__ import annotations

from gpusim.formats.zmx_glasses import Glasses
from gpusim.formats.zmx_lines import Block, ZmxFile
from gpusim.lens.surface import ASPHERE_POWERS

# Surface keys that carry no optics: display, solves (their result stands beside them), comments,
# mirror substrate, mechanical size, propagation and coating-layout settings.
_HARMLESS_SURFACE_KEYS = frozenset(
    "COMM HIDE SLAB MIRR POPS MEMA OEMA FIMP PPAR PZUP VPAR VDSZ VCUR VCON MAZH MAZP CHZH "
    "SCOL SOPA HASH TCEX BDRO EDGE PRVT OVAL".split()
)
_READ_SURFACE_KEYS = frozenset(
    "TYPE CURV DISZ CONI PARM XDAT GLAS DIAM STOP CLAP FLAP COAT".split()
)
_REFUSED_SURFACE_KEYS = {
    "OBSC": "a central obscuration is not modelled",
    "SPID": "a spider is not modelled",
    "SQAP": "a rectangular aperture is not modelled",
    "SQOB": "a rectangular obscuration is not modelled",
    "ELAP": "an elliptical aperture is not modelled",
    "ELOB": "an elliptical obscuration is not modelled",
    "UDAD": "an aperture from a file is not modelled",
    "OBDC": "a decentred aperture is not modelled",
    "SCBD": "a tilted or decentred surface is not modelled",
}
_EVEN_TERMS = 8  # PARM 1 to 8 of an even asphere: r^2 to r^16


def surface_of(
    zmx: ZmxFile, glasses: Glasses, block: Block, *, is_stop: bool, in_air: bool
) -> dict[str, object]:
    """Return a surface as fields of a prescription."""
    kind = _kind(zmx, block)
    row: dict[str, object] = {
        "curvature": zmx.number(block, "CURV"),
        "thickness": zmx.number(block, "DISZ"),
        "conic": zmx.number(block, "CONI"),
    }
    _polynomial(zmx, block, kind, row)
    glasses.put(block, row)
    read = [key for key in block.lines if key in _READ_SURFACE_KEYS - {"COAT"}]
    clips = "CLAP" in block.lines or "FLAP" in block.lines
    if in_air and "glass" not in row and not clips:
        if "DIAM" in block.lines:
            read.remove("DIAM")
            why = "the system aperture sets the stop" if is_stop else "nothing clips in air"
            zmx.import_log.ignored(block.number, f"DIAM: {why}")
    else:
        _aperture(zmx, block, row)
    zmx.import_log.read(block.number, ", ".join(read))
    if "COAT" in block.lines:
        zmx.import_log.substituted(block.number, "COAT: coating by uncoated Fresnel losses")
    ignored = [key for key in block.lines if key in _HARMLESS_SURFACE_KEYS]
    if ignored:
        zmx.import_log.ignored(block.number, ", ".join(ignored))
    return row


def _kind(zmx: ZmxFile, block: Block) -> str:
    """Return the type of a surface, of which everything is understood."""
    place = f"SURF {block.number}"
    kind = (block.lines.get("TYPE", [["STANDARD"]])[0] or ["none"])[0]
    if kind not in ("STANDARD", "EVENASPH", "XASPHERE"):
        problem = (
            "coordinate breaks are not modelled"
            if kind == "COORDBRK"
            else f"surface type {kind} is not modelled"
        )
        raise zmx.refuse(problem, f"{place} TYPE", kind, "STANDARD, EVENASPH, XASPHERE")
    for key in block.lines:
        if key in _REFUSED_SURFACE_KEYS or key not in (_HARMLESS_SURFACE_KEYS | _READ_SURFACE_KEYS):
            raise zmx.refuse(
                _REFUSED_SURFACE_KEYS.get(
                    key, f"surface key {key} is not understood and may change the optics"
                ),
                f"{place} {key}",
                " ".join(block.lines[key][0]),
                ", ".join(sorted(_READ_SURFACE_KEYS)),
            )
    for key in ("CURV", "DISZ"):
        if not block.first(key):
            raise zmx.refuse(
                "a surface is incomplete: the file is truncated", place, None, f"a {key} line"
            )
    return kind


def _polynomial(zmx: ZmxFile, block: Block, kind: str, row: dict[str, object]) -> None:
    """Even aspheres: PARM i is the coefficient of r^(2i).

    Extended aspheres: XDAT 1 is the number of terms, XDAT 2 the normalisation radius R, and
    XDAT 2 + i the coefficient of (r/R)^(2i).
    """
    place = f"SURF {block.number}"
    lines = {
        f"{key} {order}": value
        for key in ("PARM", "XDAT")
        for order, value in zmx.indexed(block, key).items()
    }
    terms = {}
    if kind == "EVENASPH":
        names = {f"PARM {i}": 2 * i for i in range(1, _EVEN_TERMS + 1)}
        terms = {names[line]: lines.pop(line) for line in names.keys() & lines.keys()}
    elif kind == "XASPHERE":
        count, radius = lines.pop("XDAT 1", 0.0), lines.pop("XDAT 2", 0.0)
        # A radius whose 30th power is no double is no length of a lens either.
        if count < 0 or not 1e-10 < radius < 1e10:
            raise zmx.refuse(
                "an extended asphere is incomplete",
                f"{place} XDAT",
                f"{count:g} terms, normalisation radius {radius:g}",
                "XDAT 1 terms, XDAT 2 normalisation radius in mm",
            )
        names = {f"XDAT {i + 2}": 2 * i for i in range(1, len(ASPHERE_POWERS) + 1)}
        terms = {
            names[line]: lines.pop(line) / radius ** names[line]
            for line in names.keys() & lines.keys()
        }
        # Coefficients beyond the stated number of terms count for nothing.
        terms = {power: value for power, value in terms.items() if power <= 2 * count}
        lines = {line: v for line, v in lines.items() if int(line.split()[1]) - 2 <= count}
    if lines:
        line, value = next(iter(lines.items()))
        raise zmx.refuse(
            "a surface parameter is not understood",
            f"{place} {line}",
            value,
            "PARM 1 to 8 of an EVENASPH, up to 15 terms of an XASPHERE",
        )
    if terms:
        row["asphere"] = {f"a{power}": value for power, value in terms.items()}


def _aperture(zmx: ZmxFile, block: Block, row: dict[str, object]) -> None:
    """DIAM is the semi-diameter; CLAP a ring, of which only the outer edge is modelled."""
    sizes = [zmx.number(block, "DIAM")]
    for key in ("CLAP", "FLAP"):
        if zmx.number(block, key, 0) != 0:
            raise zmx.refuse(
                "a central obscuration is not modelled",
                f"SURF {block.number} {key}",
                " ".join(block.lines[key][0]),
                "an inner radius of 0",
            )
    sizes.append(zmx.number(block, "CLAP", 1))
    sizes = [size for size in sizes if size > 0]
    if sizes:
        row["semi_diameter"] = min(sizes)
