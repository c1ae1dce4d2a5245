"""WGSL text: include-once composition and reflection of what the host must know.

A shader is written once, in its ``.wgsl`` file; bindings, overrides, the workgroup size, workgroup
bytes and ``struct Params`` are read from that text, so no binding number and no struct layout is
repeated in Python. Sections quoted are those of the WGSL specification (W3C).
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from .expressions import Names, Scalar
from .packing import Layouts, ShaderError, Struct, split_top


def shaders_root() -> Path:
    """Return the folder of the shaders: in the wheel, beside the package in a checkout.

    The environment variable GPUSIM_SHADERS_DIR names another one (``tools/mutate.py`` uses it).
    """
    if named := os.environ.get("GPUSIM_SHADERS_DIR"):
        return Path(named)
    package = Path(__file__).resolve().parents[1]
    packaged = package / "shaders"
    return packaged if packaged.is_dir() else package.parent / "shaders"


def shaders_sha256() -> str:
    """Return one digest over the names and texts of all shaders."""
    digest = hashlib.sha256()
    root = shaders_root()
    for path in sorted(root.rglob("*.wgsl")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()


@dataclass(frozen=True)
class Source:
    """Composed WGSL: the text and, for each of its lines, where that line was written."""

    name: str
    text: str
    origins: tuple[tuple[str, int], ...]

    @property
    def digest(self) -> str:
        """SHA-256 of the composed text: what defines the compiled shader."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def numbered(self, around: int | None = None, margin: int = 12) -> str:
        """Return the text with line numbers and origins, or only the lines near one of them."""
        first, last = 1, len(self.origins)
        if around is not None:
            first, last = max(first, around - margin), min(last, around + margin)
        lines = self.text.split("\n")
        rows = []
        for number in range(first, last + 1):
            file, line = self.origins[number - 1]
            arrow = ">" if number == around else " "
            rows.append(f"{arrow}{number:5d} {file + ':' + str(line):28s} | {lines[number - 1]}")
        return "\n".join(rows)


_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_REPEAT = re.compile(r"^\s*#repeat\s+(\w+)\s+(\d+)\s*$")
_END = re.compile(r"^\s*#end\s*$")
_FILLED = re.compile(r"\$\{([^}]+)\}")


_HELD: dict[tuple, dict[str, object]] = {}
_holders = 0  # who holds shaders now, one within the other or in several threads


@contextmanager
def held() -> Iterator[None]:
    """Read, compose and reflect on each shader once meanwhile: its files are not looked at again.

    For the four kernels of a CMOS frame that takes 4 of the 5 ms that the host spends on it.
    """
    global _holders
    _holders += 1
    try:
        yield
    finally:
        _holders -= 1
        if not _holders:
            _HELD.clear()


def kept(key: tuple) -> dict[str, object]:
    """Return what is kept of a kernel as long as shaders are `held`; else an empty dict."""
    return _HELD.setdefault(key, {}) if _holders else {}


def load(path: str) -> Source:
    """Read and compose the shader ``path`` (below the shaders root, without suffix).

    Raises
    ------
    ShaderError
        The file, or one that it includes, does not exist; an include cycle.
    """
    file = shaders_root() / f"{path}.wgsl"
    if not file.is_file():
        raise ShaderError(f"no shader {path!r}: {file} does not exist")
    return compose(path, file.read_text(encoding="utf-8"))


def compose(name: str, text: str) -> Source:
    """Compose a shader of its directives, and keep the line origins.

    ``#include "x"`` stands for ``common/x.wgsl``, the first time. Lines from ``#repeat k 16`` to
    ``#end`` stand there 16 times, for k from 0 to 15, with ``${2 * k}`` and the like worked out:
    what must be unrolled, for the numbers to stay in registers, is written once.

    Raises
    ------
    ShaderError
        A directive that is none, an unknown include, an include cycle, ``#repeat`` without end.
    """
    lines: list[str] = []
    origins: list[tuple[str, int]] = []
    done: set[str] = set()

    def paste(origin: str, content: str, chain: tuple[str, ...]) -> None:
        for number, line in _unrolled(origin, content):
            found = _INCLUDE.match(line)
            if found is None:
                if line.lstrip().startswith("#"):
                    raise ShaderError(f"{origin}:{number}: unknown directive {line.strip()!r}")
                lines.append(line)
                origins.append((origin, number))
                continue
            wanted = found[1]
            if wanted in chain:
                cycle = " -> ".join([*chain, wanted])
                raise ShaderError(f"{origin}:{number}: include cycle {cycle}")
            if wanted in done:
                continue
            done.add(wanted)
            file = shaders_root() / "common" / f"{wanted}.wgsl"
            if not file.is_file():
                raise ShaderError(f"{origin}:{number}: unknown include {wanted!r} (no {file})")
            included = file.read_text(encoding="utf-8")
            paste(f"common/{wanted}.wgsl", included, (*chain, wanted))

    paste(f"{name}.wgsl", text, ())
    return Source(name, "\n".join(lines), tuple(origins))


def _unrolled(origin: str, content: str) -> Iterator[tuple[int, str]]:
    """Yield the lines with their numbers, those between ``#repeat`` and ``#end`` so many times."""
    lines = enumerate(content.removesuffix("\n").split("\n"), start=1)
    for number, line in lines:
        found = _REPEAT.match(line)
        if found is None:
            yield number, line
            continue
        block: list[tuple[int, str]] = []
        for inner in lines:
            if _END.match(inner[1]):
                break
            block.append(inner)
        else:
            raise ShaderError(f"{origin}:{number}: #repeat without #end")
        for value in range(int(found[2])):
            for place, text in block:
                yield place, _filled(text, Names({found[1]: value}), f"{origin}:{place}")


def _filled(text: str, names: Names, where: str) -> str:
    try:
        return _FILLED.sub(lambda found: str(names.evaluate(found[1])), text)
    except ShaderError as error:
        raise ShaderError(f"{where}: {error}") from None


@dataclass(frozen=True)
class Binding:
    """One ``@group(0) @binding(index)`` buffer, or texture read as one."""

    index: int
    name: str
    kind: str  # "uniform", "read-only-storage", "storage" as wgpu names them, or "texels"
    type: str


@dataclass(frozen=True)
class Override:
    """One ``override name: type = default;``; ``default`` is the text, or None if there is none."""

    name: str
    type: str
    default: str | None


@dataclass(frozen=True)
class Module:
    """What a composed shader declares at module scope.

    Attributes
    ----------
    bindings : tuple of Binding
        In the order of their indices.
    overrides : dict of str to Override
    params : Struct
        Memory layout of ``struct Params``.
    consts, aliases, structs : dict of str to str
        The text of each module-scope constant, alias and member list.
    """

    bindings: tuple[Binding, ...]
    overrides: Mapping[str, Override]
    params: Struct
    consts: Mapping[str, str]
    _workgroup_size: str
    _workgroup_vars: Mapping[str, str]
    aliases: Mapping[str, str]
    structs: Mapping[str, str]

    def constants(self, values: Mapping[str, Scalar]) -> Names:
        """Return the module-scope constants with the overrides resolved to ``values``."""
        known: dict[str, Scalar | str] = dict(self.consts)
        for name, override in self.overrides.items():
            if name in values:
                known[name] = values[name]
            elif override.default is not None:
                known[name] = override.default
            else:
                raise ShaderError(f"override {name!r} has no default and no value was given")
        return Names(known)

    def layouts(self, names: Names) -> Layouts:
        """Return the type-layout rules of this module under resolved constants."""
        return Layouts(self.aliases, self.structs, names.evaluate)

    def workgroup_size(self, names: Names) -> tuple[int, int, int]:
        """Return the three resolved numbers of ``@workgroup_size``."""
        sizes = [int(names.evaluate(part)) for part in split_top(self._workgroup_size)]
        return tuple(sizes + [1] * (3 - len(sizes)))  # type: ignore[return-value]

    def workgroup_bytes(self, names: Names) -> int:
        """Return the bytes of all ``var<workgroup>`` declarations, each rounded up to 16.

        wgpu never validates this sum (gfx-rs/wgpu #8946), so the kernel must. Rounding up to 16 is
        how wgpu counts (Vulkan's block rules), the larger of the possible answers.
        """
        rules = self.layouts(names)
        return sum(-(-rules.of(kind).size // 16) * 16 for kind in self._workgroup_vars.values())


_BINDING = re.compile(
    r"@group\(\s*(\d+)\s*\)\s*@binding\(\s*(\d+)\s*\)\s*"
    r"var\s*(?:<\s*(\w+)\s*(?:,\s*(\w+)\s*)?>)?\s*(\w+)\s*:\s*([^;]+);"
)
_OVERRIDE = re.compile(r"(@id\([^)]*\)\s*)?\boverride\s+(\w+)\s*:\s*(\w+)\s*(?:=\s*([^;]+))?;")
_CONST = re.compile(r"\bconst\s+(\w+)\s*(?::\s*[^=;]+)?=\s*([^;]+);")
_WORKGROUP_VAR = re.compile(r"\bvar\s*<\s*workgroup\s*>\s*(\w+)\s*:\s*([^;]+);")
_ALIAS = re.compile(r"\balias\s+(\w+)\s*=\s*([^;]+);")
_STRUCT = re.compile(r"\bstruct\s+(\w+)\s*\{([^}]*)\}")
_ENTRY = re.compile(r"((?:@\w+\s*(?:\([^)]*\))?\s*)+)fn\s+main\s*\(")
TEXELS = "texture_2d<f32>"  # the one type of texture: see shaders/common/texels
_KINDS = {
    ("uniform", None): "uniform",
    ("storage", None): "read-only-storage",
    ("storage", "read"): "read-only-storage",
    ("storage", "read_write"): "storage",
}


@lru_cache(maxsize=256)  # about the shaders of one session, their mutants included
def reflect(text: str) -> Module:
    """Read the declarations of one composed shader.

    Raises
    ------
    ShaderError
        A declaration outside the rules of this project: another bind group, a binding that is
        neither a buffer nor texels, ``params`` missing or not at binding 0, no ``main``.
    """
    flat = _module_scope(strip_comments(text))
    bindings = []
    for group, index, space, access, name, kind in _BINDING.findall(flat):
        if int(group) != 0:
            raise ShaderError(f"binding {name!r} is in group {group}: only group 0 is used")
        usage = _KINDS.get((space, access or None))
        if (space, kind.strip()) == ("", TEXELS):
            usage = "texels"
        if usage is None:
            raise ShaderError(
                f"binding {name!r}: var<{space}{', ' * bool(access)}{access}> {name}: {kind}"
            )
        bindings.append(Binding(int(index), name, usage, kind.strip()))
    bindings.sort(key=lambda binding: binding.index)
    if len(bindings) != len(re.findall(r"@binding\b", flat)):
        raise ShaderError(
            "a @binding could not be read: write @group(0) @binding(n) var<...> x: T;"
        )
    indices = [binding.index for binding in bindings]
    if len(set(indices)) != len(indices):
        raise ShaderError(f"a binding index is used twice: {indices}")
    head = bindings[0] if bindings else None
    if head is None or (head.index, head.name, head.kind) != (0, "params", "uniform"):
        raise ShaderError("binding 0 must be `var<uniform> params: Params;`")
    overrides = {}
    for identifier, name, kind, default in _OVERRIDE.findall(flat):
        if identifier:
            raise ShaderError(f"override {name!r}: @id is not used, overrides go by name")
        if kind not in ("bool", "u32", "i32", "f32"):
            raise ShaderError(f"override {name!r} has type {kind!r}")
        overrides[name] = Override(name, kind, default.strip() or None)
    if len(overrides) != len(re.findall(r"\boverride\b", flat)):
        raise ShaderError("an override could not be read: write `override name: type = default;`")
    entry = _ENTRY.search(flat)
    size = re.search(r"@workgroup_size\s*\(([^)]*)\)", entry[1]) if entry else None
    if entry is None or size is None or "@compute" not in entry[1]:
        raise ShaderError("no `@compute @workgroup_size(...) fn main(`")
    consts = dict(_CONST.findall(flat))
    aliases = dict(_ALIAS.findall(flat))
    structs = dict(_STRUCT.findall(flat))
    # A uniform struct has no overridable sizes, so plain constants are enough here.
    rules = Layouts(aliases, structs, Names(dict(consts)).evaluate)
    return Module(
        bindings=tuple(bindings),
        overrides=overrides,
        params=rules.uniform(head.type),
        consts=consts,
        _workgroup_size=size[1],
        _workgroup_vars=dict(_WORKGROUP_VAR.findall(flat)),
        aliases=aliases,
        structs=structs,
    )


def strip_comments(text: str) -> str:
    """Blank out ``//`` and nested ``/* */`` comments; every line keeps its number."""
    kept = []
    depth = 0
    for piece in re.split(r"(/\*|\*/|//[^\n]*|\n)", text):
        if piece == "/*":
            depth += 1
        elif piece == "*/" and depth:
            depth -= 1
        elif piece == "\n" or (depth == 0 and not piece.startswith("//")):
            kept.append(piece)
    return "".join(kept)


def _module_scope(text: str) -> str:
    """Return the text without the bodies of functions; struct bodies stay."""
    kept, position = [], 0
    for found in re.finditer(r"\bfn\s+\w+", text):
        if found.start() < position:
            continue
        start = text.find("{", found.end())
        depth, end = 0, start
        while end < len(text):
            depth += (text[end] == "{") - (text[end] == "}")
            end += 1
            if depth == 0:
                break
        kept.append(text[position:start])
        position = end
    return "".join([*kept, text[position:]])
