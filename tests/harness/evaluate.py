"""One WGSL expression over many inputs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from gpusim.gpu import Kernel
from gpusim.gpu.packing import SCALARS

from .stage import run_stage

_SHORT = {"f": "f32", "u": "u32", "i": "i32"}
_VECTOR = re.compile(r"vec([234])(?:<(\w+)>|([fui]))")
_COUNT = "eval_count"


def _parsed(kind: str) -> tuple[str, int]:
    """Return the scalar type and the number of components of a WGSL type."""
    if kind in SCALARS:
        return kind, 1
    found = _VECTOR.fullmatch(kind)
    if found is None:
        raise ValueError(f"type {kind!r}: f32, u32, i32 or a vector of them is needed")
    return found[2] or _SHORT[found[3]], int(found[1])


def wgsl_eval(
    include: str | Sequence[str],
    expression: str,
    inputs: Mapping[str, tuple[str, np.ndarray]],
    *,
    returns: str = "f32",
    declarations: str = "",
    statements: str = "",
    params: Mapping[str, int | float] | None = None,
) -> np.ndarray:
    """Evaluate a WGSL expression on the device, once for each row of the inputs.

    Parameters
    ----------
    include : str or sequence of str
        Files of shaders/common/ that the expression needs, without suffix.
    expression : str
        Uses the inputs by name.
    inputs : dict of str to (type, array)
        WGSL type (f32, u32, i32, or a vector of them) and the values: (n,) or (n, components).
        Seven inputs at most: each is a storage buffer, and the result is the eighth.
    returns : str
        WGSL type of the expression.
    declarations, statements : str
        Further module-scope text; further statements in front of the expression.
    params : dict of str to int or float, optional
        Members of ``params`` that the include reads, u32 or f32.

    Returns
    -------
    array
        (n,) or (n, components).
    """
    names = [include] if isinstance(include, str) else list(include)
    kinds = {name: _parsed(kind) for name, (kind, _) in inputs.items()}
    scalar, width = _parsed(returns)
    arrays = {}
    for name, (kind, values) in inputs.items():
        one, components = kinds[name]
        array = np.asarray(values)
        shape = (len(array),) if components == 1 else (len(array), components)
        if array.shape != shape:
            raise ValueError(f"input {name}: {kind} needs the shape {shape}, got {array.shape}")
        converted = array.astype(SCALARS[one])
        if array.dtype.kind in "iu" and not np.array_equal(converted, array):
            raise ValueError(f"input {name}: values do not fit {kind}")
        arrays[f"in_{name}"] = converted.reshape(-1)
    counts = {len(values) for _, values in inputs.values()}
    if len(counts) != 1:
        raise ValueError(f"the inputs have different lengths: {counts}")
    count = counts.pop()
    text = [f'#include "{name}"' for name in names]
    values = {_COUNT: count, **(params or {})}
    members = ", ".join(
        f"{name}: {'f32' if isinstance(value, float) else 'u32'}" for name, value in values.items()
    )
    text += [f"struct Params {{ {members} }}", declarations]
    text.append("@group(0) @binding(0) var<uniform> params: Params;")
    for index, (name, (one, _)) in enumerate(kinds.items(), start=1):
        text.append(f"@group(0) @binding({index}) var<storage, read> in_{name}: array<{one}>;")
    text.append(
        f"@group(0) @binding({len(kinds) + 1}) var<storage, read_write> eval_out: array<{scalar}>;"
    )
    text += [
        "@compute @workgroup_size(64)",
        "fn main(@builtin(global_invocation_id) eval_id: vec3u) {",
        f"    let eval_i = eval_id.x + {64 * 65535}u * eval_id.y;",
        f"    if (eval_i >= params.{_COUNT}) {{ return; }}",
    ]
    for name, (one, components) in kinds.items():
        if components == 1:
            text.append(f"    let {name} = in_{name}[eval_i];")
        else:
            parts = ", ".join(
                f"in_{name}[{components}u * eval_i + {part}u]" for part in range(components)
            )
            text.append(f"    let {name} = vec{components}<{one}>({parts});")
    text.append(statements)
    text.append(f"    let eval_result: {returns} = {expression};")
    if width == 1:
        text.append("    eval_out[eval_i] = eval_result;")
    else:
        text += [
            f"    eval_out[{width}u * eval_i + {part}u] = eval_result[{part}];"
            for part in range(width)
        ]
    text.append("}")
    kernel = Kernel.from_text("tests/wgsl_eval", "\n".join(text))
    groups = -(-count // 64)
    shape = (count,) if width == 1 else (count, width)
    result = run_stage(
        kernel,
        (min(groups, 65535), -(-groups // 65535), 1),
        values,
        arrays,
        {"eval_out": (shape, SCALARS[scalar])},
    )
    return result["eval_out"]
