"""The generator on the device against the float64 path: fits, pupils and matrix transform."""

from dataclasses import replace

import numpy as np
import pytest
from lens.made import fisheye, lens, model
from scipy.special import j1

from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import System, build
from gpusim.lens.tracer import Beams
from gpusim.lens.wavefront import pupils
from gpusim.psf.generator import Generator
from gpusim.psf.psf import folded_share, intensity
from gpusim.psf.rim import cubic_weights

LINES = np.array([450.0, 650.0])
FIELDS = np.array([0.0, 14.0])
PITCH, SIZE = 0.5, 128


@pytest.fixture(scope="module")
def system(demo_lens) -> System:
    return build(demo_lens)


@pytest.fixture(scope="module")
def generator(device: Device, system: System):
    made = Generator(device, system, LINES, FIELDS, pitch_um=PITCH, size=SIZE)
    yield made
    made.release()


def reference(system: System, theta_deg: float):
    """Return PSFs (L, N, N) and projected solid angles (L,) of the float64 path."""
    samples = sample_field(system, system.index(LINES), np.radians(theta_deg))
    found = pupils(samples, LINES, SIZE * PITCH, 512)
    psf = [intensity(p, line, SIZE, PITCH)[0] for p, line in zip(found, LINES, strict=True)]
    return np.array(psf), np.array([p.entered for p in found]), found


@pytest.mark.parametrize("field", [0, 1])
def test_psfs_are_those_of_the_float64_path(generator, system, field: int):
    spread = generator.spread(field)
    psf, entered, found = reference(system, FIELDS[field])
    peak = psf.max(axis=(1, 2))
    # The float64 path rounds the rim to 512 nodes, which is 4e-4 of the peak (test_psf). Here: the
    # rim's cells are of 1/100 of its radius; 1e-6 waves of rounding, nothing.
    assert (np.abs(spread.psf - psf).max(axis=(1, 2)) < 4e-4 * peak).all()
    # Rims: (1/100)^2 / 6 too large (test_pupil), vignetted ones as much.
    np.testing.assert_allclose(spread.entered, entered, rtol=5e-5)
    assert (spread.folded_energy == 0).all()
    assert [folded_share(p, line, SIZE, PITCH) for p, line in zip(found, LINES, strict=True)] == [
        0,
        0,
    ]
    # A mirrored or turned PSF is far out of tolerance off axis, one of the other line always.
    for planted in (spread.psf[:, :, ::-1], spread.psf.swapaxes(1, 2)):
        wrong = np.abs(planted - psf).max(axis=(1, 2)) > 4e-4 * peak
        assert wrong.all() or field == 0
    assert (np.abs(spread.psf[::-1] - psf).max(axis=(1, 2)) > 4e-3 * peak).all()


@pytest.mark.parametrize("field", [0, 1])
def test_a_transform_of_half_the_length_gives_the_same_psfs(device, system, generator, field: int):
    given = {"pitch_um": PITCH, "size": SIZE, "transform": 512}
    made = Generator(device, system, LINES, FIELDS[[field]], **given)
    short, whole = made.spread(0), generator.spread(field)
    made.release()
    # The rim's cells are twice as wide, 1/50 of its radius: four times the error of the longer one,
    # which the float64 path bounds by 4e-4 of the peak.
    peak = whole.psf.max(axis=(1, 2))
    assert (np.abs(short.psf - whole.psf).max(axis=(1, 2)) < 1.6e-3 * peak).all()
    # The light that enters is that of all cells: it errs by cubics across the rim's, as below.
    np.testing.assert_allclose(short.entered, whole.entered, rtol=2e-4)


@pytest.mark.parametrize("field", [0, 1])
def test_psfs_of_an_apodised_stop_are_those_of_the_float64_path(device, demo_lens, field: int):
    system = build(demo_lens.model_copy(update={"gaussian_apodisation": 1.2}))
    made = Generator(device, system, LINES, FIELDS[[field]], pitch_um=PITCH, size=SIZE)
    spread = made.spread(0)
    made.release()
    psf, entered, _ = reference(system, FIELDS[field])
    peak = psf.max(axis=(1, 2))
    # As without; rho^2 is led to the nodes as the rays are, to 1e-3 of a direction at most.
    assert (np.abs(spread.psf - psf).max(axis=(1, 2)) < 4e-4 * peak).all()
    np.testing.assert_allclose(spread.entered, entered, rtol=2e-4)
    # A little less of it, and none, are seen.
    for other in (1.19, 0.0):
        weaker = build(demo_lens.model_copy(update={"gaussian_apodisation": other}))
        wrong, more = reference(weaker, FIELDS[field])[:2]
        assert (np.abs(wrong - psf).max(axis=(1, 2)) > 4e-4 * peak).all()
        assert (more > 1.005 * entered).all()


def test_chief_rays_are_those_of_the_float64_path(generator, system):
    for field, theta in enumerate(np.radians(FIELDS)):
        chief = sample_rays(system, system.index(LINES), theta, np.zeros(1), np.zeros(1))
        # Both aim to 1e-9 of the stop's radius.
        np.testing.assert_allclose(generator.chief_y_mm[field], chief.chief_y_mm, atol=1e-8)
        np.testing.assert_allclose(generator.chief_beta[field], chief.beta[:, 0], atol=1e-8)


@pytest.mark.parametrize("focus_mm", [0.01, -0.02])
def test_a_refocus_is_the_lens_with_that_image_plane(device, generator, system, focus_mm: float):
    moved = replace(system, image_z_mm=system.image_z_mm + focus_mm)
    built = Generator(device, moved, LINES, FIELDS, pitch_um=PITCH, size=SIZE)
    try:
        slope = generator.chief_beta / np.sqrt(1 - generator.chief_beta**2)
        heights = generator.chief_y_mm + focus_mm * slope
        np.testing.assert_allclose(built.chief_y_mm, heights, rtol=0, atol=1e-12)
        for field in (0, 1):
            one, other = generator.spread(field, focus_mm), built.spread(field)
            peak = other.psf.max(axis=(1, 2))
            # W is rounded at 2^-24 of up to 3 waves, and of the focus term: 1e-6 waves, 1e-5 rad.
            # Interpolation of the defocus, 3e-5 where it is not of third degree (see RAYS).
            difference = np.abs(one.psf - other.psf).max(axis=(1, 2))
            assert (difference < 6e-5 * peak).all()
            np.testing.assert_array_equal(one.entered, other.entered)
            # A plane 1 % of the way off is seen.
            off = generator.spread(field, 1.01 * focus_mm).psf
            assert (np.abs(off - other.psf).max(axis=(1, 2)) > 6e-5 * peak).all()
    finally:
        built.release()


def test_a_refocus_of_nothing_is_the_same(generator):
    np.testing.assert_array_equal(generator.spread(1).psf, generator.spread(1, 0.0).psf)


def test_light_far_out_of_focus_lands_beyond_the_period_and_is_reported(generator):
    # 2 mm out of focus at f/2.8, rays land up to 350 um away: the transform repeats after 512 um,
    # so beyond 480 none would, and 4 mm gives 710 um.
    assert (generator.spread(0, 2.0).folded_energy == 0).all()
    share = generator.spread(0, 4.0).folded_energy
    # Outside a square of 480 um within the circle of directions: there alpha / gamma = 480 / 4000.
    half = np.sin(np.arctan(0.12)) * 2 * 2.8
    assert half < 0.5**0.5
    # Rays of equal alpha do not land quite on a straight line, and the lens has coma of its own.
    np.testing.assert_allclose(share, 1 - 4 * half**2 / np.pi, atol=0.03)


def test_light_that_lands_beyond_the_period_does_not_come_back(generator, system):
    """7 mm out of focus rays land up to 1250 um away, and the transform repeats after 512."""
    focus_mm = 7.0
    moved = replace(system, image_z_mm=system.image_z_mm + focus_mm)
    samples = sample_field(moved, moved.index(LINES[1:]), 0.0)
    # 4096 nodes across: their PSFs repeat after 8 mm, so that nothing folds.
    (pupil,) = pupils(samples, LINES[1:], SIZE * PITCH, 4096)
    assert folded_share(pupil, LINES[1], SIZE, PITCH) == 0
    psf, _ = intensity(pupil, LINES[1], SIZE, PITCH)
    found = generator.spread(0, focus_mm).psf[1]
    # The window's light is 0.3 % of all; what fades ends over 430 um, softly.
    print(
        "ERR",
        np.abs(found.cumsum(0) - psf.cumsum(0)).max() / psf.sum(),
        found.sum() / psf.sum(),
        psf.sum(),
    )
    assert np.abs(found.cumsum(0) - psf.cumsum(0)).max() < 2e-2 * psf.sum()
    # Nodes as far apart as the transform's cells let it come back.
    (coarse,) = pupils(samples, LINES[1:], SIZE * PITCH, 512)
    back, _ = intensity(coarse, LINES[1], SIZE, PITCH)
    assert np.abs(back.cumsum(0) - psf.cumsum(0)).max() > 0.1 * psf.sum()


def test_the_wavefront_meets_the_aimed_rays(generator):
    # The requirement of the wavefront is 1e-3 waves.
    assert (generator.residual_waves < 1e-4).all()
    assert (generator.residual_waves > 0).all()
    assert (generator.failed_rays == 0).all()


class Rippled(Generator):
    """A generator whose nodes are wrong by a known amount."""

    RIPPLE = 0.01

    def _wavefront(self, field, rays):
        nodes = super()._wavefront(field, rays)
        data = self.device.read(nodes)
        data[..., 0] += self.RIPPLE * np.random.default_rng(1).choice([-1, 1], data.shape[:-1])
        self.device.write(nodes, data)
        return nodes


def test_the_residual_tells_of_wrong_nodes(device, system):
    made = Rippled(device, system, LINES[:1], FIELDS[:1], pitch_um=PITCH, size=SIZE)
    # A mean over t of the sum of the squared weights, each way: interpolation averages noise.
    t = (np.arange(100) + 0.5) / 100
    kept = (cubic_weights(t) ** 2).sum(axis=-1).mean()
    assert made.residual_waves[0, 0] == pytest.approx(Rippled.RIPPLE * kept, rel=0.1)
    made.release()


class Lost(Generator):
    """A generator all of whose rays fail where ``fails`` says, by direction and reach."""

    @staticmethod
    def fails(_, reach):
        """Return which nodes (L, A, B) no ray reaches."""
        return reach >= 1

    def _wavefront(self, field, rays):
        nodes = super()._wavefront(field, rays)
        data = self.device.read(nodes)
        grid = self._grids[field, 0]
        beta = grid["first"][1] + grid["step"][1] * np.arange(data.shape[2])
        data[self.fails(beta, data[..., 1])] = 0
        self.device.write(nodes, data)
        return nodes


@pytest.mark.parametrize("field", [0, 1])
def test_rays_that_fail_beyond_the_rim_cost_the_pupil_nothing(
    device, system, generator, field: int
):
    made = Lost(device, system, LINES, FIELDS[[field]], pitch_um=PITCH, size=SIZE)
    whole, lost = generator.spread(field), made.spread(0)
    made.release()
    # Cubics continue W and reach by up to three nodes of 1/60 of the pupil's radius: an error of
    # the fourth difference, below 1e-4 of reach.
    np.testing.assert_allclose(lost.entered, whole.entered, rtol=2e-4)
    peak = whole.psf.max(axis=(1, 2))
    assert (np.abs(lost.psf - whole.psf).max(axis=(1, 2)) < 4e-4 * peak).all()
    assert np.abs(made.residual_waves - generator.residual_waves[[field]]).max() < 1e-4


def test_rays_that_fail_within_the_pupil_are_an_error(device, system):
    class Half(Lost):
        @staticmethod
        def fails(beta, reach):
            return np.broadcast_to(beta > 0.05, reach.shape)

    before = device.pool.in_use
    with pytest.raises(UserError, match="rim fail at 0 deg") as caught:
        Half(device, system, LINES, FIELDS[:1], pitch_um=PITCH, size=SIZE)
    assert caught.value.field == "max_field_deg"
    assert device.pool.in_use == before


def test_weights_of_the_host_are_those_of_four_nodes():
    t = np.linspace(0, 1, 9)
    for power in range(4):
        found = cubic_weights(t) @ np.array([-1.0, 0.0, 1.0, 2.0]) ** power
        np.testing.assert_allclose(found, t**power, rtol=0, atol=1e-14)


def test_a_field_without_light_is_an_error_and_leaves_nothing(device, demo_lens):
    surfaces = list(demo_lens.surfaces)
    for i in (0, -1):
        surfaces[i] = surfaces[i].model_copy(update={"semi_diameter": 0.2})
    dark = build(demo_lens.model_copy(update={"surfaces": tuple(surfaces)}))
    before = device.pool.in_use
    with pytest.raises(UserError, match="no light passes the lens at 14 deg") as caught:
        Generator(device, dark, LINES, FIELDS, pitch_um=PITCH, size=SIZE)
    assert caught.value.value == "14"
    assert device.pool.in_use == before


def test_a_pitch_that_does_not_sample_the_psf_is_an_error_and_leaves_nothing(device, system):
    # f/2.8: the pupil's width is 1 / 2.8 and the limit 450 nm times 1.4.
    before = device.pool.in_use
    with pytest.raises(UserError, match="too coarse for this aperture at 450 nm") as caught:
        Generator(device, system, LINES, FIELDS[:1], pitch_um=0.65, size=SIZE)
    limit = float(str(caught.value.allowed).removeprefix("<= "))
    assert limit == pytest.approx(0.45 * 1.4, rel=0.02)
    assert caught.value.field == "pitch_um"
    assert device.pool.in_use == before


def test_a_field_that_the_lens_cannot_see_is_an_error_and_leaves_nothing(device, system):
    before = device.pool.in_use
    with pytest.raises(UserError, match="chief ray does not pass"):
        Beams(device, system, LINES, np.radians([0.0, 80.0]))
    assert device.pool.in_use == before


def test_release_gives_the_memory_back(device, system):
    before = device.pool.in_use
    beams = Beams(device, system, LINES, np.radians(FIELDS))
    made = Generator(device, system, LINES, FIELDS, pitch_um=PITCH, size=SIZE)
    made.spread(1, 0.01)
    assert device.pool.in_use > before
    beams.release()
    made.release()
    assert device.pool.in_use == before


def test_progress_counts_fields(device, system):
    calls = []
    made = Generator(
        device,
        system,
        LINES[:1],
        FIELDS,
        pitch_um=PITCH,
        size=SIZE,
        rays=32,
        progress=lambda *call: calls.append(call),
    )
    made.release()
    assert calls == [(1, 2), (2, 2)]


def test_a_beam_vignetted_to_a_seventh_of_the_stop_is_traced_all_the_same(device, demo_lens):
    surfaces = list(demo_lens.surfaces)
    surfaces[0] = surfaces[0].model_copy(update={"semi_diameter": 0.2})
    narrow = build(demo_lens.model_copy(update={"surfaces": tuple(surfaces)}))
    made = Generator(device, narrow, LINES, np.zeros(1), pitch_um=PITCH, size=SIZE)
    spread = made.spread(0)
    made.release()
    rim = sample_rays(narrow, narrow.index(LINES), 0.0, np.zeros(1), np.array([0.1]))
    index_rim = rim.margin[0, :, 0]  # (h / 0.2)^2 - 1 at the first surface
    # What enters is a disc that the first surface cuts.
    height = rim.entering.py[:, 0] / np.sqrt(index_rim + 1)
    np.testing.assert_allclose(spread.entered, np.pi * height**2, rtol=1e-3)


def test_an_anamorphic_pupil_gives_airys_pattern_stretched(device):
    # A ball lens with the stop at its centre: at theta the stop is foreshortened by cos(theta), and
    # so is the cone in the image plane, both along y. The image lies on a sphere, so that the plane
    # comes nearer by f (1 - cos(theta)).
    f_number, theta_deg, pitch, size = 100.0, 40.0, 4.0, 96
    rows = [
        {"radius": 10.0, "thickness": 10.0, **model(1.5)},
        {"radius": np.inf, "thickness": 10.0, **model(1.5)},
        {"radius": -10.0},
    ]
    ball = build(lens(rows, stop=2, f_number=f_number, max_field_deg=45.0))
    line = np.array([587.5618])
    fields = np.array([theta_deg])
    made = Generator(device, ball, line, fields, pitch_um=pitch, size=size)
    cosine = np.cos(np.radians(theta_deg))
    spread = made.spread(0, 15.0 * (cosine - 1))
    made.release()
    at = (np.arange(size) - size // 2) * pitch
    v = np.pi * at / (1e-3 * line[0] * f_number)
    # Area of the pupil over lambda^2: the light at the peak.
    area = np.pi * cosine**2 / (2 * f_number) ** 2
    peak = pitch**2 * area / (1e-3 * line[0]) ** 2
    for found, stretch in ((spread.psf[0][:, size // 2], 1), (spread.psf[0][size // 2], cosine**2)):
        airy = (2 * j1(v * stretch) / np.where(v == 0, 1, v * stretch)) ** 2
        airy[size // 2] = 1
        # Waves that are flat to 1e-3 at f/100; the pupil's distortion is of the order of 1 / N.
        np.testing.assert_allclose(found, peak * airy, rtol=0, atol=0.01 * peak)
    # The beam is foreshortened before the lens too: f = 15 mm.
    assert spread.entered[0] == pytest.approx(15.0**2 * area / cosine, rel=2e-3)
    assert (np.abs(spread.psf[0] - spread.psf[0].T).max()) > 0.1 * peak


def test_a_fisheye_is_that_of_the_float64_path_at_90_deg_and_beyond(device):
    wide = build(fisheye(focus="best", f_number=16.0))
    line, fields = np.array([550.0]), np.array([90.0, 100.0])
    made = Generator(device, wide, line, fields, pitch_um=1.0, size=SIZE)
    for field, theta in enumerate(np.radians(fields)):
        found = pupils(sample_field(wide, wide.index(line), theta), line, 2.0 * SIZE, 512)
        psf, _ = intensity(found[0], 550.0, SIZE, 1.0)
        # A rim of 58 cells' radius, light spread over 100 um: what the jagged rim scatters far out
        # folds back, less with the square of the cell. Measured: 5.5e-3 of the (blurred) peak.
        assert np.abs(made.spread(field).psf[0] - psf).max() < 1e-2 * psf.max()
        assert np.abs(made.spread(field).psf[0, :, ::-1] - psf).max() > 1e-1 * psf.max()
    assert (made.residual_waves < 1e-4).all()
    made.release()


def test_a_lens_with_a_moved_element_is_not_traced_as_if_it_were_straight(device, demo_lens):
    bent = build(demo_lens.with_element_moved(1, 2, decentre_mm=(0.0, 0.05)))
    with pytest.raises(ValueError, match="on one axis"):
        Generator(device, bent, LINES, np.zeros(1), pitch_um=PITCH, size=SIZE)
