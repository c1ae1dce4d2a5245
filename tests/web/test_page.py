"""The page for browsers: what it is made of, and that Chromium reads out the raws that we do."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import chromium

from gpusim.camera import Camera, load_camera
from gpusim.cli import web
from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.isp.pipeline import develop_source
from gpusim.isp.settings import Settings
from gpusim.isp.source import read_source
from gpusim.library.expose import expose
from gpusim.library.light import Light
from gpusim.scene import make_scene
from gpusim.sensor.load import load_sensor
from gpusim.web.bundle import STEPS, bundle, write_page

SWIFTSHADER = ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"]
SEED = 7
ROWS, COLS = 44, 60


@pytest.fixture(scope="module")
def light() -> Light:
    whole = load_camera("mtf-only")
    small = Camera(whole.lens, whole.sensor.roi(ROWS, COLS), "small")
    return expose(small, make_scene("colorchecker"), 1e-2, probes=0)


@pytest.fixture(scope="module")
def folder(light: Light, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the light's page."""
    made = tmp_path_factory.mktemp("page")
    write_page(light, made, SEED)
    return made


@pytest.fixture(scope="module")
def opened(folder: Path) -> Iterator[Callable[[list[str]], Any]]:
    """Return what opens the page in a browser; it is ready then, or says why it cannot be."""
    with chromium() as launch:

        def open_with(arguments: list[str]) -> Any:
            page = launch(*arguments).new_page(viewport={"width": 900, "height": 600})
            page.said = []
            page.on("console", lambda message: page.said.append(message.text))
            page.on("pageerror", lambda error: page.said.append(str(error)))
            page.goto((folder / "index.html").as_uri())
            page.wait_for_function("document.body.dataset.ready", timeout=60_000)
            return page

        yield open_with


@pytest.fixture(scope="module")
def page(opened: Callable[[list[str]], Any]) -> Any:
    """Return the page of the light, open in a browser."""
    return opened(SWIFTSHADER)


def raw_of(page: Any, noise: int, iso: int, exposure: int, frame: int) -> np.ndarray:
    call = f"camera.raw({noise}, {iso}, {exposure}, {frame}).then((raw) => Array.from(raw))"
    return np.array(page.evaluate(call), np.uint16).reshape(ROWS, COLS)


@pytest.mark.parametrize("setting", [(0, 0, 15, 0), (1, 0, 15, 0), (1, 4, 3, 0), (1, 2, 24, 9)])
def test_the_browser_reads_the_raw_out_that_we_do(page: Any, light: Light, setting: tuple):
    """Random numbers are the same on every adapter; what rounds differently may be off by one."""
    noise, iso, exposure, frame = setting
    exposure_s = light.white_exposure_s * 2 ** (STEPS[exposure] / 3)
    speed = light.sensor.analogue_gains[iso].iso
    taken = light.capture(exposure_s, iso=speed, seed=SEED, frame=frame, noise=bool(noise))
    found = raw_of(page, *setting).astype(int)
    differing = found != taken.raw
    assert differing.mean() <= 0.002 and np.abs(found - taken.raw).max() <= 1
    assert np.ptp(found) > 100


def test_another_frame_has_other_noise(page: Any):
    one, other = raw_of(page, 1, 0, 15, 0), raw_of(page, 1, 0, 15, 1)
    assert (one != other).mean() > 0.5


def test_the_browser_develops_the_picture_that_we_do(page: Any, light: Light, tmp_path: Path):
    raw = light.capture(seed=SEED)
    raw.save(tmp_path / "raw.dng")
    settings = Settings(demosaic="malvar")
    ours = develop_source(read_source(tmp_path / "raw.dng"), settings, default_device()).picture
    call = "camera.raw(1, 0, 15, 0).then((raw) => camera.picture(raw))"
    found = page.evaluate(f"{call}.then((made) => [made.width, made.height, ...made.data])")
    picture = np.array(found[2:], np.uint8).reshape(found[1], found[0], 4)
    assert (picture[..., 3] == 255).all() and picture.shape[:2] == ours.shape[:2]
    difference = np.abs(picture[..., :3].astype(int) - ours)
    assert (difference > 0).mean() <= 0.01 and (difference > 1).mean() <= 0.002
    assert np.ptp(ours) > 150


def test_knobs_mouse_and_wheel_change_what_is_shown(page: Any):
    def shown() -> bytes:
        page.wait_for_function("!busy")
        return page.screenshot()

    page.click("#fit")
    first = shown()
    for turn in (
        lambda: page.locator("#exposure").press("ArrowLeft"),
        lambda: page.select_option("#iso", index=3),
        lambda: page.uncheck("#noise"),
        lambda: (page.mouse.move(600, 300), page.mouse.wheel(0, -300)),
        lambda: (page.mouse.down(), page.mouse.move(660, 340), page.mouse.up()),
        lambda: page.click("#fit"),
    ):
        turn()
        page.wait_for_timeout(50)
        before, first = first, shown()
        assert first != before
    assert page.inner_text("#seconds").startswith("1/")
    assert page.inner_text("#said") == "" and page.said == []


def test_a_browser_without_an_adapter_is_told(opened: Callable[[list[str]], Any]):
    page = opened(["--disable-gpu"])
    assert page.evaluate("document.body.dataset.ready") == "no"
    assert "WebGPU" in page.inner_text("#said")


def test_settings_share_programs_and_the_light_is_kept_once(light: Light):
    made = bundle(light, SEED)
    assert len(made["states"]) == 2 and len(made["isos"]) == len(light.sensor.analogue_gains)
    assert len(made["programs"]) == 3  # with noise, without, and the development
    kept = [base64.b64decode(one) for one in made["data"]]
    assert kept.count(np.ascontiguousarray(light.rates).tobytes()) == 1
    states = [one for of_noise in made["states"] for of_iso in of_noise for one in of_iso]
    assert len({one["params"] for one in states}) == len(states)


def test_a_ccd_is_refused(light: Light):
    ccd = load_sensor("kodak-vga")
    with pytest.raises(UserError, match="no one recording") as caught:
        bundle(replace(light, sensor=ccd))
    assert caught.value.allowed == "a CMOS sensor"


def test_a_part_of_a_large_sensor_is_shown(tmp_path: Path):
    assert web.middle(load_sensor("imx477")) == (1548, 1160, 960, 720)
    assert web.middle(load_sensor("arvr-640"))[2:] == (640, 640)
    asked = {"tolerance": "1e-2", "probes": 0, "seed": 0, "show": False}
    with pytest.raises(UserError, match="less than that") as caught:
        web.run("demo", "demo", tmp_path / "out", tile="0,0,2000,1000", **asked)
    assert caught.value.field == "--tile" and not (tmp_path / "out").exists()
