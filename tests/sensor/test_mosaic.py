"""Mosaic: against strided assignment in NumPy, for patterns, rectangles and sizes of all kinds.

Tolerance: none. The planes hold integers and the glare eighths, of which f32 holds every sum here.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.mosaic import mosaic
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.sensor import ColourFilterArray, load_sensor

F32 = np.float32


def sites(period: tuple[int, int], cells: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return planes and glare in which no two values are alike; a tenth of them negative."""
    count = period[0] * period[1]
    planes = np.random.default_rng(31).permutation(count * cells[0] * cells[1])
    planes -= planes.size // 10
    return planes.reshape(count, *cells).astype(F32), (np.arange(count) + 1).astype(F32) / 8


def on_device(planes, glare, period, origin, shape, cell_origin=(0, 0), spare=0):
    params = {
        "row0": origin[0],
        "col0": origin[1],
        "rows": shape[0],
        "cols": shape[1],
        "cell_row0": cell_origin[0],
        "cell_col0": cell_origin[1],
        "plane_rows": planes.shape[1],
        "plane_cols": planes.shape[2],
    }
    groups = (-(-shape[1] // 16), -(-shape[0] // 16), 1)
    result = run_stage(
        "sensor/mosaic",
        groups,
        params,
        {"planes": planes, "glare": glare},
        {"rate": (shape[0] * shape[1] + spare, F32)},
        PY=period[0],
        PX=period[1],
    )
    return result["rate"]


@pytest.mark.parametrize("period", [(1, 1), (2, 2), (2, 3), (4, 4), (6, 6)])
def test_each_pixel_gets_its_site(period: tuple[int, int]):
    cells = (7, 9)
    planes, glare = sites(period, cells)
    whole = mosaic(planes, glare, period)
    assert_close(
        on_device(planes, glare, period, (0, 0), whole.shape).reshape(whole.shape), whole, atol=0
    )


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 37), (37, 1), (15, 17), (16, 16), (17, 33), (33, 31)]
)
@pytest.mark.parametrize("origin", [(0, 0), (0, 1), (1, 0), (3, 6)])
def test_a_rectangle_keeps_the_phase_of_the_pattern(
    origin: tuple[int, int], shape: tuple[int, int]
):
    planes, glare = sites((2, 2), (20, 25))
    rows, cols = (slice(first, first + count) for first, count in zip(origin, shape, strict=True))
    expected = mosaic(planes, glare, (2, 2))[rows, cols]
    found = on_device(planes, glare, (2, 2), origin, shape, spare=70)
    assert unwritten(found[expected.size :]).all()
    assert_close(found[: expected.size].reshape(shape), expected, atol=0)


def test_planes_may_begin_at_any_cell():
    planes, glare = sites((2, 3), (20, 25))
    part = np.ascontiguousarray(planes[:, 4:15, 7:20])
    expected = mosaic(planes, glare, (2, 3))[9:26, 22:51]
    found = on_device(part, glare, (2, 3), (9, 22), expected.shape, cell_origin=(4, 7))
    assert_close(found.reshape(expected.shape), expected, atol=0)


def recorded(device: Device, planes, glare, shape, **places) -> np.ndarray:
    sensor = load_sensor("imx477")
    rec = Recording(device)
    buffers = [
        rec.buffer(f"in{n}", array.shape, array.dtype) for n, array in enumerate((planes, glare))
    ]
    for buffer, array in zip(buffers, (planes, glare), strict=True):
        rec.upload(buffer, array)
    label = rec.download(record_mosaic(rec, *buffers, sensor, shape, **places))
    return rec.run()[label]


def test_the_host_records_any_rectangle(device: Device):
    planes, glare = sites((2, 2), (20, 25))
    whole = mosaic(planes, glare, (2, 2))
    assert_close(recorded(device, planes, glare, (40, 50)), whole, atol=0)
    part = np.ascontiguousarray(planes[:, 3:, 5:])
    tile = recorded(device, part, glare, (9, 11), origin=(6, 13), cell_origin=(3, 5), label="tile")
    assert_close(tile, whole[6:15, 13:24], atol=0)


@pytest.mark.parametrize(
    ("cells", "sites_given", "places"),
    [
        ((20, 25), 4, {"origin": (1, 0)}),
        ((20, 25), 4, {"cell_origin": (1, 0)}),
        ((19, 25), 4, {}),
        ((20, 24), 4, {}),
        ((20, 25), 3, {}),
    ],
)
def test_planes_that_do_not_cover_the_rectangle_are_refused(
    device: Device, cells, sites_given, places
):
    planes, glare = np.zeros((sites_given, *cells), F32), np.zeros(sites_given, F32)
    with pytest.raises(ValueError, match="does not give"):
        recorded(device, planes, glare, (40, 50), **places)


def test_the_pattern_of_the_sensor_is_used(device: Device):
    sensor = load_sensor("imx477").model_copy(
        update={"cfa": ColourFilterArray(pattern=[["R", "G", "B"]])}
    )
    planes, glare = sites((1, 3), (5, 4))
    rec = Recording(device)
    buffers = [rec.buffer("planes", planes.shape, F32), rec.buffer("glare", glare.shape, F32)]
    rec.upload(buffers[0], planes)
    rec.upload(buffers[1], glare)
    label = rec.download(record_mosaic(rec, *buffers, sensor, (5, 12)))
    found = rec.run()[label]
    assert_close(found, mosaic(planes, glare, (1, 3)), atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/mosaic", PY=2, PX=2).workgroup_size == (16, 16, 1)
