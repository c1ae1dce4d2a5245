"""The judge itself: against closed forms, against the other tracer, and against its own grids."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lens.made import lens
from scipy.interpolate import CubicSpline

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.projection import RECTILINEAR
from gpusim.lens.samples import sample_field
from gpusim.lens.system import build, first_order, transmission
from gpusim.lens.wavefront import pupils
from gpusim.psf.otf import diffraction_mtf
from gpusim.reference.aperture import aperture_of
from gpusim.reference.backward import chief_back, newton, through, trace_back
from gpusim.reference.bundle import OVERSIZE, RAYS_ACROSS, Frame, Rays, frame_of, rays_of
from gpusim.reference.lens_truth import Judge
from gpusim.reference.lens_view import view
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.raster import Raster
from gpusim.scene.spectra import WAVELENGTHS_NM

LIGHT = np.full(WAVELENGTHS_NM.size, 0.01)  # W m^-2 sr^-1 nm^-1
PITCH_UM = 4.0


def sensor(lit_nm: float | None = None):
    """Return what the judge asks of a sensor: 401 x 401 pixels that see all, or one wavelength."""
    qe = np.full(WAVELENGTHS_NM.size, 0.5) if lit_nm is None else 1.0 * (WAVELENGTHS_NM == lit_nm)
    return SimpleNamespace(
        rows=401,
        cols=401,
        pixel_pitch_um=PITCH_UM,
        fill_factor=1.0,
        cfa=SimpleNamespace(pattern=[["W"]]),
        qe_at=lambda table_nm: {"W": np.interp(table_nm, WAVELENGTHS_NM, qe)},
    )


def scene(*rects: Rect):
    """Return a bright ground with rectangles of a tenth of its light, lengths in um."""
    chart = Chart(("bright", "dark"), 0, rects).placed(1 / (401 * PITCH_UM / 2))
    return SimpleNamespace(
        source=chart, spectra=np.stack([LIGHT, 0.1 * LIGHT]), projection=RECTILINEAR
    )


@pytest.fixture(scope="module")
def gauss():
    return build(load_prescription("double-gauss").scaled(25.0).stopped(4.0))


@pytest.fixture(scope="module")
def perfect():
    """Give a plano-hyperbolic lens: its conic constant -n^2 focuses 550 nm to a point on axis.

    It offends the sine condition: beside the axis it has coma, as the aperture's square. Found in
    the MTF: 2.3e-3 at f/10, 6e-4 at f/20, 1.8e-4 at f/40.
    """
    rows = [
        {"radius": np.inf, "thickness": 3.0, "glass": "N-BK7", "semi_diameter": 3.0},
        {"radius": -10.0, "conic": 0.0, "semi_diameter": 3.0},
    ]
    # A wide field, for the scene is black beyond it.
    more = {"reference_nm": 550.0, "glass_catalogues": ["SCHOTT"], "max_field_deg": 60.0}
    n = build(lens(rows, f_number=40.0, **more)).index(np.array([550.0]))[1, 0]
    rows[1]["conic"] = -float(n * n)
    return build(lens(rows, f_number=40.0, **more))


@pytest.fixture(scope="module")
def seen_through_it(perfect):
    """Give what the axis sees: 550 nm, and two lines beside it that carry no light."""
    return view(perfect, (0.0, 0.0), np.array([500.0, 550.0, 600.0]))


def field_rays(
    system, index: np.ndarray, image: np.ndarray, chief: np.ndarray, frame: Frame
) -> Rays:
    """Trace, along the light, the field whose chief ray lands on an image point (2,), mm.

    Its rays land elsewhere, by the aberrations; places and paths are left out.
    """
    middle = trace_back(system, index, image[:, None], chief)
    along = middle.direction
    e1 = frame.e1 - (frame.e1 @ along) * along[:, 0]
    e1 /= np.sqrt(e1 @ e1)
    sides = np.stack([e1, np.cross(along[:, 0], e1)])
    rim = OVERSIZE * system.stop_radius_mm
    x, y = np.meshgrid(*2 * [np.linspace(-rim, rim, RAYS_ACROSS)])
    keep = np.hypot(x, y) <= rim
    stop = np.stack([x[keep], y[keep]])

    def launched(p, _=None):
        # From well before the lens: where a ray starts along its own direction changes nothing.
        start = middle.point + sides.T @ p - 10 * rim * along
        sent = np.broadcast_to(along, start.shape)
        return through(system, index, start, sent, np.ones(p.shape[1], bool), sense=1)

    nothing = np.zeros_like(stop)
    at, found = newton(system, launched, nothing, stop, step=1e-4 * rim, retreat=nothing[:, :1])
    here = launched(at)
    found &= here.ok
    margin = (here.own**2).sum(axis=1) / system.semi_diameter_mm[:, None] ** 2 - 1
    diaphragm = (stop**2).sum(axis=0) / system.stop_radius_mm**2 - 1
    margin = np.concatenate([margin, diaphragm[None]])
    keep = found & (margin <= OVERSIZE**2 - 1 + 1e-12).all(axis=0)
    nothing = np.zeros(int(keep.sum()))
    return Rays(
        at[:, keep] / frame.focal_mm,
        np.stack([nothing, nothing]),
        nothing,
        here.direction[:2, keep],
        margin[:, keep],
    )


@pytest.mark.parametrize(("theta", "azimuth"), [(0.0, 0.0), (10.0, 30.0), (18.0, 200.0)])
def test_rays_and_light_agree_with_the_tracer_that_goes_forwards(gauss, theta, azimuth):
    """Two programs, two directions: where the chief ray comes from, and the pupil's solid angle.

    The pupils' grids leave 1e-5 (384 against 1536 nodes) and the aim 1e-9 of the stop's radius.
    """
    index, line = gauss.index(np.array([480.0])), np.array([480.0])
    theta, azimuth = np.radians(theta), np.radians(azimuth)
    there = sample_field(gauss, index, theta, azimuth)
    image = np.array([there.chief_x_mm[0], there.chief_y_mm[0]])
    frame = frame_of(gauss, index, image, first_order(gauss.prescription, 550.0).efl_mm)
    sine = np.sin(theta)
    wanted = [sine * np.sin(azimuth), sine * np.cos(azimuth), np.cos(theta)]
    assert frame.along == pytest.approx(wanted, abs=1e-8)

    chief = chief_back(gauss, index, image)
    assert chief[:, 0] == pytest.approx(there.chief_direction[0], abs=1e-8)
    field = field_rays(gauss, index, image, chief, frame)
    found = aperture_of(field, 480.0, 384 * 0.48 / (2 * np.ptp(field.p))).solid_angle_sr
    known = pupils(there, line, 1.0, 1024)[0].projected_solid_angle_sr
    assert found == pytest.approx(known, rel=2e-5)


def test_the_path_leads_where_the_rays_go(gauss):
    """The path's slope over the frame's plane is the direction of the light: dV/dp = -w."""
    index, image = gauss.index(np.array([550.0])), np.array([2.0, 1.0])
    frame = frame_of(gauss, index, image, 25.0)
    rays = rays_of(gauss, index, image, chief_back(gauss, index, image), frame)
    u, v = rays.p / np.abs(rays.p).max()
    design = np.polynomial.chebyshev.chebvander2d(u, v, [10, 10])
    path = np.linalg.lstsq(design, rays.path_mm, rcond=None)[0].reshape(11, 11)
    slope = np.polynomial.chebyshev.chebval2d(u, v, np.polynomial.chebyshev.chebder(path))
    inside = rays.inside
    found_um = -1e3 * slope[inside] / np.abs(rays.p).max()
    # The fit's own error, differentiated: 1e-9 mm over a pupil of 0.1 focal lengths.
    assert found_um == pytest.approx(rays.landing_um[0, inside], abs=1e-3)


def test_a_perfect_lens_has_the_mtf_of_diffraction(perfect):
    """Goodman, Fourier Optics, sec. 6.4; coma leaves 2e-4."""
    # A core of 32 lambda N: in the cells beyond it, all but the lowest frequencies even out.
    seen = view(perfect, (0.0, 0.0), np.array([550.0]), core_um=32 * 0.55 * 40)
    aperture = np.sqrt(seen.solid_angle_sr[0] / np.pi)  # sin theta'
    cut_cy_um = 2 * aperture / 0.55
    share = np.array([0.05, 0.2, 0.5, 0.8])
    middles = (seen.edges_um[1:] + seen.edges_um[:-1]) / 2
    # X is the image's own length for rays at the axis of a distortion-free lens.
    scale = seen.frame.per_um[0, 0]
    found = [
        np.cos(2 * np.pi * f / scale * seen.at_um) @ seen.core[0].sum(axis=1)
        + np.cos(2 * np.pi * f / scale * middles)
        @ seen.wide[0].sum(axis=1)
        * np.sinc(f / scale * (middles[1] - middles[0]))
        for f in share * cut_cy_um
    ]
    known = diffraction_mtf(1e3 * share * cut_cy_um, 550.0, 1 / (2 * aperture))
    assert np.array(found) == pytest.approx(known, abs=4e-4)


@pytest.mark.parametrize("off_um", [-9.0, -1.0, 0.0, 0.7, 3.0, 30.0])
def test_an_edge_through_a_perfect_lens(perfect, seen_through_it, off_um):
    """The edge's response is 1/2 + integral of MTF sinc sin(2 pi f x) / (pi f) df."""
    judge = Judge(perfect, sensor(550.0), scene(Rect(1600 + off_um, 0, 1600, 3000, 0, 1)), TABLE)
    seen = seen_through_it
    found = judge.pixel(seen, 200, 200)
    aperture = np.sqrt(seen.solid_angle_sr[1] / np.pi)
    f = np.linspace(0, 2 * aperture / 0.55, 20001)[1:]
    mtf = diffraction_mtf(1e3 * f, 550.0, 1 / (2 * aperture)) * np.sinc(f * PITCH_UM)
    # On the ideal plane the edge lies at off_um; the lens is free of distortion there.
    dark = 0.5 - np.trapezoid(mtf * np.sin(2 * np.pi * f * off_um) / (np.pi * f), f)
    dark -= off_um * f[0]  # the integrand at 0 is 2 off_um, over the first half step twice
    # Half of what diffraction throws beyond 3200 um, the wall's far side: lambda N / (pi^2 r).
    behind = 0.55 / (2 * aperture) / (np.pi**2 * 3200)
    even = (judge.weights(200, 200, seen.wavelengths_nm) @ seen.solid_angle_sr)[0]
    assert found.rate / even == pytest.approx(1 - 0.9 * dark, abs=6e-4 + 0.9 * behind)


TABLE = WAVELENGTHS_NM


def test_a_raster_is_looked_up_as_its_spline(perfect, seen_through_it):
    """On the border between dark and bright halves lies half the light, by symmetry."""
    planes = np.full((2, 80, 80), 0.5, np.float32)  # not 0: radiance never rings below it
    planes[0, :, 40:] = 1.0
    planes[1] = 0.25
    subject = SimpleNamespace(
        source=Raster(planes), spectra=np.stack([LIGHT, LIGHT]), projection=RECTILINEAR
    )
    judge = Judge(perfect, sensor(550.0), subject, TABLE)
    found = judge.pixel(seen_through_it, 200, 200).rate
    even = (
        judge.weights(200, 200, seen_through_it.wavelengths_nm) @ seen_through_it.solid_angle_sr
    )[0]
    # What lies beyond is black where it is beyond the field's rim.
    assert found / even == pytest.approx(1.0, abs=seen_through_it.beyond.max())


@pytest.mark.parametrize("point", [(0, 0), (350, 60)])
def test_an_even_scene_gives_its_radiance_times_the_solid_angle(gauss, point):
    """E = L Omega (EMVA 1288 R4, eq. 1): whatever the PSF, to 1e-5, what lies beyond included."""
    camera, grey = sensor(), scene()
    judge = Judge(gauss, camera, grey, TABLE)
    lines = np.linspace(400, 700, 5)
    row, col = point
    seen = view(gauss, judge.point_um(row, col), lines)
    area, step = (PITCH_UM * 1e-6) ** 2, np.gradient(TABLE)
    step[[0, -1]] /= 2
    solid = CubicSpline(lines, seen.solid_angle_sr)(TABLE)
    photons = TABLE * 1e-9 / (6.62607015e-34 * 299792458.0)
    known = (step * photons * 0.5 * LIGHT * transmission(gauss.prescription, TABLE) * solid).sum()
    found = judge.pixel(seen, row, col).rate
    # What lies beyond falls as 1 / r^2 with the radius from 0.7 mm on: less than a tenth of it is
    # beyond the image circle, 10 mm, where the scene is black.
    assert 0 < seen.beyond.max() < 2e-3
    assert -1e-5 - 0.1 * seen.beyond.max() < found / (known * area) - 1 < 1e-5


def test_a_frame_knows_where_scenes_have_a_direction(gauss):
    """By angle, a place f theta in the direction of the field: also behind the camera."""
    index = gauss.index(np.array([550.0]))
    flat = frame_of(gauss, index, np.array([4.0, -3.0]), 25.0)
    bent = replace(flat, flat=False)
    x1, x2 = (
        one.ravel() for one in np.meshgrid(np.linspace(-9e3, 9e3, 7), np.linspace(-9e3, 9e3, 5))
    )
    x, y, off = flat.ideal(x1, x2)
    assert np.abs(np.hypot(x, y) / 25e3 - np.tan(off)).max() < 1e-12
    u, v, same = bent.ideal(x1, x2)
    assert np.abs(np.hypot(u, v) / 25e3 - off).max() < 1e-12 and (same == off).all()
    assert np.abs(np.arctan2(v, u) - np.arctan2(y, x)).max() < 1e-12
    for frame, place in ((flat, (x, y)), (bent, (u, v))):
        back = np.stack(frame.of_ideal(*place)[:2])
        assert np.abs(back - [x1, x2]).max() < 1e-7
    # A direction 120 degrees off the axis, from the other side of the axis.
    away = 25e3 * np.radians(120.0)
    assert not bent.of_ideal(np.array(away), np.array(0.0))[2]


@pytest.mark.slow
def test_the_judge_does_not_hang_on_its_grids(gauss):
    """A pixel beside a dark edge: a wider core, a wider period and more colours change 1e-4."""
    subject = scene(Rect(1500 - 9.0 * PITCH_UM, -560.0, 400, 300, 0.1, 1))
    judge = Judge(gauss, sensor(), subject, TABLE)
    row, col = 60, 330
    settings = (
        ({}, 9),
        ({"core_um": 90.0}, 9),
        ({"nodes": 1536}, 9),
        ({"finer": 1.5}, 9),
        ({}, 17),
    )
    found = []
    for more, count in settings:
        lines = np.linspace(400, 700, count)
        seen = view(gauss, judge.point_um(row, col), lines, **more)
        found.append(judge.pixel(seen, row, col).rate)
    assert np.array(found[1:]) == pytest.approx(found[0], rel=1e-4)


def test_what_splines_over_wavelengths_hide_is_told(gauss):
    """Beside an edge, and with a filter that passes one of the table's wavelengths alone."""
    subject = scene(Rect(1500 - 9.0 * PITCH_UM, -560.0, 400, 300, 0.1, 1))
    table = WAVELENGTHS_NM[:33:4]
    subject.spectra = subject.spectra[:, :33:4]
    judge = Judge(gauss, sensor(table[3]), subject, table)
    row, col = 60, 330
    coarse, all_of_them = (
        judge.pixel(view(gauss, judge.point_um(row, col), lines, nodes=256), row, col)
        for lines in (table[::2], table)
    )
    assert all_of_them.colours == 0.0
    error = abs(coarse.rate - all_of_them.rate)
    assert 0 < error <= coarse.colours
