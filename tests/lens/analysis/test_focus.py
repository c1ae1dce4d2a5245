"""Field curvature against Coddington's equations and Petzval's sum; focus over the pupil."""

from __future__ import annotations

import numpy as np
import pytest
from lens.made import lens, model
from lens.rays import oval

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.analysis.focus import field_focus, longitudinal_aberration
from gpusim.lens.samples import field_launch
from gpusim.lens.system import System, build
from gpusim.lens.trace import trace

LINES = np.array([486.1327, 587.5618, 656.2725])


def coddington(system: System, index: np.ndarray, theta: float) -> np.ndarray:
    """Return tangential and sagittal focus of spheres, mm from the image plane, shape (L, 2).

    n' cos^2 I' / t' = n cos^2 I / t + (n' cos I' - n cos I) / R and the same without the squares
    for the sagittal one (Welford 1986, eq. 9.21, 9.22), from surface to surface along the chief
    ray.
    """
    launch = field_launch(system, index, theta)
    nothing = np.zeros((index.shape[1], 1))
    vergence = np.zeros((2, index.shape[1]))  # n / t and n / s: the object is far away
    last = np.zeros((3, index.shape[1]))
    before = launch.direction
    for s, c in enumerate(system.geometry.curvature):
        rays = trace(system.geometry, index, launch, nothing, nothing, through=s + 1)
        point, after = rays.point[..., 0], rays.direction[..., 0]
        if s == 0 and launch.source is not None:
            vergence -= 1 / np.linalg.norm(point - launch.source[:, None], axis=0)
        if s:
            step = np.linalg.norm(point - last, axis=0)
            # Over a distance d: n / (n / V - d).
            vergence = index[s] / (index[s] / vergence - step)
        local = point - np.array([0, 0, system.geometry.vertex_z[s]])[:, None]
        normal = np.array([0, 0, 1.0])[:, None] - c * local
        cos_in, cos_out = (normal * before).sum(0), (normal * after).sum(0)
        n1, n2 = index[s], index[s + 1]
        power = (n2 * cos_out - n1 * cos_in) * c
        vergence = np.stack(
            [
                (vergence[0] * cos_in**2 + power) / cos_out**2,
                vergence[1] + power,
            ]
        )
        last, before = point, after
    return (last[2] + after[2] / vergence - system.image_z_mm).T


@pytest.mark.parametrize(
    ("name", "distance_m"),
    [("double-gauss", np.inf), ("cooke-triplet", 0.6), ("telephoto", np.inf)],
)
def test_close_rays_meet_where_coddington_says(name: str, distance_m: float):
    system = build(load_prescription(name).looking(distance_m))
    edge = np.radians(system.prescription.max_field_deg)
    theta = np.array([0.0, 0.4, 1.0]) * edge
    found = field_focus(system, LINES, theta)
    index = system.index(LINES)
    expected = np.stack([coddington(system, index, angle) for angle in theta])
    # Close rays see 1e-6 of the aberrations of the whole pupil, which are below 10 mm; aiming to
    # 1e-9 of the stop over 2e-3 of it moves a focus f-number times less than 1e-6 f.
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5)
    assert np.abs(found[2, :, 0] - found[2, :, 1]).max() > 0.01  # the two are told apart


def thin_lens(n: float) -> System:
    """Return a thin equiconvex lens of f = 100 mm with its stop in contact, focused paraxially."""
    radius = 2 * (n - 1) * 100.0
    rows = [
        {"radius": radius, "thickness": 1e-6, "glass": "constant", "nd": n},
        {"radius": -radius},
    ]
    return build(lens(rows, f_number=50.0, max_field_deg=2.0))


@pytest.mark.parametrize("n", [1.5, 1.9])
def test_a_thin_lens_has_the_astigmatism_and_the_petzval_sum_of_third_order(n: float):
    theta = np.radians([1.0, 2.0])
    tangential, sagittal = field_focus(thin_lens(n), np.array([550.0]), theta)[:, 0].T
    height = 100 * np.tan(theta)
    # Astigmatism of a thin lens at the stop: h^2 / f between the two; Petzval: h^2 / (2 n f).
    # Fifth order counts theta^2 times as much: 1.2e-3.
    np.testing.assert_allclose(tangential - sagittal, -(height**2) / 100, rtol=5e-3)
    np.testing.assert_allclose(
        (3 * sagittal - tangential) / 2, -(height**2) / (2 * n * 100), rtol=2e-2
    )


def test_an_oval_has_no_spherical_aberration_and_moves_with_its_image_plane():
    system = oval()
    zones = np.array([0.1, 0.5, 0.99])
    found = longitudinal_aberration(system, np.array([550.0]), zones)
    np.testing.assert_allclose(found, 0, atol=1e-6)
    nearer = System(**(vars(system) | {"image_z_mm": system.image_z_mm - 0.25}))
    found = longitudinal_aberration(nearer, np.array([550.0]), zones)
    np.testing.assert_allclose(found, 0.25, atol=1e-6)


def test_an_undercorrected_lens_focuses_its_rim_short():
    rows = [{"radius": 50.0, "thickness": 5.0, **model(1.5)}, {"radius": -50.0}]
    short = longitudinal_aberration(build(lens(rows)), LINES[[1]], np.array([0.5, 1.0]))[0]
    assert short[1] < short[0] < 0
    assert short[1] / short[0] == pytest.approx(4, rel=0.05)  # as the square of the zone
