"""Point sources: against reference and exact model, for highlights of any place, size and colour.

Tolerance of the shader. A coordinate has 8 roundings of at most |axis| times the distance, here
32 samples; the splines' gradient is at most 1.5 C along each axis, C the largest coefficient (see
test_warp). Two weights of 5 roundings a product, 16 + 4 + 4 sums: 36 of C. Coefficients of colours
and shares add up to 1 here, or are counted; N highlights are added one after another.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft
from harness import assert_close, run_stage
from optics.lamps import LENS, PITCH, PLACES, SPECTRA
from optics.made import ULP, bank, monochrome, plane_bank, sensor
from scipy.interpolate import BSpline
from scipy.special import j1

from gpusim.gpu import Device, Kernel
from gpusim.optics import highlight_plan
from gpusim.optics import point_sources as module
from gpusim.optics.highlight_plan import BUNDLE, CHANGE, groups, plan_highlights
from gpusim.optics.highlight_squares import (
    bundled,
    largest_um,
    of_few_spectra,
    real_points,
    squares_on_sensor,
)
from gpusim.optics.highlight_tables import (
    Tables,
    boxes,
    distinct,
    mixing_errors,
    mixture,
    turned,
)
from gpusim.optics.point_sources import (
    HIGHLIGHT,
    PointSources,
    in_fours,
    lists,
)
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.reference.exact_model import ExactCore
from gpusim.reference.point_sources import point_sources
from gpusim.scene.highlights import Highlights
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.aperture import Aperture, Part
from gpusim.sensor.cfa import ColourFilterArray

F32 = np.float32


def of_highlights(device: Device, *given: object) -> PointSources:
    """Return the stage of what `plan_highlights` plans."""
    return PointSources(device, plan_highlights(*given))


def random_case(period, spectra, count, rect, seed=0):
    """Return the shader's output, the reference's, and the tolerance, for one rectangle of cells.

    `rect` = (first column, first row, columns, rows), of a sensor of 40 x 50 cells.
    """
    rng = np.random.default_rng(seed)
    channels, stages = min(period**2, 3), 6
    near_side, far_side, step = 36, 36, 2

    def made(side: int, radius: float) -> np.ndarray:
        result = np.zeros((stages, channels, spectra, side, side))
        at = np.arange(side) - side // 2
        inside = np.hypot(at, at[:, None]) < radius
        # Some cubics between fields are below 0, and so may be a highlight's light.
        lit = rng.uniform(-0.2, 1, (stages, channels, spectra, int(inside.sum())))
        result[..., inside] = lit * rng.choice([1, -1], (stages, 1, 1, 1), p=[0.8, 0.2])
        return result

    # Near ones count out to 13 samples; light ends at 26 and is blurred by two far samples.
    fine, coarse = made(near_side, 17), made(far_side, 13)
    kernels = np.concatenate([one.reshape(*one.shape[:3], -1) for one in (fine, coarse)], axis=-1)
    site_channels = rng.integers(0, channels, period**2)
    words = [0, 0, 0, 0]
    for site, channel in enumerate(site_channels):
        words[site // 8] |= int(channel) << (4 * (site % 8))
    rows = np.zeros(count, HIGHLIGHT)
    rows["pixel"] = rng.integers(-4, 40 * period, (count, 2))
    rows["place"] = rng.uniform(-0.5, 0.5, (count, 2))
    angle = rng.uniform(0, 2 * np.pi, count)
    rows["axis"] = 3.1 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows["kernel"] = rng.integers(0, stages, count)
    colours = rng.uniform(0, 9, (count, spectra)).astype(F32)
    centres = rows["pixel"] + 0.5 + rows["place"].astype(float)
    across, down = -(-50 // 16), -(-40 // 16)
    starts, near = lists(centres / period, 31 / 3.1 / period, (across, down))
    x0, y0, cols, lines = rect
    # Which spline a pixel takes must not hang on a rounding: where no pixel's distance is.
    corners = np.stack(np.meshgrid(np.arange(50 * period), np.arange(40 * period)), axis=-1) + 0.5
    apart = 3.1 * np.linalg.norm(corners.reshape(-1, 1, 2) - centres, axis=-1)
    between = np.sort(apart[(apart > 12.9) & (apart < 13.1)])
    gap = int(np.argmax(np.diff(between)))
    radius = between[gap : gap + 2].mean()
    before = rng.uniform(0, 5, (period**2, lines, cols)).astype(F32)
    first = (x0 // 16, y0 // 16)
    found = run_stage(
        "optics/point_sources",
        ((x0 + cols - 1) // 16 - first[0] + 1, (y0 + lines - 1) // 16 - first[1] + 1, period**2),
        {
            "first": first,
            "origin": (x0, y0),
            "size": (cols, lines),
            "across": across,
            "reach2": 31.0**2,
            "near2": radius**2,
            "step": step,
            "fours": -(-spectra // 4),
            "site_channels": words,
        },
        {
            "highlights": rows.view(np.uint32),
            "radiance": in_fours(colours),
            "starts": starts,
            "near": near,
            "kernels": np.moveaxis(in_fours(np.moveaxis(kernels, 2, -1)), -2, 2).copy(),
            "rates": before,
        },
        {"rates": (before.shape, F32)},
        S=period**2,
        PERIOD=period,
        C=channels,
        NEAR=near_side,
        FAR=far_side,
    )["rates"]
    site, y, x = np.indices(before.shape)
    pixels = np.stack(
        [(x + x0) * period + site % period, (y + y0) * period + site // period], axis=-1
    )
    expected = before + point_sources(
        pixels.reshape(-1, 2) + 0.5,
        site_channels[site].ravel(),
        centres=centres,
        axes=rows["axis"].astype(float),
        radiance=colours,
        near=list(fine.astype(F32)[rows["kernel"]]),
        far=list(coarse.astype(F32)[rows["kernel"]]),
        radius=radius,
        step=step,
    ).reshape(before.shape)
    amount = colours.sum(axis=1).max()
    each = 2 * 1.5 * 8 * 32 + 36
    # Four highlights at most lie over one pixel with all their weight; of others their sums.
    atol = ULP * (each * 4 * amount + count * expected.max())
    return found, expected, atol, before


@pytest.mark.parametrize("spectra", [1, 3, 5])
@pytest.mark.parametrize(
    ("period", "rect"),
    [
        (1, (0, 0, 50, 40)),
        (2, (0, 0, 50, 40)),
        (4, (0, 0, 50, 40)),
        (2, (17, 5, 3, 31)),
        (2, (15, 16, 18, 1)),
        (2, (49, 39, 1, 1)),
    ],
)
def test_pixels_get_what_the_reference_gives(period, rect, spectra):
    found, expected, atol, before = random_case(period, spectra, 40, rect)
    assert_close(found, expected, atol=atol)
    if rect[2] == 50:
        assert (found > before + 100 * atol).mean() > 0.1
        assert (found == before).mean() > 0.05  # nothing comes from out of reach


def test_a_rectangle_of_the_frame_has_the_same_bits():
    whole = random_case(2, 3, 60, (0, 0, 50, 40))
    x0, y0, cols, rows = 13, 7, 20, 30
    part = random_case(2, 3, 60, (x0, y0, cols, rows))
    place = np.s_[:, y0 : y0 + rows, x0 : x0 + cols]
    # What is already there differs; the sums that are added do not.
    assert_close(part[1] - part[3], (whole[1] - whole[3])[place], atol=1e-9)
    dark = whole[0].astype(float) - whole[3]
    assert_close(
        (part[0].astype(float) - part[3]),
        dark[place],
        atol=2 * ULP * max(whole[0].max(), part[0].max()),
    )


# Host


def on_sensor(device, camera, highlights, lens=LENS, tolerance=1e-3, rects=None) -> np.ndarray:
    """Return electrons/s of each pixel by the highlights alone."""
    stage = of_highlights(device, lens, camera, highlights, SPECTRA, tolerance)
    period = camera.period[0]
    frame = np.full((camera.rows, camera.cols), np.nan, F32)
    tiles = rects or [(0, 0, camera.rows, camera.cols)]
    for (row, col, rows, cols), planes in zip(tiles, stage.light(tiles), strict=True):
        for site in range(period**2):
            part = frame[row : row + rows, col : col + cols]
            part = part[site // period :: period, site % period :: period]
            part[...] = planes[site][: part.shape[0], : part.shape[1]]
    return frame


def around(camera, lens, place, steps=(-9, -4, -1, 0, 2, 5)) -> np.ndarray:
    """Return pixels (P, 2), row and column, around where an ideal point lands."""
    height = np.hypot(*place)
    real = place * lens.real_from_ideal(height)[0] / height
    col, row = np.floor(real / PITCH + [camera.cols / 2, camera.rows / 2]).astype(int)
    return np.array([[row + dy, col + dx] for dy in steps for dx in (-6, 0, 1, 7)])


@pytest.mark.parametrize("place", PLACES)
def test_a_highlight_lights_pixels_as_in_the_exact_model(device: Device, place):
    """In every quadrant and on the axis: turned with the azimuth, displaced by lateral colour."""
    camera = sensor()
    one = Highlights(place[None], PITCH, np.array([[1e9, 2e9, 0.5e9]]))
    pixels = around(camera, LENS, place)
    exact = ExactCore(LENS, camera, SPECTRA, WAVELENGTHS_NM)
    expected = exact.highlights(one, pixels)
    found = on_sensor(device, camera, one)[pixels[:, 0], pixels[:, 1]].astype(float)
    # Angles 11 degrees apart: 1e-3 next to the highlight. Splines between samples half a sigma
    # apart: see reference/test_exact_model. The PSF is taken as one over the square.
    assert_close(found, expected, rtol=5e-3, atol=2e-4 * expected.max())
    if np.hypot(*place) > 10:
        other = exact.highlights(
            Highlights(place[None] * [1, -1], PITCH, one.excess),
            np.stack([camera.rows - 1 - pixels[:, 0], pixels[:, 1]], axis=1),
        )
        assert np.ptp(other / expected) > 0.1 or np.allclose(other, expected, rtol=0.05)


@pytest.mark.parametrize("place", PLACES[[0, 2]])
def test_an_aperture_that_is_no_square_sees_highlights_as_in_the_exact_model(device: Device, place):
    """An L that moves over the image: the same only after a whole turn of the azimuth."""
    moved = l_shaped()
    shape = moved["aperture"]
    camera = sensor(**moved)
    one = Highlights(place[None], PITCH, np.array([[1e9, 2e9, 0.5e9]]))
    pixels = around(camera, LENS, place)
    expected = ExactCore(LENS, camera, SPECTRA, WAVELENGTHS_NM).highlights(one, pixels)
    found = on_sensor(device, camera, one)[pixels[:, 0], pixels[:, 1]].astype(float)
    # As for the square, but steps of the angle turn an L, not only its corners: twice as much.
    assert_close(found, expected, rtol=1e-2, atol=4e-4 * expected.max())
    square = sensor(fill_factor=shape.area)
    other = ExactCore(LENS, square, SPECTRA, WAVELENGTHS_NM).highlights(one, pixels)
    assert np.abs(other - expected).max() > 0.05 * expected.max()  # the control


@pytest.mark.parametrize("fine", [1, 2])
def test_points_behind_a_sharp_lens_are_right_relative_to_themselves(
    device: Device, monkeypatch, fine
):
    """Airy's pattern at f/2.8: its rings hold 0.42 cycles a sample, which cubics miss."""
    monkeypatch.setattr(highlight_plan, "FINE", fine)
    camera, soft = monochrome(), bank(coma_um=0.0, size=64)
    at = (np.arange(64) - 32) * soft.pitch_um
    phase = 1e3 * np.pi / 2.8 * np.hypot(at, at[:, None]) / soft.wavelengths_nm[:, None, None]
    rings = (2 * j1(phase) / np.where(phase > 0, phase, 1)) ** 2
    rings[:, 32, 32] = 1.0
    rings /= rings.sum(axis=(1, 2), keepdims=True)
    lens = replace(soft, psf=np.broadcast_to(rings, soft.psf.shape).astype(F32))
    one = Highlights(np.array([[33.3, 20.2]]), PITCH / 2, np.array([[1e9, 1e9, 1e9]]))
    pixels = np.array([[48 + 13 + dy, 64 + 21 + dx] for dy in range(-2, 3) for dx in range(-2, 3)])
    expected = ExactCore(lens, camera, SPECTRA, WAVELENGTHS_NM).highlights(one, pixels)
    frame = on_sensor(device, camera, one, lens).astype(float)
    off = frame[pixels[:, 0], pixels[:, 1]] / expected - 1
    # A third of 3e-3, the tolerance of the chart of points: 7e-4 with 2 to 4 samples, where the
    # exact model's own splines end. By the bank's own samples 3.9e-3: the tolerance is missed.
    error = np.sqrt(np.mean(off**2))
    assert error < 1e-3 if fine == 2 else error > 3e-3


def test_light_far_from_a_highlight_is_right_relative_to_itself(device: Device):
    """Out to the end of the PSF, 1e-7 of its peak."""
    camera = monochrome()
    lens = bank(coma_um=1.0, halo=0.05, size=64)
    one = Highlights(np.array([[33.3, 20.2]]), PITCH, np.array([[1e9, 1e9, 1e9]]))
    pixels = np.array([[48 + 13 + dy, 64 + 21 + dx] for dy in (-8, -6, 6, 8) for dx in (0, 3, -5)])
    expected = ExactCore(lens, camera, SPECTRA, WAVELENGTHS_NM).highlights(one, pixels)
    frame = on_sensor(device, camera, one, lens).astype(float)
    found = frame[pixels[:, 0], pixels[:, 1]]
    assert 0 < expected.max() < 1e-3 * frame.max()
    assert_close(found, expected, rtol=5e-3)


@pytest.mark.parametrize("size_um", [0.4, PITCH, 20.0])
def test_a_highlight_keeps_its_energy(device: Device, size_um: float):
    lens = bank(coma_um=1.0, falloff=0.0, distortion=-0.04)
    camera = monochrome()
    place = np.array([20.0, -17.0])
    one = Highlights(place[None], size_um, np.array([[3.0, 1.0, 2.0]]))
    line = size_um * ((np.arange(40) + 0.5) / 40 - 0.5)
    height = np.hypot(place[0] + line, place[1] + line[:, None])
    low, real, high = (lens.real_from_ideal(height + d)[0] for d in (-0.01, 0.0, 0.01))
    area = size_um**2 * np.mean(real / height * (high - low) / 0.02)
    weights = spectral_weights(lens, camera)[0].sum(axis=0) @ (SPECTRA.T @ one.excess[0])
    expected = weights * area / PITCH**2
    found = on_sensor(device, camera, one, lens).sum(dtype=float)
    # Sums at the pixels of what is known every 0.5 um: 1e-4.
    assert found == pytest.approx(expected, rel=1e-4)


def l_shaped() -> dict[str, object]:
    parts = [Part(x=0, y=0, width=1, height=0.4), Part(x=0, y=0.4, width=0.5, height=0.6)]
    shape = Aperture(rectangles=parts)
    return {"fill_factor": shape.area, "aperture": shape, "scan_motion_px": (0.6, -1.0)}


@pytest.mark.parametrize("shaped", [False, True], ids=["square", "moving L"])
def test_boxes_are_the_spline_averaged_over_aperture_and_square(shaped: bool):
    """Against sums over points of both; of a turned pixel and a parallelogram."""
    camera = sensor(**(l_shaped() if shaped else {}))
    square, angle, shift = np.array([[2.0, 0.3], [-0.4, 1.7]]), 0.7, np.array([0.3, -0.6])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    line, share = np.polynomial.legendre.leggauss(12)
    nodes = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) / 2
    even = np.outer(share, share).ravel() / 4
    if shaped:
        seen, shares = camera.response_um.points(0.4)
    else:
        seen, shares = nodes * camera.response_um, even
    # A point of the pixel sees to its side of what lies there; squares are even.
    offsets = ((seen @ turn)[:, None] + nodes @ turn @ square.T).reshape(-1, 2) / 0.5
    weights = np.outer(shares, even).ravel()
    spline = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    side = 48
    spectrum = boxes(side, 0.5, camera.response_um, shift[None], angle=angle, square=square)[0]
    found = scipy.fft.irfft2(spectrum, s=(side, side))
    places = [(0, 0), (1, -2), (-3, 1), (4, 4), (-2, -5), (0, 6)]
    expected = [
        weights
        @ np.nan_to_num(spline(x + offsets[:, 0] - shift[0]) * spline(y + offsets[:, 1] - shift[1]))
        for y, x in places
    ]
    # Three nodes and more between the knots of a quintic; the aliases beyond the second: SLIGHT.
    assert_close(found[tuple(np.transpose(places))], np.array(expected), atol=1e-4 * found.max())
    assert found.sum() == pytest.approx(1, abs=1e-12)


# On the axis, half-way to the corner, and at it.
ACROSS = np.array([[0.0, 0.0], [60.0, 0.0], [0.0, 120.0]])


def test_squares_are_as_large_as_the_psf_lets_them():
    """Half as large where it changes twice as much, and where half as much is allowed."""
    size = largest_um(LENS, 0.01, ACROSS)
    assert largest_um(LENS, 0.005, ACROSS) == pytest.approx(size / 2)
    lenses = (bank(coma_um=2.0, circle_um=circle) for circle in (82.5, 165.0))
    fast, slow = (largest_um(lens, 0.01, ACROSS).min() for lens in lenses)
    assert fast == pytest.approx(slow / 2, rel=0.02)
    assert largest_um(bank(coma_um=0.0), 0.01, ACROSS).min() > 5 * size.min()
    # A grid of fields in both directions says the same of the same PSFs.
    assert 1.0 < largest_um(plane_bank(coma_um=2.0), 0.01, ACROSS).max() < 100.0


def test_highlights_are_cut_up_where_the_psf_changes_and_nowhere_else():
    at = np.arange(LENS.psf.shape[-1]) - LENS.psf.shape[-1] // 2
    round_ = np.exp(-(at**2 + at[:, None] ** 2) / 18)
    psf = LENS.psf.copy()
    psf[:3] = round_ / round_.sum()  # alike out to the third field of five
    lens = replace(LENS, psf=psf)
    heights = lens.real_height_um[:, lens.reference]
    near, far = heights[1] / 2, (heights[2] + heights[3]) / 2 / np.sqrt(2)
    two = Highlights(np.array([[near, 0.0], [far, far]]), 12.0, np.array([[1.0, 0, 0], [0, 1, 0]]))
    alone = squares_on_sensor(lens, sensor(), two, 200.0)
    cut = squares_on_sensor(lens, sensor(), two, 200.0, change=CHANGE)
    of_near, of_far = (cut.light[:, number] > 0 for number in (0, 1))
    assert of_near.sum() == 1 and of_far.sum() > 4 and len(cut.light) == 1 + of_far.sum()
    assert_close(cut.size_um[of_near], np.array([12.0]), atol=0)
    assert_close(cut.size_um[of_far] ** 2 * of_far.sum(), np.full(of_far.sum(), 144.0), rtol=1e-12)
    # Distortion differs a little between the parts.
    assert_close(cut.light.sum(axis=0), alone.light.sum(axis=0), rtol=1e-3)
    # Tables hold the kernel of one shape: those of other sizes are others.
    keys = mixture(lens.places(300.0)[1], cut, 8).keys
    assert set(keys[of_near][..., 2].flat).isdisjoint(keys[of_far][..., 2].flat)


def test_a_large_highlight_is_cut_up(device: Device):
    """A square of 12 um with the PSF of each of its parts."""
    camera = sensor()
    big = Highlights(np.array([[-40.0, 28.0]]), 12.0, np.array([[1e6, 0.0, 2e6]]))
    assert big.size_um > largest_um(LENS, CHANGE, big.centre_um)[0]
    pixels = around(camera, LENS, big.centre_um[0], (-7, -5, -4, -2, 3, 4))
    expected = ExactCore(LENS, camera, SPECTRA, WAVELENGTHS_NM).highlights(big, pixels)
    found = on_sensor(device, camera, big)[pixels[:, 0], pixels[:, 1]].astype(float)
    # The test lens turns its coma of 2 um over its field of 165 um: by 3 um / 50 um within a part.
    assert_close(found, expected, rtol=5e-3, atol=1e-3 * expected.max())


def many(count: int = 30) -> Highlights:
    """Return highlights in three places, of which one lies across borders of tiles."""
    rng = np.random.default_rng(7)
    places = np.array([[-46.0, 30.0], [88.0, 61.0], [62.0, -64.0]])[np.arange(count) % 3]
    return Highlights(
        places + rng.uniform(-4, 4, (count, 2)), PITCH, rng.uniform(0, 1e9, (count, 3))
    )


def test_bundles_keep_the_light_and_are_small():
    """Parts of rings, in which the PSF changes little in its own frame."""
    squares = squares_on_sensor(LENS, sensor(), many(300), 200.0, change=CHANGE)
    owner, bundles = bundled(LENS, squares, CHANGE, 0.1)
    count = len(bundles.light)
    assert 3 < count < len(owner) / 2 and sorted(set(owner)) == list(range(count))
    # Sums of N positive float64 numbers, in two orders: each within N 2^-53 of the true one.
    bound = 2 * len(owner) * 2.0**-53
    assert_close(bundles.light.sum(axis=0), squares.light.sum(axis=0), rtol=bound)
    radius = np.hypot(*squares.real_um.T)
    angle = np.arctan2(*squares.real_um.T[::-1])
    limit = largest_um(LENS, CHANGE, squares.real_um, turns=False)
    for number in range(count):
        own = owner == number
        assert len(np.unique(squares.size_um[own])) == 1
        assert np.ptp(angle[own]) <= 0.1
        assert np.ptp(radius[own]) + squares.size_um[own][0] <= limit[own].min() or own.sum() == 1
        weight = squares.light[own].sum(axis=1)
        middle = weight @ squares.real_um[own] / weight.sum()
        # Means of n numbers: a product, a sum of light and of n terms, a quotient, on each side.
        error_um = 2 * (2 * own.sum() + 2) * 2.0**-53 * radius[own].max()
        assert_close(bundles.real_um[number], middle, atol=error_um)
    # Half of the change: parts of half the depth.
    finer = bundled(LENS, squares, CHANGE / 4, 0.1 / 4)[1]
    assert len(finer.light) > 2 * count


def test_a_bundle_lights_pixels_as_its_squares_do(device: Device, monkeypatch):
    """Three lamps of ten samples each, by few kernels and by one each."""
    camera = sensor()
    bundles = on_sensor(device, camera, many()).astype(float)
    planned = plan_highlights(LENS, camera, many(), SPECTRA, 1e-3)
    assert len(planned.tables) < len(planned.squares.light) * 0.9
    monkeypatch.setattr(highlight_plan, "BUNDLE", 1e-9)
    alone = on_sensor(device, camera, many()).astype(float)
    # Across a square CHANGE of a PSF's light may lie elsewhere, across a bundle BUNDLE of that;
    # what is too much on one side of its middle is too little on the other.
    assert np.abs(bundles - alone).max() < BUNDLE * CHANGE * alone.max()
    assert np.abs(bundles - alone).max() > 0


def test_tiles_change_not_one_bit(device: Device):
    camera = sensor()
    whole = on_sensor(device, camera, many())
    rects = [
        (row, col, min(34, 96 - row), min(34, 128 - col))
        for row in range(0, 96, 34)
        for col in range(0, 128, 34)
    ]
    assert_close(on_sensor(device, camera, many(), rects=rects), whole, atol=0)
    assert whole.min() >= 0 and whole.max() > 1e9


def test_patterns_of_four_by_four(device: Device):
    """Sixteen sites see what the same channels see in patterns of two by two."""
    quad = ColourFilterArray(pattern=[list("BBGG")] * 2 + [list("GGRR")] * 2)
    found = on_sensor(device, sensor(cfa=quad), many())
    plain = on_sensor(device, sensor(), many())
    same = np.array(quad.pattern) == np.tile(np.array([list("BG"), list("GR")]), (2, 2))
    mask = np.tile(same, (24, 32))
    assert 0.3 < mask.mean() < 0.9
    assert_close(found[mask], plain[mask].copy(), rtol=100 * ULP, atol=1e-3)


def test_tables_too_many_for_one_dispatch_go_into_several(device: Device, monkeypatch):
    camera = sensor()
    whole = on_sensor(device, camera, many())
    kernels = Tables(LENS, camera, SPECTRA, PITCH)
    squares = squares_on_sensor(LENS, camera, many(), kernels.reach_um)
    used, tables = distinct(mixture(LENS.places(150.0)[1], squares, 16).keys)
    assert (np.diff(used[:, 0]) >= 0).all() and tables.max() == len(used) - 1 > 10
    samples = plan_highlights(LENS, camera, many(), SPECTRA, 1e-3).sampling.samples
    bytes_each = 16 * 3 * samples
    monkeypatch.setattr(highlight_plan, "DISPATCH_BYTES", 17 * bytes_each)
    cut = groups(tables, bytes_each)
    assert len(cut) > 2
    assert sorted(np.concatenate(cut)) == list(range(len(tables)))
    assert max(len(np.unique(tables[one])) for one in cut) <= 17
    # The order of the sums is another: thirty highlights at most.
    assert_close(on_sensor(device, camera, many()), whole.copy(), rtol=30 * 2 * ULP)


@pytest.mark.parametrize("most", [3, 2, 1, 0])
def test_spectra_and_channels_too_many_for_one_dispatch_take_turns(device, monkeypatch, most):
    """A table of one channel and four spectra, `most` times over, is bound at once."""
    six = np.concatenate([SPECTRA, SPECTRA[::-1] * np.linspace(0.5, 1.5, SPECTRA.shape[1])])
    camera, seen = sensor(), many()
    seen = replace(seen, excess=np.random.default_rng(9).uniform(0, 1e9, (30, 6)))
    whole = of_highlights(device, LENS, camera, seen, six, 1e-3)
    one = 16 * whole.planned.sampling.samples * whole.planned.tables.shape[1]
    monkeypatch.setattr(highlight_plan, "DISPATCH_BYTES", most * one)
    parts = of_highlights(device, LENS, camera, seen, six, 1e-3)
    assert len(whole.shares) == 1 and len(parts.shares) == {3: 2, 2: 4}.get(most, 6)
    tile = [(0, 0, camera.rows, camera.cols)]
    calls = []
    found, expected = parts.light(tile, lambda *done: calls.append(done)), whole.light(tile)
    # The order of the sums is another; what a cubic takes below zero is cut off for each part.
    assert_close(found[0], expected[0], rtol=1e-5, atol=1e-6 * expected[0].max())
    assert calls[-1][0] == calls[-1][1] == len(calls)


def test_tables_are_light_and_end():
    kernels = Tables(LENS, sensor(), SPECTRA, PITCH)
    field = LENS.field(2)
    table = kernels.table(field, kernels.spectra(field), kernels.weights, 0.3, PITCH * np.eye(2))
    assert table.shape == (3, 3, kernels.side, kernels.side)
    assert table.min() == 0
    at = np.arange(kernels.side) - kernels.side // 2
    radius = np.hypot(at, at[:, None])
    assert table[..., radius > kernels.support].max() == 0
    # To the corners of windows of 64 samples; aperture and square reach 2.2 um farther, lateral
    # colour 0.016 of 158 um, and splines 2 samples.
    assert kernels.support == pytest.approx(32 * np.sqrt(2) + 2 * (2.2 + 2.5) + 2, abs=0.3)
    assert kernels.side / 2 >= kernels.support + 2 + 2


@pytest.mark.parametrize("bins", [8, 13])
def test_shares_are_those_of_fields_and_angles(bins: int):
    radii = LENS.real_height_um[:, 1]
    squares = squares_on_sensor(LENS, sensor(), many(200), 20.0)
    keys, shares, axis = mixture(LENS.places(150.0)[1], squares, bins)
    assert keys.shape == (len(squares.light), 16, 3)
    assert_close(shares.sum(axis=1), np.ones(len(shares)), atol=1e-12)
    assert keys.min() >= 0 and keys[..., 0].max() <= 4 and keys[..., 1].max() < bins
    radius = np.hypot(*squares.real_um.T)
    for power in range(4):  # a cubic comes out as it is; the last of the list is beyond the axis
        heights = np.append(radii, -radii[1])[keys[..., 0]] / 100
        assert_close(np.sum(shares * heights**power, axis=1), (radius / 100) ** power, atol=1e-12)
    assert_close(axis, squares.real_um / radius[:, None], atol=1e-12)
    turn = np.exp(4j * np.arctan2(*squares.real_um.T[::-1]))
    mixed = np.sum(shares * np.exp(2j * np.pi * keys[..., 1] / bins), axis=1)
    # Half-way a cubic through four places errs by 9 / 16 h^4 / 24 of the fourth derivative, 1.
    assert_close(mixed, turn, atol=(2 * np.pi / bins) ** 4 * 9 / 384)


def test_mixing_between_angles_errs_with_powers_of_their_step():
    kernels = Tables(LENS, monochrome(), SPECTRA[:1], 2 * PITCH)
    field = LENS.field(1)
    spectra = kernels.spectra(field)

    def table(angle: float) -> np.ndarray:
        return kernels.table(field, spectra, kernels.weights, angle, 2 * PITCH * np.eye(2))

    middle = table(0.4)
    errors = []
    for bins in (8, 16):
        half = np.pi / 4 / bins
        mean, wide = ((table(0.4 - n * half) + table(0.4 + n * half)) / 2 for n in (1, 3))
        mixed = mean, (9 * mean - wide) / 8
        errors.append([np.abs(one - middle).max() / middle.max() for one in mixed])
    for power, (coarse, fine) in zip((2, 4), np.transpose(errors), strict=True):
        assert coarse / fine == pytest.approx(2**power, rel=0.1)
    whole = table(0.4 + np.pi / 2)
    assert_close(whole, middle, atol=1e-12 * middle.max())
    # At one wavelength and another angle it is found out well enough.
    assert mixing_errors(kernels, [field]) == pytest.approx(errors[1], rel=0.2)


def test_lamps_of_few_colours_need_tables_of_few_spectra(device: Device):
    """Sixteen bands, three colours of lamps and their mixtures: the light stays what it was."""
    rng = np.random.default_rng(3)
    colours = rng.uniform(0, 1, (3, 16))
    share = np.concatenate([np.eye(3), rng.uniform(0, 1, (27, 3))])
    bands = rng.uniform(0, 1, (16, SPECTRA.shape[1]))
    camera, seen = sensor(), many()
    light = share @ colours * 10.0 ** rng.uniform(3, 9, (30, 1))
    stage = of_highlights(device, LENS, camera, replace(seen, excess=light), bands, 1e-3)
    assert stage.planned.squares.light.shape[1] == 3
    three = of_highlights(
        device, LENS, camera, replace(seen, excess=light @ bands), np.eye(61), 1e-3
    )
    assert three.planned.squares.light.shape[1] == 3
    tile = [(0, 0, camera.rows, camera.cols)]
    found, expected = stage.light(tile)[0], three.light(tile)[0]
    # A tenth of the tolerance is what colours may differ by; the dark has the f32 of the bright.
    assert_close(found, expected, rtol=1e-4, atol=1e-6 * expected.max())


def test_spectra_that_are_no_sums_of_others_stay_as_they_are():
    light = np.random.default_rng(4).uniform(0, 1, (30, 5))
    few, same = of_few_spectra(light, 1e-4)
    assert np.array_equal(few, np.eye(5)) and same is light
    dark = np.zeros((4, 5))
    assert np.array_equal(of_few_spectra(dark, 1e-4)[1], dark)
    # A faint lamp has a colour of its own.
    light = np.array([[1e9, 0, 0], [2e9, 0, 0], [1.0, 1.0, 0]])
    few, shares = of_few_spectra(light, 1e-4)
    assert len(few) == 2
    # Least squares in float64; of the faint one alone what `alike` allows.
    assert_close(shares @ few, light, rtol=1e-12, atol=1e-12 * light.max())
    assert_close(shares[2] @ few, light[2], rtol=1e-4)


def test_real_points_are_where_the_map_leads_back():
    ideal = np.random.default_rng(2).uniform(-100, 100, (40, 2))
    real, slopes, lit = real_points(LENS, ideal)
    assert lit.all()
    height = np.hypot(*ideal.T)
    assert_close(np.hypot(*real.T), LENS.real_from_ideal(height)[0], atol=1e-4)
    assert_close(real[:, 0] * ideal[:, 1], real[:, 1] * ideal[:, 0], atol=1e-2)
    # real = ideal (1 - 0.04 (ideal / 165)^2), through the bank's four fields by a spline.
    share = (height / 165) ** 2
    frame = turned(slopes, ideal / height[:, None])
    assert_close(frame[:, 0, 0], 1 - 3 * 0.04 * share, atol=2e-3)
    assert_close(frame[:, 1, 1], 1 - 0.04 * share, atol=1e-3)
    assert_close(frame[:, [0, 1], [1, 0]], np.zeros((40, 2)), atol=1e-5)


def test_points_beyond_the_circle_land_nowhere():
    ideal = np.array([[0.0, 0.0], [164.0, 0.0], [0.0, -166.0], [1e6, 1e6]])
    for lens in (LENS, plane_bank()):
        real, slopes, lit = real_points(lens, ideal)
        assert lit[0] and not lit[3]
        assert np.isfinite(real[lit]).all() and np.isfinite(slopes[lit]).all()
    assert real_points(LENS, ideal)[2].tolist() == [True, True, False, False]


@pytest.mark.parametrize("place", [(35.0, 20.0), (-50.0, -31.0)])
def test_a_lens_without_an_axis(device: Device, place):
    """Coma on the axis, keystone, an image off the centre: nothing is turned, fields are mixed."""
    lens = plane_bank(
        coma_um=1.0, axial_coma_um=(1.6, -0.7), keystone=(0.06, 0.025), boresight_um=(6.0, -3.0)
    )
    camera = sensor()
    one = Highlights(np.array([place]), 2 * PITCH, np.array([[1e9, 2e9, 0.5e9]]))
    real = real_points(lens, one.centre_um)[0][0]
    col, row = np.floor(real / PITCH + [64, 48]).astype(int)
    pixels = np.array([[row + dy, col + dx] for dy in (-7, -2, 0, 1, 4) for dx in (-5, -1, 0, 3)])
    expected = ExactCore(lens, camera, SPECTRA, WAVELENGTHS_NM).highlights(one, pixels)
    found = on_sensor(device, camera, one, lens)[pixels[:, 0], pixels[:, 1]].astype(float)
    assert_close(found, expected, rtol=5e-3, atol=5e-4 * expected.max())
    # Dark ones are alike: far off, parabolas between three wavelengths swing below 0.
    assert len(np.unique(np.round(expected, -3))) > 12  # not all in the dark


def test_every_highlight_within_reach_is_listed():
    rng = np.random.default_rng(3)
    position, reach, size = rng.uniform(-20, 90, (50, 2)), 9.0, (4, 3)
    starts, near = lists(position, reach, size)
    assert len(starts) == 13 and starts[0] == 0
    for square in range(12):
        own = near[starts[square] : starts[square + 1]]
        assert (np.diff(own.astype(int)) > 0).all()
        x, y = np.meshgrid(np.arange(16) + 0.5, np.arange(16) + 0.5)
        cells = np.stack([x + 16 * (square % 4), y + 16 * (square // 4)], axis=-1)
        distance = np.abs(cells[..., None, :] - position).max(axis=-1)
        needed = np.flatnonzero((distance < reach).any(axis=(0, 1)))
        assert set(needed) <= set(own.tolist())
        assert len(own) < 40


def test_the_dispatch_is_as_the_header_says():
    kernel = Kernel("optics/point_sources", NEAR=64, FAR=80)
    assert kernel.workgroup_size == (16, 16, 1)
    assert kernel.params.members.keys() >= {"reach2", "near2", "step", "site_channels"}


def test_whoever_stops_it_waits_for_no_more_than_the_tables_in_work(device: Device, monkeypatch):
    """Ctrl-C comes between two tables or two pieces: those that wait are never made."""
    made = []
    table = Tables.table
    monkeypatch.setattr(Tables, "table", lambda *given: made.append(1) or table(*given))
    stage = of_highlights(device, LENS, sensor(), many(), SPECTRA, 1e-6)
    assert len(stage.planned.used) >= 60

    def stop(done: int, total: int) -> None:
        assert total >= len(stage.planned.used)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage.light([(0, 0, 96, 128)], stop)
    assert len(made) < len(stage.planned.used) / 2
    in_use = device.pool.in_use
    steps = []
    stage.light([(0, 0, 96, 128)], lambda *step: steps.append(step))
    assert [done for done, _ in steps] == list(range(1, steps[-1][1] + 1))
    assert device.pool.in_use == in_use


def test_sums_are_cut_into_pieces_that_take_a_moment(device: Device, monkeypatch):
    """Whose sums are, bit for bit, those of the whole."""
    camera = sensor()
    stage = of_highlights(device, LENS, camera, many(), SPECTRA, 1e-3)
    whole, *_ = stage.light([(0, 0, 96, 128)])
    monkeypatch.setattr(module, "PIECE_S", 1e-4)
    pieces = stage._pieces(stage._lists(stage.groups[0])[0], (0, 0, 48, 64))
    assert len(pieces) > 6
    assert_close(stage.light([(0, 0, 96, 128)])[0], whole.copy(), atol=0)
