"""What a shader sees of its ``struct Params``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Kernel
from gpusim.gpu.packing import SCALARS, TypeLayout

from .stage import run_stage


def example_params(kernel: Kernel, seed: int) -> dict[str, np.ndarray]:
    """Return a random value for each member of the kernel's params, all of them different."""
    rng = np.random.default_rng(seed)
    values = {}
    for name, (_, kind) in kernel.params.members.items():
        whole = rng.integers(1, 1 << 24, kind.shape)  # exact in f32, u32 and i32
        values[name] = whole.astype(SCALARS[kind.scalar])
    return values


def _reads(name: str, kind: TypeLayout) -> list[str]:
    """Return a WGSL expression for each scalar of a member, in the order of its NumPy value."""
    reads = []
    for index in np.ndindex(kind.shape):
        if kind.matrix:  # NumPy (..., row, column) is WGSL [column][row]
            index = (*index[:-2], index[-1], index[-2])
        reads.append(f"params.{name}" + "".join(f"[{part}]" for part in index))
    return reads


def echo_params(kernel: Kernel, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the values as a shader with the same ``struct Params`` reads them, one by one."""
    module = kernel.module
    kept = [f"const {name} = {value};" for name, value in module.consts.items()]
    kept += [f"alias {name} = {kind};" for name, kind in module.aliases.items()]
    kept += [f"struct {name} {{{members}}}" for name, members in module.structs.items()]
    members = kernel.params.members
    reads = [read for name, (_, kind) in members.items() for read in _reads(name, kind)]
    body = [f"    echo[{n}] = bitcast<u32>({read});" for n, read in enumerate(reads)]
    echo = Kernel.from_text(
        "tests/echo",
        "\n".join(
            [
                *kept,
                "@group(0) @binding(0) var<uniform> params: Params;",
                "@group(0) @binding(1) var<storage, read_write> echo: array<u32>;",
                "@compute @workgroup_size(1)\nfn main() {",
                *body,
                "}",
            ]
        ),
    )
    echo.params = kernel.params  # packed as for the kernel itself
    words = run_stage(echo, (1, 1, 1), values, {}, {"echo": (len(reads), np.uint32)})["echo"]
    seen, start = {}, 0
    for name, (_, kind) in members.items():
        count = int(np.prod(kind.shape))
        part = words[start : start + count].view(SCALARS[kind.scalar])
        seen[name] = part.reshape(kind.shape)
        start += count
    return seen
