"""Mosaic: against a loop over pixels, for patterns, rectangles and sizes of all kinds.

Tolerance: none. The planes hold integers and the glare eighths, of which f32 holds every sum here.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.mosaic import mosaic
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.load import load_sensor
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

F32 = np.float32
BAYER = ("RG", "GB")
XTRANS = ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
PATTERNS = (("W",), BAYER, ("RG",), ("RGB",), ("RG", "GB", "WG"), ("RRGG", "GGBB"), XTRANS)


def of_pattern(pattern: tuple[str, ...]) -> Sensor:
    cfa = ColourFilterArray(pattern=[list(row) for row in pattern])
    curve = load_sensor("imx477").quantum_efficiency
    names = {name: curve.channels["G"] for name in {*"".join(pattern)}}
    curves = curve.model_copy(update={"channels": names})
    return load_sensor("imx477").model_copy(update={"cfa": cfa, "quantum_efficiency": curves})


def light(camera: Sensor, samples: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return planes and glare in which no two values are alike; a tenth of them negative."""
    count = len(planes_of(camera).channels)
    planes = np.random.default_rng(31).permutation(count * samples[0] * samples[1])
    planes -= planes.size // 10
    glare = (np.arange(len(camera.site_channels())) + 1).astype(F32) / 8
    return planes.reshape(count, *samples).astype(F32), glare


def expected_of(camera: Sensor, planes: np.ndarray, glare: np.ndarray) -> np.ndarray:
    made = planes_of(camera)
    shape = tuple(made.period * count for count in planes.shape[1:])
    return mosaic(planes, glare, made.sites, made.period, shape)


def on_device(camera, planes, glare, origin, shape, cell_origin=(0, 0), spare=0):
    made = planes_of(camera)
    py, px, _ = made.sites.shape
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
    groups = (-(-shape[1] // 64), py * -(-shape[0] // (16 * py)), 1)
    result = run_stage(
        "sensor/mosaic",
        groups,
        params,
        {"planes": planes, "glare": glare, "sites": made.sites.astype(np.uint32)},
        {"rate": (shape[0] * shape[1] + spare, F32)},
        P=made.period,
        PY=py,
        PX=px,
    )
    return result["rate"]


@pytest.mark.parametrize("pattern", PATTERNS, ids="/".join)
def test_each_pixel_gets_its_plane(pattern: tuple[str, ...]):
    camera = of_pattern(pattern)
    planes, glare = light(camera, (17, 19))
    whole = expected_of(camera, planes, glare)
    found = on_device(camera, planes, glare, (0, 0), whole.shape).reshape(whole.shape)
    assert_close(found, whole, atol=0)


@pytest.mark.parametrize("pattern", PATTERNS, ids="/".join)
def test_each_pixel_sees_its_own_filter(pattern: tuple[str, ...]):
    """Planes that hold the number of their channel give the pattern of the numbers."""
    camera = of_pattern(pattern)
    made = planes_of(camera)
    shape = (12 // made.period, 24 // made.period)
    planes = np.stack([np.full(shape, float(channel)) for channel in made.channels]).astype(F32)
    glare = np.zeros(len(camera.site_channels()), F32)
    found = on_device(camera, planes, glare, (0, 0), (12, 24)).reshape(12, 24)
    names = [list(row) for row in pattern]
    for row, col in np.ndindex(12, 24):
        name = names[row % len(names)][col % len(names[0])]
        assert camera.channels[int(found[row, col])] == name


def test_planes_are_as_few_as_the_pattern_allows():
    counts = [len(planes_of(of_pattern(pattern)).channels) for pattern in PATTERNS]
    periods = [planes_of(of_pattern(pattern)).period for pattern in PATTERNS]
    assert periods == [1, 2, 2, 1, 1, 4, 1]
    assert counts == [1, 4, 4, 3, 4, 16, 3]


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 65), (37, 1), (15, 64), (16, 63), (33, 33), (34, 31), (64, 9)]
)
@pytest.mark.parametrize("origin", [(0, 0), (0, 1), (1, 0), (3, 6)])
def test_a_rectangle_keeps_the_phase_of_the_pattern(
    origin: tuple[int, int], shape: tuple[int, int]
):
    camera = of_pattern(BAYER)
    planes, glare = light(camera, (40, 40))
    rows, cols = (slice(first, first + count) for first, count in zip(origin, shape, strict=True))
    expected = expected_of(camera, planes, glare)[rows, cols]
    found = on_device(camera, planes, glare, origin, shape, spare=70)
    assert unwritten(found[expected.size :]).all()
    assert_close(found[: expected.size].reshape(shape), expected, atol=0)


@pytest.mark.parametrize(("pattern", "cell"), [(BAYER, (4, 7)), (XTRANS, (8, 14))])
def test_planes_may_begin_anywhere(pattern, cell: tuple[int, int]):
    camera = of_pattern(pattern)
    planes, glare = light(camera, (30, 40))
    part = np.ascontiguousarray(planes[:, cell[0] : cell[0] + 15, cell[1] : cell[1] + 20])
    whole = expected_of(camera, planes, glare)
    found = on_device(camera, part, glare, (9, 15), (13, 17), cell_origin=cell)
    assert_close(found.reshape(13, 17), whole[9:22, 15:32], atol=0)


def recorded(device: Device, camera, planes, glare, shape, **places) -> np.ndarray:
    rec = Recording(device)
    buffers = [
        rec.buffer(f"in{n}", array.shape, array.dtype) for n, array in enumerate((planes, glare))
    ]
    for buffer, array in zip(buffers, (planes, glare), strict=True):
        rec.upload(buffer, array)
    label = rec.download(record_mosaic(rec, *buffers, camera, shape, **places))
    return rec.run()[label]


@pytest.mark.parametrize("pattern", [BAYER, XTRANS], ids="/".join)
def test_the_host_records_any_rectangle(device: Device, pattern):
    camera = of_pattern(pattern)
    period = planes_of(camera).period
    planes, glare = light(camera, (40 // period, 50 // period))
    whole = expected_of(camera, planes, glare)
    assert_close(recorded(device, camera, planes, glare, (40, 50)), whole, atol=0)
    cell = (6 // period, 10 // period)
    part = np.ascontiguousarray(planes[:, cell[0] :, cell[1] :])
    places = {"origin": (7, 13), "cell_origin": cell, "label": "tile"}
    tile = recorded(device, camera, part, glare, (20, 11), **places)
    assert_close(tile, whole[7:27, 13:24], atol=0)


@pytest.mark.parametrize(
    ("cells", "planes_given", "places"),
    [
        ((20, 25), 4, {"origin": (1, 0)}),
        ((20, 25), 4, {"cell_origin": (1, 0)}),
        ((19, 25), 4, {}),
        ((20, 24), 4, {}),
        ((20, 25), 3, {}),
    ],
)
def test_planes_that_do_not_cover_the_rectangle_are_refused(
    device: Device, cells, planes_given, places
):
    planes, glare = np.zeros((planes_given, *cells), F32), np.zeros(4, F32)
    with pytest.raises(ValueError, match="does not give"):
        recorded(device, of_pattern(BAYER), planes, glare, (40, 50), **places)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/mosaic", PY=2, PX=2).workgroup_size == (64, 1, 1)
