"""Blur: the whole against a sum over every sample, and what it refuses.

Tolerance: the error of a transform goes with the root mean square of what it transforms. For images
between 0 and 1 and PSFs of unit sum, at most eight roundings of 2^-24 of the largest result are to
be expected (five transforms of 7 levels, random roundings); 1e-6 of the peak is the design's bar.
"""

import numpy as np
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.optics.blur import Blur, blur, straight_through

BAR = 1e-6


def made(nodes: tuple[int, int], channels: int, size: int) -> np.ndarray:
    """Return PSFs of unit sum, lopsided and different everywhere."""
    rng = np.random.default_rng(size)
    psfs = rng.random((*nodes, channels, size, size)) ** 4
    return psfs / psfs.sum(axis=(-1, -2), keepdims=True)


def scattered(image: np.ndarray, psfs: np.ndarray, spacing: int) -> np.ndarray:
    """Spread every sample by its own PSF, in float64."""
    channels, rows, cols = image.shape
    half = psfs.shape[-1] // 2
    out = np.zeros((channels, rows + 2 * half, cols + 2 * half))
    for y in range(rows):
        i, t = divmod((y + 0.5) / spacing, 1)
        above, below = psfs[int(i)], psfs[int(i) + 1]
        for x in range(cols):
            j, s = divmod((x + 0.5) / spacing, 1)
            j = int(j)
            left = (1 - t) * above[j] + t * below[j]
            right = (1 - t) * above[j + 1] + t * below[j + 1]
            psf = (1 - s) * left + s * right
            part = np.s_[:, y : y + 2 * half + 1, x : x + 2 * half + 1]
            out[part] += image[:, y, x, None, None].astype(float) * psf
    return out[:, half : half + rows, half : half + cols]


@pytest.mark.parametrize(
    ("shape", "spacing", "size"),
    [((128, 128), 128, 31), ((90, 201), 160, 9), ((1, 130), 80, 31), ((83, 80), 80, 63)],
)
def test_every_sample_is_spread_by_its_own_psf(shape: tuple[int, int], spacing: int, size: int):
    nodes = tuple(-(-side // spacing) + 1 for side in shape)
    psfs = made(nodes, 2, size)
    image = np.random.default_rng(1).random((2, *shape), np.float32)
    expected = scattered(image, psfs, spacing)
    assert_close(blur(image, psfs, spacing), expected, atol=BAR * expected.max())


def test_channels_that_do_not_fit_a_binding_come_one_after_another(monkeypatch):
    psfs = made((2, 2), 5, 31)
    image = np.random.default_rng(3).random((5, 80, 80), np.float32)
    whole = Blur(psfs, (80, 80), 80)
    assert len(whole.turns) == 1
    monkeypatch.setattr("gpusim.optics.blur.MAX_BINDING_BYTES", 2 * 8 * 81 * 2 * 80)
    parts = Blur(psfs, (80, 80), 80)
    assert [len(turn) for turn in parts.turns] == [2, 2, 1]
    np.testing.assert_array_equal(parts(image), whole(image))
    whole.release()
    parts.release()


def test_a_point_lands_as_its_psf_not_mirrored():
    psfs = made((2, 2), 1, 31)
    psfs[:] = psfs[0, 0]
    image = np.zeros((1, 64, 64), np.float32)
    image[0, 20, 40] = 1
    found = blur(image, psfs, 128)[0, 5:36, 25:56]
    assert_close(found, psfs[0, 0, 0], atol=BAR * psfs.max())


def test_it_is_kept_for_the_next_image():
    psfs = made((2, 2), 1, 31)
    kept = Blur(psfs, (40, 40), 80)
    image = np.random.default_rng(2).random((1, 40, 40), np.float32)
    first = kept(image)
    np.testing.assert_array_equal(kept(2 * image), 2 * first)
    kept.release()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"psfs": np.ones((2, 2, 1, 4, 4))}, "odd and square"),
        ({"psfs": np.ones((2, 2, 1, 3, 5))}, "odd and square"),
        ({"psfs": np.ones((2, 2, 1, 83, 83))}, "at most 81"),
        ({"psfs": np.ones((1, 2, 1, 3, 3))}, "2 x 2 nodes"),
        ({"psfs": np.full((2, 2, 1, 3, 3), np.nan)}, "finite"),
        ({"spacing": 82}, "multiple of 4"),
        ({"spacing": 164}, "the side of a block"),
        ({"image": np.ones((1, 81, 80))}, "80 x 80"),
        ({"image": np.full((1, 80, 80), np.inf)}, "finite"),
        ({"image": np.ones((2, 80, 80))}, "(1, 80, 80)"),
    ],
)
def test_bad_input_is_named(change: dict, says: str):
    given = {"image": np.ones((1, 80, 80)), "psfs": np.ones((2, 2, 1, 3, 3)), "spacing": 80}
    with pytest.raises(UserError) as caught:
        blur(**{**given, **change})
    assert says in caught.value.screen()


def test_nodes_go_straight_through_on_mesa_22_alone():
    assert straight_through("Mesa 22.3.6 (LLVM 15.0.6)")
    for driver in ("Mesa 25.0.7-2~bpo12+1 (LLVM 15.0.6)", "Mesa 220.1", "driver of no name"):
        assert not straight_through(driver)
