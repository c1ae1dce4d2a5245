"""Predicted errors: of cuts and of the nodes, beside edges and in scenes of one tone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from optics.made import FLAT, at_lines, bank, monochrome, scene, sensor, shapes

from gpusim.optics import kernels as optics_kernels
from gpusim.optics.images import field_images
from gpusim.optics.kernels import core_window, distances_um, field_kernels
from gpusim.plan import Accuracy, plan_optics
from gpusim.plan.predict import Edge, cells_within, cut_error, edge_integral, even_error, node_error
from gpusim.plan.problem import CUTS_UM

HALO = bank(coma_um=0.5, falloff=0.1, halo=0.02)


def test_an_edge_sees_a_frequency_by_its_reciprocal():
    f = np.linspace(0.1, 0.7, 4001)
    assert edge_integral(f, 3.0 * f) == pytest.approx(2 * 3.0 * 0.6 / (2 * np.pi))
    assert edge_integral(f, np.ones(4001)) == pytest.approx(np.log(7) / np.pi, rel=1e-5)
    assert edge_integral(f, -f) > 0


def test_what_the_coarse_grid_loses_falls_with_the_cut():
    images, _ = field_images(HALO, at_lines(HALO, np.ones((1, 1, 3))), 1e9)
    lost = [cut_error(images, 0.5, 3.1, monochrome(), cut) for cut in CUTS_UM[:4]]
    assert lost == sorted(lost, reverse=True) and lost[0] > 1e-6
    finer = cut_error(images, 0.5, 1.55, monochrome(), CUTS_UM[0])
    assert finer < lost[0]
    assert cut_error(3 * images, 0.5, 3.1, monochrome(), 6.0) == pytest.approx(lost[0])
    small = np.zeros((1, 1, 1, 128, 128))
    small[..., 64, 64] = 1.0
    assert cut_error(small, 0.5, 3.1, monochrome(), 6.0) == 0


def first_kernels(lens, pitch_um=0.775):
    images, places = field_images(lens, at_lines(lens, np.ones((1, 1, 3))), 1e9)
    return field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))


def test_nodes_of_sharp_psfs_err_as_much_whatever_their_kernels_are_held_as(monkeypatch):
    """Held softly, edges would look blurred, and the error beside them less than it is."""
    lens = bank(coma_um=3.0, fields=24)
    given, edge = (2.0, 48.0, (99.2, 74.4), 24.0), Edge(16.0, 2)
    soft = first_kernels(lens, 2.0)
    assert soft.ringing
    found = node_error(soft, *given, edge=edge)
    monkeypatch.setattr(optics_kernels, "SOFT_EDGE", optics_kernels.BAND_EDGE)
    sharp = first_kernels(lens, 2.0)  # sharpened by nothing
    # What rings beyond 24 samples is folded back there: 5e-4 of the light beside an edge of 16:1.
    assert found == pytest.approx(node_error(sharp, *given, edge=edge), rel=0.02)
    assert node_error(replace(soft, ringing=False), *given, edge=edge) < 0.8 * found  # the control


def test_nodes_err_by_the_square_of_their_spacing():
    half_um = (99.2, 74.4)
    # The kernels of a field that never changes are alike at all nodes, but for splines in f32.
    still = bank(coma_um=0.0, falloff=0.0, lateral=(0.0, 0.0, 0.0))
    assert node_error(first_kernels(still), 0.775, 20.0, half_um, 20.0) < 1e-4
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    wide, close = (node_error(kernels, 0.775, 20.0, half_um, spacing) for spacing in (24.0, 12.0))
    assert wide > 5 * 1e-4
    assert wide / close == pytest.approx(4, rel=0.3)  # kinks at the fields, 7 um apart, disturb it


def test_beside_a_harder_edge_nodes_err_more():
    """By the light of the dark side, which blur fills: less than the contrasts themselves."""
    half_um = (99.2, 74.4)
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    errors = [
        node_error(kernels, 0.775, 20.0, half_um, 24.0, edge=Edge(contrast, 2))
        for contrast in (1.0, 2.0, 4.0, 16.0)
    ]
    assert errors[0] == 0.0
    assert errors == sorted(errors)
    assert errors[2] < errors[3] < 4 * errors[2]
    few, many = (
        cells_within(kernels, 0.775, 20.0, half_um, 1e-3, beyond_um=20.0, edge=Edge(contrast, 2))[0]
        for contrast in (2.0, 16.0)
    )
    assert np.prod(few) < np.prod(many)


def test_an_edges_error_is_that_of_pixels_over_their_light():
    """A response that errs by a hundredth everywhere, and a step: the dark side is 1/8 of white."""
    off, whole = np.full(65, 0.01), np.concatenate([np.zeros(32), [0.5], np.ones(32)])
    found = Edge(8.0, 1).square(off, whole)
    seen = 1 / 8 + 7 / 8 * np.array([0.0, 0.5, 1.0])  # within a pixel of the middle
    assert found == pytest.approx(np.mean((7 / 8 * 0.01 / seen) ** 2))


def test_a_scene_of_one_tone_needs_nodes_for_the_kernels_sums_alone():
    """Coma moves light within a kernel: edges see it, one tone does not; it sees what falls off."""

    def errors_of(kernels) -> tuple[float, float]:
        half_um, cells = (99.2, 74.4), (8, 6)
        edge = node_error(kernels, 0.775, 20.0, half_um, 2 * 99.2 / 8)
        return edge, even_error(kernels, half_um, (2 * 99.2, 2 * 74.4), cells)

    even = first_kernels(bank(coma_um=3.0, falloff=0.0, fields=24))
    edge, tone = errors_of(even)
    assert edge > 3e-4 and tone < 0.1 * edge
    dim = first_kernels(bank(coma_um=0.0, falloff=0.3, fields=24))
    edge, tone = errors_of(dim)
    assert tone > 0.5 * edge > 1e-5
    # In the plan: fewer nodes, and no alias that asks for a finer grid.
    lens = bank(sigma_um=(0.35,) * 3, coma_um=3.0, falloff=0.0, fields=24)
    one, many = scene((), np.stack([FLAT])), scene(shapes()[:1], np.stack([FLAT, 0.5 * FLAT]))
    grids = [
        plan_optics(lens, sensor(), what, Accuracy(1e-3), method="fft").scales[0].grid
        for what in (one, many)
    ]
    assert np.prod(grids[0].cells) < 0.5 * np.prod(grids[1].cells)
    assert (grids[0].oversampling, grids[1].oversampling) == (2, 4)


def test_the_error_of_an_even_scene_is_that_of_a_parabola_between_nodes():
    """Light falls as 1 - 0.3 (r / 165)^2: straight lines err by f'' h^2 / sqrt(720) each way."""
    kernels = first_kernels(bank(coma_um=0.0, falloff=0.3, lateral=(0.0,) * 3, fields=24))
    half_um, sides = (82.5, 62.0), (2 * 82.5, 2 * 62.0)
    found = even_error(kernels, half_um, sides, (5, 4))
    curved = 2 * 0.3 / kernels.places.radius_um[-1] ** 2
    expected = curved * np.hypot(33.0**2, 31.0**2) / np.sqrt(720)
    # Over what is left of the light, 0.7 to 1.
    assert expected < found < expected / 0.7
    # What changes at one height alone is seen where it does: a ring at 0.6 of the field.
    sums = np.ones(len(kernels.splines))
    sums[13:16] += 0.03
    ringed = replace(kernels, splines=kernels.splines * sums[:, None, None, None, None])
    assert even_error(ringed, half_um, sides, (5, 4)) > 1.5 * found


def test_cells_keep_the_error_that_they_are_allowed():
    half_um = (99.2, 74.4)
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    found = {}
    for allowed in (4e-3, 1e-3, 2.5e-4):
        cells, error = cells_within(kernels, 0.775, 20.0, half_um, allowed, beyond_um=20.0)
        assert error <= allowed
        # One cell fewer each way would not do: the error goes with the square.
        assert error * (max(cells) / (max(cells) - 1)) ** 2 > allowed * 0.9
        found[allowed] = cells
    assert found[4e-3] < found[1e-3] < found[2.5e-4]
    # Where nothing changes one cell does; where pixels see more than the sensor around it, cells of
    # half its narrower side, 74.4 um, over 2 x 199.2 and 2 x 174.4 um.
    still = first_kernels(bank(coma_um=0.0, falloff=0.0, lateral=(0.0, 0.0, 0.0)))
    assert (
        cells_within(still, 0.775, 20.0, half_um, 1e-3, beyond_um=20.0)[0] == (1, 1) < found[4e-3]
    )
    assert cells_within(still, 0.775, 20.0, half_um, 1e-3, beyond_um=100.0)[0] == (6, 6)


def test_cells_cover_what_pixels_see_around_the_sensor():
    """As many more as the sensor is wider with it, for the same error."""
    half_um = (99.2, 74.4)
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    narrow, wide = (
        cells_within(kernels, 0.775, 20.0, half_um, 2.5e-4, beyond_um=beyond_um)
        for beyond_um in (0.0, 99.2)
    )
    assert wide[1] <= 2.5e-4 and narrow[1] <= 2.5e-4
    for few, many, half in zip(narrow[0], wide[0], half_um, strict=True):
        # Each is rounded up to whole cells.
        assert abs(many - few * (half + 99.2) / half) <= (half + 99.2) / half


def test_before_a_sensor_of_one_pixel_cells_are_no_smaller_than_they_must_be():
    """16 samples of 0.775 um, over 2 x (0.775 + 20) um: not half a pixel, which no grid allows."""
    kernels = first_kernels(bank(coma_um=0.5))
    assert cells_within(kernels, 0.775, 20.0, (0.775, 0.775), 1e-2, beyond_um=20.0)[0] == (4, 4)
    # A row of pixels as well; half its length is no cell either.
    assert cells_within(kernels, 0.775, 20.0, (31.0, 0.775), 1e-2, beyond_um=20.0)[0] == (10, 4)


def test_a_tail_that_changes_over_the_field_needs_nodes_of_its_own():
    lens = bank(fields=24)
    images, places = field_images(lens, at_lines(lens, np.ones((1, 1, 3))), 1e9)
    n = images.shape[-1]
    tail = 1 - core_window(distances_um(n, 0.5), 8.0)
    # A ring 15 um off, as bright everywhere or growing with the field.
    halo = np.abs(distances_um(n, 0.5) - 15.0) < 1.0
    halo = halo / halo.sum()
    heights = np.append(places.radius_um, places.radius_um[1])  # the last beyond the axis
    grows = (heights / places.radius_um[-1])[:, None, None, None, None] ** 2
    energy = images.sum(axis=(3, 4), keepdims=True)
    found = [
        cells_within(
            field_kernels(images + part * energy * halo, places, 0.5, 3.1, tail),
            3.1,
            40.0,
            (99.2, 74.4),
            5e-2,
            beyond_um=40.0,
        )[0]
        for part in (0.2, 0.2 * grows)
    ]
    assert max(found[0]) < min(found[1])
