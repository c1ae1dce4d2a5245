"""The exact model of a halo's levels before photographs: lamps beside shadows, and borders."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import BLUE, FLAT, RED, bank, sensor

from gpusim.reference import wide
from gpusim.reference.landing import landed
from gpusim.reference.point_spread import PointSpread
from gpusim.reference.wide import Wide
from gpusim.scene.raster import Raster
from gpusim.scene.spectra import WAVELENGTHS_NM

SPECTRA = np.stack([FLAT, RED, BLUE])
# Samples of 0.5 um and Gaussians of 3 to 4 um: smooth, as levels are.
LEVEL = bank(size=64, sigma_um=(3.0, 3.3, 3.6), coma_um=2.0, distortion=-0.03)
CAMERA = sensor()
HALF = tuple(n * CAMERA.pixel_pitch_um / 2 for n in (CAMERA.cols, CAMERA.rows))
PIXELS = np.array([[30, 40], [47, 63], [70, 101], [12, 90]])


def shadows(lamp: float) -> Raster:
    """Return a dim, uneven scene with one lamp of one sample."""
    rng = np.random.default_rng(3)
    planes = rng.uniform(0.5, 1.5, (3, 380, 510)).astype(np.float32)
    planes[:, 120, 170] = lamp, 0.5 * lamp, 2 * lamp
    return Raster(planes)


def by_samples(raster: Raster, pixels: np.ndarray) -> np.ndarray:
    """Sum each sample of a raster, highlights and all, as a point."""
    ((_, spread),) = Wide(LEVEL, CAMERA, SPECTRA, WAVELENGTHS_NM).spreads
    pitch = raster.pitch_um(*HALF)
    _, rows, cols = raster.planes.shape
    x, y = np.meshgrid(
        (np.arange(cols) - cols / 2 + 0.5) * pitch, (np.arange(rows) - rows / 2 + 0.5) * pitch
    )
    real, stretch = landed(LEVEL_FIELDS, np.stack([x.ravel(), y.ravel()], axis=1))
    light = raster.planes.reshape(3, -1).T * (stretch * pitch**2)[:, None]
    found = []
    for row, col in pixels:
        middle = np.array([col + 0.5 - CAMERA.cols / 2, row + 0.5 - CAMERA.rows / 2])
        t = middle * CAMERA.pixel_pitch_um - real
        near = np.hypot(*t.T) < 16.0
        name = CAMERA.cfa.pattern[row % 2][col % 2]
        h = spread.at(CAMERA.channels.index(name), light[near], t[near], real[near])
        found.append(h.sum() * CAMERA.pixel_pitch_um**2 * CAMERA.fill_factor)
    return np.array(found)


LEVEL_FIELDS = Wide(LEVEL, CAMERA, SPECTRA, WAVELENGTHS_NM).fields


@pytest.mark.parametrize("lamp", [1.0, 100.0, 1e6], ids=["none", "below the limit", "highlight"])
def test_lamps_count_where_they_stand(lamp: float):
    """Whether they are highlights or samples like others, and whatever the cells."""
    raster = shadows(lamp)
    placed = raster.placed(*HALF, 0.0)
    assert len(placed.highlights) == (lamp == 1e6)
    found = Wide(LEVEL, CAMERA, SPECTRA, WAVELENGTHS_NM).at(placed, PIXELS)
    expected = by_samples(raster, PIXELS)
    assert lamp < 10 or expected.max() > 1.5 * expected.min()
    # Cells of 0.75 um, which change by (0.75 / 3.3)^2 / 24 from their middles: 2e-3 of them.
    assert_close(found, expected, rtol=3e-3)


def test_cells_of_many_samples_are_taken_where_their_light_is(monkeypatch):
    """A lamp below the limit in cells of 3 um: their middles would be 30 % off."""
    raster = shadows(300.0)
    placed = raster.placed(*HALF, 0.0)
    monkeypatch.setattr(wide, "SAMPLED", 6.0)
    monkeypatch.setattr(wide, "SMOOTH", (6.0, 3))
    monkeypatch.setattr(wide, "STRUCTURED", (6.0, 3))
    near = np.array([[30, 42], [33, 45], [27, 38]])
    expected = by_samples(raster, near)
    one = Wide(LEVEL, CAMERA, SPECTRA, WAVELENGTHS_NM)
    assert_close(one.at(placed, near), expected, rtol=0.02)
    monkeypatch.setattr(wide, "FEW_SAMPLES", np.inf)
    assert np.abs(one.at(placed, near) / expected - 1).max() > 0.03


def test_beyond_its_border_a_photograph_goes_on_as_there():
    """Pixels at the corner of an even one have as much light as where nothing is beyond."""
    even = Raster(np.ones((3, 190, 254), np.float32)).placed(*HALF, 0.0)
    flat = bank(size=64, sigma_um=(3.0, 3.3, 3.6), coma_um=0.0, distortion=0.0, falloff=0.0)
    one = Wide(flat, CAMERA, SPECTRA, WAVELENGTHS_NM)
    corner, middle = one.at(even, np.array([[0, 0], [48, 64]]))
    # The PSFs' rim, 1e-4 of their middle at 16 um, is cut in steps of cells.
    assert corner == pytest.approx(middle, rel=2e-6)


def test_a_pixel_beside_a_lamp_sees_it_with_its_whole_aperture():
    """Where a level begins, its light is curved: the middle of a wide pixel is not its mean."""
    camera = CAMERA.model_copy(update={"pixel_pitch_um": 3.1, "rows": 48, "cols": 64})
    side = camera.pixel_pitch_um * np.sqrt(camera.fill_factor)
    given = LEVEL, camera, LEVEL_FIELDS, SPECTRA, WAVELENGTHS_NM
    at_points = PointSpread(*given)
    lamp = np.array([[30.0, 12.0]])
    excess = np.ones((1, 3))
    line, weights = np.polynomial.legendre.leggauss(6)
    nodes = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) * side / 2
    shares = np.outer(weights, weights).ravel() / 4
    for way in np.array([[7.5, 0.0], [-5.0, 5.0], [0.0, 2.0]]):
        mean = shares @ at_points.at(0, excess, (way + nodes)[:, None], lamp)[:, 0]
        found = PointSpread(*given, aperture_um=side).at(0, excess, way[None], lamp)[0]
        by_products = PointSpread(*given, aperture_um=side).wide(0, excess, way[None], lamp)[0]
        middle = at_points.at(0, excess, way[None], lamp)[0]
        # Transfers of square and Gaussian differ by x^4 / 180 along each axis, x half a side times
        # the wave number; of Gaussians of 3 um 2.5 sigma off by 2e-3.
        assert found == pytest.approx(mean, rel=4e-3)
        assert by_products == pytest.approx(mean, rel=4e-3)
        assert abs(middle / mean - 1) > 0.01
    assert Wide(LEVEL, camera, SPECTRA, WAVELENGTHS_NM).spreads[0][1].sigma > 0
