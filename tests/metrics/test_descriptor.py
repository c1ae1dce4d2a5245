"""Data sets in the layout of the EMVA 1288 working group, outliers, and the sensor file of one.

The frames are NumPy's linear camera's. Real frames of a CCD, the 12-bit reference set of
EMVA1288/datasets, are measured where the variable GPUSIM_EMVA1288 names their folder, or where they
lie beside the checkout.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from metrics.made import Camera
from PIL import Image
from scipy.special import ndtri
from scipy.stats import chi2_contingency

from gpusim.errors import UserError
from gpusim.metrics import descriptor, flat_field, frames
from gpusim.metrics.as_sensor import as_sensor
from gpusim.metrics.emva import characterise
from gpusim.metrics.flat_field import Light
from gpusim.metrics.nonuniformity import pattern_of
from gpusim.plan.stages import sensor_runs

NS = 1e9
BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data" / "emva1288-ccd-12bit"
REAL = Path(os.environ.get("GPUSIM_EMVA1288", BESIDE))
needs_real = pytest.mark.skipif(
    not (REAL / descriptor.NAME).exists(),
    reason="GPUSIM_EMVA1288 names no data set, and none is beside this checkout",
)
PARTS = ("pixel", "row", "column")
ARRAYS = 12  # pieces of the twin's type, whose fixed patterns are averaged
SIGMAS = 3.0
STACK_PHOTONS = 15508.0  # of the lit level of 50 frames


def written(folder: Path, camera: Camera, *, levels: int = 40, stack: int = 12, wrong=None) -> Path:
    """Write frames and their list; one level's light may be `wrong`: (number, factor)."""
    (folder / "images").mkdir(parents=True)
    full = camera.full_e / camera.efficiency
    lights = [("d", 10e-3 * k, 0.0, 2) for k in range(1, 7)] + [("d", 5e-3, 0.0, 2)]
    lights += [("b", 5e-3, 1.1 * full * (k + 1) / levels, 2) for k in range(levels)]
    lights += [("b", 4e-3, full / 2 + 1, stack), ("d", 4e-3, 0.0, stack)]
    lines = ["# a comment", "v 3.0", f"n 12 {camera.shape[1]} {camera.shape[0]}"]
    for number, (kind, exposure, photons, count) in enumerate(lights):
        end = f" {photons!r}" if kind == "b" else ""
        lines.append(f"{kind} {exposure * NS!r}{end}")
        for take in range(count):
            # Two frames of which one flickers differ by no more than their noise: the mean is off.
            factor = wrong[1] if wrong is not None and number == wrong[0] else 1.0
            name = f"{kind}_{number:03}_{take}.png"
            Image.fromarray(camera.frame(photons * factor, exposure)).save(folder / "images" / name)
            lines.append(f"i images\\{name}")
    (folder / descriptor.NAME).write_text("\n".join(lines) + "\n")
    return folder


def measured(folder: Path):
    listed = descriptor.read_descriptor(descriptor.find_descriptor(folder))
    return listed, characterise(list(frames.measure(listed)), listed.sites)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return measured(written(tmp_path_factory.mktemp("emva") / "set", Camera()))


def test_the_layout_is_read(found):
    listed, sheet = found
    assert listed.bit_depth == 12
    assert len(listed.groups) == 49
    camera, figures = Camera(), sheet.channels[0].figures
    gain, eta = figures["system_gain_dn_per_e"], figures["quantum_efficiency"]
    # k = 4: 1 in 16000.
    assert abs(gain.value - camera.gain) < 4 * gain.u
    assert abs(eta.value - camera.efficiency) < 4 * eta.u
    assert sheet.channels[0].outliers == ()


def test_a_level_that_contradicts_the_others_is_named_and_left_out(found, tmp_path):
    _, sheet = measured(written(tmp_path / "set", Camera(), wrong=(20, 1.015)))
    (one,) = sheet.channels[0].outliers
    assert one.quantity == "mean"
    # Its mean is 1.5 % too high; a pixel's shot noise over 96 x 80 of them is 0.03 %.
    assert one.value / one.expected == pytest.approx(1.015, abs=0.003)
    assert any(f"{one.photons:g} photons" in note for note in sheet.notes)
    before = found[1].channels[0].transfer.photons.size
    assert sheet.channels[0].transfer.photons.size == before - 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("q 1\n", ("line 1", "q 1")),
        ("v 3.0\nn 12 x 80\n", ("line 2", "n 12 x 80")),
        ("b 1000.0 5.0\ni nothing.png\n", ("a frame is missing", "nothing.png")),
        ("i nothing.png\n", ("belongs to no level",)),
        ("b 1000.0 -5.0\n", ("line 1",)),
        ("", ("no frames",)),
    ],
)
def test_lists_that_cannot_be_read_are_refused(tmp_path, text, words):
    file = tmp_path / descriptor.NAME
    file.write_text(text)
    with pytest.raises(UserError) as caught:
        descriptor.read_descriptor(file)
    assert all(word in caught.value.screen() for word in words)


def exposures(listed, least=2):
    """Return the lights of a list of frames, those of at least so many frames."""
    return [
        Light(time, photons, 550.0 if photons else None, len(files))
        for (time, photons, _), files in listed.groups.items()
        if len(files) >= least
    ]


def twin(listed, sheet, device, seed=3):
    """Measure the sensor that was measured: the same exposures, simulated."""
    first = frames.read_frame(next(iter(listed.groups.values()))[0])
    sensor = as_sensor(sheet, listed, first.shape)
    levels = flat_field.measure(sensor, exposures(listed), device, sensor_runs(sensor), seed=seed)
    return sensor, characterise(list(levels), sensor.site_channels())


def variances(bright, dark, gain):
    """Return the six parts, %^2 and e-^2, each with its standard uncertainty."""
    response, signal = bright.spatial.minus(dark.spatial), bright.mean - dark.mean
    return {
        f"{name} {part}": (
            getattr(of, part) / unit**2,
            getattr(of, f"{part}_u2") ** 0.5 / unit**2,
        )
        for name, of, unit in (("prnu", response, signal / 100), ("dsnu", dark.spatial, gain))
        for part in PARTS
    }


def parts_of_twins(listed, sensor, device):
    """Return the six parts' mean over ARRAYS pieces of a sensor's type, and its uncertainty."""
    stacks, found = exposures(listed, least=3), []
    for piece in range(ARRAYS):
        one = sensor.model_copy(update={"serial_number": piece})
        levels = flat_field.measure(one, stacks, device, sensor_runs(one), seed=piece)
        bright, dark = sorted(
            (pattern_of(level, [0]) for level in levels), key=lambda one: -one.photons
        )
        found.append(variances(bright, dark, sensor.system_gain_dn_per_e))
    return {
        name: (np.mean([one[name][0] for one in found]),
               np.mean([one[name][1] for one in found]) / ARRAYS**0.5)
        for name in found[0]
    }  # fmt: skip


def dark_histograms(*patterns):
    """Return chi-square of the dark frames' histograms against one another, and its freedom.

    Of the average of a stack, less its rows and columns: pixels are then independent. A single
    frame's histogram tells the converter's unequal steps and nothing else.
    """
    values = [split_off(one.images[0]).ravel() for one in patterns]
    edges = np.quantile(np.concatenate(values), np.linspace(0, 1, 41)[1:-1])
    counts = [np.bincount(np.searchsorted(edges, one), minlength=40) for one in values]
    return chi2_contingency(counts)


def split_off(image):
    """Return an image without the means of its rows and columns."""
    return image - image.mean(axis=0) - image.mean(axis=1)[:, None] + image.mean()


def variance_sigmas(sheet, again):
    """Return how far the variances lie apart, in standard uncertainties, below saturation."""
    one = sheet.channels[0].transfer
    at = one.between(-np.inf, 0.99) & (one.photons < one.photons[one.saturation])
    other = again.channels[0].transfer
    same = np.searchsorted(other.photons, one.photons[at])
    u = np.sqrt(one.variance_u2[at] + other.variance_u2[same])
    return (other.variance[same] - one.variance[at]) / u


def test_the_sensor_file_is_a_twin_of_the_camera(found, device):
    listed, sheet = found
    sensor, again = twin(listed, sheet, device)
    assert sensor.linearity is None  # the camera is straight
    assert sensor.bit_depth == 12
    assert sensor.full_well_e == pytest.approx(Camera.full_e, rel=0.01)
    for name, theirs, relative in (
        ("system_gain_dn_per_e", Camera.gain, 0.02),
        ("temporal_dark_noise_e", Camera.noise_e, 0.05),
        ("dsnu_e", Camera.offset_e, 0.05),
        ("prnu_percent", 100 * Camera.response, 0.05),
    ):
        assert getattr(sensor, name) == pytest.approx(theirs, rel=relative), name
    sigmas = variance_sigmas(sheet, again)
    # The largest of 37 normal deviations is below 4 but once in 400 times.
    assert np.abs(sigmas).max() < 4.0
    for name in ("quantum_efficiency", "system_gain_dn_per_e", "saturation_photons"):
        mine, twins = (one.channels[0].figures[name] for one in (sheet, again))
        assert abs(mine.value - twins.value) < 4 * np.hypot(mine.u, twins.u), name


@needs_real
@pytest.mark.slow
def test_real_frames_of_a_ccd_give_what_an_outside_fit_found():
    _, sheet = measured(REAL)
    figures = sheet.channels[0].figures | sheet.figures
    for name, outside in (
        ("quantum_efficiency", 0.453),
        ("system_gain_dn_per_e", 0.280),
        ("temporal_dark_noise_e", 10.9),
    ):
        assert figures[name].value == pytest.approx(outside, rel=0.01), name
    # Saturation is where the variance is highest: a level more or less is 3 %.
    assert figures["saturation_e"].value == pytest.approx(14000, rel=0.04)


@pytest.fixture(scope="module")
def real_twin(device):
    listed, sheet = measured(REAL)
    return listed, sheet, *twin(listed, sheet, device)


@needs_real
@pytest.mark.slow
def test_the_twin_of_real_frames_has_their_photon_transfer(real_twin):
    _, sheet, sensor, again = real_twin
    assert sensor.linearity is not None
    sigmas = variance_sigmas(sheet, again)
    many = sheet.channels[0].transfer.photons[: len(sigmas)] == STACK_PHOTONS
    assert len(sigmas) == 38 and many.sum() == 1
    # The largest of 37 normal deviations is below this in 99 of 100 measurements (Sidak 1967).
    assert np.abs(sigmas[~many]).max() < ndtri((1 + 0.99 ** (1 / 37)) / 2)
    # The level of 50 frames is known five times as well as pairs are, and shows the slope of the
    # converter's own steps about 1977 DN (see the test below), which the sensor has not. As two
    # frames tell it, it agrees as the others do.
    assert np.abs(sigmas[many]).max() < 5 * SIGMAS
    for mine, twins in (
        *((sheet.channels[0].figures[n], again.channels[0].figures[n]) for n in
          ("quantum_efficiency", "system_gain_dn_per_e")),
        *((sheet.figures[n], again.figures[n]) for n in ("temporal_dark_noise_e", "row_noise_e")),
    ):  # fmt: skip
        assert abs(twins.value - mine.value) < SIGMAS * np.hypot(mine.u, twins.u)


@needs_real
@pytest.mark.slow
def test_the_converter_of_the_real_frames_has_unequal_steps(real_twin):
    """Why one level and the histograms of single frames are not compared."""
    listed, sheet, *_ = real_twin
    bright = sheet.channels[0].bright
    (files,) = (files for key, files in listed.groups.items() if key[1] == STACK_PHOTONS)
    codes = np.concatenate([frames.read_frame(file).ravel() for file in files])
    spread = codes.std()
    near = np.arange(int(bright.mean - spread), int(bright.mean + spread))
    law = codes.size * np.exp(-(((near - codes.mean()) / spread) ** 2) / 2)
    width = np.bincount(codes, minlength=near[-1] + 1)[near] / (law / (spread * np.sqrt(np.pi * 2)))
    # Each code has 40000 counts and more: 0.5 % of noise. Steps are off by twelve times as much.
    assert width.std() > 0.06


@needs_real
@pytest.mark.slow
def test_the_twin_of_real_frames_has_their_non_uniformity(real_twin, device):
    listed, sheet, sensor, _ = real_twin
    gain = sensor.system_gain_dn_per_e
    mine = variances(sheet.channels[0].bright, sheet.dark, gain)
    twins = parts_of_twins(listed, sensor, device)
    for name, (value, u) in twins.items():
        # The sensor file says what was measured, so that the twins' scatter alone counts. A
        # variance that was measured as negative is none.
        wanted = max(mine[name][0], 0.0)
        assert abs(value - wanted) < SIGMAS * u, name
        # That is closer than 5 % of the part, 10 % of its variance, but for three: columns' PRNU
        # of 0.018 %, to 8 %, and DSNU of pixels and rows, below 0.1 e-, which 50 frames hardly tell
        # from nothing.
        assert SIGMAS * u < 0.1 * wanted or name in ("prnu column", "dsnu pixel", "dsnu row")


@needs_real
@pytest.mark.slow
def test_the_twin_of_real_frames_has_their_histogram_in_the_dark(real_twin):
    _, sheet, _, again = real_twin
    # One right twin in 1000 would fail; noise that is 4 % off fails.
    assert dark_histograms(sheet.dark, again.dark).pvalue > 1e-3


@needs_real
@pytest.mark.slow
def test_real_frames_agree_with_the_reference_implementation():
    pytest.importorskip("emva1288")
    import logging
    import types

    from emva1288.process import data, loader, parser, results, routines

    if not hasattr(np, "asfarray"):  # NumPy 2 no longer has a name that it uses
        routines.np = types.ModuleType("numpy with asfarray")
        routines.np.__dict__.update(np.__dict__)
        routines.np.asfarray = lambda values: np.asarray(values, float)
    quiet = {"loglevel": logging.ERROR}
    parsed = parser.ParseEmvaDescriptorFile(str(REAL / descriptor.NAME), **quiet)
    images = loader.LoadImageData(parsed.images, **quiet)
    theirs = results.Results1288(data.Data1288(images.data, **quiet).data, pixel_area=25.0, **quiet)
    figures = measured(REAL)[1].channels[0].figures
    assert figures["system_gain_dn_per_e"].value == pytest.approx(theirs.K, rel=0.01)
    assert figures["quantum_efficiency"].value == pytest.approx(theirs.QE / 100, rel=0.01)
