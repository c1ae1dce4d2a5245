"""The second stage of directional demosaicing against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.direction import direction


def found(device: Device, cells: np.ndarray) -> np.ndarray:
    rows, cols, _ = cells.shape
    rec = Recording(device)
    given = rec.buffer("differences", cells.shape, "f4")
    rec.upload(given, cells)
    out = rec.buffer("chosen", cells.shape, "f4")
    kernel = Kernel("isp/direction")
    params = {"rows": rows, "cols": cols}
    kernel.record(rec, kernel.cover(cols - 2, rows - 2), params, differences=given, chosen=out)
    label = rec.download(out)
    return rec.run()[label][1:-1, 1:-1]


def pixels(cells: np.ndarray) -> np.ndarray:
    """Return differences of pixels (rows, cols, 2) of those of cells; green ones are 0."""
    rows, cols, _ = cells.shape
    whole = np.zeros((2 * rows, 2 * cols, 2))
    whole[::2, ::2], whole[1::2, 1::2] = cells[..., :2], cells[..., 2:]
    return whole


@pytest.mark.parametrize("shape", [(3, 3), (20, 40), (35, 19)])
def test_choices_are_those_of_the_reference(device: Device, shape):
    cells = np.random.default_rng(shape[0]).normal(0, 0.1, (*shape, 4)).astype(F32)
    chosen = found(device, cells)
    more, expected = direction(pixels(cells))
    for number, place in enumerate((0, 1)):
        sites = (slice(2 + place, -2, 2),) * 2
        # Sums of ten steps, of up to 0.8 each with weights up to 3.
        sure = np.abs(more[sites]) > 100 * ULP
        assert sure.mean() > 0.9
        assert_close(chosen[..., number][sure], expected[sites][sure], atol=0)
        along_row = (more[sites] >= 0).astype(float)
        assert_close(chosen[..., 2 + number][sure], along_row[sure], atol=0)


def test_where_nothing_changes_it_is_the_row(device: Device):
    chosen = found(device, np.ones((6, 7, 4), F32) * F32([1, 2, 3, 4]))
    assert_close(chosen, np.broadcast_to([1.0, 3, 1, 1], chosen.shape), atol=0)
