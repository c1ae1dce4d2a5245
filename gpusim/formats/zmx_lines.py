"""The lines of a Zemax lens file: ``KEY value ...``; indented keys belong to the last ``SURF``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gpusim.formats.imported import INFINITE
from gpusim.formats.reading import Reading
from gpusim.formats.text import finite

# Fields and vignetting factors in files of about 2003 and before.
_OLD_KEYS = {
    "XFLD": "XFLN",
    "YFLD": "YFLN",
    "ZVDX": "VDXN",
    "ZVDY": "VDYN",
    "ZVCX": "VCXN",
    "ZVCY": "VCYN",
    "ZVAN": "VANN",
}


@dataclass
class Block:
    """The lines of one surface, or of the head: key to the values of each occurrence."""

    number: int | None
    lines: dict[str, list[list[str]]] = field(default_factory=dict)

    def first(self, key: str) -> list[str] | None:
        """Return the values of the first occurrence of a key."""
        return self.lines[key][0] if key in self.lines else None


class ZmxFile(Reading):
    """One file being read: its head and its surfaces, the object first and the image last.

    Raises
    ------
    UserError
        Where the surfaces are not numbered in order.
    """

    def __init__(self, text: str, file: Path) -> None:
        super().__init__(file)
        self.head = Block(None)
        self.surfaces: list[Block] = []
        for line in text.splitlines():
            words = line.split()
            if not words:
                continue
            key, values = words[0].upper(), words[1:]
            if key == "SURF":
                if values[:1] != [str(len(self.surfaces))]:
                    raise self.refuse(
                        "the surfaces are not numbered in order: the file is damaged",
                        "SURF",
                        " ".join(values),
                        f"SURF {len(self.surfaces)}",
                    )
                self.surfaces.append(Block(len(self.surfaces)))
                continue
            key = _OLD_KEYS.get(key, key)
            # Only indented lines belong to a surface; operands and settings may follow the last.
            indented = line[0] in " \t" and self.surfaces
            block = self.surfaces[-1] if indented else self.head
            block.lines.setdefault(key, []).append(values)

    def number(self, block: Block, key: str, position: int = 0, default: float = 0.0) -> float:
        """Return one number of a key, or the default where the key or the number is missing."""
        values = block.first(key)
        if values is None or len(values) <= position:
            return default
        try:
            return finite(values[position])
        except ValueError as error:
            where = key if block.number is None else f"SURF {block.number} {key}"
            raise self.refuse(
                "a value is not a number", where, values[position], "a number"
            ) from error

    def indexed(self, block: Block, key: str) -> dict[int, float]:
        """Return the values of ``KEY i value`` lines that are not 0."""
        found = {}
        for values in block.lines.get(key, []):
            try:
                order, value = int(values[0]), finite(values[1])
            except (IndexError, ValueError) as error:
                raise self.refuse(
                    "a parameter is not a number",
                    f"SURF {block.number} {key}",
                    " ".join(values),
                    f"{key} i value",
                ) from error
            if value:
                found[order] = value
        return found

    def distance(self) -> float | None:
        """Return the distance of the object; None at infinity.

        Raises
        ------
        UserError
            Where it does not lie before the lens.
        """
        object_ = self.surfaces[0]
        text = (object_.first("DISZ") or ["none"])[0]
        if text.upper() == "INFINITY" or self.number(object_, "DISZ") >= INFINITE:
            return None
        if self.number(object_, "DISZ") <= 0:
            raise self.refuse(
                "the object does not lie before the lens", "SURF 0 DISZ", text, "> 0, or INFINITY"
            )
        return self.number(object_, "DISZ")

    def stop(self) -> int:
        """Return the number of the stop, the one surface with STOP."""
        stops = [block.number for block in self.surfaces if "STOP" in block.lines]
        if len(stops) != 1:
            raise self.refuse(
                "the file has no stop" if not stops else "the file has several stops",
                "STOP",
                stops or None,
                "one surface with STOP",
            )
        return stops[0]
