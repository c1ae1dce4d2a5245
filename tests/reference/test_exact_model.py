"""The exact model against closed forms: a lens of Gaussians, straight edges, one spectrum."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import FLAT, MOVED, RED, bank, dots_image, monochrome, plane_bank, sensor
from sampling import one_in
from scipy.special import j1, ndtr
from scipy.stats import ncx2

from gpusim.reference import exact_model as module
from gpusim.reference import point_spread
from gpusim.reference.exact_model import ExactCore
from gpusim.scene.chart import Chart, Disc, Polygon, Rect
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.qe import QuantumEfficiency

PITCH = 1.55
HC = 6.62607015e-34 * 299792458.0
# Round, of one width, and the same over the field: what is left is the geometry.
PLAIN = {
    "sigma_um": (1.0, 1.0, 1.0),
    "coma_um": 0.0,
    "lateral": (0.0, 0.0, 0.0),
    "distortion": 0.0,
    "falloff": 0.0,
}
# PSFs are f32 and cut off at 16 um; quarters of them at 1.2 sigma: 0.75 x 1 and 0.25 x 1.2 um wide.
SHARES = ((0.75, 1.0), (0.25, 1.2))
# Cubic splines through samples half a sigma apart err by up to 3 / 16 / 384 = 5e-4 of the peak, as
# often above as below. Sums over a whole PSF do not see it, but where its azimuth turns under the
# sum, within a PSF's width of the axis; there a fifth of it is left.
TURNED = 1e-4


def grey_sensor(**changes):
    """Return a sensor with a QE of one half at all wavelengths."""
    half = QuantumEfficiency(wavelengths_nm=[400, 700], channels={"W": [0.5, 0.5]})
    return monochrome(quantum_efficiency=half, **changes)


def parabola(lens, values: np.ndarray) -> np.ndarray:
    """Return what goes through three wavelengths, at all: the parabola in 1 / lambda."""
    terms = np.linalg.solve(np.vander(550 / lens.wavelengths_nm), values)
    return np.vander(550 / WAVELENGTHS_NM, 3) @ terms


def even_rate(lens, fill_factor: float = 1.0) -> float:
    """Return electrons/s of an even field of spectrum FLAT, by hand: see test_spectral_basis."""
    spectral = WAVELENGTHS_NM * 1e-9 / HC * 0.5 * FLAT
    steradian = parabola(lens, lens.projected_solid_angle_sr * lens.transmission)
    rule = np.full(61, 5.0)
    rule[[0, -1]] = 2.5
    return float(np.sum(rule * spectral * steradian) * fill_factor * (PITCH * 1e-6) ** 2)


def exact(lens, camera, spectra=None) -> ExactCore:
    return ExactCore(
        lens, camera, np.stack([FLAT, 0 * FLAT]) if spectra is None else spectra, WAVELENGTHS_NM
    )


def chart(*primitives, background=0) -> Chart:
    return Chart(("white", "black", "red"), background, primitives)


@pytest.mark.parametrize("fill_factor", [1.0, 0.5])
def test_an_even_field_gives_the_weights(fill_factor: float):
    lens = bank(**PLAIN | {"distortion": -0.02})
    camera = grey_sensor(fill_factor=fill_factor)
    pixels = np.array([[48, 64], [10, 5], [80, 100]])
    found = exact(lens, camera).chart(chart(), pixels)
    assert_close(found, np.full(3, even_rate(lens, fill_factor)), rtol=TURNED)
    # Away from the axis: f32 PSFs sum to 1 within 1e-6, and midpoint sums of a Gaussian are exact.
    assert_close(found[1:], np.full(2, even_rate(lens, fill_factor)), rtol=5e-6)


def test_lateral_colour_takes_no_light_however_large_it_is():
    """One wavelength is larger by 0.6 %, so that an even field has 1 / 1.006^2 of its light there.

    3.7 mm off the axis PSFs land 22 um off by it, and their window ends at 16 um.
    """
    plain = bank(**PLAIN, circle_um=4500.0)
    wide = bank(**PLAIN | {"lateral": (0.0, 0.0, 0.006)}, circle_um=4500.0)
    camera, line = grey_sensor(rows=3000, cols=4000), plain.wavelengths_nm[2]
    spectra = np.stack([FLAT * (line == WAVELENGTHS_NM), 0 * FLAT])
    pixel = np.array([[2900, 3900]])  # of 3000 x 4000, 1.55 um apart
    assert 0.006 * np.hypot(1400, 1900) * PITCH > 16 + 4
    found, even = (exact(one, camera, spectra).chart(chart(), pixel)[0] for one in (wide, plain))
    assert found == pytest.approx(even / 1.006**2, rel=5e-6)


def test_channels_have_their_own_efficiency():
    lens, camera = bank(**PLAIN), sensor()
    # Rows of B G / G R.
    found = exact(lens, camera).chart(chart(), np.array([[48, 64], [48, 65], [49, 64], [49, 65]]))
    spectral = WAVELENGTHS_NM * 1e-9 / HC * FLAT
    steradian = parabola(lens, lens.projected_solid_angle_sr * lens.transmission)
    rates = [
        np.trapezoid(spectral * steradian * camera.qe[name], WAVELENGTHS_NM) * (PITCH * 1e-6) ** 2
        for name in "BGGR"
    ]
    assert_close(found, np.array(rates), rtol=TURNED)


def edge_profile(distance: np.ndarray, angle: float, width: float) -> np.ndarray:
    """Return the share of light of a half-plane, at aperture centres `distance` inside it."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    x, y = np.meshgrid(nodes * width / 2, nodes * width / 2)
    along = x * np.cos(angle) + y * np.sin(angle)
    total = np.zeros(len(distance))
    for share, sigma in SHARES:
        response = ndtr((distance[:, None, None] - along) / sigma)
        total += share * np.einsum("i,j,pij->p", weights, weights, response) / 4
    return total


@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 45.0, -130.0])
def test_a_straight_edge_is_the_normal_distribution_averaged_over_the_aperture(angle_deg: float):
    lens, camera = bank(**PLAIN), grey_sensor(fill_factor=0.8)
    angle = np.radians(angle_deg)
    outward = np.array([np.cos(angle), np.sin(angle)])
    where = np.array([11.3, -7.7])  # a point of the edge, um
    centre = where - 400 * outward
    white = Rect(*centre, 400.0, 900.0, angle, 0)
    cols, rows = np.meshgrid(np.arange(66, 77, 2), [40, 43])
    pixels = np.stack([rows.ravel(), cols.ravel()], axis=1)
    at = (pixels[:, ::-1] + 0.5 - [64, 48]) * PITCH
    distance = -(at - where) @ outward
    found = exact(lens, camera).chart(chart(white, background=1), pixels)
    width = PITCH * np.sqrt(0.8)
    expected = edge_profile(distance, angle, width) * even_rate(lens, 0.8)
    assert expected.min() < 0.05 * expected.max() or angle_deg == -130.0
    assert np.ptp(expected) > 0.2 * even_rate(lens, 0.8)
    assert_close(found, expected, atol=TURNED * even_rate(lens, 0.8))


def test_shapes_that_touch_are_the_whole():
    """Two rectangles, and a rectangle and polygons, in place of one: side by side, and inside."""
    lens, camera = bank(**PLAIN), grey_sensor()
    angle = 0.4
    whole = Rect(11.3, -7.7, 30.0, 12.0, angle, 0)
    along = 15.0 * np.array([np.cos(angle), np.sin(angle)])
    left, right = (Rect(*((11.3, -7.7) + s * along), 15.0, 12.0, angle, 0) for s in (-1, 1))
    corners = [tuple(one) for one in right.corners()]
    thirds = (Polygon(tuple(corners[:3]), 0), Polygon((*corners[2:], corners[0]), 0))
    inner = Rect(left.cx, left.cy, 15.0, 12.0, angle, 2)
    rows, cols = np.meshgrid([36, 43, 44], [64, 68, 70, 71, 83])
    pixels = np.stack([rows.ravel(), cols.ravel()], axis=1)
    spectra = np.stack([FLAT, 0 * FLAT, FLAT])
    expected = exact(lens, camera, spectra).chart(chart(whole, background=1), pixels)
    assert np.ptp(expected) > 0.9 * even_rate(lens)
    for shapes in ((left, right), (left, *thirds), (whole, inner)):
        found = exact(lens, camera, spectra).chart(chart(*shapes, background=1), pixels)
        # The parts' centres of mass lie apart, which the splines take in their own way.
        assert_close(found, expected, atol=1e-5 * even_rate(lens))


def test_a_small_dot_of_a_sharp_lens_is_as_dark_as_it_should_be(monkeypatch):
    """Detail of 0.4 cycles to a sample of the bank, of which cubic splines lose a part."""
    lens, radius = bank(**PLAIN | {"sigma_um": (0.45,) * 3}), 1.0
    pixel, camera = np.array([[30, 90]]), grey_sensor()
    centre = (90.5 - camera.cols / 2) * PITCH, (30.5 - camera.rows / 2) * PITCH
    nodes, weights = np.polynomial.legendre.leggauss(24)
    off2 = (nodes[:, None] ** 2 + nodes**2) * (PITCH / 2) ** 2
    dark = sum(
        share * ncx2.cdf((radius / width) ** 2, 2, off2 / width**2)
        for share, width in ((share, 0.45 * factor) for share, factor in SHARES)
    )
    expected = 1 - weights @ dark @ weights / 4
    assert 0.3 < expected < 0.35

    def error() -> float:
        found = exact(lens, camera).chart(chart(Disc(*centre, radius, 1)), pixel)[0]
        return abs(found / even_rate(lens) / expected - 1)

    # Splines of degree d err by (f / (1 - f))^(d + 1) of a wave of f cycles a sample: of 0.4 the
    # quintic ones by 9 %, of 8 % that the Gaussian and of 5 % that dot and pixel hold: 4e-4 of the
    # white, in a light of a third of it; less, for half of the waves add and half take away.
    assert error() < 6e-4
    monkeypatch.setattr(module, "DEGREES", (3, 3))
    assert error() > 2e-3


def gaussian_box(d: np.ndarray, sigma: float, width: float) -> np.ndarray:
    return ndtr((d + width / 2) / sigma) - ndtr((d - width / 2) / sigma)


@pytest.mark.parametrize("azimuth_deg", [0, 40, 90, 180, 250])
@pytest.mark.parametrize("place", [1, 2])
def test_a_dot_off_axis_flares_outwards_and_is_displaced_by_lateral_colour(azimuth_deg, place):
    """Against sums over the dot of isotropic Gaussians, whose integral over the aperture is erf.

    x right, y down; neither mirrored nor transposed: for every azimuth the flare goes with the
    radius.
    """
    lens = bank(
        **PLAIN | {"coma_um": 3.0, "lateral": (0.0, 0.0, 0.008), "sigma_um": (1.0, 1.0, 1.1)}
    )
    # The same PSF in all fields, the rim's; so that interpolation between fields changes nothing.
    psf = np.broadcast_to(lens.psf[-1], lens.psf.shape)
    lens = replace(lens, psf=np.ascontiguousarray(psf))
    sigma = (1.0, 1.0, 1.1)[place]
    line = np.where(WAVELENGTHS_NM == (400, 550, 700)[place], 1e-3, 0.0)
    camera = grey_sensor()
    angle = np.radians(azimuth_deg)
    centre = 55.0 * np.array([np.cos(angle), np.sin(angle)])
    dot = Disc(*centre, 1.2, 0)
    col, row = np.floor(centre / PITCH + [64, 48]).astype(int)
    pixels = np.array([[row + dy, col + dx] for dy in (-2, 0, 2) for dx in (-2, -1, 0, 2)])
    found = exact(lens, camera, np.stack([line, 0 * line])).chart(chart(dot, background=1), pixels)

    steps = (np.arange(60) + 0.5) / 60
    r, phi = np.meshgrid(1.2 * np.sqrt(steps), 2 * np.pi * steps)  # equal areas
    points = centre + np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1).reshape(-1, 2)
    outward = points / np.hypot(*points.T)[:, None]
    shift = np.hypot(*points.T)[:, None] * (0, 0, 0.008)[place] * outward
    at = (pixels[:, ::-1] + 0.5 - [64, 48]) * PITCH
    light = np.zeros(len(pixels))
    for share, scale, flare in ((0.75, 1.0, 0.0), (0.25, 1.2, 3.0)):
        d = at[:, None] - (points + shift + flare * outward)
        boxes = gaussian_box(d[..., 0], scale * sigma, PITCH) * gaussian_box(
            d[..., 1], scale * sigma, PITCH
        )
        light += share * boxes.mean(axis=1)
    nm = WAVELENGTHS_NM[line > 0][0]
    width = 2.5 if nm == 700 else 5.0
    rate = nm * 1e-9 / HC * 0.5 * 1e-3 * width * 1e-12 * np.pi * 1.2**2
    rate *= float(lens.projected_solid_angle_sr[place] * lens.transmission[place])
    assert np.ptp(light) > 0.05
    # With a dot hardly wider than the PSF's samples the splines' error does not average out: 5e-4
    # of the peak in each direction, and 2.5 times that of the largest light, spread over a pixel.
    assert_close(found, light * rate, atol=3e-3 * rate * light.max())


@pytest.mark.parametrize("line", [0, 2])
def test_a_lens_without_an_axis_has_its_own_flare_and_place_everywhere(line: int):
    """Coma on the axis, keystone, boresight and lateral colour, none alike in x and y."""
    lens, camera = plane_bank(coma_um=0.6, falloff=0.1, **MOVED), grey_sensor()
    laser = np.where(WAVELENGTHS_NM == lens.wavelengths_nm[line], 1e-3, 0.0)
    place, half_um = (-0.8, 0.45), 48 * PITCH
    dot = Disc(place[0] * half_um, place[1] * half_um, 0.03 * half_um, 0)
    images = {
        flip: dots_image([place], 0.03, (96, 128), np.eye(3)[line], flip)
        for flip in ((1, 1), (-1, 1), (1, -1))
    }
    row, col = np.unravel_index(images[1, 1].argmax(), (96, 128))
    pixels = np.array([[row + dy, col + dx] for dy in (-2, 0, 2) for dx in (-2, -1, 0, 2)])
    found = exact(lens, camera, np.stack([laser, 0 * laser])).chart(
        chart(dot, background=1), pixels
    )
    steradian = lens.projected_solid_angle_sr * lens.transmission
    photons = lens.wavelengths_nm[line] * 1e-9 / HC * 0.5 * 1e-3 * 2.5e-12 * steradian[line]
    rate = photons * np.pi * (0.03 * half_um) ** 2
    expected = rate * images[1, 1][tuple(pixels.T)]
    # The splines' error of a small dot (see above), and bilinear PSFs between fields 41 um apart:
    # lateral colour and coma are linear there but for distortion and keystone, some per cent.
    assert_close(found, expected, atol=5e-3 * expected.max())
    for flip in ((-1, 1), (1, -1)):
        wrong = rate * images[flip][tuple(pixels.T)]
        assert np.abs(found - wrong).max() > 0.2 * expected.max()


def test_a_symmetric_lens_has_the_same_exact_model_in_both_kinds_of_bank():
    settings = {"coma_um": 1.0, "falloff": 0.2}
    camera = grey_sensor()
    white = Rect(20.0, 14.0, 31.0, 17.0, 0.3, 0)
    pixels = np.array([[48, 64], [65, 97], [40, 60], [70, 80], [57, 90]])
    one, other = (
        exact(lens, camera).chart(chart(white, background=1), pixels)
        for lens in (bank(fields=24, **settings), plane_bank(17, **settings))
    )
    # Light between fields h apart errs by 0.22 (h / 2)^2 / 165^2 along x and y each (h = 20.6 um);
    # coma and place are linear but for distortion. Splines: see TURNED.
    assert_close(other, one, atol=(2 * 0.22 * 10.3**2 / 165**2 + TURNED) * one.max())
    assert np.ptp(one) > 0.3 * one.max()


def test_beyond_the_circle_of_a_lens_without_an_axis_it_is_dark():
    """The circle lies about the chief ray of the axis: 6 um within its rim, and 6 um beyond."""
    lens = plane_bank(**PLAIN | {"circle_um": 60.0}, boresight_um=(20.0, -12.0))
    camera = grey_sensor()
    row, col = 48 - 12 / PITCH, 64 + 20 / PITCH
    inside, beyond = 54 / PITCH, 66 / PITCH
    pixels = [(row, col + inside), (row, col - inside), (row + inside, col)]
    pixels += [(row, col + beyond), (row, col - beyond), (row + beyond, col)]
    found = exact(lens, camera).chart(chart(), np.array(pixels).astype(int)) / even_rate(lens)
    assert_close(found, np.array([1.0, 1, 1, 0, 0, 0]), atol=1e-3)  # 5 sigma off


def test_distortion_moves_an_edge_to_where_its_chief_ray_lands():
    lens, camera = bank(**PLAIN | {"distortion": -0.05}), grey_sensor()
    ideal = 80.0
    real = float(lens.real_from_ideal(ideal)[0])
    assert real < ideal - 0.5
    white = Rect(ideal - 500, 0.0, 500.0, 900.0, 0.0, 0)
    pixels = np.array([[48, col] for col in range(112, 120)])
    found = exact(lens, camera).chart(chart(white, background=1), pixels)
    at = (pixels[:, 1] + 0.5 - 64) * PITCH
    expected = edge_profile(real - at, 0.0, PITCH) * even_rate(lens)
    # The edge bends towards the axis, by y^2 / (2 r): dx/x = -0.05 (y/165)^2 is 4e-4 um at 3 um;
    # half a pixel off the row of the axis; and stretches by 1 +- 0.03 over the PSF's 1 um at 0.4
    # per um.
    assert_close(found, expected, atol=2e-3 * even_rate(lens))
    shifted = edge_profile(ideal - at, 0.0, PITCH) * even_rate(lens)
    assert np.abs(shifted - expected).max() > 0.2 * even_rate(lens)  # a control


def test_illumination_falls_with_the_height():
    lens, camera = bank(**PLAIN | {"falloff": 0.4}), grey_sensor()
    pixels = np.array([[48, 64], [48, 110], [5, 20]])
    found = exact(lens, camera).chart(chart(), pixels)
    at = (pixels[:, ::-1] + 0.5 - [64, 48]) * PITCH
    heights = np.hypot(*at.T)
    # By wavelength: as much light as the lens passes, times the illumination, 1 - 0.4 s (1, 1.05,
    # 1.1) with s = (r / 165)^2. Without distortion fields lie evenly, and no cubic errs.
    light = 1 - 0.4 * (heights / 165)[:, None] ** 2 * np.array([1.0, 1.05, 1.1])
    splines = np.array([parabola(lens, one) for one in np.eye(3)])
    spectral = WAVELENGTHS_NM * 1e-9 / HC * 0.5 * FLAT * (PITCH * 1e-6) ** 2
    spectral = spectral * parabola(lens, lens.projected_solid_angle_sr * lens.transmission)
    expected = np.trapezoid(spectral * (light @ splines), WAVELENGTHS_NM, axis=-1)
    # The parabola over PSF and aperture: 0.44 / 165^2 times their variances, of at most 1.4^2 and
    # 1.55^2 / 12 um^2 along each axis, 7e-5; and as on the axis.
    assert_close(found, expected, rtol=TURNED + 7e-5)


def test_beyond_the_image_circle_it_is_dark():
    lens, camera = bank(**PLAIN | {"circle_um": 80.0}), grey_sensor()
    # 80 um = 51.6 pixels: the circle's edge runs through pixel 64 + 51.
    off = np.array([44, 48, 49, 50, 51, 52, 53, 54, 59])
    found = exact(lens, camera).chart(chart(), np.stack([0 * off + 48, 64 + off], axis=1))
    within = 80 - np.hypot((off + 0.5) * PITCH, 0.5 * PITCH)
    expected = edge_profile(within, 0.0, PITCH)
    assert expected[0] == pytest.approx(1, abs=1e-6)
    assert expected[-1] == pytest.approx(0, abs=1e-6)
    # The circle's bend: sigma^2 / (2 R) = 0.008 um of 0.4 per um, 0.0031; cells of 1/4 um along it,
    # each lit by its share: (1/4)^2 / 12 of the slope's slope, 0.24 per um^2, 0.0013.
    assert_close(found / even_rate(lens), expected, atol=0.0045)


def test_a_raster_is_its_spline():
    lens, camera = bank(**PLAIN), grey_sensor()
    rng = np.random.default_rng(3)
    samples = np.stack(
        [0.5 + 0.02 * np.arange(30) + np.zeros((24, 1)), rng.uniform(0, 1, (24, 30))]
    )
    pitch = 8.0
    placed = PlacedRaster(samples.astype(np.float32), pitch, -120.0, -96.0, "")
    both = np.stack([FLAT, 0.5 * FLAT])
    pixels = np.array([[48, 64], [30, 90]])
    ramp = replace(placed, planes=placed.planes * [[[1.0]], [[0.0]]])
    found = exact(lens, camera, both).raster(ramp, pixels)
    x = ((pixels[:, 1] + 0.5 - 64) * PITCH + 120) / pitch - 0.5
    # A ramp stays a ramp: a symmetric PSF and aperture take its value at the centre.
    assert_close(found, (0.5 + 0.02 * x) * even_rate(lens), rtol=TURNED)

    mixed = exact(lens, camera, both).raster(placed, pixels)
    noise = replace(placed, planes=placed.planes[::-1] * np.array([[[1.0]], [[0.0]]]))
    alone = exact(lens, camera, both).raster(noise, pixels)
    assert_close(mixed, found + 0.5 * alone, rtol=1e-6)  # linear, each plane with its own spectrum
    assert np.abs(alone / even_rate(lens) - 0.5).min() > 0.005


# How good the sums are: a lens with coma, lateral colour and falloff, probes on outlines

REAL = {"coma_um": 0.8, "falloff": 0.2, "halo": 0.05}
OUTLINES = (Rect(-25.0, 12.0, 40.0, 25.0, 0.1, 1), Disc(45.0, -30.0, 14.0, 2))
ON_OUTLINES = np.array([[58, 73], [39, 49], [28, 102], [37, 93], [40, 50], [58, 75]])
SHADES = np.stack([FLAT, 0.1 * FLAT, RED])


def on_outlines(lens, camera) -> np.ndarray:
    return exact(lens, camera, SHADES).chart(chart(*OUTLINES), ON_OUTLINES)


@pytest.mark.parametrize(("size", "zones"), one_in(3, [(128, 2), (64, 1), (512, 3)]))
def test_a_quarter_of_the_steps_changes_little(monkeypatch, size: int, zones: int):
    """The smallest tolerance that can be asked for is 1e-5."""
    lens, camera = bank(**REAL, size=size), sensor()
    # A twentieth of the light in a Gaussian as wide as the window lets it be.
    wide = np.exp(-0.5 * ((np.arange(size) - size // 2) / (size / 8)) ** 2) / (size / 8)
    halo = np.float32(0.05 / (2 * np.pi)) * np.outer(wide, wide).astype(np.float32)
    lens = replace(lens, psf=np.float32(0.95) * lens.psf + halo)
    assert len(exact(lens, camera).zones) == 1 + zones  # the first is that of the change
    found = on_outlines(lens, camera)
    even = exact(lens, camera, SHADES).chart(chart(), ON_OUTLINES)
    share = found / even
    assert ((share > 0.15) & (share < 0.9)).sum() >= 3  # on outlines indeed
    monkeypatch.setattr(module, "CELLS", (8, 4, 2))
    finer = on_outlines(lens, camera)
    assert 0 < np.sqrt(np.mean((found / finer - 1) ** 2)) < 3e-6
    assert np.abs(found / finer - 1).max() < 1e-5
    monkeypatch.setattr(module, "CELLS", (0.5, 0.5, 0.5))  # a control
    coarser = on_outlines(lens, camera)
    assert np.abs(coarser / finer - 1).max() > 1e-4


def test_the_aperture_gathers_what_falls_on_it():
    """The mean over the aperture of what apertures of a thousandth see: of each source its PSF."""
    lens, camera = bank(**REAL), sensor()
    some = ON_OUTLINES[1:3]
    found = exact(lens, camera, SHADES).chart(chart(*OUTLINES), some)
    point = exact(lens, camera.model_copy(update={"fill_factor": 1e-6}), SHADES)
    centre = point._position
    nodes, weights = np.polynomial.legendre.leggauss(4)
    expected = np.zeros(len(found))
    for x, wx in zip(nodes, weights, strict=True):
        for y, wy in zip(nodes, weights, strict=True):
            way = np.array([x, y]) * PITCH / 2
            point._position = lambda row, col, way=way: centre(row, col) + way
            expected += wx * wy / 4 * point.chart(chart(*OUTLINES), some) * 1e6
    # As for the steps. With the PSF that belongs to the pixel instead it would be 1e-4.
    assert_close(found, expected, rtol=1e-5)


def test_probes_in_threads_share_few_kernels(monkeypatch):
    """More kernels than are kept, made and dropped by threads at the same time."""
    monkeypatch.setattr(point_spread, "KEPT_KERNELS", 2)
    lens, camera = bank(size=32), sensor()
    spectra = np.stack([FLAT, RED])
    some = chart(Rect(3.0, 5.0, 60.0, 40.0, 0.2, 1))
    pixels = np.array([[row, col] for row in (20, 41, 63) for col in (11, 60, 64, 111)])
    alone = exact(lens, camera, spectra).chart(some, pixels)
    shared = exact(lens, camera, spectra)
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(shared.chart, some, pixel[None]) for pixel in pixels]
    assert_close(np.concatenate([one.result() for one in found]), alone, atol=0)
    assert len(shared.spread.kernels) <= 2 + 3  # one more for each other thread


@pytest.mark.parametrize(
    ("away_um", "size", "finest", "coarser"),
    [(28.0, 256, (8, 8), (2, 0.5)), (50.0, 512, (2, 1, 2), (2, 1, 0.125))],
)
def test_light_from_the_rings_of_a_sharp_lens_is_counted(
    away_um: float, size: int, finest: tuple[float, ...], coarser: tuple[float, ...]
):
    """A pixel in the dark, whose light comes from far away, by rings 1.1 to 2 um wide."""
    lens, camera = bank(**PLAIN, size=size), grey_sensor()
    at = (np.arange(size) - size // 2) * lens.pitch_um
    off = np.maximum(np.hypot(at[:, None], at), 1e-9)
    airy = np.stack(
        [(j1(u) / u) ** 2 for u in np.pi * off / (2.8e-3 * lens.wavelengths_nm[:, None, None])]
    )
    airy /= airy.sum(axis=(1, 2), keepdims=True)
    lens = replace(lens, psf=np.broadcast_to(airy.astype(np.float32), lens.psf.shape))
    dark = np.stack([FLAT, 0.02 * FLAT])
    pixels = np.array([[48, 70], [40, 90]])

    def found() -> np.ndarray:
        centres = (pixels[:, ::-1] + 0.5 - [64, 48]) * PITCH
        return np.concatenate(
            [
                exact(lens, camera, dark).chart(chart(Disc(*centre, away_um, 1)), pixel[None])
                for centre, pixel in zip(centres, pixels, strict=True)
            ]
        )

    def error() -> float:
        return float(np.abs(found() - finer).max() / even_rate(lens))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "CELLS", finest)
        finer = found()
    assert (finer < 0.03 * even_rate(lens)).all()
    assert error() < 1e-6  # a tenth of the smallest tolerance, of the white
    with pytest.MonkeyPatch.context() as patch:  # a control
        patch.setattr(module, "CELLS", coarser)
        assert error() > 2e-6


@pytest.mark.parametrize(
    ("pitch", "undivided"), one_in(2, [(0.775, 2e-5), (0.3875, 2e-5), (1.55, 0.0)])
)
def test_the_cells_are_small_enough_for_a_raster_and_its_border(
    monkeypatch, pitch: float, undivided: float
):
    lens, camera = bank(**REAL), sensor()
    count = int(120 / pitch)
    samples = np.random.default_rng(5).uniform(0, 1, (1, count, count)).astype(np.float32)
    placed = PlacedRaster(samples, pitch, -count * pitch / 2, -count * pitch / 2, "")
    corner = int(count * pitch / 2 / PITCH)
    pixels = np.array([[48, 64], [40, 60], [48 + corner - 1, 64 + corner - 1]])
    found = exact(lens, camera, FLAT[None]).raster(placed, pixels)
    coarse = exact(lens, camera, FLAT[None])
    monkeypatch.setattr(coarse, "_zones", lambda *_: coarse.zones)
    coarser = coarse.raster(placed, pixels)
    monkeypatch.setattr(module, "CELLS", (8, 4, 2))
    finer = exact(lens, camera, FLAT[None]).raster(placed, pixels)
    assert_close(found, finer, rtol=1e-5)  # the smallest tolerance that can be asked for
    assert np.abs(coarser / finer - 1).max() > undivided  # a control


def test_no_cell_of_the_outer_zone_is_wider_than_a_raster_s_sample(monkeypatch):
    """Cells of two samples of the bank, 1 um, before samples of 0.775 um and at the border."""
    monkeypatch.setattr(module, "FALLS_UM", ((2.0, 3.0), (4.0, 6.0)))
    zones_of = exact(bank(**REAL), sensor())._zones
    assert [zone.step_um for zone in zones_of(1)[1:]] == [0.25, 0.5, 1.0]
    assert [zone.step_um for zone in zones_of(1, 0.775)[1:]] == [0.25, 0.5, 0.5]
    assert [zone.step_um for zone in zones_of(2, 0.3875)[1:]] == [0.125, 0.25, 0.25]


def test_a_camera_twice_as_large_has_the_same_exact_model():
    """Steps go with the bank's samples, and so must the widths of zones."""
    small = bank(**REAL, size=128)
    large = replace(
        small,
        pitch_um=2 * small.pitch_um,
        efl_mm=2 * small.efl_mm,
        ideal_height_um=2 * small.ideal_height_um,
        real_height_um=2 * small.real_height_um,
    )
    shapes = (Rect(-25.0, 12.0, 40.0, 25.0, 0.1, 1), Disc(45.0, -30.0, 14.0, 2))
    wide = (Rect(-50.0, 24.0, 80.0, 50.0, 0.1, 1), Disc(90.0, -60.0, 28.0, 2))
    one = exact(small, sensor(), SHADES).chart(chart(*shapes), ON_OUTLINES)
    other = exact(large, sensor(pixel_pitch_um=2 * PITCH), SHADES).chart(chart(*wide), ON_OUTLINES)
    # The place on the ideal plane is found to 1e-9 um, of which an edge makes 0.4 per um.
    assert_close(other, 4 * one, rtol=1e-9)


def test_far_beyond_the_image_circle_nothing_is_worked_out(monkeypatch):
    lens, camera = bank(**PLAIN | {"circle_um": 30.0}, size=32), grey_sensor()
    dark = exact(lens, camera, FLAT[None])
    monkeypatch.setattr(dark.spread, "around", None)
    pixels = np.array([[5, 5], [90, 120]])
    placed = PlacedRaster(np.ones((1, 4, 4), np.float32), 10.0, -20.0, -20.0, "")
    assert_close(dark.chart(chart(), pixels), np.zeros(2), atol=0)
    assert_close(dark.raster(placed, pixels), np.zeros(2), atol=0)
