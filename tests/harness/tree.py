"""The shaders that exist."""

from __future__ import annotations

from gpusim.gpu import Kernel
from gpusim.gpu.wgsl import load, reflect, shaders_root


def shader_names(includes: bool = False) -> list[str]:
    """Return every stage as ``folder/name``; with ``includes`` every file of common/ instead."""
    root = shaders_root()
    names = (
        file.relative_to(root).with_suffix("").as_posix() for file in sorted(root.rglob("*.wgsl"))
    )
    return [name for name in names if name.startswith("common/") == includes]


def example_kernel(name: str) -> Kernel:
    """Return the stage ``name``; overrides without a default get 2, 2.0 or true."""
    examples = {"u32": 2, "i32": 2, "f32": 2.0, "bool": True}
    declared = reflect(load(name).text).overrides.values()
    return Kernel(name, **{one.name: examples[one.type] for one in declared if not one.default})
