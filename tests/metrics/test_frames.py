"""Frames on disk: what is read, what is written, and how the rest is refused."""

from pathlib import Path

import numpy as np
import pytest
from metrics.made import write

from gpusim.errors import UserError
from gpusim.isp.dng import write_dng
from gpusim.metrics import frames
from gpusim.metrics.emva import characterise
from gpusim.metrics.flat_field import Light
from gpusim.sensor.load import load_sensor

WHOLE = [(0.01, 0.0, 2), *((0.01, 400.0 * k, 2) for k in range(1, 24))]


def read(path: Path):
    found = frames.find_frames(path)
    return found, list(frames.measure(found))


@pytest.mark.parametrize("suffix", [".npy", ".tif"])
def test_a_folder_of_frames_is_measured(tmp_path, suffix):
    found, levels = read(write(tmp_path / "cam", WHOLE, suffix))
    assert (found.name, found.sites) == ("cam", ("W",))
    assert [(one.exposure_s, one.photons) for one in levels] == [(a, b) for a, b, _ in WHOLE]
    channel = characterise(levels, found.sites).channels[0]
    assert channel.wavelength_nm == 550
    gain = channel.figures["system_gain_dn_per_e"]
    assert abs(gain.value - 0.8) < 4 * gain.u


def test_the_list_itself_may_be_given(tmp_path):
    folder = write(tmp_path / "cam", WHOLE[:2])
    assert frames.find_frames(folder / "frames.csv").groups == frames.find_frames(folder).groups


def test_the_camera_gives_name_and_pattern(tmp_path):
    camera = {"name": "two colours", "pattern": [["R", "B"]]}
    found, levels = read(write(tmp_path, WHOLE[:2], camera=camera))
    assert (found.name, found.sites) == ("two colours", ("R", "B"))
    assert [site.shape for site in levels[0].sites] == [(24, 10), (24, 10)]


def test_an_irradiance_becomes_photons(tmp_path):
    """R3.1, (4): 50.34 A t lambda E in um^2, ms, um, uW/cm^2."""
    write(tmp_path, [(0.0, 0.0, 2), (0.02, 1.0, 2)], camera={"pixel_pitch_um": 3.0})
    listed = tmp_path / "frames.csv"
    text = listed.read_text().replace("photons", "irradiance_w_m2").replace(",1.0,", ",0.25,")
    listed.write_text(text)
    lit = frames.find_frames(tmp_path).groups
    photons = max(key[1] for key in lit)
    assert photons == pytest.approx(50.34 * 9 * 20 * 0.55 * 25, rel=1e-3)


def test_what_is_kept_is_read_back(tmp_path):
    kept = frames.Kept(tmp_path)
    rng = np.random.default_rng(0)
    lights = [Light(0.01, 0.0, None, 2), Light(0.01, 1 / 3, 530.0, 2)]
    stored = [rng.integers(0, 4096, (16, 16)).astype(np.uint16) for _ in range(4)]
    for number, frame in enumerate(stored):
        kept.frame(lights[number // 2], number, frame)
    kept.close("cam", [["G"]], 1.5)
    found = frames.find_frames(tmp_path)
    assert (found.name, found.sites) == ("cam", ("G",))
    assert list(found.groups) == [(0.01, 0.0, None), (0.01, 1 / 3, 530.0)]
    files = [file for group in found.groups.values() for file in group]
    for file, frame in zip(files, stored, strict=True):
        assert np.array_equal(frames.read_frame(file), frame)


def test_a_dng_is_read_as_its_digital_numbers(tmp_path):
    sensor = load_sensor("imx477").roi(64, 96)
    raw = np.random.default_rng(1).integers(0, 4096, (64, 96)).astype(np.uint16)
    white = {"R": 900.0, "G": 1000.0, "B": 800.0}
    write_dng(tmp_path / "raw.dng", raw, sensor, white_e=white, exposure_s=0.01)
    assert np.array_equal(frames.read_frame(tmp_path / "raw.dng"), raw)


def spoil(folder: Path, old: str, new: str) -> None:
    listed = folder / "frames.csv"
    text = listed.read_text()
    assert old in text
    listed.write_text(text.replace(old, new))


def drop_frame(folder: Path) -> None:
    listed = folder / "frames.csv"
    listed.write_text("".join(listed.read_text().splitlines(keepends=True)[:-1]))


MISTAKES = {
    "no list": (lambda at: (at / "frames.csv").unlink(), "list of frames cannot be read"),
    "no frames": (lambda at: (at / "frames.csv").write_text("file,exposure_s,photons\n"), "there"),
    "empty": (lambda at: (at / "frames.csv").write_text(""), "other columns"),
    "column": (lambda at: spoil(at, "photons", "light"), "other columns"),
    "two lights": (lambda at: spoil(at, "wavelength_nm", "irradiance_w_m2"), "other columns"),
    "too short": (lambda at: spoil(at, "1.npy,0.01,0.0,", "1.npy,0.01"), "more or fewer"),
    "too long": (lambda at: spoil(at, "1.npy,0.01,0.0,", "1.npy,0.01,0,,,"), "more or fewer"),
    "no number": (lambda at: spoil(at, "400.0", "many"), "photons, line 4"),
    "negative": (lambda at: spoil(at, "400.0", "-1"), "photons, line 4"),
    "not a time": (lambda at: spoil(at, "1.npy,0.01", "1.npy,nan"), "exposure_s, line 2"),
    "infinite": (lambda at: spoil(at, "550", "inf"), "wavelength_nm, line 4"),
    "one frame": (drop_frame, "one frame where two are needed"),
    "missing": (lambda at: (at / "2.npy").unlink(), "a frame is missing"),
    "kind": (lambda at: spoil(at, "2.npy", "2.jpg"), "not a kind of file"),
    "broken": (lambda at: (at / "2.npy").write_bytes(b"\x93NUMPY"), "cannot be read"),
    "objects": (
        lambda at: np.save(at / "2.npy", np.array([None]), allow_pickle=True),
        "cannot be read",
    ),
    "floats": (lambda at: np.save(at / "2.npy", np.ones((24, 20))), "digital numbers"),
    "colour": (lambda at: np.save(at / "2.npy", np.ones((24, 20, 3), int)), "digital numbers"),
    "below zero": (lambda at: np.save(at / "2.npy", -np.ones((24, 20), int)), "digital numbers"),
    "size": (lambda at: np.save(at / "2.npy", np.ones((24, 21), int)), "not of one size"),
    "small": (lambda at: np.save(at / "1.npy", np.ones((24, 7), int)), "too small"),
    "camera": (lambda at: (at / "camera.json").write_text("{"), "is not JSON"),
    "camera field": (lambda at: (at / "camera.json").write_text('{"gain": 2}'), "not what a"),
    "pattern": (
        lambda at: (at / "camera.json").write_text('{"pattern": [["R"], ["G", "B"]]}'),
        "filter pattern",
    ),
    "pitch": (lambda at: (at / "camera.json").write_text('{"pixel_pitch_um": 0}'), "pixel pitch"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_clear_error(tmp_path, mistake):
    folder = write(tmp_path / "cam", WHOLE[:2])
    do, words = MISTAKES[mistake]
    do(folder)
    with pytest.raises(UserError) as refused:
        read(folder)
    assert words in refused.value.screen()
    assert refused.value.file is not None


def test_an_irradiance_without_pitch_or_wavelength_is_refused(tmp_path):
    folder = write(tmp_path, WHOLE[:2])
    spoil(folder, "photons", "irradiance_w_m2")
    with pytest.raises(UserError, match="irradiance is not enough"):
        read(folder)


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(UserError, match="no such folder"):
        frames.find_frames(tmp_path / "nowhere")
