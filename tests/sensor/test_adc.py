"""Analogue-to-digital conversion: against float64, at its clips and its rounding.

Tolerance: codes are exact, except where float32 carries K e + black across a rounding boundary.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.adc import adc, response
from gpusim.reference.column_offset import column_offset
from gpusim.sensor.adc import record_adc
from gpusim.sensor.adc_model import ColumnOffset, Linearity
from gpusim.sensor.load import load_sensor

F32 = np.float32
SERIAL = (5 << 32) + 88


def on_device(
    electrons: np.ndarray,
    gain: float,
    black: float,
    bits: int,
    spare: int = 0,
    origin: tuple[int, int] = (0, 0),
    tables: dict[str, np.ndarray] | None = None,
    **overrides,
) -> np.ndarray:
    rows, cols = electrons.shape
    params = {
        "row0": origin[0],
        "col0": origin[1],
        "rows": rows,
        "cols": cols,
        "system_gain_dn_per_e": gain,
        "black_level_dn": black,
        "max_dn": 2**bits - 1,
    }
    nothing = dict.fromkeys(("curve", "black", "columns"), np.zeros(1, F32))
    result = run_stage(
        "sensor/adc",
        (-(-cols // 16), -(-rows // 16), 1),
        params,
        {"electrons": electrons, **nothing, **(tables or {})},
        {"dn": (rows * cols + spare, np.uint32)},
        **overrides,
    )
    return result["dn"]


@pytest.mark.parametrize(
    ("gain", "black", "bits"), [(0.47, 256, 12), (4.1, 63.5, 10), (1, 0, 1), (7.9, 512, 16)]
)
def test_codes_are_those_of_the_reference(gain: float, black: float, bits: int):
    top = 2**bits / gain
    electrons = np.random.default_rng(41).uniform(-0.2 * top, 1.2 * top, (300, 411)).astype(F32)
    expected = adc(electrons, F32(gain), black, bits)
    # Three roundings of at most 2^-24 of the top code carry this share of the pixels over a half,
    # doubled for chance.
    share = 6 * 2.0 ** (bits - 24)
    assert_close(
        on_device(electrons, gain, black, bits).reshape(electrons.shape).astype(int),
        expected.astype(int),
        atol=0,
        outliers=share,
        outlier_atol=1,
    )


def test_halves_round_up_and_codes_are_clipped():
    electrons = F32([[-1e9, -17, -16.5, -16.0, -1.0, 0, 1.0, 2.0, 30, 31, 238, 239, 1e9]])
    # K = 1/2, black 8: exact in f32. -17 is -1/2, which rounds to 0; 1 is 8.5; 31 is 23.5.
    expected = [[0, 0, 0, 0, 8, 8, 9, 9, 23, 24, 127, 127, 127]]
    assert_close(on_device(electrons, 0.5, 8, 7)[None], np.array(expected), atol=0)


def test_a_code_changes_at_its_half():
    steps = (np.arange(256) + 0.5).astype(F32)
    below = np.nextafter(steps, F32(0))
    assert_close(on_device(steps[None], 1, 0, 9), np.arange(256) + 1, atol=0)
    assert_close(on_device(below[None], 1, 0, 9)[1:], np.arange(1, 256), atol=0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (37, 1), (15, 17), (16, 16), (17, 33)])
def test_every_pixel_and_nothing_else_is_written(shape: tuple[int, int]):
    electrons = np.arange(shape[0] * shape[1], dtype=F32).reshape(shape)
    found = on_device(electrons, 1, 3, 16, spare=40)
    assert unwritten(found[electrons.size :]).all()
    assert_close(found[: electrons.size].reshape(shape), electrons + 3, atol=0)


# --- what real converters add ---


def exactly(found: np.ndarray, expected: np.ndarray, doubt_dn: float) -> None:
    """Compare codes; where K e + black is in doubt by so much, a rounding boundary may lie."""
    # As many of the pixels as the doubt is of a code, on both sides, doubled for chance.
    share = max(4 * doubt_dn, 1 / expected.size)
    found = found.reshape(expected.shape).astype(int)
    assert_close(found, expected.astype(int), atol=0, outliers=share, outlier_atol=1)


@pytest.mark.parametrize("points", [2, 3, 4, 5, 9, 33, 100])
def test_the_response_is_that_of_the_table(points: int):
    rng = np.random.default_rng(points)
    at = np.concatenate([[0], np.sort(rng.uniform(10, 7990, points - 2)), [8000]])
    read = at * (1 + 0.1 * np.sin(at / 2000)) - 5e-6 * at**2 + 3.0
    linearity = Linearity(electrons=list(at), read_e=list(read))
    pieces = linearity.pieces().astype(F32)
    electrons = rng.uniform(-300, 9000, (150, 411)).astype(F32)
    electrons[0, :points] = at[:411]  # the points themselves
    search = {2: 0, 3: 1, 4: 2, 5: 2, 9: 4, 33: 16, 100: 64}[points]
    found = on_device(
        electrons, 0.47, 300, 12, tables={"curve": pieces}, PIECES=points - 1, SEARCH=search
    )
    expected = adc(response(electrons.astype(float), at, read), float(F32(0.47)), 300.0, 12)
    # f32 rounds start, value, slope and the sum, each 2^-24 of 9000 e-, times 0.47: 1e-3 DN.
    exactly(found, expected, 1.1e-3)
    # The control: the straight line is another by far more than the share of doubt.
    straight = adc(electrons, 0.47, 300, 12)
    assert np.mean(found.reshape(straight.shape) != straight) > 0.2


def test_a_straight_response_changes_nothing():
    electrons = np.random.default_rng(4).integers(0, 8000, (40, 50)).astype(F32)
    pieces = F32([[0, 0, 1], [1024, 1024, 1]])
    found = on_device(electrons, 0.5, 8, 13, tables={"curve": pieces}, PIECES=2, SEARCH=1)
    assert_close(found, on_device(electrons, 0.5, 8, 13).copy(), atol=0)


def test_no_more_than_the_pieces_are_read():
    pieces = F32([[0, 0, 1], [1000, 1000, 2], [2000, 3000, 1], [0, 9999, 0]])
    electrons = np.linspace(0, 4000, 64 * 50).reshape(64, 50).astype(F32)
    found = [
        on_device(electrons, 0.5, 8, 13, tables={"curve": table}, PIECES=3, SEARCH=2)
        for table in (pieces, pieces[:3])
    ]
    assert_close(found[0], found[1], atol=0)


@pytest.mark.parametrize("origin", [(0, 0), (1, 0), (0, 1), (3, 5)])
@pytest.mark.parametrize("period", [(2, 2), (1, 3), (6, 6)])
def test_each_site_has_its_black_level(origin: tuple, period: tuple):
    levels = 100 + 3 * np.arange(period[0] * period[1], dtype=F32).reshape(period)
    electrons = np.zeros((20, 35), F32)
    found = on_device(
        electrons,
        1,
        0,
        12,
        origin=origin,
        tables={"black": levels},
        SITES=True,
        PY=period[0],
        PX=period[1],
    )
    row, col = np.indices((20, 35))
    expected = levels[(row + origin[0]) % period[0], (col + origin[1]) % period[1]]
    assert_close(found.reshape(20, 35), expected.astype(int), atol=0)


def test_columns_have_their_offsets():
    offsets = np.random.default_rng(3).integers(-50, 50, 37).astype(F32)
    pixels = np.full((18, 37), 7, F32)
    found = on_device(pixels, 2, 100, 12, origin=(4, 31), tables={"columns": offsets}, COLUMNS=True)
    assert_close(found.reshape(18, 37), np.tile(114 + offsets, (18, 1)).astype(int), atol=0)


# --- the host ---


def recorded(device: Device, electrons: np.ndarray, sensor=None, **more) -> np.ndarray:
    rec = Recording(device)
    buffer = rec.buffer("electrons", electrons.shape, F32)
    rec.upload(buffer, electrons)
    label = rec.download(record_adc(rec, buffer, sensor or load_sensor("imx477"), **more))
    return rec.run()[label]


def changed(**changes):
    return load_sensor("imx477").unchecked(
        **{"serial_number": SERIAL, "first_row": 2, "first_col": 6} | changes
    )


def test_the_host_gives_everything_that_the_sensor_has(device: Device):
    at, read = np.array([0.0, 3000, 9000]), np.array([0.0, 3050, 8800])
    sensor = changed(
        linearity=Linearity(electrons=list(at), read_e=list(read)),
        channel_black_level_dn={"R": 250.0, "B": 261.5},
        column_offset=ColumnOffset(sigma_dn=2.0),
    )
    assert sensor.cfa.pattern == (("B", "G"), ("G", "R"))
    electrons = np.random.default_rng(9).uniform(-50, 8000, (21, 50)).astype(F32)
    found = recorded(device, electrons, sensor, origin=(3, 8))
    row, col = np.indices((21, 50))
    row, col = row + 5, col + 14
    black = np.array([[261.5, 256], [256, 250]])[row % 2, col % 2]
    offset = column_offset(col[0], SERIAL, 2.0)
    gain = float(F32(0.47))
    expected = adc(response(electrons.astype(float), at, read), gain, black + offset, 12)
    exactly(found, expected, 1.5e-3)
    # The control: each part counts.
    for name in ("linearity", "channel_black_level_dn", "column_offset"):
        without = recorded(device, electrons, sensor.model_copy(update={name: None}), origin=(3, 8))
        assert np.mean(without != expected) > 0.2, name
    off = recorded(device, electrons, sensor, origin=(3, 8), column_offset=False)
    bare = sensor.model_copy(update={"column_offset": None})
    assert_close(off, recorded(device, electrons, bare, origin=(3, 8)), atol=0)


def test_the_host_takes_the_columns_of_the_chip(device: Device):
    offsets = [float(k) for k in range(100)]
    sensor = changed(column_offset=ColumnOffset(offsets_dn=offsets))
    found = recorded(device, np.zeros((2, 9), F32), sensor, origin=(0, 5))
    assert_close(found, np.tile(256 + np.arange(11, 20), (2, 1)), atol=0)


def test_a_plain_sensor_compiles_all_of_it_away(device: Device, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "gpusim.sensor.adc.Kernel",
        lambda path, **given: seen.append(given) or Kernel(path, **given),
    )
    recorded(device, np.zeros((2, 3), F32))
    assert seen == [{}]
    recorded(device, np.zeros((2, 3), F32), changed(column_offset=ColumnOffset(sigma_dn=1)))
    assert seen[1:] == [{"COLUMNS": True}]


def test_the_host_converts_by_the_sensor(device: Device):
    electrons = F32([[0, 100, 5000, 8180, -3]])
    # 256 + 0.47 e: 256, 303, 2606, 4100.6 -> 4095, 254.59 -> 255
    assert_close(recorded(device, electrons), np.array([[256, 303, 2606, 4095, 255]]), atol=0)


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/adc").workgroup_size == (16, 16, 1)
