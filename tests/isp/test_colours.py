"""The last stage of directional demosaicing against the reference, and all four together."""

import numpy as np
import pytest
from harness import assert_close
from isp.photographs import cpsnr_db, mosaicked, photographs
from isp.stages import F32, ULP, scene, through

from gpusim.gpu import Device, Kernel, Recording
from gpusim.isp.directional import record_directional
from gpusim.reference.colours import colours
from gpusim.reference.differences import differences
from gpusim.reference.direction import direction
from gpusim.reference.refine import refine


def spread_out(red: np.ndarray, blue: np.ndarray) -> np.ndarray:
    """Return values of pixels, of those of the red and blue sites of cells; others are 0."""
    whole = np.zeros((2 * red.shape[0], 2 * red.shape[1]))
    whole[::2, ::2], whole[1::2, 1::2] = red, blue
    return whole


@pytest.mark.parametrize("shape", [(3, 3), (20, 37), (33, 18)])
def test_colours_are_those_of_the_reference(device: Device, shape):
    rng = np.random.default_rng(shape[1])
    light = scene(2 * shape[0], 2 * shape[1], 5)
    chosen = rng.normal(0, 0.3, (*shape, 4)).astype(F32)
    chosen[..., 2:] = rng.integers(0, 2, (*shape, 2))
    refined = rng.normal(0, 0.3, (*shape, 2)).astype(F32)
    rec = Recording(device)
    given = {}
    for name, array in (("light", light), ("chosen", chosen), ("refined", refined)):
        given[name] = rec.buffer(name, array.shape, "f4")
        rec.upload(given[name], array)
    out = rec.buffer("planes", (3, *light.shape), "f4")
    kernel = Kernel("isp/colours")
    groups = kernel.cover(shape[1] - 2, shape[0] - 2)
    params = dict(zip(("rows", "cols"), shape, strict=True))
    kernel.record(rec, groups, params, **given, planes=out)
    label = rec.download(out)
    inner = (slice(None), slice(2, -2), slice(2, -2))
    expected = colours(
        light.astype(float),
        spread_out(chosen[..., 0], chosen[..., 1]),
        spread_out(refined[..., 0], refined[..., 1]),
        spread_out(chosen[..., 2], chosen[..., 3]) > 0.5,
    )
    # Sums of two dozen differences of up to 1.5, a quarter or a sixth of them; light of 1.2.
    assert_close(rec.run()[label][inner], expected[inner], atol=16 * ULP)


def by_the_references(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return planes, and where no decision within their reach is in doubt by rounding."""
    more, chosen = direction(differences(light))
    red_or_blue = np.indices(light.shape).sum(axis=0) % 2 == 0
    doubtful = (np.abs(more) < 200 * ULP) & red_or_blue
    reached = np.zeros(light.shape, bool)
    for place in np.argwhere(doubtful):
        row, col = place
        reached[max(row - 4, 0) : row + 5, max(col - 4, 0) : col + 5] = True
    along_row = more >= 0
    return colours(light, chosen, refine(chosen, along_row), along_row), ~reached


@pytest.mark.parametrize("shape", [(24, 24), (62, 98)])
def test_four_stages_are_the_references(device: Device, shape):
    light = scene(*shape, 11)
    expected, sure = by_the_references(light.astype(float))
    inner = (slice(None), slice(8, -8), slice(8, -8))
    sure = np.broadcast_to(sure, expected.shape)[inner]
    assert sure.mean() > 0.95
    found = through(device, light, record_directional)[inner]
    assert_close(found[sure], expected[inner][sure], atol=40 * ULP)


@pytest.mark.parametrize("name", ["whole", "half"])
def test_it_is_as_good_as_another_programs(device: Device, name: str):
    demosaicing = pytest.importorskip("colour_demosaicing")
    picture = photographs()[name]
    light = mosaicked(picture)
    ours = through(device, light.astype(F32), record_directional).transpose(1, 2, 0)
    theirs = demosaicing.demosaicing_CFA_Bayer_Menon2007(light, "RGGB")
    quality = [cpsnr_db(one, picture) for one in (ours, theirs)]
    print(f"{name}: CPSNR {quality[0]:.3f} dB, colour-demosaicing's Menon {quality[1]:.3f} dB")
    assert abs(quality[0] - quality[1]) < 0.05
    # Decisions between equal changes fall as rounding has it: 8 bits make many equal.
    same = np.abs(ours - theirs).max(axis=2)[12:-12, 12:-12] < 1e-5
    assert same.mean() > 0.9


@pytest.mark.parametrize("axis", [0, 1])
def test_lines_keep_their_neighbours_out(device: Device, axis: int):
    """Grey lines along an axis come out grey: the direction follows them."""
    line = np.random.default_rng(3).uniform(0.2, 0.8, 64).astype(F32)
    light = np.repeat(line[:, None], 64, axis=1)
    light = np.ascontiguousarray(light if axis else light.T)
    found = through(device, light, record_directional)[:, 8:-8, 8:-8]
    assert_close(found, np.repeat(light[None], 3, axis=0)[:, 8:-8, 8:-8], atol=16 * ULP)
