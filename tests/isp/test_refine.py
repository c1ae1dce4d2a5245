"""The third stage of directional demosaicing against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.refine import refine


@pytest.mark.parametrize("shape", [(3, 3), (20, 40), (35, 19)])
def test_differences_are_those_of_the_reference(device: Device, shape):
    rng = np.random.default_rng(shape[0])
    cells = rng.normal(0, 0.1, (*shape, 4)).astype(F32)
    cells[..., 2:] = rng.integers(0, 2, (*shape, 2))
    rec = Recording(device)
    given = rec.buffer("chosen", cells.shape, "f4")
    rec.upload(given, cells)
    out = rec.buffer("refined", (*shape, 2), "f4")
    kernel = Kernel("isp/refine")
    groups = kernel.cover(shape[1] - 2, shape[0] - 2)
    kernel.record(
        rec, groups, dict(zip(("rows", "cols"), shape, strict=True)), chosen=given, refined=out
    )
    label = rec.download(out)
    found = rec.run()[label][1:-1, 1:-1]
    for number in range(2):
        chosen, row = np.zeros((2, 2 * shape[0], 2 * shape[1]))
        chosen[::2, ::2], row[::2, ::2] = cells[..., number], cells[..., 2 + number]
        expected = refine(chosen, row > 0)[2:-2:2, 2:-2:2]
        # Two sums of up to 3, a division within 2.5 ULP of it, over 6.
        assert_close(found[..., number], expected, atol=8 * ULP)
