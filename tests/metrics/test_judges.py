"""The measurement against the reference implementation of the standard, on the same frames.

emva1288 (extra ``judges``) reads the frames that ``gpusim measure noise --keep`` writes, through a
descriptor file of its own. Skipped where it is not installed. Two measurements: one exposure time
under rising light, and one light for rising exposure times, from which it also has dark current.

Both take the equations of the standard. What differs and is compared within 2 %: the program counts
a level of two frames as photon transfer alone and one of more as non-uniformity alone; it finds
saturation from above, the first maximum; it divides by numbers of pixels where unbiased variances
have one less.
"""

from __future__ import annotations

import logging
import types
from pathlib import Path

import numpy as np
import pytest

from gpusim.gpu import Device
from gpusim.metrics import flat_field, frames
from gpusim.metrics.emva import Characterisation, characterise
from gpusim.metrics.flat_field import Light
from gpusim.plan.stages import sensor_runs
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.load import load_sensor
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

pytestmark = pytest.mark.slow

CLOSE = 0.02
AGREE = {
    "K": "system_gain_dn_per_e",
    "R": "responsivity_dn_per_photon",
    "u_p_sat": "saturation_photons",
    "u_e_sat": "saturation_e",
    "u_p_min": "sensitivity_threshold_photons",
    "u_e_min": "sensitivity_threshold_e",
    "SNR_max": "snr_max",
    "DR": "dynamic_range",
    "sigma_y_dark": "temporal_dark_noise_dn",
    "sigma_d": "temporal_dark_noise_e",
}
UNEVEN = {
    "DSNU1288": "dsnu_e",
    "DSNU1288_pixel": "dsnu_pixel_e",
    "PRNU1288": "prnu_percent",
    "PRNU1288_pixel": "prnu_pixel_percent",
}


@pytest.fixture(scope="module")
def judge():
    """Return the program's modules; NumPy 2 no longer has a name that it uses."""
    pytest.importorskip("emva1288")
    from emva1288.process import data, loader, parser, results, routines

    if not hasattr(np, "asfarray"):
        routines.np = types.ModuleType("numpy with asfarray")
        routines.np.__dict__.update(np.__dict__)
        routines.np.asfarray = lambda values: np.asarray(values, float)
    return types.SimpleNamespace(
        data=data.Data1288,
        loader=loader.LoadImageData,
        parser=parser.ParseEmvaDescriptorFile,
        results=results.Results1288,
    )


def judged(judge, folder: Path, groups, sensor: Sensor):
    """Let the program measure the frames of a folder."""
    lines = [f"v 4.0\nn {sensor.bit_depth} {sensor.cols} {sensor.rows}"]
    for (exposure, photons, _), files in groups.items():
        title = f"b {exposure * 1e9!r} {photons!r}" if photons else f"d {exposure * 1e9!r}"
        # The first two frames of a stack in the dark are the pair, where there are lit pairs beside
        # it.
        pairs = any(key[0] == exposure and key[1] and len(groups[key]) == 2 for key in groups)
        takes = [files[:2], files] if len(files) > 2 and not photons and pairs else [files]
        for taken in takes:
            lines.append(title)
            lines += [f"i {file.name}" for file in taken]
    descriptor = folder / "descriptor.txt"
    descriptor.write_text("\n".join(lines) + "\n")
    quiet = {"loglevel": logging.ERROR}
    parsed = judge.parser(str(descriptor), **quiet)
    images = judge.loader(parsed.images, **quiet)
    data = judge.data(images.data, **quiet)
    return judge.results(data.data, pixel_area=sensor.pixel_pitch_um**2, **quiet)


def sensor_of() -> Sensor:
    return load_sensor("imx477").model_copy(
        update={
            "rows": 160,
            "cols": 192,
            "cfa": ColourFilterArray(pattern=[["W"]]),
            "quantum_efficiency": QuantumEfficiency(
                wavelengths_nm=[400, 550, 700], channels={"W": [0.3, 0.64, 0.2]}
            ),
            "system_gain_dn_per_e": 0.4,
            "temporal_dark_noise_e": 5.0,
            "dark_current_e_per_s": 15.0,
            "dsnu_e": 2.5,
            "prnu_percent": 1.2,
        }
    )


def taken(device: Device, folder: Path, sensor: Sensor, wanted: list[Light]) -> frames.Frames:
    """Take frames of lights, keep them and read their list."""
    kept = frames.Kept(folder)
    for _ in flat_field.measure(
        sensor, wanted, device, sensor_runs(sensor), seed=5, keep=kept.frame
    ):
        pass
    kept.close(sensor.name, sensor.cfa.pattern, sensor.pixel_pitch_um)
    return frames.find_frames(folder)


def ours(found: frames.Frames) -> Characterisation:
    return characterise(list(frames.measure(found)), found.sites)


def relative(theirs: float, figures: dict, name: str) -> float:
    return abs(theirs / figures[name].value - 1)


@pytest.fixture(scope="module")
def of_one_time(judge, device, tmp_path_factory):
    sensor = sensor_of()
    folder = tmp_path_factory.mktemp("light")
    wanted = [
        one
        for one in flat_field.lights(sensor, stack=16)
        if one.exposure_s == flat_field.EXPOSURE_S
    ]
    found = taken(device, folder, sensor, wanted)
    measured = ours(found)
    theirs = judged(judge, folder, found.groups, sensor)
    return theirs, measured.figures | measured.channels[0].figures, measured


def test_photon_transfer_and_what_follows_from_it_agree(of_one_time):
    theirs, figures, _ = of_one_time
    off = {name: relative(getattr(theirs, name), figures, key) for name, key in AGREE.items()}
    off["QE"] = relative(theirs.QE / 100, figures, "quantum_efficiency")
    assert {name: one for name, one in off.items() if one > CLOSE} == {}


def test_non_uniformities_agree(of_one_time):
    theirs, figures, _ = of_one_time
    off = {name: relative(getattr(theirs, name), figures, key) for name, key in UNEVEN.items()}
    assert {name: one for name, one in off.items() if one > CLOSE} == {}


def test_rows_and_columns_are_split_alike(of_one_time):
    """Parts that are nothing but chance here: variances, in units of the uncertainty."""
    theirs, _, measured = of_one_time
    for ours_of, postfix in ((measured.dark, "_dark"), (measured.channels[0].bright, "")):
        for part, name in (("row", "row"), ("column", "col")):
            variance = getattr(theirs, f"s_2_y_{name}{postfix}")
            u = getattr(ours_of.spatial, f"{part}_u2") ** 0.5
            assert abs(variance - getattr(ours_of.spatial, part)) < 0.5 * u


def test_linearity_agrees(of_one_time):
    """Deviations of a straight camera are noise: alike within a fiftieth of a per cent."""
    theirs, figures, _ = of_one_time
    for one, other in ((theirs.LE_min, "min"), (theirs.LE_max, "max")):
        assert abs(one - figures[f"linearity_error_{other}_percent"].value) < 0.02


def test_dark_current_agrees(judge, device, tmp_path):
    """One light for rising times: each has a pair with it and a pair in the dark."""
    sensor = sensor_of()
    full = sensor.saturation_e / sensor.qe["W"].max()
    times = np.arange(1, 61) * 0.25
    wanted = [
        Light(float(time), photons, 550.0 if photons else None, 2)
        for time in times
        for photons in (0.0, float(1.1 * full * time / times[-1]))
    ]
    half = float(full * times[27] / times[-1])
    wanted += [Light(0.01, 0.0, None, 16), Light(0.01, half, 550.0, 16)]
    found = taken(device, tmp_path, sensor, wanted)
    figures = ours(found).figures
    theirs = judged(judge, tmp_path, found.groups, sensor)
    assert relative(theirs.u_I_mean, figures, "dark_current_e_per_s") < CLOSE
    assert relative(theirs.u_I_var, figures, "dark_current_variance_e_per_s") < CLOSE
    assert abs(theirs.u_I_mean / sensor.dark_current_e_per_s - 1) < CLOSE
