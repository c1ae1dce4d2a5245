"""Distortion and lateral colour undone: the stage against its reference, and whole pictures."""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through

from gpusim.gpu import Device
from gpusim.isp import pipeline
from gpusim.isp.colour import response
from gpusim.isp.lens_tags import Optics, colour_shifts, opcodes, warp
from gpusim.isp.pipeline import develop_source
from gpusim.isp.rectify import Rectification, record_rectify
from gpusim.isp.settings import Settings
from gpusim.isp.source import Source
from gpusim.reference.rectify import rectify
from gpusim.sensor.load import load_sensor

BARREL = (0.99, -0.12, 0.02, 0.0, 0.003, -0.002)
PINCUSHION = (1.0, 0.15, 0.0, 0.01, 0.0, 0.0)
OWN = tuple((1.0 + 0.004 * n, -0.08, 0.01, 0.0, 0.0, 0.0) for n in range(3))


def smooth(rows: int, cols: int) -> np.ndarray:
    y, x = np.mgrid[:rows, :cols]
    waves = [np.sin(0.31 * x + 0.2 * n) * np.cos(0.23 * y - 0.4 * n) for n in range(3)]
    return (0.5 + 0.4 * np.stack(waves)).astype(F32)


@pytest.mark.parametrize("maps", [(BARREL,), (PINCUSHION,), OWN])
@pytest.mark.parametrize("shape", [(9, 12), (31, 40)])
def test_planes_are_those_of_the_reference(device: Device, maps: tuple, shape: tuple):
    planes = smooth(*shape)
    made = Rectification(maps, (0.47, 0.55))
    found = through(
        device,
        planes,
        lambda rec, one: record_rectify(rec, one, made, shape, first=(0, 0), rows=(0, shape[0])),
    )
    # Places of up to 40 pixels, some 20 ULP of 40 off, on slopes of 0.3 a pixel; and 16 products.
    assert_close(found, rectify(planes, maps, made.axis), atol=20 * 40 * 0.3 * ULP + 32 * ULP)


def test_a_band_is_that_of_the_whole(device: Device):
    planes, made = smooth(40, 44), Rectification((BARREL,), (0.5, 0.5))
    whole = rectify(planes, made.maps, made.axis)
    first, last = made.rows_for((40, 44), 8, 20)
    assert 0 <= first < last <= 40
    part = np.pad(planes, ((0, 0), (0, 0), (4, 4)), constant_values=np.nan)[:, first:last]
    found = through(
        device,
        np.ascontiguousarray(part),
        lambda rec, one: record_rectify(rec, one, made, (40, 44), first=(first, -4), rows=(8, 12)),
    )
    assert_close(found[..., 4:-4], whole[:, 8:20], atol=20 * 44 * 0.3 * ULP + 32 * ULP)


def test_the_map_of_nothing_changes_nothing(device: Device):
    planes, made = smooth(12, 16), Rectification(((1.0, 0, 0, 0, 0, 0),), (0.5, 0.5))
    found = through(
        device,
        planes,
        lambda rec, one: record_rectify(rec, one, made, (12, 16), first=(0, 0), rows=(0, 12)),
    )
    assert_close(found, planes, atol=20 * 16 * 0.3 * ULP)


def source(light: np.ndarray, **more: object) -> Source:
    codes = np.round(1000 + 60000 * light).astype(np.uint16)
    given = {"neutral": np.ones(3), "matrices": {}} | more
    return Source(codes, None, np.full((1, 1), 1000.0), 60000.0, ("RG", "GB"), **given)


def test_a_bent_picture_is_straight_again_in_one_band_and_in_many(device: Device, monkeypatch):
    """A disc's edge in each colour, laid where a lens with lateral colour lays it."""
    side, made = 160, Rectification(OWN, (0.5, 0.5))
    row, col = np.mgrid[:side, :side].astype(float)
    sites = np.array([["R", "G"], ["G", "B"]])[np.ix_(np.arange(side) % 2, np.arange(side) % 2)]
    unit = made.unit((side, side))
    light = np.zeros((side, side))
    for number, colour in enumerate("RGB"):
        lands = np.hypot(row - 79.5, col - 79.5) / unit
        ideal = np.linspace(0, 1.4, 4000)
        k0, k1, k2, *_ = OWN[number]
        true = np.interp(lands, ideal * (k0 + k1 * ideal**2 + k2 * ideal**4), ideal) * unit
        seen = 0.2 + 0.5 / (1 + np.exp((true - 60) / 2.0))  # an edge at 60 pixels
        light = np.where(sites == colour, seen, light)
    given = source(light, rectification=made)
    settings = Settings(space="linear", rectify=True, demosaic="malvar")
    whole = develop_source(given, settings, device, 16).picture / 65535
    across = whole[80, 80:]
    edges = [np.interp(-0.45, -across[:, number], np.arange(80) + 0.5) for number in range(3)]
    assert_close(np.array(edges), np.full(3, 60.0), atol=0.1)
    # Without it the colours lie apart, and elsewhere.
    bent = develop_source(given, replace_rectify(settings), device, 16).picture[80, 80:] / 65535
    edges = [np.interp(-0.45, -bent[:, number], np.arange(80) + 0.5) for number in range(3)]
    assert max(edges) < 59.5
    assert np.ptp(edges) > 0.4
    monkeypatch.setattr(pipeline, "BAND_PIXELS", 10 * side)
    banded = develop_source(given, settings, device, 16).picture
    assert_close(banded / 65535, whole, atol=2e-4)


def replace_rectify(settings: Settings) -> Settings:
    return settings.model_copy(update={"rectify": False})


def test_what_there_is_no_map_for_is_left_out(device: Device):
    given = source(np.full((24, 24), 0.5))
    asked = Settings(rectify=True)
    assert "nothing" in develop_source(given, asked, device).left_out["rectify"]
    one = Rectification((BARREL,), (0.5, 0.5))
    assert (
        "rectify" not in develop_source(replace(given, rectification=one), asked, device).left_out
    )
    two = Rectification((BARREL, BARREL), (0.5, 0.5))
    left = develop_source(replace(given, rectification=two), asked, device).left_out
    assert "other colours" in left["rectify"]


def test_the_maps_of_a_lens_have_its_lateral_colour():
    sensor = load_sensor("imx477")
    height = np.linspace(0, 3000, 50)
    lines = np.array([400.0, 550.0, 700.0])
    shift = np.array([0.004, 0.0, -0.002])[:, None] * height  # blue lands farther out
    lens = Optics("a lens", 8.0, 2.8, height, height, np.ones(50), lines, shift)
    red, green, blue = colour_shifts(lens, response(sensor.colour_qe))
    assert blue[-1] > green[-1] > red[-1]
    assert blue[-1] == pytest.approx(0.004 * 3000 * (550 - 460) / 150, rel=0.3)
    for one in (red, green, blue):
        k = warp(lens, 3000.0, one)
        assert_close(k[0], 1 + one[-1] / 3000, atol=1e-9)
    mono = colour_shifts(lens, response(load_sensor("imx249-mono").colour_qe))
    assert mono.shape == (1, 50)


def test_unlike_greens_are_one_colour_of_the_maps():
    sensor = load_sensor("eqe-sample")
    assert {"Gr", "Gb"} <= set(sensor.channels)
    height, lines = np.linspace(0, 1800, 20), np.array([400.0, 700.0])
    shift = np.array([0.002, -0.002])[:, None] * height
    lens = Optics("a lens", 8.0, 2.8, height, height, np.ones(20), lines, shift)
    red, green, blue = colour_shifts(lens, response(sensor.colour_qe))
    assert blue[-1] > green[-1] > red[-1]
    whole = (0, 0, sensor.rows, sensor.cols)
    assert len(opcodes(lens, sensor, whole)) > len(opcodes(lens, load_sensor("imx249-mono"), whole))
