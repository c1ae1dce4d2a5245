"""Cases of the read-out: borders, gains, bent responses, two reads of one charge."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Recording, default_device
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.adc import record_adc
from gpusim.sensor.adc_model import ColumnOffset, DualGain, GainStep, Linearity
from gpusim.sensor.frame import Border
from gpusim.sensor.merge import record_merge
from gpusim.sensor.sensor import Sensor
from gpusim.stress.made import FLAT, camera_of, gaussian_bank, mono, white_rate
from gpusim.stress.sensor_files import wrong
from gpusim.stress.table import Case, Engine

WHITE = Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
DUAL = DualGain(
    system_gain_dn_per_e=0.03, temporal_dark_noise_e=20.0, black_level_dn=200.0, switch_dn=3800
)


def captured(
    sensor: Sensor, exposure_s: float = 0.01, noise: bool = False, **more: object
) -> np.ndarray:
    """Return the raw of an even white frame, in float64."""
    renderer = Renderer(camera_of(gaussian_bank(), sensor), WHITE, Accuracy(1e-2, 0), noise=noise)
    try:
        return renderer.capture(exposure_s, seed=5, **more).raw.astype(np.float64)
    finally:
        renderer.release()


def converted(electrons: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Return the codes of some electrons (rows, cols)."""
    device = default_device()
    held = device.resident("electrons", electrons.astype(np.float32))
    rec = Recording(device)
    codes = record_adc(rec, held, sensor)
    if sensor.dual_gain is not None:
        low = record_adc(rec, held, sensor.at_low_gain(), label="low")
        codes = record_merge(rec, codes, low, sensor, label="merged")
    label = rec.download(codes)
    try:
        return rec.run()[label].astype(np.float64)
    finally:
        held.destroy()


def mostly_border() -> tuple:
    """Take one lit pixel in a border of 200 x 300, with noise, in tiles most of which are dark."""
    border = Border(top=90, bottom=109, left=150, right=149)
    sensor = mono(1, 1).model_copy(update={"optical_black": border})
    whole = captured(sensor, noise=True)
    same = np.array_equal(whole, captured(sensor, noise=True, tile_px=100))
    lit = whole[90, 150]
    whole[90, 150] = 256
    level = float(whole.mean())
    # Black 256 and 0.005 DN of dark current; noise of 1.6 DN over 6e4 pixels, 5 sigma.
    right = same and whole.shape == (200, 300) and abs(level - 256) < 0.04 and lit > 270
    return "black 256.00 to 0.04; tiles change no bit", f"{level:.3f}, lit {lit:g}", right


def steep_response() -> tuple:
    """Take a response that all but stands still on every other of 4000 pieces."""
    at = np.sort(np.random.default_rng(3).uniform(0, 1e5, 3998))
    at = np.concatenate([[0], at, [1e5]])
    slope = np.where(np.arange(3999) % 2, 1e-3, 1.9)
    read = np.concatenate([[0], np.cumsum(slope * np.diff(at))])
    sensor = mono().model_copy(
        update={
            "linearity": Linearity(electrons=list(at), read_e=list(read)),
            "full_well_e": 1e5,
            "system_gain_dn_per_e": 0.5,
            "bit_depth": 16,
        }
    )
    electrons = np.linspace(-100, 1e5, 256 * 300).reshape(256, 300).astype(np.float32)
    expected = 256 + 0.5 * np.interp(electrons, at, read)
    expected[electrons < 0] = 256 + 0.5 * 1.9 * electrons[electrons < 0]
    off = float(np.abs(converted(electrons, sensor) - expected).max())
    # Half a DN, and f32's steps of 1/128 at 1e5 in charge, start and value.
    return "the table, to half a DN", f"{off:.3f} DN off", off < 0.53


def saturated_at_each_gain() -> tuple:
    """Take twice the full well at gains from 1/16 to 1000: the code of the well, or the top."""
    gains = (0.0625, 1.0, 16.0, 1000.0)
    base = mono(8, 8).model_copy(
        update={
            "full_well_e": 500.0,
            "analogue_gains": [GainStep(gain=gain) for gain in gains],
            "prnu_percent": 0.0,
        }
    )
    exposure_s = 1000 / white_rate(gaussian_bank(), base)
    # The pixel clips at its well before the converter reads it.
    found = [float(captured(base.at_gain(gain), exposure_s).min()) for gain in gains]
    expected = [min(4095.0, float(np.floor(256 + 0.47 * gain * 500 + 0.5))) for gain in gains]
    return f"{expected}", f"{found}", found == expected


def two_reads(full_well_e: float) -> Sensor:
    """Return a sensor that reads each charge at two gains, 16 to 1."""
    changes = {"dual_gain": DUAL, "analogue_gains": (), "full_well_e": full_well_e}
    return mono().model_copy(update=changes)


def merged_ramp() -> tuple:
    """Read a ramp of 130 000 electrons at two gains, 16 to 1: one straight line to 16 bits."""
    sensor = two_reads(1.3e5)
    electrons = np.linspace(0, 1.25e5, 256 * 400).reshape(256, 400)
    found = converted(electrons, sensor)
    low = np.floor(256 + 0.47 * electrons + 0.5) >= 3800
    # A step of the high gain; one of the low gain, 15.7 DN of the high.
    bound = np.where(low, 0.5 + 0.5 * 0.47 / 0.03, 0.5) + 0.01
    off = float((np.abs(found - 256 - 0.47 * electrons) / bound).max())
    rising = bool((np.diff(found.ravel()) >= -8).all())
    return "the line within half a step", f"{off:.3f} half steps off", off <= 1 and rising


def beyond_both_reads() -> tuple:
    """Take a charge beyond both reads, and one far below black: the merged codes' ends."""
    sensor = two_reads(1e7)
    found = converted(np.array([[-1e7, 1e7]]), sensor).ravel()
    top = float(np.floor(256 + 0.47 / 0.03 * (4095 - 200) + 0.5))
    return f"0 and {top:g}", f"{found[0]:g} and {found[1]:g}", list(found) == [0.0, top]


def offsets_beyond_the_codes() -> tuple:
    """Take column offsets of many times the range: codes are clipped, and none wraps around."""
    offsets = [-1e6, 0.0, 1e6] * 21 + [0.0]
    # Counted on the chip, where a region begins elsewhere.
    whole = {"first_row": 0, "first_col": 0, "column_offset": ColumnOffset(offsets_dn=offsets)}
    sensor = mono().model_copy(update=whole)
    found = converted(np.zeros((48, 64)), sensor)
    expected = np.clip(256 + np.array(offsets), 0, 4095)
    return "0, 256 and 4095", f"{np.unique(found)}", bool((found == expected).all())


CASES: tuple[Case, ...] = (
    ("one lit pixel in a wide border", mostly_border, None),
    ("response of 4000 points, all but standing still", steep_response, None),
    ("full wells at gains from 1/16 to 1000", saturated_at_each_gain, None),
    ("two reads, 16 to 1, over 125 000 electrons", merged_ramp, None),
    ("charge beyond both reads", beyond_both_reads, None),
    ("column offsets beyond the codes", offsets_beyond_the_codes, None),
    ("border of no pixel", wrong("optical_black", {"top": 0}), "optical_black"),
    ("border wider than allowed", wrong("optical_black", {"left": 5000}), Engine("4096")),
    ("border out of phase", wrong("optical_black", {"top": 3}), "filter pattern"),
    (
        "response that falls",
        wrong("linearity", {"electrons": [0, 5000, 9000], "read_e": [0, 9000, 8000]}),
        "not monotone",
    ),
    (
        "response that is too short",
        wrong("linearity", {"electrons": [0, 5000], "read_e": [0, 5000]}),
        "full well",
    ),
    (
        "response with NaN",
        wrong("linearity", {"electrons": [0, 9000], "read_e": [0, float("nan")]}),
        "linearity.read_e",
    ),
    (
        "column offsets of another length",
        wrong("column_offset", {"offsets_dn": [0.0] * 100}),
        "4056",
    ),
    (
        "merged codes beyond 16 bits",
        wrong("dual_gain", DUAL.model_dump() | {"system_gain_dn_per_e": 0.01}, analogue_gains=[]),
        Engine("65535"),
    ),
    ("unknown step of the gain", lambda: mono().at_gain(3), "no such step"),
)
