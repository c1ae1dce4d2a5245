"""One light, read as often as asked: what a render makes, and nothing of the optics again."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from optics.made import StubCamera, bank, monochrome, scene, sensor, shapes

from gpusim.errors import UserError
from gpusim.library import burst as bursts
from gpusim.library.camera import Camera
from gpusim.library.expose import expose, lit
from gpusim.library.light import Light
from gpusim.library.scene import Scene
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.render.checks import rectangle
from gpusim.scene.exr import units_of
from gpusim.sensor.adc_model import ColumnOffset, DualGain, GainStep, Linearity
from gpusim.sensor.crosstalk_model import Crosstalk, Kernels
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.frame import Border, Overscan
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.smear_model import Smear

LENS = bank(coma_um=0.6, falloff=0.1)
EXPOSURE_S, SEED = 0.02, 11
NEAR = [[0.0, 0.02, 0.0], [0.03, 0.9, 0.03], [0.0, 0.02, 0.0]]
STEPS = (GainStep(gain=1.0, iso=100), GainStep(gain=4.0, iso=400, temporal_dark_noise_e=1.2))
SENSORS = {
    "Bayer": sensor(32, 40, veiling_glare=0.02, analogue_gains=STEPS),
    "monochrome": monochrome(32, 40, lines=LineNoise(row_noise_e=2.0)),
    "border, cross-talk": sensor(
        32,
        40,
        optical_black=Border(top=4, left=6),
        crosstalk=Crosstalk(optical=Kernels({"*": NEAR}), electrical=Kernels({"*": NEAR})),
        column_offset=ColumnOffset(sigma_dn=8.0),
        linearity=Linearity(electrons=[0, 100, 9000], read_e=[0, 110, 8800]),
    ),
    "two gains": sensor(
        32,
        40,
        dual_gain=DualGain(
            system_gain_dn_per_e=0.04,
            temporal_dark_noise_e=12.0,
            black_level_dn=200.0,
            switch_dn=3800,
        ),
        analogue_gains=(),
        full_well_e=85_000.0,
    ),
    "CCD": sensor(
        32,
        40,
        overscan=Overscan(rows=3, cols=5),
        smear=Smear(kind="frame_transfer", row_s=1e-5),
        parallel_cti=Cti(inefficiency=1e-3),
        serial_cti=Cti(inefficiency=1e-3),
    ),
}


def light_of(made: Sensor, tile: tuple | None = None, probes: int = 0) -> tuple[Light, Renderer]:
    renderer = Renderer(StubCamera(LENS, made), scene(shapes()), Accuracy(1e-2, probes))
    return lit(renderer, rectangle(tile, made)), renderer


@pytest.fixture(scope="module")
def bayer() -> Light:
    light, renderer = light_of(SENSORS["Bayer"], probes=16)
    renderer.release()
    return light


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("tile", [None, (7, 5, 20, 16)])
def test_a_frame_of_the_light_is_the_render_byte_for_byte(name: str, tile: tuple | None):
    light, renderer = light_of(SENSORS[name], tile)
    rendered = renderer.capture(
        EXPOSURE_S, seed=SEED, frame=3, temperature_c=35.0, tile=tile, keep=("electrons",)
    )
    renderer.release()
    frame = light.capture(EXPOSURE_S, seed=SEED, frame=3, temperature_c=35.0)
    assert frame.raw.tobytes() == rendered.raw.tobytes() and rendered.raw.std() > 10
    assert frame.electrons.tobytes() == rendered.electrons.tobytes()
    assert frame.areas == rendered.areas


def test_the_certificate_is_there_and_met(bayer: Light):
    assert bayer.certificate.met and bayer.certificate.probes == 16
    assert bayer.capture().certificate is bayer.certificate
    assert "(met)" in repr(bayer)


@pytest.mark.parametrize("name", ["Bayer", "border, cross-talk", "CCD"])
def test_a_burst_is_its_frames_taken_one_by_one(name: str):
    light, renderer = light_of(SENSORS[name])
    renderer.release()
    burst = light.burst(5, [0.01, 0.02], seed=SEED)
    assert burst.exposure_s.tolist() == [0.01, 0.02, 0.01, 0.02, 0.01]
    for number, exposure_s in enumerate(burst.exposure_s):
        alone = light.capture(exposure_s, seed=SEED, frame=number)
        assert burst[number].raw.tobytes() == alone.raw.tobytes()
    assert len(list(burst)) == len(burst) == 5


def test_frames_of_a_burst_have_noise_of_their_own(bayer: Light):
    burst = bayer.burst(4, EXPOSURE_S, seed=1)
    noise = burst.raw - burst.raw.mean(axis=0)
    found = np.corrcoef(noise.reshape(4, -1))
    # Less its mean over 4 frames, independent noise correlates by -1/3; 1280 pixels: +- 0.03.
    assert np.abs(found[~np.eye(4, dtype=bool)] + 1 / 3).max() < 0.15


def test_a_bracket_of_gains_comes_in_turns(bayer: Light):
    burst = bayer.burst(4, EXPOSURE_S, iso=[100, 400], seed=SEED)
    assert [one.iso for one in burst] == [100, 400, 100, 400]
    alone = bayer.capture(EXPOSURE_S, iso=400, seed=SEED, frame=1)
    assert burst[1].raw.tobytes() == alone.raw.tobytes()
    signal = [one.raw.mean() - bayer.sensor.black_level_dn for one in burst]
    assert signal[1] / signal[0] == pytest.approx(4, rel=0.02)


@pytest.mark.parametrize("name", ["Bayer", "border, cross-talk", "two gains"])
def test_the_truth_is_the_mean_of_many_frames(name: str):
    """Within 5 standard errors of 64 frames everywhere, fixed patterns left out."""
    quiet = {"dsnu_e": 0.0, "prnu_percent": 0.0, "column_offset": None, "dcnu_percent": 0.0}
    light, renderer = light_of(SENSORS[name].model_copy(update=quiet))
    renderer.release()
    burst = light.burst(64, EXPOSURE_S, seed=SEED, truth=True)
    spread = burst.raw.std(axis=0, ddof=1)
    # Rounding adds up to 0.5 DN where the noise is less than a code.
    allowed = 5 * spread / np.sqrt(64) + 0.05
    error = np.abs(burst.raw.mean(axis=0) - burst.truth_dn[0])
    inside = (burst.truth_dn[0] > 20) & (burst.truth_dn[0] < 0.9 * light.sensor.raw_max_dn)
    assert inside.mean() > 0.5
    # A few pixels of two merged reads lie beside the switch, where the codes' noise changes.
    assert (error <= allowed)[inside].mean() > 0.995


def test_a_light_outlives_its_file_and_its_process(bayer: Light, tmp_path: Path):
    raw = bayer.capture(EXPOSURE_S, seed=SEED).raw.tobytes()
    bayer.save(tmp_path / "light.npz")
    loaded = Light.load(tmp_path / "light.npz")
    assert loaded.capture(EXPOSURE_S, seed=SEED).raw.tobytes() == raw
    assert loaded.certificate == bayer.certificate and repr(loaded) == repr(bayer)
    pickled = pickle.loads(pickle.dumps(bayer))
    assert pickled.capture(EXPOSURE_S, seed=SEED).raw.tobytes() == raw


@pytest.mark.parametrize(
    "name, content",
    [
        ("none.npz", None),
        ("text.npz", b"hello"),
        ("empty.npz", b""),
    ],
)
def test_what_is_no_light_is_refused(tmp_path: Path, name: str, content: bytes | None):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError) as error:
        Light.load(path)
    assert error.value.file == path and "Light.save" in error.value.allowed


def test_a_light_with_a_part_missing_is_refused(bayer: Light, tmp_path: Path):
    path = tmp_path / "light.npz"
    bayer.save(path)
    arrays = dict(np.load(path))
    del arrays["glare"]
    np.savez(path, **arrays)
    with pytest.raises(UserError, match="glare"):
        Light.load(path)


DEEP = "[" * 100_000 + "]" * 100_000


@pytest.mark.parametrize("changed", [DEEP, '{"kind": 1', "[1]", '{"kind": "gpusim light 2"}'])
def test_a_light_whose_account_is_none_is_refused(bayer: Light, tmp_path: Path, changed: str):
    path = tmp_path / "light.npz"
    bayer.save(path)
    facts = np.frombuffer(changed.encode(), np.uint8)
    np.savez(path, **dict(np.load(path)) | {"facts": facts})
    with pytest.raises(UserError) as caught:
        Light.load(path)
    assert caught.value.file == path


def test_another_sensor_reads_it_if_its_pixels_see_the_same(bayer: Light):
    noisy = bayer.sensor.model_copy(update={"temporal_dark_noise_e": 50.0})
    quiet, loud = (
        one.capture(1e-6, seed=SEED).raw.std() for one in (bayer, bayer.at(sensor=noisy))
    )
    assert loud > 5 * quiet
    with pytest.raises(UserError, match="other pixels") as error:
        bayer.at(sensor=bayer.sensor.model_copy(update={"fill_factor": 0.5}))
    assert error.value.field == "sensor.fill_factor"


@pytest.mark.parametrize(
    "changes, field",
    [
        ({"exposure_s": 0.0}, "exposure"),
        ({"exposure_s": float("nan")}, "exposure"),
        ({"seed": -1}, "seed"),
        ({"frame": 2**32}, "frame"),
        ({"iso": 123}, "iso"),
        ({"iso": 100, "gain": 1.0}, "iso"),
        ({"temperature_c": -300.0}, "temperature_c"),
        ({"exposure_s": "1/60"}, "exposure"),
        ({"seed": 1.5}, "seed"),
        ({"frame": 0.5}, "frame"),
    ],
)
def test_what_cannot_be_taken_is_refused(bayer: Light, changes: dict, field: str):
    with pytest.raises(UserError) as error:
        bayer.capture(**changes)
    assert error.value.field == field
    if "frame" not in changes:
        with pytest.raises(UserError):
            bayer.burst(0 if not changes else 1, **changes if "gain" not in changes else {"iso": 1})


@pytest.mark.parametrize(
    "given, field",
    [
        ({"count": 2.5}, "count"),
        ({"count": 2, "exposure_s": "1/60"}, "exposure_s"),
        ({"count": 2, "exposure_s": []}, "exposure_s"),
        ({"count": 2, "iso": "100"}, "iso"),
    ],
)
def test_a_burst_that_cannot_be_taken_is_refused(bayer: Light, given: dict, field: str):
    with pytest.raises(UserError) as error:
        bayer.burst(**given)
    assert error.value.field == field


def test_a_folder_that_is_not_there_is_told(bayer: Light, tmp_path: Path):
    for name in ("a.png", "a.npz", "a.exr", "a.dng"):
        with pytest.raises(UserError) as error:
            bayer.capture(EXPOSURE_S).save(tmp_path / "none" / name)
        assert error.value.file == tmp_path / "none" / name


@pytest.mark.parametrize(
    "changes, field",
    [
        ({"camera": "phone"}, "camera"),
        ({"scene": "colorchecker"}, "scene"),
        ({"probes": 1.5}, "probes"),
        ({"tile": (0, 0, 9)}, "tile"),
        ({"exposure_s": 0.0}, "exposure_s"),
    ],
)
def test_what_is_no_camera_and_no_scene_is_refused(changes: dict, field: str):
    given = {"camera": Camera.load("mtf-only"), "scene": Scene.load("colorchecker")}
    with pytest.raises(UserError) as error:
        expose(**(given | changes))
    assert error.value.field == field
    with pytest.raises(UserError, match="not a camera"):
        expose(given["scene"], given["camera"])


def test_a_frame_is_written_as_its_suffix_says(bayer: Light, tmp_path: Path):
    frame = bayer.capture(EXPOSURE_S, seed=SEED)
    for name in ("a.dng", "a.png", "a.jpg", "a.exr", "a.npz"):
        frame.save(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 500
    assert units_of(tmp_path / "a.exr") == "e-"
    held = np.load(tmp_path / "a.npz")
    assert (held["raw"] == frame.raw).all() and held["truth_dn"].shape == frame.raw.shape
    with pytest.raises(UserError, match=r"\.dng, \.tif"):
        frame.save(tmp_path / "a.gif")
    assert frame.develop().size == (40, 32)
    shown = frame._repr_html_()
    assert "data:image/png" in shown and "<svg" in shown and "total RMS" in shown


def test_the_histogram_counts_every_lit_pixel_in_its_colour(bayer: Light):
    edges, counts = bayer.capture(EXPOSURE_S, seed=SEED).histogram()
    assert {letter: int(one.sum()) for letter, one in counts.items()} == {
        "R": 320,
        "G": 640,
        "B": 320,
    }
    assert edges[0] == 0 and edges[-1] == bayer.sensor.raw_max_dn + 1


def test_saturated_pixels_are_told(bayer: Light):
    assert not bayer.capture(1e-5, seed=SEED).saturated.any()
    assert bayer.capture(1e3, seed=SEED).saturated.mean() > 0.9


def test_frames_in_one_recording_are_those_one_by_one(bayer: Light, monkeypatch):
    together = bayer.burst(7, EXPOSURE_S, seed=SEED).raw
    monkeypatch.setattr(bursts, "TOGETHER", 1)
    assert together.tobytes() == bayer.burst(7, EXPOSURE_S, seed=SEED).raw.tobytes()


def test_frames_that_are_read_together_are_those_one_by_one(bayer: Light):
    """Steps of the gain share the mean charge, other exposures and other sensors have their own."""
    warm = bayer.sensor.model_copy(update={"dark_current_e_per_s": 500.0})
    lights = [bayer, bayer.at(iso=400), bayer.at(sensor=warm), bayer]
    times = [EXPOSURE_S, EXPOSURE_S, EXPOSURE_S, 2 * EXPOSURE_S]
    shots = [one.shot(time, SEED) for one, time in zip(lights, times, strict=True)]
    for found, light, shot in zip(
        bursts.read_frames(list(zip(lights, shots, strict=True))), lights, shots, strict=True
    ):
        alone = light.capture(shot.exposure_s, seed=SEED)
        assert found.raw.dtype == alone.raw.dtype == np.uint16
        assert found.raw.tobytes() == alone.raw.tobytes()
    assert bayer.sensor.collects_as(lights[1].sensor) and not bayer.sensor.collects_as(warm)


def test_a_light_that_errs_shows_in_the_frame(bayer: Light):
    """A planted error of 1 % in one plane is seen: the read-out takes the planes it is given."""
    wrong = bayer.rates.copy()
    wrong[0] *= 1.01
    found = replace(bayer, rates=wrong).capture(0.05, noise=False).electrons
    right = bayer.capture(0.05, noise=False).electrons
    ratio = found[0::2, 0::2].sum() / right[0::2, 0::2].sum()
    assert ratio == pytest.approx(1.01, abs=2e-3) and (found[1::2] == right[1::2]).all()
