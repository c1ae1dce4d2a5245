"""Pupil: against its twin, and against closed forms of simple wavefronts and rims.

Grids are dyadic, so that cells and their places among the nodes are exact. Tolerance, in units of
u = 2^-24: the weights of the cubics take 6 roundings and their amounts add up to 1.25 at most each
way; 16 products and sums: 30 u of 1.6 times the largest node, for W and for reach. The focus term:
8 roundings of numbers of up to focus * waves per mm. Phase: 2 pi times the error of W, and what
turn leaves, 1.5e-7. Share: the edge is off by the error of reach, over its slope per cell; of the
share itself 6 u. A sum over T cells: T times that of a cell, and T u of the sum.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten, wgsl_eval
from optics.made import ULP

from gpusim.gpu import Kernel
from gpusim.gpu.wgsl import shaders_root
from gpusim.reference.pupil import edge_share, pupil

T, ROWS, NA, NB = 200, 70, 5, 28
FAR = 1e9  # um: nothing fades and nothing folds
WAVES = 1 / 512e-6


def grid(**changed: float) -> dict[str, object]:
    """Return a grid whose cells end beyond the nodes on every side, and never lie on one."""
    made = {
        "first": (1 / 128, -0.125 + 1 / 4096),
        "step": (1 / 64, 1 / 128),
        "origin": (0.0, 1 / 32),
        "cell": 3 / 2048,
        "chief": (0.0, 0.0625),
        "waves_per_mm": float(np.float32(WAVES)),
    }
    made["first"] = (made["first"][0], made["origin"][1] - 27 / 256 + 1 / 4096)
    return made | changed


def packed(grids: list[dict]) -> np.ndarray:
    rows = [
        (*one["first"], *one["step"], *one["origin"], *one["chief"], one["cell"],
         one["waves_per_mm"])
        for one in grids
    ]  # fmt: skip
    return np.array(rows, np.float32)


def on_device(nodes, grids, *, rows=ROWS, pairs=None, fade_um=None, fold_um=FAR, focus_mm=0.0,
              exponent=None, mirrored=True):  # fmt: skip
    """Return field and sums of P beams; of an even amplitude without ``exponent``."""
    count = len(grids)
    exponent = np.zeros(nodes.shape[:3]) if exponent is None else exponent
    found = run_stage(
        "psf/pupil",
        (rows, count if pairs is None else pairs, 1),
        {
            "na": nodes.shape[1],
            "fade_um": fold_um / 2 if fade_um is None else fade_um,
            "fold_um": fold_um,
            "focus_mm": focus_mm,
        },
        {
            "grids": packed(grids),
            "nodes": nodes.astype(np.float32),
            "exponent": exponent.astype(np.float32),
        },
        {
            "field": ((count, rows, T), np.complex64),
            "sums": ((count, rows, 2), np.float32),
        },
        T=T,
        NB=nodes.shape[2],
        MIRRORED=mirrored,
    )
    return found["field"], found["sums"].astype(float)


def twin(nodes, grids, *, rows=ROWS, fade_um=None, fold_um=FAR, focus_mm=0.0, mirrored=True):
    results = [
        pupil(
            one,
            **place,
            length=T,
            rows=rows,
            fade_um=fold_um / 2 if fade_um is None else fade_um,
            fold_um=fold_um,
            focus_mm=focus_mm,
            exponent=np.zeros(one.shape[:2]),
            mirrored=mirrored,
        )
        for one, place in zip(nodes.astype(np.float32), grids, strict=True)
    ]
    return tuple(np.array(part) for part in zip(*results, strict=True))


def at_nodes(place: dict) -> np.ndarray:
    """Return alpha and beta of the nodes, shape (NA, NB, 2)."""
    a, b = np.meshgrid(np.arange(NA), np.arange(NB), indexing="ij")
    return np.array(place["first"]) + np.stack([a, b], axis=-1) * np.array(place["step"])


def at_cells(place: dict) -> tuple[np.ndarray, np.ndarray]:
    alpha = place["origin"][0] + (np.arange(ROWS) + 0.5) * place["cell"]
    return alpha[:, None], place["origin"][1] + (np.arange(T) - T / 2 + 0.5) * place["cell"]


def known(place: dict) -> np.ndarray:
    """Return the cells with two nodes on every side."""
    alpha, beta = at_cells(place)
    x, y = (
        (alpha - place["first"][0]) / place["step"][0],
        (beta - place["first"][1]) / place["step"][1],
    )
    return (x < NA - 2) & (y >= 1) & (y < NB - 2)


def amplitude_bound(w: float, focus_waves: float = 0.0) -> float:
    return 2 * np.pi * (30 * ULP * 1.6 * w + 8 * ULP * focus_waves) + 2e-7


def noise(seed: int, count: int = 2) -> np.ndarray:
    """Return nodes of which no two are alike, W to 2 waves, all well inside the rim."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [rng.uniform(-2, 2, (count, NA, NB)), rng.uniform(0.2, 0.4, (count, NA, NB))], axis=-1
    )


TWO = [grid(), grid(cell=5 / 4096, origin=(0.0, -3 / 64), first=(1 / 128, -5 / 32 + 1 / 4096))]


def test_fields_are_those_of_the_reference():
    nodes = noise(1)
    found, sums = on_device(nodes, TWO)
    expected, expected_sums = twin(nodes, TWO)
    bound = amplitude_bound(2.0)
    assert_close(found, expected, atol=bound)
    assert_close(sums, expected_sums, atol=0)  # whole cells: integers
    for lit, place in zip(expected, TWO, strict=True):
        assert_close((lit != 0).astype(int), known(place).astype(int), atol=0)
        assert 0 < known(place).mean() < 1
    # A wavefront off by 1e-4 of its nodes is out of tolerance.
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(on_device(nodes * [1.0001, 1], TWO)[0], expected, atol=bound)


def test_more_nodes_than_invocations_amid_the_cells():
    """A third of the cells lies before the nodes, a sixth beyond; beta's steps are not alpha's."""
    rng = np.random.default_rng(11)
    nodes = np.stack([rng.uniform(-2, 2, (1, NA, 70)), rng.uniform(0.2, 0.4, (1, NA, 70))], axis=-1)
    place = grid(first=(1 / 128, 1 / 4096), step=(1 / 64, 1 / 512))
    found, sums = on_device(nodes, [place])
    expected, expected_sums = twin(nodes, [place])
    lit = np.flatnonzero((expected[0] != 0).any(axis=0))
    assert 64 < lit[0] < 90 and 160 < lit[-1] < 180
    assert_close(found, expected, atol=amplitude_bound(2.0))
    assert_close(sums, expected_sums, atol=0)  # whole cells: integers


def test_cubics_are_met_exactly():
    # Even in alpha, so that the mirrored half continues it.
    place = grid()
    a, b = np.moveaxis(at_nodes(place) / 0.1, -1, 0)
    nodes = np.stack([0.5 - a * a + 0.4 * b**3 - 0.3 * a * a * b + b, 0 * a + 0.3], axis=-1)[None]
    a, b = (one / 0.1 for one in at_cells(place))
    w = 0.5 - a * a + 0.4 * b**3 - 0.3 * a * a * b + b
    inside = known(place)
    found = on_device(nodes, [place])[0][0]
    # The nodes themselves are rounded: 2^-24 of them, 1.6 times.
    assert_close(found[inside], np.exp(2j * np.pi * w)[inside], atol=amplitude_bound(3.5) + 2e-6)


@pytest.mark.parametrize("focus_mm", [0.02, -0.05])
def test_a_shift_of_the_image_plane(focus_mm: float):
    nodes = noise(2)
    found, _ = on_device(nodes, TWO, focus_mm=focus_mm)
    expected, _ = twin(nodes, TWO, focus_mm=float(np.float32(focus_mm)))
    assert_close(found, expected, atol=amplitude_bound(2.0, abs(focus_mm) * WAVES))


def test_a_focused_beam_far_off_axis():
    # A field of 60 deg in the image, and cells beyond alpha^2 + beta^2 = 1, where gamma ends.
    place = grid(
        origin=(0.0, 0.984375),
        cell=1 / 2048,
        chief=(0.0, 0.875),
        first=(1 / 128, 0.875 + 1 / 4096),
    )
    nodes = noise(3, 1)
    found, _ = on_device(nodes, [place], focus_mm=0.02)
    expected, _ = twin(nodes, [place], focus_mm=float(np.float32(0.02)))
    alpha, beta = at_cells(place)
    gamma2 = 1 - alpha**2 - beta**2
    assert (gamma2[known(place)] < 0).any()
    # gamma carries the rounding of 1 - dot over 2 gamma, which is 1e-3 at least.
    gamma = np.sqrt(np.maximum(gamma2, 1e-6))
    loss = 2 * np.pi * 0.02 * WAVES * ULP * np.where(gamma2 < 2e-6, 1, 1 / gamma)
    assert_close(found, expected, atol=(amplitude_bound(2.0, 3 * 0.02 * WAVES) + 2 * loss)[None])


@pytest.mark.parametrize("focus_mm", [0.0, 0.02])
def test_a_whole_pupil_about_any_direction(focus_mm: float):
    """Rows begin before the nodes and end beyond them; the chief ray leans both ways."""
    rng = np.random.default_rng(14)
    shape = (2, 12, NB)
    nodes = np.stack([rng.uniform(-2, 2, shape), rng.uniform(0.2, 0.4, shape)], axis=-1)
    whole = {"origin": (-3 / 128, 1 / 32), "chief": (-0.125, 0.0625), "step": (1 / 256, 1 / 128)}
    first = 1 / 32 - 27 / 256 + 1 / 4096
    places = [grid(**whole, first=(-1 / 64 + 1 / 8192, first))]
    places.append(grid(**whole | {"chief": (0.25, 0.0)}, first=(1 / 32 + 1 / 8192, first)))
    for place in places:
        place["first"] = (place["first"][0], first)
    given = {"mirrored": False, "focus_mm": float(np.float32(focus_mm))}
    found, sums = on_device(nodes, places, **given)
    expected, expected_sums = twin(nodes, places, **given)
    bound = amplitude_bound(2.0, 2 * focus_mm * WAVES)
    assert_close(found, expected, atol=bound)
    assert_close(sums, expected_sums, atol=0)  # whole cells: integers
    for lit in expected != 0:
        rows = np.flatnonzero(lit.any(axis=1))
        assert rows[0] > 0 and rows[-1] < ROWS - 1
    # As half of one, and with the other beam's chief ray, it is out of tolerance.
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(on_device(nodes, places, focus_mm=focus_mm)[0], expected, atol=bound)
    if focus_mm:
        leant = [place | {"chief": (0.0, 0.0625)} for place in places]
        with pytest.raises(AssertionError, match="elements are bad"):
            assert_close(on_device(nodes, leant, **given)[0], expected, atol=bound)


@pytest.mark.parametrize("place", [(1, 9), (0, 20), (4, 3), (2, 27)])
def test_a_missing_node_is_dark_around_it(place: tuple[int, int]):
    nodes = noise(4)
    nodes[1][place][1] = 0.0
    found, sums = on_device(nodes, TWO)
    expected, expected_sums = twin(nodes, TWO)
    assert_close(found, expected, atol=amplitude_bound(2.0))
    assert_close(sums, expected_sums, atol=0)
    alpha, beta = at_cells(TWO[1])
    x = (alpha - TWO[1]["first"][0]) / TWO[1]["step"][0]
    y = (beta - TWO[1]["first"][1]) / TWO[1]["step"][1]
    near = (np.minimum(abs(x - place[0]), abs(x + 1 + place[0])) < 2) & (abs(y - place[1]) < 2)
    assert near[known(TWO[1])].any()
    assert (found[1][near] == 0).all()
    assert (found[1][known(TWO[1]) & ~near] != 0).all()


def rim_bound(slope_per_cell: float, reach: float) -> float:
    return 30 * ULP * 1.6 * reach / slope_per_cell + 6 * ULP


@pytest.mark.parametrize("degrees", [0, 0.01, 20, 45, 77, 90, 150, 180, 200, 270])
def test_a_straight_rim(degrees: float):
    place = grid()
    turn = np.radians(degrees)
    # One along alpha would not be the mirror of itself: keep it away from alpha = 0.
    middle = np.array([0.03, 1 / 32])
    normal = np.array([np.cos(turn), np.sin(turn)]) * 20
    nodes = noise(5, 1) * [0, 0]
    nodes[..., 1] = 1.2 + (at_nodes(place) - middle) @ normal
    nodes[..., 1] = np.maximum(nodes[..., 1], 0.01)
    found, sums = on_device(nodes, [place])
    expected, expected_sums = twin(nodes, [place])
    # Slopes of the interpolated, cut plane stay above half of the plane's where reach is near 1.
    bound = rim_bound(0.5 * 20 * place["cell"] * 0.7, 3.0)
    assert_close(found, expected, atol=bound)
    assert_close(sums, expected_sums, atol=T * bound + T * ULP * sums.max())
    partly = (expected.real > 0.01) & (expected.real < 0.99)
    assert partly.sum() > 10
    for planted in (np.round(expected.real), expected.real - 0.01 * partly):
        with pytest.raises(AssertionError, match="elements are bad"):
            assert_close(planted, expected.real, atol=bound)


def test_a_disc_covers_its_area():
    place = grid(first=(1 / 128, 1 / 32 - 27 / 256))
    radius = 0.0475
    a, b = np.moveaxis(at_nodes(place) - [0, 1 / 32], -1, 0)
    nodes = np.stack([0 * a, (a * a + b * b) / radius**2], axis=-1)[None]
    _, sums = on_device(nodes, [place])
    # The edge is straight by the slopes at the middle of its cell, and misses d^2 / (2 r) where it
    # is d away; d^2 is cell^2 / 6 in the mean over a square. 2 pi r of that, of pi r^2:
    excess = (place["cell"] / radius) ** 2 / 6
    area = 2 * sums[0, :, 0].sum() * place["cell"] ** 2
    assert area / (np.pi * radius**2) - 1 == pytest.approx(excess, rel=0.1)
    assert excess == pytest.approx(1.6e-4, rel=0.01)


def test_rims_of_two_apertures():
    place = grid()
    a, b = np.moveaxis(at_nodes(place) - [0, 1 / 32], -1, 0)
    one = (a * a + (b + 0.02) ** 2) / 0.06**2
    other = (a * a + (b - 0.03) ** 2) / 0.07**2
    nodes = np.stack([0 * a + 0.25, np.maximum(one, other)], axis=-1)[None]
    found, sums = on_device(nodes, [place])
    expected, expected_sums = twin(nodes, [place])
    # Slopes at rims 2 / r; where they meet, at 80 deg, half of that is left.
    bound = rim_bound(place["cell"] / 0.07, 8.0) + amplitude_bound(0.25)
    assert_close(found, expected, atol=bound)
    assert_close(sums, expected_sums, atol=T * bound)
    assert 0.3 < sums[..., 0].sum() * 2 * place["cell"] ** 2 / (np.pi * 0.06**2) < 0.9


def filtered_bound(exponent: float) -> float:
    """Return what exp adds to a share: the error of the exponent, and (3 + 2 |x|) u of itself."""
    return 30 * ULP * 1.6 * exponent + (4 + 2 * exponent) * ULP


def test_an_exponent_darkens_the_rim():
    place = grid()
    a, b = np.moveaxis(at_nodes(place) - [0, 1 / 32], -1, 0)
    nodes = np.stack([0 * a + 0.25, (a * a + b * b) / 0.05**2], axis=-1)[None]
    exponent = 1.5 * (a * a + (b - 0.01) ** 2)[None] / 0.05**2  # not about the rim's middle
    found, sums = on_device(nodes, [place], exponent=exponent)
    field, light = pupil(
        nodes[0].astype(np.float32), **place, length=T, rows=ROWS, fade_um=FAR / 2, fold_um=FAR,
        focus_mm=0.0, exponent=exponent[0].astype(np.float32),
    )  # fmt: skip
    bound = rim_bound(place["cell"] / 0.05, 4.0) + amplitude_bound(0.25) + filtered_bound(3.0)
    assert_close(found[0], field, atol=bound)
    assert_close(sums[0], light, atol=2 * T * bound)
    # Amplitude at the cells within, from the equation; the light is its square.
    alpha, beta = at_cells(place)
    inside = (alpha**2 + (beta - 1 / 32) ** 2) < (0.05 - place["cell"]) ** 2
    exact = np.exp(-1.5 * (alpha**2 + (beta - 1 / 32 - 0.01) ** 2) / 0.05**2)
    assert_close(np.abs(found[0][inside]).astype(float), exact[inside], atol=bound)
    assert (exact[inside] < 0.3).any()
    even, _ = on_device(nodes, [place])
    with pytest.raises(AssertionError, match="elements are bad"):
        assert_close(even[0], field, atol=bound)


def test_light_that_a_filter_stops_does_not_fold_either():
    place = grid()
    nodes = tilted(place, (0, 200.0))
    exponent = np.full((1, NA, NB), 0.5)
    _, sums = on_device(nodes, [place], fold_um=100.0, exponent=exponent)
    assert_close(sums[..., 1], sums[..., 0].copy(), atol=0)
    _, even = on_device(nodes, [place], fold_um=100.0)
    # The filter leaves exp(-2 x 0.5) of the light, in T sums of it.
    expected = np.exp(-1.0) * even
    assert_close(sums, expected, atol=T * filtered_bound(1.0) + T * ULP * even.max())


def test_more_light_than_about_the_chief_ray_is_a_negative_exponent():
    place = grid()
    nodes = np.stack([np.zeros((NA, NB)), np.full((NA, NB), 0.5)], axis=-1)[None]
    found, _ = on_device(nodes, [place], exponent=np.full((1, NA, NB), -0.25))
    lit = found[0] != 0
    assert lit.any()
    exact = np.full(lit.sum(), np.exp(0.25))
    assert_close(np.abs(found[0][lit]).astype(float), exact, atol=1.3 * filtered_bound(0.25))


def tilted(place: dict, landing_um: tuple[float, float]) -> np.ndarray:
    """Return nodes of a wavefront all of whose rays land at one point, in x and y."""
    waves = -at_nodes(place) @ np.array(landing_um) * 1e-3 * place["waves_per_mm"]
    return np.stack([waves, 0 * waves + 0.5], axis=-1)[None]


@pytest.mark.parametrize("landing", [(150.0, 0), (-150.0, 0), (0, 150.0), (0, -150.0)])
def test_rays_beyond_the_fold_are_counted(landing):
    place = grid()
    nodes = tilted(place, landing)
    # A tilt in alpha has a kink at alpha = 0: rows two nodes away from it do not see it.
    clear = slice(25, ROWS)
    for fold, share in ((149.9, 1.0), (150.1, 0.0)):
        _, sums = on_device(nodes, [place], fold_um=fold)
        assert sums[0, clear, 0].sum() > 0
        assert_close(sums[0, clear, 1], share * sums[0, clear, 0], atol=0)


@pytest.mark.parametrize("focus_mm", [1.0, -1.0])
def test_what_folds_follows_the_image_plane(focus_mm: float):
    nodes = noise(6) * [0.1, 1]
    _, sums = on_device(nodes, TWO, fold_um=60.0, focus_mm=focus_mm)
    # The slope is off by less than 1e-4 of 60 um.
    _, fewer = twin(nodes, TWO, fold_um=60.006, focus_mm=focus_mm)
    _, more = twin(nodes, TWO, fold_um=59.994, focus_mm=focus_mm)
    assert (fewer <= sums).all()
    assert (sums <= more).all()
    assert (more - fewer).sum() <= 4
    assert 0.1 < sums[..., 1].sum() / sums[..., 0].sum() < 0.9
    _, planted = on_device(nodes, TWO, fold_um=61.0, focus_mm=focus_mm)
    assert not (fewer <= planted).all()


@pytest.mark.parametrize("landing", [(0, 150.0), (0, -150.0), (0, 199.0), (0, 201.0), (0, 99.0)])
def test_rays_fade_towards_the_fold(landing):
    place = grid()
    nodes = tilted(place, landing)
    found, sums = on_device(nodes, [place], fade_um=100.0, fold_um=200.0)
    lit = known(place)
    # The quintic that leads from 1 to 0 with two derivatives of 0: t^3 (10 - 15 t + 6 t^2) less.
    t = np.clip(abs(landing[1]) / 100 - 1, 0, 1)
    kept = 1 - t**3 * (10 - 15 * t + 6 * t * t)
    # The landing is W's slope: 30 u of 1.6 times nodes of up to 53 waves, over a node's step of
    # 15 waves/mm, is 1e-2 um at most; the quintic's slope is 1.9 / 100 um at most: 2e-4. Half of
    # that is held.
    assert_close(np.abs(found[0][lit]).astype(float), np.full(lit.sum(), kept), atol=1e-4)
    # The light is all of it, wherever it lands.
    assert_close(sums[0, :, 0], on_device(nodes, [place])[1][0, :, 0], atol=0)
    late, _ = on_device(nodes, [place], fade_um=101.0, fold_um=200.0)
    if 0.01 < kept < 0.99:
        assert np.abs(np.abs(late[0][lit]) - kept).min() > 1e-3


def test_fading_is_that_of_the_reference_in_both_directions():
    nodes = noise(12) * [0.1, 1]
    given = {"fade_um": 20.0, "fold_um": 60.0, "focus_mm": 1.0}
    found, _ = on_device(nodes, TWO, **given)
    expected, _ = twin(nodes, TWO, **given)
    # Landings err by 6 nm (below), and the quintic's slope is 1.9 / 40 um: 3e-4.
    assert_close(found, expected, atol=amplitude_bound(0.2, WAVES) + 3e-4)
    with pytest.raises(AssertionError, match="elements are bad"):
        none = twin(nodes, TWO, focus_mm=1.0)[0]
        assert_close(found, none, atol=amplitude_bound(0.2, WAVES) + 3e-4)


def test_the_folded_part_of_a_cell_on_the_rim_is_its_share():
    place = grid()
    nodes = tilted(place, (0, 200.0))
    a, b = np.moveaxis(at_nodes(place) - [0, 1 / 32], -1, 0)
    nodes[..., 1] = (a * a + b * b) / 0.05**2
    _, sums = on_device(nodes, [place], fold_um=100.0)
    assert_close(sums[..., 1], sums[..., 0].copy(), atol=0)
    assert (sums[..., 0] % 1 != 0).any()


def test_a_beam_that_is_not_dispatched_is_left_alone():
    field, sums = on_device(noise(7), TWO, pairs=1)
    assert unwritten(field[1]).all()
    assert not unwritten(field[0]).any()
    assert not np.isnan(sums[0]).any()
    assert np.isnan(sums[1]).all()


def source(name: str) -> str:
    """Return one function of the shader."""
    text = (shaders_root() / "psf/pupil.wgsl").read_text()
    start = text.index(f"fn {name}(")
    return text[start : text.index("\n}", start) + 2]


def test_the_share_of_a_cell():
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(2, 4000)) * 10.0 ** rng.uniform(-6, 1, (2, 4000))
    h = rng.uniform(-0.6, 0.6, 4000) * (abs(a) + abs(b))
    special = [
        (0, 0, 0), (1, 0, 0), (-1, 0, 0), (0.5, 1, 0), (-0.5, 1, 0), (0.5, 0, 1), (0.25, 0, -1),
        (0.25, 1, 0), (0, 1, 1), (0, 1, 0), (1, 1, 1), (-1, 1, 1), (0.5, 1, 1), (0.25, 1, 0.5),
        (0.4999999, 1, 1e-30),
    ]  # fmt: skip
    h, a, b = np.concatenate([np.stack([h, a, b]), np.transpose(special)], axis=1)
    h, a, b = (one.astype(np.float32) for one in (h, a, b))
    inputs = {"h": ("f32", h), "a": ("f32", a), "b": ("f32", b)}
    found = wgsl_eval(
        [], "half_plane_share(h, a, b)", inputs, declarations=source("half_plane_share")
    )
    expected = np.array([edge_share(*map(float, one)) for one in zip(h, a, b, strict=True)])
    # The edge's place, three roundings of numbers of up to (|a| + |b|) / 2, over the wider slope.
    assert_close(found, expected, atol=6 * ULP)


def test_the_twins_share_is_the_area():
    u = (np.arange(400) + 0.5) / 400 - 0.5
    rng = np.random.default_rng(9)
    for h, a, b in [*rng.normal(size=(30, 3)), (0.2, 1, 0), (0.2, 0, -1), (-0.3, 1e-12, 1)]:
        counted = (a * u[:, None] + b * u < h).mean()
        # A line crosses at most 800 of the 160000 sub-cells, each counted wrong by half at most.
        assert edge_share(h, a, b) == pytest.approx(counted, abs=2.5e-3)


def test_weights_and_slopes_are_those_of_four_nodes():
    t = np.linspace(0, 1, 257)
    for name, order in (("weights", 0), ("slopes", 1)):
        found = wgsl_eval(
            [], f"{name}(t)", {"t": ("f32", t)}, returns="vec4f", declarations=source(name)
        )
        exact = np.empty((257, 4))
        for place in range(4):
            cubic = np.polynomial.Polynomial.fit((-1, 0, 1, 2), np.eye(4)[place], 3)
            exact[:, place] = cubic.deriv(order)(t) if order else cubic(t)
        # Sums of three terms of up to 1.5; eight roundings.
        assert_close(found.astype(float), exact, atol=8 * 1.5 * ULP)


def test_the_defaults_are_of_one_grid():
    made = Kernel("psf/pupil")
    assert made.overrides == {"T": 1024, "NB": 128, "MIRRORED": True}
    assert made.workgroup_size == (64, 1, 1)
