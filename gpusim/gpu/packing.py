"""WGSL memory layout: sizes, alignments and the packing of a uniform struct.

Rules of the WGSL specification, sections "Alignment and Size" and "Address Space Layout
Constraints" (W3C): a vec3 has size 12 and alignment 16; a matrix is its columns, each at the
alignment of a column; in a uniform, array strides are multiples of 16.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

SCALARS = {"f32": np.float32, "u32": np.uint32, "i32": np.int32}
_SHORT = {"f": "f32", "u": "u32", "i": "i32"}


class ShaderError(ValueError):
    """A shader that breaks a rule of WGSL or of this project, or a call that does not fit it."""


def _round_up(value: int, step: int) -> int:
    return -(-value // step) * step


@dataclass(frozen=True)
class TypeLayout:
    """Memory layout of one type, in bytes.

    Attributes
    ----------
    size, align : int
        ``size`` is 0 for a run-time-sized array, whose element then gives ``stride``.
    stride : int
        Distance between the elements of an array; 0 if it is none.
    scalar : str or None
        ``f32``, ``u32`` or ``i32``; None for a struct or a bool.
    shape : tuple of int
        As NumPy sees a value: () scalar, (n,) vector, (rows, cols) matrix, arrays in front.
    stored : tuple of int
        As it lies in memory, in scalars: matrices by column, columns and elements padded.
    """

    size: int
    align: int
    stride: int
    scalar: str | None
    shape: tuple[int, ...] = ()
    stored: tuple[int, ...] = ()
    matrix: bool = False


class Layouts:
    """Layout rules of one module.

    Parameters
    ----------
    aliases, structs : dict of str to str
        The text of each alias, and the member list of each struct.
    evaluate : callable
        Evaluates a constant expression, for array lengths.
    """

    def __init__(
        self,
        aliases: Mapping[str, str],
        structs: Mapping[str, str],
        evaluate: Callable[[str], float],
    ) -> None:
        self._aliases = aliases
        self._structs = structs
        self._evaluate = evaluate

    def of(self, kind: str) -> TypeLayout:
        """Return the layout of the type written as ``kind``.

        Raises
        ------
        ShaderError
            A type that is neither scalar, vector, matrix, array, atomic nor a known struct.
        """
        kind = re.sub(r"\s+", "", kind)
        if kind in self._aliases:
            return self.of(self._aliases[kind])
        if kind in SCALARS:
            return TypeLayout(4, 4, 0, kind)
        if kind == "bool":  # only in workgroup memory, where naga stores 4 bytes
            return TypeLayout(4, 4, 0, None)
        if found := re.fullmatch(r"atomic<([ui]32)>", kind):
            return TypeLayout(4, 4, 0, found[1])
        if found := re.fullmatch(r"vec([234])(?:<(\w+)>|([fui]))", kind):
            count, scalar = int(found[1]), found[2] or _SHORT[found[3]]
            if scalar in SCALARS:
                return TypeLayout(4 * count, 8 if count == 2 else 16, 0, scalar, (count,), (count,))
        if found := re.fullmatch(r"mat([234])x([234])(?:<f32>|f)", kind):
            cols, rows = int(found[1]), int(found[2])
            step = 2 if rows == 2 else 4
            return TypeLayout(
                4 * cols * step, 4 * step, 0, "f32", (rows, cols), (cols, step), matrix=True
            )
        if kind.startswith("array<") and kind.endswith(">"):
            return self._array(kind[len("array<") : -1])
        if kind in self._structs:
            members = self._members(kind)
            align = max(layout.align for _, _, layout in members)
            _, offset, last = members[-1]
            return TypeLayout(_round_up(offset + last.size, align), align, 0, None)
        raise ShaderError(f"type {kind!r} is not known to the host")

    def _array(self, inside: str) -> TypeLayout:
        kind, *length = split_top(inside)
        element = self.of(kind)
        stride = _round_up(element.size, element.align)
        count = int(self._evaluate(length[0])) if length else 0
        stored = (4,) if element.stored == (3,) else element.stored  # vec3: padded to a vec4
        return TypeLayout(
            count * stride,
            element.align,
            stride,
            element.scalar,
            (count, *element.shape),
            (count, *stored),
            element.matrix,
        )

    def _members(self, struct: str) -> list[tuple[str, int, TypeLayout]]:
        members, offset = [], 0
        body = self._structs[struct]
        if "@" in body:
            raise ShaderError(f"struct {struct}: attributes on members are not used")
        for declaration in split_top(body):
            name, _, kind = declaration.partition(":")
            layout = self.of(kind)
            offset = _round_up(offset, layout.align)
            members.append((name.strip(), offset, layout))
            offset += layout.size
        if not members:
            raise ShaderError(f"struct {struct} is empty")
        return members

    def uniform(self, struct: str) -> Struct:
        """Return the packer of a struct bound as ``var<uniform>``.

        Raises
        ------
        ShaderError
            No such struct, or a member that a uniform may not hold.
        """
        if struct not in self._structs:
            raise ShaderError(f"there is no `struct {struct}`")
        members = self._members(struct)
        for name, _, layout in members:
            if layout.scalar is None:
                raise ShaderError(f"{struct}.{name}: a scalar, vector, matrix or array is needed")
            if layout.stride % 16:
                raise ShaderError(
                    f"{struct}.{name}: the elements of an array in a uniform must be 16 bytes "
                    f"apart, these are {layout.stride}: use vec4"
                )
        align = max(16, *(layout.align for _, _, layout in members))
        _, offset, last = members[-1]
        size = _round_up(offset + last.size, align)
        return Struct(struct, {name: (at, layout) for name, at, layout in members}, size)


@dataclass(frozen=True)
class Struct:
    """A uniform struct: member offsets and types, and the packing of values.

    Attributes
    ----------
    members : dict of str to (int, TypeLayout)
        Offset in bytes and type of each member, in order.
    size : int
        Bytes, a multiple of 16.
    """

    name: str
    members: Mapping[str, tuple[int, TypeLayout]]
    size: int

    @property
    def dtype(self) -> np.dtype:
        """NumPy dtype with the members where the shader sees them (matrices by column, padded)."""
        return np.dtype(
            {
                "names": list(self.members),
                "formats": [
                    (SCALARS[kind.scalar], kind.stored) for _, kind in self.members.values()
                ],
                "offsets": [offset for offset, _ in self.members.values()],
                "itemsize": self.size,
            }
        )

    def pack(self, values: Mapping[str, object]) -> bytes:
        """Return the bytes of the struct.

        Parameters
        ----------
        values : dict
            One value for each member: a number, or an array of the member's shape; a matrix as
            (rows, cols).

        Raises
        ------
        ShaderError
            Missing or unknown names, wrong shape, a value that the type cannot hold.
        """
        missing, extra = self.members.keys() - values.keys(), values.keys() - self.members.keys()
        if missing or extra:
            raise ShaderError(
                f"struct {self.name}: missing {sorted(missing)}, unknown {sorted(extra)}"
            )
        record = np.zeros((), self.dtype)
        for name, (_, kind) in self.members.items():
            value = _converted(f"{self.name}.{name}", values[name], kind)
            target = record[name]
            if kind.matrix:
                value = np.swapaxes(value, -1, -2)
            if value.shape == target.shape:
                target[...] = value
            else:  # a padded vec3, or a matrix with columns of three
                target[..., : value.shape[-1]] = value
        return record.tobytes()


def _converted(where: str, value: object, kind: TypeLayout) -> np.ndarray:
    """Return the value in the scalar type of ``kind``; refuse what would change or overflow."""
    given = np.asarray(value)
    if given.shape != kind.shape:
        raise ShaderError(f"{where} has shape {kind.shape}, got {given.shape}")
    if given.dtype.kind not in ("iufb" if kind.scalar == "f32" else "iub"):
        raise ShaderError(f"{where} is {kind.scalar}, got {given.dtype} {value!r}")
    if kind.scalar == "f32":
        with np.errstate(over="ignore"):
            result = given.astype(np.float32)
        if not np.isfinite(result).all():
            raise ShaderError(f"{where} is not a finite f32: {value!r}")
        return result
    limits = np.iinfo(SCALARS[kind.scalar])
    if given.size and (int(given.min()) < limits.min or int(given.max()) > limits.max):
        raise ShaderError(f"{where} is {kind.scalar}, {value!r} is out of its range")
    return given.astype(SCALARS[kind.scalar])


def split_top(text: str) -> list[str]:
    """Split at the commas that stand outside every bracket; drop a trailing empty part."""
    parts, depth, start = [], 0, 0
    for position, sign in enumerate(text):
        depth += (sign in "(<") - (sign in ")>")
        if sign == "," and depth == 0:
            parts.append(text[start:position])
            start = position + 1
    parts.append(text[start:])
    return [part.strip() for part in parts if part.strip()]
