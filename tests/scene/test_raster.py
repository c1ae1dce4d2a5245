"""Placing a raster, low-passing it, and the spline that makes it continuous."""

import numpy as np
import pytest
from harness import assert_close
from scipy.interpolate import BSpline
from scipy.ndimage import correlate1d, map_coordinates

from gpusim.scene import PlacedRaster, Raster, highlights
from gpusim.scene.raster import (
    BAND_ROWS,
    FIT_STEPS,
    FLOOR,
    INTEGRALS,
    REST,
    STRIP_ROWS,
    VALUES,
)

RNG = np.random.default_rng(5)


def raster(rows: int, cols: int) -> Raster:
    return Raster(RNG.uniform(0.5, 1.5, (2, rows, cols)).astype(np.float32))


@pytest.mark.parametrize(("rows", "cols"), [(30, 40), (20, 60), (50, 10), (1, 1)])
def test_a_raster_covers_the_sensor_and_is_centred(rows, cols):
    placed = raster(rows, cols).placed(400.0, 300.0, 1.0)
    width, height = cols * placed.pitch_um, rows * placed.pitch_um
    # One of the two directions fits exactly, the other hangs over.
    assert min(width / 800, height / 600) == pytest.approx(1, rel=1e-12)
    assert (placed.x0_um, placed.y0_um) == pytest.approx((-width / 2, -height / 2), rel=1e-12)
    assert placed.note == f"{cols} x {rows} samples at {placed.pitch_um:.4g} um"


def test_a_raster_no_finer_than_the_grid_keeps_its_samples():
    source = raster(30, 40)
    assert source.placed(400.0, 300.0, 20.0).planes is source.planes


@pytest.mark.parametrize(
    ("rows", "cols", "min_pitch_um"), [(30, 40, 21.0), (30, 40, 47.0), (90, 40, 55.0)]
)
def test_a_finer_raster_is_reduced_to_the_grid_or_just_above(rows, cols, min_pitch_um):
    placed = raster(rows, cols).placed(400.0, 300.0, min_pitch_um)
    _, new_rows, new_cols = placed.planes.shape
    assert min_pitch_um <= placed.pitch_um < min_pitch_um * (1 + 1 / new_cols)
    assert new_cols * placed.pitch_um >= 800 - 1e-9
    assert new_rows * placed.pitch_um >= 600 - 1e-9
    assert (placed.x0_um, placed.y0_um) == pytest.approx(
        (-new_cols * placed.pitch_um / 2, -new_rows * placed.pitch_um / 2), rel=1e-12
    )
    assert "low-passed" in placed.note


def waves(cols: int, pitch_um: float, cycles_um: float, down: bool = False) -> Raster:
    """Return samples of 1 + cos / 2 at the middles of their cells, about the middle."""
    at = (np.arange(cols) + 0.5 - cols / 2) * pitch_um
    wave = 1 + 0.5 * np.cos(2 * np.pi * cycles_um * at + 0.3)
    plane = np.broadcast_to(wave, (96, cols))
    return Raster((plane.T if down else plane)[None].astype(np.float32))


@pytest.mark.parametrize("frequency", [0.1, 0.25, 0.5, 0.8, 1.0])
def test_new_samples_are_integrals_with_a_cubic_spline(frequency):
    # In cycles per new sample: its transform is sinc^4. 8 old samples to a new one.
    placed = waves(1600, 1.0, frequency / 8).placed(800.0, 1.0, 8.0)
    assert placed.pitch_um == 8
    n = np.arange(200)[20:-20] - 99.5
    expected = 1 + 0.5 * np.sinc(frequency) ** 4 * np.cos(2 * np.pi * frequency * n + 0.3)
    # The cells' images lie at 8 k +- f: sinc^4 of 7 or more, 4e-6.
    assert_close(placed.planes[0, 1, 20:-20], expected, atol=1e-5)


# The grid has two samples in a pixel: half its Nyquist frequency is that of the pixels.
@pytest.mark.parametrize("down", [False, True], ids=["across", "down"])
@pytest.mark.parametrize("step", [1.02, 1.3, 2.0, 3.7, 8.0])
def test_reduction_loses_no_contrast_that_pixels_see(step, down):
    width, grid = 160.0, 0.5
    cols = round(width / grid * step)
    for part in (0.2, 0.5, 0.8, 0.95):
        cycles_um = part * 0.5
        source = waves(cols, width / cols, cycles_um, down)
        half = (0.5, width / 2) if down else (width / 2, 0.5)
        placed = source.placed(*half, grid)
        assert placed.pitch_um == pytest.approx(grid, rel=0.04)
        assert placed.integrals
        contrast = []
        for shift in (0.0, 0.125, 0.25, 0.375):
            at = (np.arange(200) - 100) * grid + shift
            along = (at - (placed.y0_um if down else placed.x0_um)) / placed.pitch_um - 0.5
            across = np.full(at.shape, placed.planes.shape[2 if down else 1] // 2, float)
            found = spline(placed, *((across, along) if down else (along, across)))[0]
            turn = 2 * np.pi * cycles_um * at
            design = np.column_stack([np.cos(turn), np.sin(turn), np.ones(len(at))])
            fit = np.linalg.lstsq(design, found, rcond=None)[0]
            contrast.append(2 * (fit[0] - 1j * fit[1]) * np.exp(-0.3j))
        assert abs(np.mean(contrast) - 1) < 2e-3
        # An image of the wave lies 1 / pitch away. On the grid it meets the wave, with a phase that
        # goes round with where the samples lie: B(1 - f) B(f) over the sum of squares, B = sinc^4.
        assert np.abs(np.array(contrast) - 1).max() < 0.012
    # Samples taken for values of the spline lose a tenth and more.
    plain = PlacedRaster(
        placed.planes, placed.pitch_um, placed.x0_um, placed.y0_um, "", integrals=False
    )
    wrong = spline(plain, *((across, along) if down else (along, across)))[0]
    assert np.ptp(wrong) < 0.7 * np.ptp(found)


@pytest.mark.parametrize("frequency", [0.75, 0.8, 1.0, 1.3, 2.2])
def test_what_is_finer_than_the_grid_does_not_come_back(frequency):
    # In cycles per new sample; below 0.75 it comes back above what pixels see.
    placed = waves(3200, 1.0, frequency / 8).placed(1600.0, 1.0, 8.0)
    n = np.arange(400.0)[40:-40]
    found = spline(placed, n, np.ones_like(n))[0]
    # B(f) B(f - k) over the sum of squares, B = sinc^4, and the other images.
    assert np.abs(found - 1).max() < 0.5 * 0.02


def test_a_highlight_in_a_finer_raster_stays_one(monkeypatch):
    monkeypatch.setattr(highlights, "OUTLIER", np.inf)  # it would be held apart
    planes = np.ones((1, 200, 200), np.float32)
    planes[0, 101, 99] = 1e6
    placed = Raster(planes).placed(50.0, 50.0, 1.7)
    coefficients = placed.spline_coefficients()
    assert coefficients.min() >= 0
    rows, cols = placed.planes.shape[1:]
    y, x = np.mgrid[2 : rows - 3 : 0.5, 2 : cols - 3 : 0.5]
    light = spline(placed, x, y)[0]
    assert light.min() >= 0
    middle = np.array([100.0, 100.0]) * 0.5 / placed.pitch_um
    away = np.maximum(np.abs(x - middle[0]), np.abs(y - middle[1]))
    assert np.abs(light[away >= 8] - 1).max() < 0.5
    scale = (placed.pitch_um / 0.5) ** 2
    # Rows that hang over repeat the border.
    total = rows * cols + (1e6 - 1) / scale
    assert coefficients.sum(dtype=np.float64) == pytest.approx(total, rel=1e-5)


def test_reduction_leaves_uniform_light_uniform():
    source = Raster(np.full((1, 33, 47), 0.7, np.float32))
    placed = source.placed(400.0, 300.0, 55.5)
    assert_close(placed.planes, np.full(placed.planes.shape, np.float32(0.7)), rtol=2.0**-22)


def test_reduction_keeps_the_light_of_a_small_source():
    planes = np.zeros((1, 60, 80), np.float32)
    planes[0, 30, 41] = 1000.0
    source = Raster(planes)
    before = source.placed(400.0, 300.0, 1.0)
    after = source.placed(400.0, 300.0, 33.3)
    assert after.planes.sum() * after.pitch_um**2 == pytest.approx(
        1000 * before.pitch_um**2, rel=1e-6
    )  # float32 sums of some ten samples


def calm(rows: int, cols: int) -> PlacedRaster:
    """Return samples of 0.9 to 1.1: interpolation rings by at most 0.1 * 9, not below zero.

    9 is the sum of the interpolation filter's absolute weights, 3 in each direction.
    """
    planes = RNG.uniform(0.9, 1.1, (2, rows, cols)).astype(np.float32)
    return PlacedRaster(planes, 1.0, -cols / 2, -rows / 2, "")


def spline(placed: PlacedRaster, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the radiance at positions in samples, mirrored beyond the first and last."""
    return np.stack(
        [
            map_coordinates(
                plane.astype(np.float64), [y, x], order=3, prefilter=False, mode="mirror"
            )
            for plane in placed.spline_coefficients()
        ]
    )


def test_the_spline_goes_through_the_samples():
    placed = calm(12, 17)
    y, x = np.mgrid[0:12, 0:17].astype(float)
    # float32 coefficients, rounded, that lie between 0 and 2.
    assert_close(spline(placed, x, y), placed.planes, atol=2.0**-23)


def test_coefficients_are_those_of_the_cubic_b_spline():
    placed = calm(12, 17)
    coefficients = placed.spline_coefficients()[0].astype(np.float64)
    basis = BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
    for row, col in [(3, 4), (8, 12)]:
        near = np.nan_to_num(basis(np.arange(-1, 2)))
        block = coefficients[row - 1 : row + 2, col - 1 : col + 2]
        assert near @ block @ near == pytest.approx(placed.planes[0, row, col], abs=1e-6)


@pytest.mark.parametrize("peak", [10.0, 1e6])
def test_a_highlight_makes_no_negative_light_and_no_ghosts(peak):
    planes = np.ones((1, 41, 41), np.float32)
    planes[0, 20, 20] = peak
    placed = PlacedRaster(planes, 1.0, -20.5, -20.5, "")
    coefficients = placed.spline_coefficients()
    assert coefficients.min() >= 0
    y, x = np.mgrid[2:38:0.25, 2:38:0.25]
    light = spline(placed, x, y)[0]
    assert light.min() >= 0
    away = np.maximum(np.abs(x - 20), np.abs(y - 20))
    # A spline with non-negative coefficients cannot fall faster than its own basis function,
    # which reaches 2 samples; at 4, interpolation alone would be off by 0.5 % of the peak.
    assert np.abs(light[away >= 4] - 1).max() < 0.5
    # The narrowest that can be, one coefficient, has 4/9 of itself at its own sample.
    assert light[away == 0][0] >= 4 / 9 * peak * 0.99
    # Each step conserves the sum; float32 rounds what 25 samples near the peak hold.
    assert coefficients.sum(dtype=np.float64) == pytest.approx(peak + 41**2 - 1, rel=1e-6)


def test_zeros_stay_zero():
    placed = PlacedRaster(np.zeros((1, 5, 6), np.float32), 1.0, -3.0, -2.5, "")
    assert_close(placed.spline_coefficients(), np.zeros((1, 5, 6)), atol=0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2), (3, 2)])
def test_small_rasters_have_a_spline(shape):
    placed = raster(*shape).placed(10.0, 10.0, 1.0)
    coefficients = placed.spline_coefficients()
    assert coefficients.shape == placed.planes.shape
    assert np.isfinite(coefficients).all()
    assert coefficients.min() >= 0


def non_negative(samples: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the coefficients of `spline_coefficients`, by matrices and over the whole plane."""
    down, across = (
        correlate1d(np.eye(size), weights, axis=0, mode="mirror") for size in samples.shape
    )
    linear = np.linalg.solve(across, np.linalg.solve(down, samples).T).T
    fit = np.maximum(linear, FLOOR * samples)
    for _ in range(FIT_STEPS):
        value = down @ fit @ across.T
        ratio = np.divide(samples, value, out=np.zeros_like(value), where=value > 0)
        # By the filter, not by its transpose: the same but for what is mirrored.
        fit = fit * (down @ ratio @ across.T)
    return fit


@pytest.mark.parametrize("integrals", [False, True])
@pytest.mark.parametrize("kind", ["rings everywhere", "rings at one place", "black but for it"])
def test_the_fit_is_that_of_the_whole_plane(integrals: bool, kind: str):
    """Rows are fitted in bands, and strips of them where need be: to the rounding of f32."""
    rng = np.random.default_rng(4)
    rows, cols = 2 * BAND_ROWS + 3, 9
    if kind == "rings everywhere":
        planes = rng.uniform(0, 1, (2, rows, cols)) ** 8
    else:
        planes = rng.uniform(0.9, 1.1, (2, rows, cols)) * (kind != "black but for it")
        # Above where strips meet, and below: what the one changes reaches into its neighbour.
        off = 10 if integrals else 4
        for plane, row in zip(planes, (2 * STRIP_ROWS - off, STRIP_ROWS + off), strict=True):
            plane[row, 4] = 3.0
    planes = planes.astype(np.float32)
    found = PlacedRaster(planes, 1.0, 0, 0, "", integrals).spline_coefficients()
    assert found.min() >= 0
    weights = INTEGRALS if integrals else VALUES
    expected = np.stack([non_negative(plane.astype(float), weights) for plane in planes])
    # What is cut off above a band and below it.
    assert_close(found, expected, rtol=2**-23, atol=2 * REST * planes.max())


@pytest.mark.parametrize("integrals", [False, True])
@pytest.mark.parametrize(
    ("rows", "cols"), [(range(0, 9), range(0, 12)), (range(140, 171), range(70, 200))]
)
def test_a_window_has_the_coefficients_of_the_whole(integrals: bool, rows: range, cols: range):
    planes = (RNG.uniform(0, 1, (2, 300, 200)) ** 8).astype(np.float32)  # rings everywhere
    placed = PlacedRaster(planes, 1.0, 0, 0, "", integrals)
    whole = placed.spline_coefficients()[:, rows.start : rows.stop, cols.start : cols.stop]
    found = placed.spline_in(rows, cols)
    assert found.shape == (2, len(rows), len(cols))
    # Rounded to f32 the one, and what is cut off above a window, below and beside it.
    assert_close(found, whole, rtol=2**-23, atol=2 * REST * planes.max())
