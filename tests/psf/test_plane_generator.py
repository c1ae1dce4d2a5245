"""Fields of a lens without an axis, by few rays and the shaders, against the float64 path."""

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.gpu import Device
from gpusim.lens.samples import RINGS, RINGS_OVERSIZE, SPOKES, sample_field, sample_rings
from gpusim.lens.system import build
from gpusim.psf.plane_generator import PlaneGenerator
from gpusim.psf.traced import plane_field_of

LINES = np.array([450.0, 550.0, 650.0])
SIZE = 128
TRIPLET = load_prescription("cooke-triplet").with_element_moved(3, 4, (0.05, 0.03))
PHONE = load_prescription("phone").with_element_moved(1, 2, (0.005, 0.003), (0.1, 0.0))
GAUSS = load_prescription("double-gauss").scaled(25.0).stopped(2.8)
GAUSS = GAUSS.with_element_moved(3, 5, (0.02, 0.01), (0.1, 0.0))
CASES = {
    "the axis": (TRIPLET, (0.0, 0.0), 0.5),
    "far off": (TRIPLET, (13.0, -12.0), 0.5),
    "vignetted": (GAUSS, (16.0, 14.0), 0.5),
    "aspheres": (PHONE, (15.0, -20.0), 0.25),
}


def both(device: Device, lens, field, pitch_um):
    """Return a field by the device and by the float64 path."""
    system = build(lens)
    given = {"size": SIZE, "pitch_um": pitch_um}
    generator = PlaneGenerator(device, system, LINES, reference_nm=550.0, **given)
    try:
        pupils = generator.pupils(field)
        found = generator.row(pupils, generator.beside(pupils))
    finally:
        generator.release()
    true = plane_field_of(system, LINES, field, map_nm=550.0, **given)
    return found, true | {"pitch_um": pitch_um}


@pytest.fixture(scope="module", params=list(CASES))
def rows(request, device):
    return both(device, *CASES[request.param])


def ideal_peak(row: dict) -> np.ndarray:
    """Return the peaks (L,) that a field's light would have without aberrations, per sample.

    Area of the pupil in direction cosines, as far as the cones reach, times (pitch / lambda)^2.
    """
    cosines = row["cone"][..., :2].astype(float)
    lit = row["cone"][..., 2] > 0
    sides = [
        [np.ptp(one[own, axis]) for axis in (0, 1)] for one, own in zip(cosines, lit, strict=True)
    ]
    return np.pi / 4 * np.prod(sides, axis=1) * (row["pitch_um"] / (1e-3 * LINES)) ** 2


def edges(psf: np.ndarray) -> np.ndarray:
    """Return what edges along rows and along columns make of PSFs (L, n, n)."""
    return np.stack([psf.sum(axis=axis, dtype=float).cumsum(axis=-1) for axis in (1, 2)])


def test_psfs_are_those_of_the_float64_path(rows):
    """The rim is in cells, and a cell on it counts as if W were even over it.

    A ray there lands up to a quarter of the period off, a phase of pi / 2 across the cell, and the
    lit part's middle lies a quarter of a cell off on average: each of pi D such cells of pi D^2 / 4
    in all errs by 0.4 of an amplitude of 1 / 2. Errors of random phase add up to 0.2 sqrt(pi D) of
    pi D^2 / 4 at the peak of a perfect PSF: D = 140 at the reddest line here, 2.7e-4. Beside a peak
    P of it, 2 sqrt(P) of that.
    """
    found, true = rows
    peak = true["psf"].max(axis=(1, 2))
    bound = 2 * 2.7e-4 * np.sqrt(peak * ideal_peak(true))
    assert (np.abs(found["psf"] - true["psf"]).max(axis=(1, 2)) < bound).all()
    # Edges take from that what light does: see below.
    assert np.abs(edges(found["psf"]) - edges(true["psf"])).max() < 2e-4
    # Its mirror images, and the PSFs of the other lines, are far out of tolerance.
    for planted in (np.roll(found["psf"][:, ::-1], 1, 1), found["psf"].swapaxes(1, 2)):
        wrong = np.abs(planted - true["psf"]).max(axis=(1, 2))
        assert (wrong > 2 * bound).all()
    assert np.abs(edges(found["psf"][::-1]) - edges(true["psf"])).max() > 1e-3


def test_the_light_is_that_of_the_float64_path(rows):
    found, true = rows
    # Rims: as of `tests/psf/test_generator.py`, 5e-5. Where two of them cross, up to four times,
    # cubics miss a tenth of a node's square, (2 / 110)^2 / pi of the light: 4e-5.
    np.testing.assert_allclose(found["light_sr"], true["light_sr"], rtol=9e-5)
    np.testing.assert_allclose(found["outside_energy"], true["outside_energy"], atol=2e-4)
    np.testing.assert_allclose(found["core"], true["core"], atol=2e-4)
    assert (found["folded_energy"] == 0).all()


def test_chief_rays_are_the_same(rows):
    found, true = rows
    for name in ("chief_x_um", "chief_y_um", "chief"):
        # Both aim to 1e-9 of the stop's radius.
        np.testing.assert_allclose(found[name], true[name], rtol=0, atol=1e-5)


def test_the_halo_is_that_of_twice_as_many_nodes(rows):
    found, true = rows
    held = true["levels"].sum(axis=(-2, -1))
    off = np.abs(found["levels"] - true["levels"]).sum(axis=(-2, -1))
    # Slopes of W are differences over two nodes, and rays lie on straight lines between them: both
    # go with the square of the spacing. At the pupil's 1/57 they move 1 % of the light by a sample.
    assert (off[0] < 0.01).all()
    assert (off[1:] < 0.1 * held[1:] + 1e-5).all()
    assert np.abs(edges(found["levels"][0]) - edges(true["levels"][0])).max() < 1.5e-3
    np.testing.assert_allclose(found["beyond"], true["beyond"], atol=1e-6)
    turned = found["levels"][0].swapaxes(1, 2)
    assert (np.abs(turned - true["levels"][0]).sum(axis=(-2, -1)) > 0.01).any()


def test_cones_have_the_same_mean_and_spread(rows):
    found, true = rows
    for power in (1, 2):
        mine, other = (
            (one["cone"][..., :2].astype(float) ** power * one["cone"][..., 2:]).sum(axis=1)
            for one in (found, true)
        )
        # Each ray is the light of a cell of its own: nodes of 1/57 count by their shares.
        np.testing.assert_allclose(mine, other, atol=2e-5)


def test_rings_reach_beyond_the_rim_and_no_farther():
    """All of the light lies within the outermost ring, and that is 1.06 times as wide."""
    system = build(GAUSS)
    index = system.index(LINES)
    theta, azimuth = np.radians(21.0), 1.0
    rings = sample_rings(system, index, theta, azimuth, 1)
    assert rings.alpha.shape == (3, RINGS * SPOKES)
    nearest = rings.margin.max(axis=0)[1].reshape(RINGS, SPOKES)
    assert (nearest[-1] > 0).all() and (nearest[:-4] < 0).all()
    # Vignetted by two surfaces and the stop: the light is no disc.
    many = sample_field(system, index, theta, azimuth)
    lit = np.ptp(many.alpha[1, many.inside[1]]), np.ptp(many.beta[1, many.inside[1]])
    last = slice(-SPOKES, None)
    mine = np.ptp(rings.alpha[1, last]), np.ptp(rings.beta[1, last])
    assert np.divide(mine, lit) == pytest.approx(RINGS_OVERSIZE, abs=0.04)
    assert max(lit) > 1.1 * min(lit)


def test_a_pitch_that_is_too_coarse_is_refused(device):
    generator = PlaneGenerator(
        device, build(TRIPLET), LINES, size=SIZE, pitch_um=2.0, reference_nm=550.0
    )
    try:
        with pytest.raises(UserError, match="too coarse") as caught:
            generator.pupils((0.0, 0.0))
    finally:
        generator.release()
    assert caught.value.field == "pitch_um"


@pytest.mark.parametrize("apodisation", [0.8])
def test_an_apodised_stop(device, apodisation):
    lens = TRIPLET.model_copy(update={"gaussian_apodisation": apodisation})
    found, true = both(device, lens, (9.0, 5.0), 0.5)
    np.testing.assert_allclose(found["light_sr"], true["light_sr"], rtol=5e-5)
    assert np.abs(edges(found["psf"]) - edges(true["psf"])).max() < 2e-4
    even, _ = both(device, TRIPLET, (9.0, 5.0), 0.5)
    assert (even["light_sr"] > 1.5 * found["light_sr"]).all()
