"""The map of a lens without symmetry: closed forms, chief rays that took no part, refusals."""

import dataclasses

import numpy as np
import pytest
from harness import assert_close
from optics.made import plane_bank

from gpusim.errors import UserError
from gpusim.lens.projection import ANGULAR
from gpusim.psf.plane_map import FIT_ERROR_UM, MAP_ERROR_UM, MOST_CELLS, PlaneMap, Rings

# The maps' directions differ in x and y, and so do all numbers.
KEYSTONE, SHIFT = (0.08, -0.03), (7.0, -4.0)


def closed_form(ideal: np.ndarray, distortion: float = -0.02, circle_um: float = 165.0):
    """Return real points of ideal ones (..., 2): written again from the docstring of the lens."""
    x, y = ideal[..., 0], ideal[..., 1]
    grown = 1 + distortion * (x * x + y * y) / circle_um**2
    grown += (KEYSTONE[0] * x + KEYSTONE[1] * y) / circle_um
    return np.stack([x * grown + SHIFT[0], y * grown + SHIFT[1]], axis=-1)


@pytest.fixture(scope="module")
def bank():
    return plane_bank(keystone=KEYSTONE, boresight_um=SHIFT)


def ideal_points(count: int = 400, within: float = 0.85) -> np.ndarray:
    rng = np.random.default_rng(8)
    r, turn = 165.0 * within * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    return np.stack([r * np.cos(turn), r * np.sin(turn)], axis=-1)


def test_it_leads_from_the_real_to_the_ideal_plane(bank):
    ideal = ideal_points()
    real = closed_form(ideal)
    u, v, inside = bank.ideal_points(real[:, 0], real[:, 1])
    assert inside.all()
    assert_close(np.stack([u, v], axis=-1), ideal, atol=1.5 * FIT_ERROR_UM)  # between the rays
    assert 8 <= len(bank.plane_map.net) - 3 < MOST_CELLS
    assert bank.plane_map.error_um < MAP_ERROR_UM
    # The control: what the keystone does, x for y or of the other sign.
    assert np.abs(closed_form(ideal[:, ::-1])[:, ::-1] - real).max() > 1
    assert np.abs(closed_form(-ideal) + real).max() > 1


def test_the_jacobian_is_that_of_the_map(bank):
    plane = bank.plane_map
    line = np.linspace(-1, 1, 33)
    z = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    z = z[np.hypot(*z.T) <= 1]
    found = plane.jacobian()
    assert found.shape == (len(z), 2, 2)
    inner = np.hypot(*z.T) < 0.99  # differences reach beyond the rim else
    real = z[inner] * plane.radius_um + plane.centre_um
    for axis in (0, 1):
        step = 0.1 * np.eye(2)[axis]
        ahead, behind = (
            np.stack(plane.ideal_points(*(real + way * step).T)[:2], axis=-1) for way in (1, -1)
        )
        # Error of a central difference: step^2 u''' / 6, with u''' = 6e-5 um^-2 or less.
        assert_close(found[inner][:, :, axis], (ahead - behind) / 0.2, atol=2e-7)


def test_beyond_the_circle_it_is_the_rims(bank):
    x, y = bank.centre_um
    turn = np.linspace(0, 6, 17)
    near, far = (
        bank.ideal_points(x + r * np.cos(turn), y + r * np.sin(turn))
        for r in np.array([1.0, 3.0]) * bank.image_circle_um * (1 - 1e-12)
    )
    assert near[2].all() and not far[2].any()
    assert_close(np.stack(far[:2]), np.stack(near[:2]), atol=1e-6)


def test_the_circle_is_the_largest_that_the_fields_fill(bank):
    assert bank.centre_um == SHIFT
    turn = np.linspace(0, 2 * np.pi, 721)
    rim = closed_form(165.0 * np.stack([np.cos(turn), np.sin(turn)], axis=-1))
    least = np.hypot(*(rim - SHIFT).T).min()
    # 16 spokes: between them the rim comes nearer by at most 4 % (1 - cos 11.25 deg), keystone's.
    assert bank.image_circle_um == pytest.approx(least, rel=0.085 * (1 - np.cos(np.pi / 16)))
    assert bank.rectilinear_circle_um == bank.image_circle_um


def test_fields_are_found_where_they_land(bank):
    for row, col in ((4, 4), (2, 5), (6, 3), (4, 1)):
        x = bank.chief_x_um[row, col, bank.reference]
        y = bank.chief_y_um[row, col, bank.reference]
        found = bank.field_deg(x, y)
        # 1000 um of focal length: a thousandth of a micrometre is 6e-5 deg.
        assert_close(np.array(found), [bank.field_x_deg[col], bank.field_y_deg[row]], atol=1e-4)


def test_illumination_is_bicubic_over_the_fields(bank):
    row, col = 3, 5
    corner = [
        (bank.chief_x_um[r, c, 1], bank.chief_y_um[r, c, 1], bank.relative_illumination[r, c])
        for r in (row, row + 1)
        for c in (col, col + 1)
    ]
    x, y, light = (np.array(one) for one in zip(*corner, strict=True))
    assert_close(bank.illumination_at(x, y), light.T, atol=1e-4)
    middle = bank.illumination_at(x.mean(keepdims=True), y.mean(keepdims=True))[:, 0]
    # It falls with the square of tan(theta), of which bicubics in angle miss 1e-5: see
    # optics/test_kernels.
    angle = np.radians(np.hypot(*bank.field_deg(x.mean(), y.mean())))
    expected = 1 - 0.3 * (1e3 * np.tan(angle) / 165.0) ** 2 * np.array([1.0, 1.05, 1.1])
    assert_close(middle, expected, atol=5e-5)
    assert np.abs(light.mean(axis=0) - expected).max() > 5e-3  # a control: the bilinear mean


def test_only_the_fields_that_are_needed_are_taken(bank):
    whole, grid = bank.places(1e9)
    assert whole == tuple(range(81)) and len(grid.x_deg) == 9
    few, grid = bank.places(20.0)  # and 16 um of the PSFs' half width
    assert 9 <= len(few) < 49
    assert_close(grid.x_deg, bank.field_x_deg[np.isin(bank.field_x_deg, grid.x_deg)], atol=0)
    # The places' numbers are those of the bank: the field that lies at a point.
    for at in grid.probes:
        number = few[at]
        row, col = divmod(number, 9)
        angles = (bank.field_x_deg[col], bank.field_y_deg[row])
        assert angles == (grid.x_deg[at % len(grid.x_deg)], grid.y_deg[at // len(grid.x_deg)])
        shift = bank.field(number).shift_um
        assert_close(shift[:, 0], bank.chief_x_um[row, col] - bank.chief_x_um[row, col, 1], atol=0)
        assert_close(shift[:, 1], bank.chief_y_um[row, col] - bank.chief_y_um[row, col, 1], atol=0)


def test_blends_are_bicubic_and_nothing_is_turned(bank):
    _, grid = bank.places(1e9)
    x, y = bank.chief_x_um[5, 3, 1], bank.chief_y_um[5, 3, 1]
    blend = grid.at(x, y)
    assert (blend.cos, blend.sin) == (1.0, 0.0)
    shares = dict.fromkeys(blend.fields, 0.0)
    for field, weight in zip(blend.fields, blend.weights, strict=True):
        shares[field] += weight
    assert shares[5 * 9 + 3] == pytest.approx(1, abs=1e-4)
    ahead = grid.at(0.7 * x + 0.3 * bank.chief_x_um[5, 4, 1], y)
    columns = [
        sum(w for f, w in zip(ahead.fields, ahead.weights, strict=True) if f % 9 == col)
        for col in (2, 3, 4, 5)
    ]
    # Lagrange's at 0.3 from the second: -t (t - 1) (t - 2) / 6 and so on.
    assert columns == pytest.approx([-0.0595, 0.7735, 0.3315, -0.0455], abs=0.02)
    assert sum(ahead.weights) == pytest.approx(1)
    assert len(ahead.fields) == 16


def test_rays_that_tell_of_no_smooth_map_are_refused(bank):
    rough = bank.ray_x_um + np.where(np.arange(len(bank.ray_x_um)) % 2, 0.05, 0.0)
    with pytest.raises(UserError, match="not smooth enough") as caught:
        _ = dataclasses.replace(bank, ray_x_um=rough).plane_map
    assert "um are open" in caught.value.value and caught.value.field == "max_field_deg"


def rings(count: int = 12, spokes: int = 20, start: float = 0.4, turn: int = 1) -> np.ndarray:
    """Return fields x, y of rays: (0, 0), then rings to 10 deg."""
    azimuth = start + turn * 2 * np.pi * np.arange(spokes) / spokes
    way = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    angles = 10.0 * np.sin(np.pi / 2 * np.arange(1, count + 1) / count)
    return np.concatenate([np.zeros((1, 2)), (angles[:, None, None] * way).reshape(-1, 2)])


def wavy(field_deg: np.ndarray) -> np.ndarray:
    """Return real points (M, 2) of fields, um: barrel, shear and coma, in no simple function."""
    x, y = field_deg.T / 10
    bend = 1 - 0.1 * (x * x + y * y) + 0.01 * np.cos(2 * x - y)
    return np.stack([100 * x * bend + 8 * y + 3, 100 * y * bend - 4 * x * x - 2], axis=-1)


@pytest.mark.parametrize(("start", "turn"), [(0.4, 1), (-2.0, 1), (0.0, -1)])
def test_rings_tell_of_every_field(start: float, turn: int):
    fields = rings(start=start, turn=turn)
    told = Rings(fields, wavy(fields))
    theta, azimuth = np.radians(np.linspace(0.3, 10, 9)), np.linspace(-4, 4, 11)
    found = told(theta, azimuth)
    way = np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1)
    expected = wavy((np.degrees(theta)[:, None, None] * way).reshape(-1, 2)).reshape(9, 11, 2)
    assert_close(found, expected, atol=told.error_um)
    assert 1e-7 < told.error_um < MAP_ERROR_UM
    # Fewer rings, or directions, leave more open: and say so.
    for few in (rings(5, 20), rings(12, 8)):
        less = Rings(few, wavy(few))
        off = np.abs(less(theta, azimuth) - expected).max()
        assert off < less.error_um and 3 * told.error_um < less.error_um


def test_a_map_of_another_projection_has_its_heights():
    fields = rings()
    real = wavy(fields)
    circle = (float(real[0, 0]), float(real[0, 1]))
    radius = np.hypot(*(real[-20:] - real[0]).T).min()
    inner = np.hypot(*(real - real[0]).T) < 0.999 * radius
    for height in (np.tan, ANGULAR.height):
        plane = PlaneMap(fields, real, lambda theta, h=height: 1e3 * h(theta), circle, radius)
        theta = np.radians(np.hypot(*fields.T))
        expected = 1e3 * (height(theta) / np.maximum(np.degrees(theta), 1e-9))[:, None] * fields
        found = np.stack(plane.ideal_points(*real.T)[:2], axis=-1)
        assert_close(found[inner], expected[inner], atol=plane.error_um + FIT_ERROR_UM)
    assert np.abs(1e3 * np.tan(theta) - 1e3 * theta).max() > 1  # the two do differ


def test_rays_that_are_no_rings_are_refused():
    fields = rings()
    for wrong in (fields[:-1], fields + 0.01, np.roll(fields, 5, axis=0), rings(3), rings(8, 3)):
        with pytest.raises(UserError, match="no rings"):
            Rings(wrong, wavy(wrong))


def test_a_map_that_folds_is_refused():
    """Fields that move outwards and back again: two of them meet in one image point."""
    fields = rings(20, 16)
    x, y = fields.T / 10
    for folds, back in ((True, 0.6), (False, 0.2)):
        real = 100 * np.stack([x - back * x * x, y], axis=-1)  # slope 1 - 2 back at the rim
        circle, radius = (0.0, 0.0), 100 * (1 - back)
        given = fields, real, lambda theta: 570 * np.tan(theta), circle, radius
        if folds:
            with pytest.raises(UserError, match="folds the image over"):
                PlaneMap(*given)
        else:
            assert PlaneMap(*given).error_um < 0.1
