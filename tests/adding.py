"""Kernels that add to one number: for tests of how kernels are compiled and run."""

from collections.abc import Sequence

from gpusim.gpu import Device, Kernel, Recording

TEXT = """
struct Params { number: u32 }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> found: array<u32>;
@compute @workgroup_size(1, 1, 1)
fn main() { found[0] += params.number; }
"""


def recorded(device: Device, names: Sequence[str], text: str = TEXT) -> Recording:
    """Return a recording that adds one for each name, by a kernel of a text of its own.

    ``text``: that of the last one.
    """
    rec = Recording(device)
    found = rec.buffer("found", 1, "u4")
    rec.clear(found)
    for name in names:
        own = text if name == names[-1] else TEXT
        kernel = Kernel.from_text(name, f"// {name}\n{own}")
        kernel.record(rec, (1, 1, 1), {"number": 1}, found=found)
    rec.download(found)
    return rec
