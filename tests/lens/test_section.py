"""The drawing of a lens is to scale: glass where it is, rays that refract where they are drawn."""

import itertools

import numpy as np
import pytest
from lens.made import lens, model

from gpusim.lens.section import beam, elements, section
from gpusim.lens.system import build, geometry_of


def plate(**moved):
    """Return two plane surfaces with 3 mm of glass between them; the first may be moved."""
    rows = [
        {"radius": np.inf, "thickness": 3.0, "semi_diameter": 2.0, **model(1.5), **moved},
        {"radius": 20.0, "thickness": 1.0, "semi_diameter": 4.0},
        {"radius": 10.0, "thickness": 1.0, "semi_diameter": 4.0, **model(1.5)},
        {"radius": -10.0, "semi_diameter": 4.0},
    ]
    return lens(rows, stop=2)


def test_a_section_is_the_surface():
    geometry = geometry_of(plate())
    np.testing.assert_array_equal(section(geometry, 0, np.array([-2.0, 0.0, 2.0]))[:, 0], 0)
    # A sphere of radius 20 at height 4, its vertex at z = 3.
    (rim,) = section(geometry, 1, np.array([4.0]))
    np.testing.assert_allclose(rim, [3 + 20 - np.sqrt(400 - 16), 4.0], rtol=1e-14)


def test_an_asphere_is_drawn_with_its_polynomial():
    rows = [
        {"radius": np.inf, "thickness": 1.0, **model(1.5), "asphere": {"a4": 1e-3}},
        {"radius": -10.0},
    ]
    at = section(geometry_of(lens(rows)), 0, np.array([2.0]))
    np.testing.assert_allclose(at, [[16e-3, 2.0]], rtol=1e-14)


def test_a_moved_surface_is_drawn_where_it_is():
    # ax = 30 deg turns y towards z.
    geometry = geometry_of(plate(decentre_mm=[0.0, 0.5], tilt_deg=[30.0, 0.0]))
    low, high = section(geometry, 0, np.array([-2.0, 2.0]))
    np.testing.assert_allclose((low + high) / 2, [0.0, 0.5], atol=1e-14)
    np.testing.assert_allclose(high - low, [4 * 0.5, 4 * np.sqrt(0.75)], rtol=1e-14)


def test_each_glass_is_drawn_between_its_surfaces_to_the_wider_rim():
    system = build(plate())
    first, second = elements(system)
    assert first.outline[:, 0].min() == 0
    # The narrow first surface goes on flat to the height of the second.
    flat = first.outline[first.outline[:, 0] == 0]
    assert flat[:, 1].min() == -4
    assert flat[:, 1].max() == 4
    assert second.outline[:, 0].min() == 4
    assert second.outline[:, 0].max() == pytest.approx(5)
    # Two-term Cauchy glass of Abbe number 149.
    assert first.abbe == pytest.approx(149, rel=1e-6)


@pytest.mark.parametrize("field_deg", [0.0, 7.0, 14.0])
def test_drawn_rays_refract_by_snells_law_and_end_in_the_image(demo_lens, field_deg):
    system = build(demo_lens)
    paths = beam(system, np.radians(field_deg), 5, 2.0)
    count = len(demo_lens.surfaces)
    assert paths.shape == (count + 2, 5, 2)
    index = system.index(np.array([demo_lens.reference_nm]))[:, 0]
    leg = np.diff(paths, axis=0)
    leg /= np.linalg.norm(leg, axis=2, keepdims=True)
    for s, ((n1, before), (n2, after)) in enumerate(
        itertools.pairwise(zip(index, leg, strict=True))
    ):
        y = paths[s + 1, :, 1]
        z = section(system.geometry, s, y)[:, 0]
        np.testing.assert_allclose(paths[s + 1, :, 0], z, rtol=0, atol=1e-9)
        # n sin(angle to the normal) is n times the part along the surface.
        ahead = section(system.geometry, s, y + 1e-4)[:, 0]
        behind = section(system.geometry, s, y - 1e-4)[:, 0]
        along = np.column_stack([(ahead - behind) / 2e-4, np.ones_like(y)])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # The difference quotient of the sag is off by h^2 sag''' / 6, 1e-10.
        np.testing.assert_allclose(
            n1 * (before * along).sum(1), n2 * (after * along).sum(1), rtol=0, atol=1e-8
        )
        assert (np.abs(y) < system.semi_diameter_mm[s]).all()
    assert (paths[-1, :, 0] == system.image_z_mm).all()
    height = 8.3 * np.tan(np.radians(field_deg))
    # 2 % of distortion and 10 um of aberrations at the most.
    np.testing.assert_allclose(paths[-1, :, 1], height, rtol=0.02, atol=0.01)


def test_a_beam_starts_on_a_plane_across_it(demo_lens):
    theta = np.radians(14.0)
    paths = beam(build(demo_lens), theta, 5, 2.0)
    across = np.array([-np.sin(theta), np.cos(theta)])
    along = np.array([np.cos(theta), np.sin(theta)])
    np.testing.assert_allclose(np.diff(paths[0] @ along), 0, atol=1e-12)
    np.testing.assert_allclose(paths[0] @ across, paths[1] @ across, atol=1e-12)
    # The lead is measured from where the first ray meets the glass.
    assert ((paths[1] - paths[0]) @ along).min() == pytest.approx(2.0)


def test_rays_fill_the_stop_to_its_rims_where_nothing_vignettes(demo_lens):
    system = build(demo_lens)
    heights = beam(system, 0.0, 7, 1.0)[1 + system.geometry.stop, :, 1]
    np.testing.assert_allclose(
        heights, 0.999 * system.stop_radius_mm * np.linspace(-1, 1, 7), rtol=1e-6, atol=1e-9
    )


def test_a_field_that_is_vignetted_whole_has_no_rays():
    # A tube: two apertures of 0.5 mm, 20 mm apart, pass nothing at 20 deg.
    rows = [
        {"radius": np.inf, "thickness": 20.0, "semi_diameter": 0.5},
        {"radius": np.inf, "thickness": 1.0, "semi_diameter": 0.5, **model(1.5)},
        {"radius": -50.0, "thickness": 100.0, "semi_diameter": 5.0},
    ]
    system = build(lens(rows, stop=2, focus="as-given", stop_semi_diameter_mm=0.5))
    assert beam(system, np.radians(20.0), 7, 1.0).shape == (5, 0, 2)
    assert beam(system, 0.0, 7, 1.0).shape == (5, 7, 2)
