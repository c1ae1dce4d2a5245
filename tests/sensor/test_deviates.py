"""Deviates of pixels, rows and columns: those of the reference, from the same counters.

Tolerance: that of a deviate, 1e-6 of itself (test_gaussian).
"""

import numpy as np
from harness import assert_close, wgsl_eval

from gpusim.reference import philox as reference

ROW, COL = (axis.ravel() for axis in np.indices((300, 8)))
KEY = (7 << 32) + 5


def on_device(call: str) -> np.ndarray:
    """Return one value for each pixel of the quads that begin at COL % 4 == 0."""
    first = COL % 4 == 0
    inputs = {"quad": ("u32", COL[first] // 4), "row": ("u32", ROW[first])}
    return wgsl_eval("deviates", call, inputs, returns="vec4f").ravel()


def test_every_pixel_has_its_own():
    found = on_device("of_pixels(quad, row, 3u, PURPOSE_READ, vec2u(5u, 7u))")
    expected = reference.deviate(ROW, COL, 3, reference.READ, KEY)
    assert_close(found, expected, rtol=1e-6)
    assert np.unique(found).size == found.size


def test_rows_and_columns_have_theirs():
    found = on_device("vec4f(of_row(row, 3u, PURPOSE_ROW_NOISE, vec2u(5u, 7u)))")
    expected = reference.row_deviate(ROW, 3, reference.ROW_NOISE, KEY)
    assert_close(found, expected, rtol=1e-6)
    assert np.unique(found).size == 300
    found = on_device("of_columns(quad, 3u, PURPOSE_COLUMN_NOISE, vec2u(5u, 7u))")
    expected = reference.column_deviate(COL, 3, reference.COLUMN_NOISE, KEY)
    assert_close(found, expected, rtol=1e-6)
    assert np.unique(found).size == 8
