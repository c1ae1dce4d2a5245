"""The loop on the product's own shaders: what was put in comes out, and what is wrong is seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from gpusim.gpu import Device, Recording
from gpusim.metrics import flat_field, law, loop
from gpusim.metrics.as_sensor import as_sensor
from gpusim.metrics.emva import characterise
from gpusim.metrics.frames import Frames
from gpusim.metrics.statistics import Accumulator
from gpusim.plan.stages import sensor_runs
from gpusim.sensor import readout
from gpusim.sensor.adc_model import ColumnOffset, DualGain, Linearity
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise_model import Defects, LineNoise, Masks, ResetNoise
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

MONO = {
    "name": "mono",
    "analogue_gains": (),
    "rows": 192,
    "cols": 256,
    "cfa": ColourFilterArray(pattern=[["W"]]),
    "quantum_efficiency": QuantumEfficiency(
        wavelengths_nm=[400, 550, 700], channels={"W": [0.3, 0.64, 0.2]}
    ),
    "system_gain_dn_per_e": 0.3,
    "black_level_dn": 64.0,
    "bit_depth": 12,
    "full_well_e": 1e4,
    "temporal_dark_noise_e": 6.0,
    "dark_current_e_per_s": 8.0,
    "dsnu_e": 2.5,
    "prnu_percent": 1.2,
}


def sensor_of(**changes: object) -> Sensor:
    return load_sensor("imx477").model_copy(update={**MONO, **changes})


def measured(device: Device, sensor: Sensor, levels: int = 24):
    wanted = flat_field.lights(sensor, levels=levels, stack=16)
    found = flat_field.measure(sensor, wanted, device, sensor_runs(sensor), seed=3)
    return characterise(list(found), sensor.site_channels())


@pytest.fixture(scope="module")
def found(device: Device):
    return measured(device, sensor_of())


def verdicts(found, sensor: Sensor) -> dict[str, loop.Row]:
    return {row.parameter: row for row in loop.rows(found, sensor)}


def test_the_loop_closes(found):
    table = verdicts(found, sensor_of())
    assert [row for row in table.values() if not row.within] == []
    assert set(table) == {
        "K", "eta at 550 nm", "mu_e.sat", "PRNU", "K of unlike pixels", "sigma_d", "mu_I (mean)",
        "mu_I (variance)", "DSNU",
    }  # fmt: skip
    # What cannot fail proves nothing: the uncertainties are small.
    for name, most in (("K", 0.02), ("eta at 550 nm", 0.02), ("sigma_d", 0.02), ("DSNU", 0.05)):
        assert table[name].uncertainty < most * table[name].data_sheet


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        ({"system_gain_dn_per_e": 0.3 * 1.03}, "K"),
        ({"prnu_percent": 1.2 * 1.05}, "PRNU"),
        ({"dsnu_e": 2.5 * 1.05}, "DSNU"),
        ({"temporal_dark_noise_e": 6.0 * 1.03}, "sigma_d"),
        ({"dark_current_e_per_s": 8.0 * 1.03}, "mu_I (mean)"),
        ({"full_well_e": 0.85e4}, "mu_e.sat"),
    ],
)
def test_a_wrong_sensor_file_falls_outside(found, change, seen):
    """Frames of the sensor against a file that is off by a few per cent."""
    table = verdicts(found, sensor_of(**change))
    assert not table[seen].within
    assert loop.failed(list(table.values())) >= 1


def test_prnu_after_the_shot_noise_falls_outside(device: Device, monkeypatch):
    """A planted error of order: even light, then charges times the pixels' responses."""
    sensor = sensor_of(prnu_percent=3.0)
    noise = readout.record_noise

    def wrong(rec: Recording, mean, sensor, **options):
        electrons = noise(rec, mean, sensor, **{**options, "label": "even"})
        dark = sensor.model_copy(update={"dark_current_e_per_s": 0.0})
        return record_exposure(rec, electrons, dark, 1.0, label="uneven")

    monkeypatch.setattr(readout, "record_noise", wrong)
    runs = sensor_runs(sensor)
    wanted = flat_field.lights(sensor, levels=24, stack=16)
    levels = flat_field.measure(
        sensor, wanted, device, lambda name: name != "prnu" and runs(name), seed=3
    )
    table = verdicts(characterise(list(levels), sensor.site_channels()), sensor)
    assert not table["K of unlike pixels"].within
    assert table["K of unlike pixels"].recovered == pytest.approx(0.6, rel=0.1)
    # The figure itself is right: nothing but the noise of unlike pixels tells the order.
    assert table["PRNU"].within


def test_a_converter_off_by_3_percent_falls_outside(device: Device, monkeypatch):
    """A planted error of the stage: the sensor file is right, the converter is not."""
    adc = readout.record_adc

    def steeper(rec: Recording, electrons, sensor, **options):
        gain = 1.03 * sensor.system_gain_dn_per_e
        planted = sensor.model_copy(update={"system_gain_dn_per_e": gain})
        return adc(rec, electrons, planted, **options)

    monkeypatch.setattr(readout, "record_adc", steeper)
    table = verdicts(measured(device, sensor_of()), sensor_of())
    assert not table["K"].within
    # What is measured in electrons does not depend on the gain.
    assert table["sigma_d"].within and table["DSNU"].within


def test_a_converter_coarser_than_the_noise_is_predicted_and_said(device: Device):
    sensor = sensor_of(
        bit_depth=8, system_gain_dn_per_e=0.04, temporal_dark_noise_e=5.0, full_well_e=5000.0,
        black_level_dn=3.3, dsnu_e=4.0,
    )  # fmt: skip
    table = verdicts(measured(device, sensor), sensor)
    assert [row for row in table.values() if not row.within] == []
    assert "converter's steps" in table["sigma_d"].reason
    assert table["sigma_d"].expected != pytest.approx(5.0, rel=0.02)


def test_a_black_level_of_zero_is_predicted_and_said(device: Device):
    sensor = sensor_of(black_level_dn=0.0)
    found = measured(device, sensor)
    table = verdicts(found, sensor)
    assert [row for row in table.values() if not row.within] == []
    assert "black level" in table["sigma_d"].reason
    assert table["sigma_d"].expected < 0.8 * sensor.temporal_dark_noise_e
    assert any("black level" in note for note in found.notes)


def test_a_bent_response_is_predicted_and_said(device: Device):
    """Gain, quantum efficiency and PRNU are those of the curve's slopes."""
    bent = {"electrons": [0, 3000, 6000, 1e4], "read_e": [0, 2950, 5700, 9000]}
    sensor = sensor_of(linearity=Linearity.model_validate(bent))
    table = verdicts(measured(device, sensor), sensor)
    assert [row for row in table.values() if not row.within] == []
    assert "straight line" in table["K"].reason
    assert abs(table["K"].expected - 0.3) > 3 * table["K"].uncertainty
    assert abs(table["PRNU"].expected - 1.2) > table["PRNU"].uncertainty


def test_the_file_of_a_measured_sensor_has_the_responses_that_its_curve_bends(device: Device):
    electrons = np.linspace(0, 1e4, 21)
    bent = {"electrons": electrons, "read_e": electrons * (1 - electrons / 1e5)}
    sensor = sensor_of(linearity=Linearity.model_validate(bent))
    found = measured(device, sensor)
    again = as_sensor(found, Frames(Path(), "bent", (("W",),), {}), (192, 256))
    # Half way up a pixel that responds by 1 % more gives 0.95 % more.
    prnu = found.channels[0].figures["prnu_percent"]
    assert abs(prnu.value - 1.2) > 9 * prnu.u
    assert abs(again.prnu_percent - 1.2) < 3 * prnu.u


def test_offsets_of_columns_and_black_levels_of_channels_are_seen(device: Device):
    sensor = load_sensor("imx477").roi(192, 192)
    sensor = sensor.model_copy(
        update={
            "channel_black_level_dn": {"R": 240.0, "B": 270.5},
            "column_offset": ColumnOffset(sigma_dn=0.8),
        }
    )
    table = verdicts(measured(device, sensor, levels=16), sensor)
    assert [row for row in table.values() if not row.within] == []
    assert table["DSNU"].expected == pytest.approx(np.hypot(1.1, 0.8 / 0.47))
    assert table["DSNU.col"].uncertainty < 0.5 * table["DSNU.col"].expected


def test_rows_columns_and_reset_are_seen_apart(device: Device):
    lines = LineNoise(
        prnu_row_percent=0.8, prnu_column_percent=0.5, dsnu_row_e=1.5, dsnu_column_e=3.0,
        row_noise_e=2.0, column_noise_e=1.0,
    )  # fmt: skip
    sensor = sensor_of(lines=lines, reset_noise=ResetNoise(noise_e=5.0), dcnu_percent=50.0)
    table = verdicts(measured(device, sensor), sensor)
    assert [row for row in table.values() if not row.within] == []
    assert table["sigma_d"].expected == pytest.approx(np.sqrt(36 + 25 + 4 + 1))
    assert "reset" in table["sigma_d"].reason
    for name, planted in (
        ("sigma_d.row", 2.0), ("sigma_d.col", 1.0), ("DSNU.row", 1.5), ("DSNU.col", 3.0),
        ("PRNU.row", 0.8), ("PRNU.col", 0.5),
    ):  # fmt: skip
        assert table[name].expected == planted
        assert table[name].uncertainty < 0.4 * planted


@pytest.mark.parametrize(
    ("changes", "word", "seen", "expected"),
    [
        # Variance 81 + 1.8 n: K and all that it divides is 1.8 times as large.
        (
            {"gaussian_variance_per_e": 1.8, "temporal_dark_noise_e": 9.0},
            "Poisson",
            "K",
            1.8 * 0.3,
        ),
        # The variance of a soft well falls from the knee on: n exp(-2 (n - k) / (w - k)).
        ({"full_well_knee": 0.5}, "slowly", "mu_e.sat", 5000.0),
    ],
)
def test_other_laws_of_noise_and_well_are_predicted_and_said(
    device: Device, changes, word, seen, expected
):
    sensor = sensor_of(**changes)
    table = verdicts(measured(device, sensor), sensor)
    assert [row for row in table.values() if not row.within] == []
    assert word in table["K"].reason
    assert table[seen].expected == pytest.approx(expected, rel=0.05)


def test_a_colour_sensor_is_measured_channel_by_channel(device: Device):
    sensor = load_sensor("imx477").roi(192, 192)
    table = verdicts(measured(device, sensor, levels=16), sensor)
    assert [row for row in table.values() if not row.within] == []
    for name, nm in (("R", 595), ("G", 530), ("B", 460)):
        row = table[f"eta {name} at {nm} nm"]
        assert row.data_sheet == pytest.approx(sensor.qe[name].max())


@pytest.mark.parametrize(
    "pattern", [[["R", "B"]], [["R", "G", "B"], ["G", "B", "R"]], [["G"], ["B"], ["R"]]]
)
def test_every_photosite_has_the_light_of_its_channel(device: Device, pattern):
    """Patterns of 1 x 2, 2 x 3 and 3 x 1, of which the optics make unlike planes."""
    channels = {"R": [0.1, 0.1, 0.5], "G": [0.1, 0.6, 0.1], "B": [0.7, 0.1, 0.2]}
    channels = {name: channels[name] for row in pattern for name in row}
    curves = QuantumEfficiency(wavelengths_nm=[400, 550, 700], channels=channels)
    cfa = ColourFilterArray(pattern=pattern)
    sensor = flat_field.region(sensor_of(cfa=cfa, quantum_efficiency=curves, prnu_percent=0.0), 48)
    light = flat_field.Light(0.01, 5000.0, 700.0, 1)
    frame = flat_field.take(sensor, light, device, sensor_runs(sensor), seed=1, frame=0)
    py, px = sensor.period
    for row, names in enumerate(pattern):
        for col, name in enumerate(names):
            site = frame[row::py, col::px]
            mean = 64 + 0.3 * (5000 * channels[name][2] + 0.08)
            assert abs(site.mean() - mean) < 5 * site.std() / site.size**0.5


def test_every_frame_has_noise_of_its_own(device: Device):
    sensor = sensor_of()
    taken = []
    wanted = flat_field.lights(sensor, levels=2, stack=4)
    for _ in flat_field.measure(
        sensor, wanted, device, sensor_runs(sensor), seed=3,
        keep=lambda light, number, frame: taken.append((number, frame.tobytes())),
    ):  # fmt: skip
        pass
    assert [number for number, _ in taken] == list(range(len(taken)))
    assert len({frame for _, frame in taken}) == len(taken)


def law_of(sensor: Sensor) -> law.PixelLaw:
    return law.PixelLaw(
        sensor,
        sensor.black_level_dn,
        sensor.temporal_dark_noise_e,
        sensor.dsnu_e,
        sensor.prnu_percent,
    )


def test_the_model_is_the_law_of_a_pixel():
    """Mean and variance against 4e5 draws of NumPy: well, offsets, rounding, clipping."""
    rng = np.random.default_rng(2)
    for changes, light in (
        ({}, 300.0),
        ({"full_well_e": 3000.0}, 2950.0),
        ({"bit_depth": 9, "prnu_percent": 4.0}, 1400.0),
        ({"full_well_e": 3000.0, "full_well_knee": 0.6}, 2500.0),
        ({"black_level_dn": 0.4, "system_gain_dn_per_e": 0.05}, 3.0),
    ):
        sensor = sensor_of(**changes)
        draws = (200_000, 2)
        response = 1 + sensor.prnu_percent / 100 * rng.standard_normal((draws[0], 1))
        charge = rng.poisson(light * response, draws)
        if sensor.full_well_knee < 1:
            knee = sensor.full_well_knee * sensor.full_well_e
            room = sensor.full_well_e - knee
            soft = sensor.full_well_e - room * np.exp(-(charge - knee) / room)
            charge = np.where(charge > knee, soft, charge)
        charge = np.minimum(charge, sensor.full_well_e)
        charge = charge + sensor.dsnu_e * rng.standard_normal((draws[0], 1))
        charge = charge + sensor.temporal_dark_noise_e * rng.standard_normal(draws)
        level = sensor.system_gain_dn_per_e * charge + sensor.black_level_dn
        dn = np.clip(np.floor(level + 0.5), 0, sensor.max_dn)
        squares = (dn[:, 0] - dn[:, 1]) ** 2 / 2
        mean, variance = law_of(sensor).levels(np.array([light]), np.zeros(1))
        assert abs(mean[0] - dn.mean()) < 4.5 * dn.mean(axis=1).std() / draws[0] ** 0.5
        assert abs(variance[0] - squares.mean()) < 4.5 * squares.std() / draws[0] ** 0.5


def test_the_moments_of_a_clipped_normal_are_those_of_a_sum():
    """The closed form of a wide noise against the sum over all codes, in the middle and clipped."""
    middle = np.array([-3.0, 0.0, 7.5, 120.0, 253.0, 255.0, 262.0])
    codes = np.arange(256)
    edges = np.concatenate([[-np.inf], codes[1:] - 0.5, [np.inf]])
    share = np.diff(ndtr((edges[None] - middle[:, None]) / 4.0), axis=1)
    first, second = law.converted(middle, np.array(4.0), 255)
    variance = share @ codes**2 - (share @ codes) ** 2
    # At the ends rounding is not independent of the noise: that takes up to a twelfth.
    assert np.abs(first - share @ codes).max() < 0.02
    assert np.abs(second - first**2 - variance).max() < 1 / 12
    assert second[3] - first[3] ** 2 == pytest.approx(variance[3], rel=1e-6)
    narrow = np.diff(ndtr((edges[None] - middle[:, None]) / 1.5), axis=1)
    first, second = law.converted(middle, np.array(1.5), 255)
    assert np.allclose(first, narrow @ codes, atol=1e-6)
    assert np.allclose(second, narrow @ codes**2, rtol=1e-6, atol=1e-5)


def test_a_ccd_is_measured_without_its_transfer(device: Device):
    """What moves charge is no part of the standard's camera, and the page says that it is out."""
    sensor = load_sensor("kodak-vga")
    assert "serial cti" in flat_field.left_out(sensor, sensor_runs(sensor))
    part = sensor.roi(64, 64)
    light = next(one for one in flat_field.lights(part) if one.photons)
    alone = part.model_copy(update={"smear": None, "parallel_cti": None, "serial_cti": None})
    frames = [
        flat_field.take(one, light, device, sensor_runs(one), seed=1, frame=0)
        for one in (part, alone)
    ]
    assert np.array_equal(*frames)


def test_defect_pixels_are_left_out_and_that_is_said():
    sensor = load_sensor("imx477")
    assert flat_field.left_out(sensor, sensor_runs(sensor)) == ""
    spotted = sensor.model_copy(update={"defects": Defects(dead_fraction=0.01)})
    assert flat_field.region(spotted).defects is None
    assert "defect" in flat_field.left_out(spotted, sensor_runs(spotted))


def test_masks_are_part_of_the_non_uniformity(device: Device, tmp_path):
    rng = np.random.default_rng(4)
    shape = (MONO["rows"], MONO["cols"])
    np.save(tmp_path / "gain.npy", (0.9 + 0.02 * rng.standard_normal(shape)).astype(np.float32))
    np.save(tmp_path / "offset.npy", (3 * rng.standard_normal(shape)).astype(np.float32))
    masks = Masks(gain="gain.npy", offset_e="offset.npy").placed(tmp_path, (0, 0, *shape))
    sensor = sensor_of(masks=masks, first_row=0, first_col=0)
    table = verdicts(measured(device, sensor), sensor)
    assert [row for row in table.values() if not row.within] == []
    assert table["eta at 550 nm"].expected == pytest.approx(0.9 * 0.64, rel=2e-3)
    assert table["PRNU"].expected == pytest.approx(np.hypot(1.2, 2 / 0.9), rel=0.02)
    assert table["DSNU"].expected == pytest.approx(np.hypot(2.5, 3.0), rel=0.02)


DUAL = DualGain(
    system_gain_dn_per_e=0.05, temporal_dark_noise_e=25.0, black_level_dn=70, switch_dn=1800
)


@pytest.fixture(scope="module")
def merged(device: Device):
    return measured(device, sensor_of(dual_gain=DUAL, full_well_e=4e4))


def test_two_merged_reads_are_predicted_and_said(merged):
    """A transfer that steps up where the read at low gain takes over."""
    sensor = sensor_of(dual_gain=DUAL, full_well_e=4e4)
    table = verdicts(merged, sensor)
    assert [row for row in table.values() if not row.within] == []
    assert "from 1800 DN on" in table["K"].reason
    assert table["K"].expected > 0.3 + table["K"].uncertainty
    # Dark frames show the noise of the read at high gain, in DN.
    assert table["sigma_d"].expected * table["K"].expected == pytest.approx(6.0 * 0.3, rel=0.01)


@pytest.mark.parametrize("change", [{"temporal_dark_noise_e": 35.0}, {"switch_dn": 3900}])
def test_a_wrong_read_at_low_gain_falls_outside(merged, change):
    sensor = sensor_of(dual_gain=DUAL.model_copy(update=change), full_well_e=4e4)
    assert not verdicts(merged, sensor)["K"].within


@pytest.mark.parametrize("change", [{"system_gain_dn_per_e": 0.051}, {"black_level_dn": 80}])
def test_a_wrong_merge_falls_outside(device: Device, monkeypatch, change):
    """A planted error of the stage: the sensor file is right, the merging is not."""
    merge = readout.record_merge

    def planted(rec: Recording, high, low, sensor, **options):
        dual = sensor.dual_gain.model_copy(update=change)
        return merge(rec, high, low, sensor.model_copy(update={"dual_gain": dual}), **options)

    monkeypatch.setattr(readout, "record_merge", planted)
    sensor = sensor_of(dual_gain=DUAL, full_well_e=4e4)
    table = verdicts(measured(device, sensor), sensor)
    assert not (table["K"].within and table["eta at 550 nm"].within)


def test_the_light_reaches_beyond_saturation_in_even_steps():
    sensor = sensor_of()
    lit = [one for one in flat_field.lights(sensor) if one.photons and one.frames == 2]
    steps = np.diff([one.photons for one in lit])
    assert np.allclose(steps, steps[0])
    assert sum(one.photons * 0.64 <= 1e4 for one in lit) >= 50
    assert lit[-1].photons * 0.64 > 1.05 * 1e4


def test_statistics_of_the_device_and_of_a_float_reference_agree(device: Device):
    """A frame counts as its digital numbers: sums of integers are exact in float64."""
    sensor = sensor_of(rows=16, cols=16)
    light = replace(flat_field.lights(sensor)[-1], frames=2)
    frames = [
        flat_field.take(sensor, light, device, sensor_runs(sensor), seed=1, frame=number)
        for number in range(4)
    ]
    statistics = Accumulator((1, 1))
    for frame in frames:
        statistics.add(frame)
    site = statistics.sites()[0]
    assert site.mean == np.mean(frames)
    pairs = [np.var(frames[i] - frames[i + 1].astype(float), ddof=1) / 2 for i in (0, 2)]
    assert site.temporal.total == pytest.approx(np.mean(pairs), rel=0.01)
