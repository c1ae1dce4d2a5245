"""What a sensor file says of the read-out: derived figures, gains, each mistake's clear error."""

from pathlib import Path

import numpy as np
import pytest
from changes import sensor_file

from gpusim.errors import UserError
from gpusim.sensor.adc_model import LEVELS, ColumnOffset, DualGain, GainStep, Linearity
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor

CURVE = {"electrons": [0, 4000, 8180], "read_e": [0, 4100, 8100]}
DUAL = {
    "system_gain_dn_per_e": 0.047,
    "temporal_dark_noise_e": 12,
    "black_level_dn": 200,
    "switch_dn": 3800,
}


ONE_GAIN = {"analogue_gains": []}  # the preset has steps, which do not go with a dual gain


def changed(**changes) -> Sensor:
    one = {"analogue_gains": ()} if "dual_gain" in changes else {}
    return load_sensor("imx477").model_copy(update=one | changes)


def loaded(folder: Path, **fields) -> Sensor:
    """Return the preset with some fields set, through a file."""
    return load_sensor(sensor_file(folder, **fields))


# --- linearity ---


def test_a_deviation_is_a_response(tmp_path: Path):
    percent = {"electrons": [0, 4000, 8180], "deviation_percent": [1, 2.5, -1]}
    found = loaded(tmp_path, linearity=percent).linearity
    assert np.allclose(found.response, [0, 4100, 8098.2], rtol=1e-15)


def test_the_response_is_undone():
    curve = Linearity(**CURVE)
    electrons = np.array([-500.0, 0, 10, 3999, 4000, 4001, 8180, 9000])
    assert np.allclose(curve.collected(curve.read(electrons)), electrons, rtol=1e-14)
    # Straight on beyond its ends: 4100 / 4000 below, 4000 / 4180 above.
    assert np.allclose(curve.read(electrons)[[0, -1]], [-512.5, 8100 + 820 * 4000 / 4180])


def test_a_straight_line_has_no_linearity_error():
    line = Linearity(electrons=[0, 100, 9000], read_e=[3, 103, 9003])
    assert np.allclose(line.error_percent(8000), 0, atol=1e-10)


def test_the_linearity_error_of_a_parabola():
    """A response x - c x^2: against scipy's weighted fit of the same levels."""
    from scipy.optimize import curve_fit

    at = np.linspace(0, 8000, 400)
    curve = Linearity(electrons=list(at), read_e=list(at - 2e-6 * at**2))
    level = np.linspace(400, 7600, LEVELS)
    true = level - 2e-6 * level**2
    line = curve_fit(lambda x, a, b: a + b * x, level, true, sigma=true)[0] @ [1 + 0 * level, level]
    expected = 100 * (true - line) / line
    # 400 pieces leave c (20/2)^2 = 2e-4 e- of 400: 5e-5 %.
    found = curve.error_percent(8000)
    assert np.allclose(found, [expected.min(), expected.max()], atol=1e-4)
    assert found[0] < -0.1 and found[1] > 0.1  # the control


def test_saturation_is_where_the_read_out_ends():
    assert changed().saturation_e == pytest.approx((4095 - 256) / 0.47)
    assert changed(full_well_e=5000).saturation_e == 5000
    curved = changed(linearity=Linearity(electrons=[0, 10000], read_e=[0, 9000]))
    assert curved.saturation_e == 8180  # the converter clips at 9076 e- collected
    assert changed(dual_gain=DualGain(**DUAL), full_well_e=1e5).saturation_e == pytest.approx(
        (4095 - 200) / 0.047, rel=1e-4
    )


# --- gain ---


def test_a_gain_step_scales_the_conversion_and_nothing_else():
    steps = [GainStep(gain=1, iso=100), GainStep(gain=8, iso=800, temporal_dark_noise_e=1.8)]
    base = changed(analogue_gains=steps)
    at_8 = base.at_gain(8)
    assert at_8.system_gain_dn_per_e == 8 * 0.47
    assert (at_8.temporal_dark_noise_e, at_8.iso, at_8.analogue_gain) == (1.8, 800, 8)
    assert base.at_gain(1) == base and base.iso == 100
    kept = {"system_gain_dn_per_e", "temporal_dark_noise_e", "analogue_gain"}
    for name in set(Sensor.model_fields) - kept:
        assert getattr(at_8, name) == getattr(base, name)
    assert at_8.saturation_e == pytest.approx((4095 - 256) / (8 * 0.47))
    quiet = changed(analogue_gains=[GainStep(gain=1), GainStep(gain=2)]).at_gain(2)
    assert (quiet.temporal_dark_noise_e, quiet.iso) == (3.0, None)


@pytest.mark.parametrize(("gains", "wanted"), [([], 2), ([1, 4], 2), ([1, 4], float("nan"))])
def test_an_unknown_gain_step_is_refused_with_the_known_ones(gains: list, wanted: float):
    sensor = changed(analogue_gains=[GainStep(gain=gain) for gain in gains])
    with pytest.raises(UserError, match="no such step") as caught:
        sensor.at_gain(wanted)
    assert caught.value.field == "gain"
    assert caught.value.allowed == ("1, 4" if gains else "1")


def test_a_sensor_at_one_gain_is_not_taken_to_another():
    sensor = changed(analogue_gains=[GainStep(gain=1), GainStep(gain=4)]).at_gain(4)
    with pytest.raises(UserError, match="no such step"):
        sensor.at_gain(4)


# --- column offsets ---


def test_offsets_come_from_a_table(tmp_path: Path):
    (tmp_path / "columns.txt").write_text("# DN\n" + "0.5\n-1.25  # the second\n" * 2028)
    offset = loaded(tmp_path, column_offset={"file": "columns.txt"}).column_offset
    assert offset.offsets_dn[:3] == (0.5, -1.25, 0.5) and len(offset.offsets_dn) == 4056


@pytest.mark.parametrize("content", ["1\ntwo\n", "1\nnan\n", "1\ninf\n", None])
def test_a_table_that_is_none_is_refused(tmp_path: Path, content: str | None):
    if content is not None:
        (tmp_path / "columns.txt").write_text(content)
    with pytest.raises(UserError, match="table") as caught:
        loaded(tmp_path, column_offset={"file": "columns.txt"})
    assert caught.value.file == tmp_path / "columns.txt"
    assert caught.value.field == (None if content is None else "line 2")


# --- mistakes ---


def curve(**changes) -> dict:
    return {"linearity": CURVE | changes}


MISTAKES = {
    "no bits": ({"bit_depth": 0}, "greater than or equal to 1"),
    "40 bits": ({"bit_depth": 40}, "less than or equal to 16"),
    "black at the top": ({"black_level_dn": 4095}, "below 4095"),
    "black is no number": ({"black_level_dn": float("nan")}, "finite"),
    "a channel's black at the top": ({"channel_black_level_dn": {"G": 4095.0}}, "below 4095"),
    "black of no channel": ({"channel_black_level_dn": {"W": 256}}, "R, G, B"),
    "a channel's black below 0": ({"channel_black_level_dn": {"R": -1}}, "greater than"),
    "a table falls": (curve(read_e=[0, 8100, 8000]), "rising"),
    "a table stays": (curve(read_e=[0, 0, 8000]), "rising"),
    "electrons fall": (curve(electrons=[0, 9000, 8180]), "rising"),
    "a table of one point": (curve(electrons=[0], read_e=[0]), "at least 2"),
    "a table ends before the full well": (curve(electrons=[0, 4000, 8000]), "8180"),
    "a table begins above 0": (curve(electrons=[1, 4000, 8180]), "at 0"),
    "columns of unlike length": (curve(read_e=[0, 8000]), "3, as electrons"),
    "a response without values": (curve(read_e=None), "read_e or deviation_percent"),
    "a response of two columns": (curve(deviation_percent=[0, 1, 1]), "read_e or"),
    "NaN in a table": (curve(read_e=[0, float("nan"), 8000]), "finite"),
    "offsets of another length": ({"column_offset": {"offsets_dn": [0.0] * 4000}}, "4056"),
    "no offsets": ({"column_offset": {}}, "sigma_dn, offsets_dn"),
    "offsets twice": ({"column_offset": {"sigma_dn": 1, "offsets_dn": [1.0]}}, "sigma_dn"),
    "offsets and a file": ({"column_offset": {"file": "a", "offsets_dn": [1.0]}}, "the other"),
    "sigma below 0": ({"column_offset": {"sigma_dn": -1}}, "greater than 0"),
    "a gain of 0": ({"analogue_gains": [{"gain": 0}]}, "greater than 0"),
    "a field of a gain": ({"analogue_gains": [{"gain": 1, "ISO": 100}]}, "gain, iso"),
    "the low gain is not lower": (
        {"dual_gain": DUAL | {"system_gain_dn_per_e": 0.5}} | ONE_GAIN,
        "below",
    ),
    "a switch above the codes": (
        {"dual_gain": DUAL | {"switch_dn": 4096}} | ONE_GAIN,
        "up to 4095",
    ),
    "a switch in the black": (
        {"dual_gain": DUAL | {"switch_dn": 256}} | ONE_GAIN,
        "above the black",
    ),
    "codes beyond 16 bits": (
        {"dual_gain": DUAL | {"system_gain_dn_per_e": 0.02}} | ONE_GAIN,
        "65535",
    ),
    "low black at the top": (
        {"dual_gain": DUAL | {"black_level_dn": 4095}} | ONE_GAIN,
        "below 4095",
    ),
    "dual gain and steps": ({"dual_gain": DUAL, "analogue_gains": [{"gain": 1}]}, "no analogue"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_with_what_is_allowed(tmp_path: Path, name: str):
    fields, allowed = MISTAKES[name]
    with pytest.raises(UserError) as caught:
        loaded(tmp_path, **fields)
    assert caught.value.file == tmp_path / "sensor.yaml"
    assert caught.value.field.startswith(next(iter(fields)))
    assert allowed in caught.value.allowed


def test_the_fields_of_these_mistakes_are_right_without_them(tmp_path: Path):
    """The control."""
    sensor = loaded(
        tmp_path,
        linearity=CURVE,
        channel_black_level_dn={"G": 250.5},
        column_offset={"offsets_dn": [0.0] * 4056},
        analogue_gains=[{"gain": 1, "iso": 100}],
    )
    assert sensor.site_black_dn == (256, 250.5, 250.5, 256)
    assert isinstance(sensor.column_offset, ColumnOffset)
    assert loaded(tmp_path, dual_gain=DUAL, **ONE_GAIN).raw_max_dn == 256 + 10 * (4095 - 200)
