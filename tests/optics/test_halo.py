"""The halo stage: coarse light at photosites, whatever the rectangle."""

from __future__ import annotations

import numpy as np
import pytest
from harness import assert_close
from optics.made import sensor

from gpusim.gpu import Device, Recording
from gpusim.optics.halo import (
    PREFILTER,
    CoarseGrid,
    Halo,
    coarse_grid,
    coefficients,
    interpolated,
    needed,
    wanted,
)
from gpusim.reference.halo import halo

EPSILON = 2.0**-24


class Level:
    """What a coarse grid asks of a level."""

    def __init__(self, pitch_um: float, share: float = 1e-3) -> None:
        self.pitch_um = pitch_um
        self.psf = np.full((1, 1, 8, 8), share / 64)


def made(
    pitches: tuple[float, ...] = (4.0,), rows: int = 60, cols: int = 80
) -> tuple[object, list[CoarseGrid], list[np.ndarray]]:
    camera = sensor(rows, cols)
    grids = [coarse_grid(Level(pitch), camera) for pitch in pitches]
    rng = np.random.default_rng(5)
    # Smooth light: a coarse grid carries no other.
    light = []
    for grid in grids:
        y, x = np.indices((grid.sensor.rows, grid.sensor.cols))
        waves = [
            1 + 0.5 * np.cos(0.3 * x + a) * np.sin(0.2 * y + b)
            for a, b in rng.uniform(0, 6, (len(camera.channels), 2))
        ]
        light.append(np.stack(waves).astype(np.float32))
    return camera, grids, light


@pytest.mark.parametrize(
    ("edges", "first", "share", "samples"),
    [
        (True, True, 1e-3, 4),
        (True, False, 0.02, 2),
        (False, True, 1e-3, 2),
        (False, False, 1e-3, 1),
    ],
    ids=["smooth", "structured", "photograph", "photograph, far out"],
)
def test_coarse_pixels_are_as_far_apart_as_the_light_allows(edges, first, share, samples):
    grid = coarse_grid(Level(16.0, share), sensor(60, 80), edges, first)
    assert grid.sensor.pixel_pitch_um == samples * 16.0


def test_coefficients_are_those_of_the_spline_through_the_samples():
    # What lies beyond FADED samples is 3^1/2 0.268^9 / (1 - 0.268) = 2e-5 of the light.
    _, (grid,), (light,) = made()
    whole = (0, 0, grid.sensor.rows, grid.sensor.cols)
    splines = coefficients(light, whole, whole)
    y, x = np.arange(9.0, grid.sensor.rows - 9), np.arange(9.0, grid.sensor.cols - 9)
    found = interpolated(splines, (0, 0), y, x)
    assert PREFILTER.sum() == pytest.approx(1)
    assert_close(found, light[:, 9:-9, 9:-9], atol=4 * 2e-5)


@pytest.mark.parametrize("pitches", [(4.0,), (4.0, 32.0, 256.0)])
def test_the_light_at_photosites_is_that_of_the_splines(device: Device, pitches: tuple[float, ...]):
    camera, grids, light = made(pitches)
    rect = (0, 0, camera.rows, camera.cols)
    parts = [
        one[:, row : row + rows, col : col + cols]
        for one, (row, col, rows, cols) in zip(light, needed(grids, rect), strict=True)
    ]
    found = rates(device, camera, Halo(device, camera, grids, parts, rect), rect)
    pattern = np.array(camera.cfa.pattern)
    for (row, col), name in np.ndenumerate(pattern):
        channel = camera.channels.index(name)
        y, x = np.meshgrid(
            np.arange(row, camera.rows, 2), np.arange(col, camera.cols, 2), indexing="ij"
        )
        expected = 0.0
        for grid, one in zip(grids, light, strict=True):
            whole = (0, 0, grid.sensor.rows, grid.sensor.cols)
            splines = coefficients(one, whole, whole)
            at = (
                side.ravel() * grid.step + offset
                for side, offset in zip((x, y), grid.offset, strict=True)
            )
            expected = expected + halo(splines, *at)[channel].reshape(x.shape)
        # Coordinates below 64 in f32 are off by 2^-19, where the light's slope is 0.3 a sample; 16
        # products. Coarser levels come by the spline of the finest grid through their splines,
        # whose waves of 0.05 rad a sample and less it bends by less than 1e-6.
        atol = 3 * 2**-19 + 40 * EPSILON + (2e-4 if len(grids) > 1 else 0.0)
        assert_close(found[2 * row + col], expected, atol=atol)


def rates(device: Device, camera: object, stage: Halo, rect: tuple[int, int, int, int]):
    _, _, rows, cols = rect
    rec = Recording(device)
    planes = rec.buffer("rates", (4, rows // 2, cols // 2), "f4")
    rec.clear(planes)
    stage.record(rec, planes, rect)
    rec.download(planes)
    return rec.run()["rates"]


def test_a_rectangle_has_the_bits_of_the_whole(device: Device):
    camera, grids, light = made((4.0, 32.0))
    whole = (0, 0, camera.rows, camera.cols)
    part = (14, 22, 20, 30)
    found = []
    for rect in (whole, part):
        parts = [
            one[:, row : row + rows, col : col + cols]
            for one, (row, col, rows, cols) in zip(light, needed(grids, rect), strict=True)
        ]
        stage = Halo(device, camera, grids, parts, rect)
        assert stage.covers(part) and stage.covers(whole) == (rect == whole)
        found.append(rates(device, camera, stage, rect))
        stage.release()
    np.testing.assert_array_equal(found[0][:, 7:17, 11:26], found[1])


def test_coarse_pixels_lie_about_the_same_axis():
    camera, grids, _ = made((4.0, 32.0, 256.0))
    for grid in grids:
        middle = np.array([(camera.cols - 1) / 2, (camera.rows - 1) / 2])
        np.testing.assert_allclose(
            middle * grid.step + grid.offset,
            [(grid.sensor.cols - 1) / 2, (grid.sensor.rows - 1) / 2],
        )
        assert len(wanted(grids, (0, 0, camera.rows, camera.cols))) == 3
        area = grid.sensor.fill_factor * grid.sensor.pixel_pitch_um**2
        assert area == pytest.approx(camera.fill_factor * camera.pixel_pitch_um**2)
