"""Development by LibRaw against the same conversion in float64, and against the true colours."""

import numpy as np
import pytest
import rawpy
import tifffile
from harness import assert_close

from gpusim.errors import UserError
from gpusim.isp.colour import colour_matrix, response
from gpusim.isp.develop import _baseline_exposure_ev, develop
from gpusim.isp.dng import TAGS, write_dng
from gpusim.scene.colorimetry import (
    REC709_CHROMATICITIES,
    adaptation,
    encode_srgb,
    rgb_to_xyz,
)
from gpusim.scene.spectra import colorchecker, white_radiance, xyz

PATCH = 40
SPACE = rgb_to_xyz(REC709_CHROMATICITIES)


def patches_of(picture: np.ndarray) -> np.ndarray:
    """Return the mean of each patch, without its border where demosaicing mixes neighbours."""
    cells = picture.reshape(4, PATCH, 6, PATCH, 3)[:, 10:-10, :, 10:-10].astype(np.float64)
    return cells.mean(axis=(1, 3)).reshape(24, 3)


def written(shot, folder):
    path = folder / "raw.dng"
    write_dng(path, shot.raw, shot.sensor, white_e=shot.white_e, exposure_s=0.01)
    return path


def true_rgb(illuminant: str) -> np.ndarray:
    """Return linear sRGB of the patches, adapted from the illuminant to D65 by Bradford."""
    white = white_radiance(illuminant, 1.0)
    patches = xyz(np.stack(list(colorchecker().values())) * white)
    return patches @ np.linalg.solve(SPACE, adaptation(xyz(white), SPACE.sum(axis=1))).T


def difference(rgb: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return dE2000 of linear sRGB values, both clipped to what a picture can hold."""
    colour = pytest.importorskip("colour", reason="for dE2000")
    d65 = np.array(REC709_CHROMATICITIES[6:])
    lab = [colour.XYZ_to_Lab(np.clip(v, 0, 1) @ SPACE.T, d65) for v in (rgb, other)]
    return colour.delta_E(*lab, method="CIE 2000")


def decoded(srgb: np.ndarray) -> np.ndarray:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("illuminant", ["D50", "D65", "A"])
def test_libraw_agrees_with_the_matrix_in_float64(tmp_path, shoot, illuminant):
    shot = shoot(illuminant)
    developed = patches_of(develop(written(shot, tmp_path)))
    # LibRaw's conversion: the camera's channels balanced to the as-shot white, then the inverse of
    # ColorMatrix2 with its rows scaled so that the white of sRGB is (1, 1, 1).
    from_rgb = colour_matrix(response(shot.sensor.qe), "D65") @ SPACE
    to_rgb = np.linalg.inv(from_rgb / from_rgb.sum(axis=1, keepdims=True))
    white = np.array([shot.white_e[c] for c in "RGB"])
    expected = 256 * encode_srgb(shot.patches_e / white @ to_rgb.T)
    # LibRaw cuts 16 bits to 8: 0 to 1 level low. Before that, its 16-bit steps of 1.5e-5, times 3
    # for matrix and white balance, times 12.92 * 256, are 0.15 level in the darkest patches.
    assert_close(developed, np.clip(expected - 0.5, 0, 255), atol=0.5 + 0.15)


@pytest.mark.parametrize(
    ("illuminant", "mean", "worst"), [("D50", 1.3, 3.1), ("D65", 1.1, 3.2), ("A", 3.1, 8.5)]
)
def test_developed_patches_have_their_true_colours(tmp_path, shoot, illuminant, mean, worst):
    # What a 3 x 3 matrix can do with these spectra, in float64: D65 0.84 mean, 2.83 worst; D50
    # 1.12, 2.74; A 2.86, 8.09, since LibRaw uses the matrix for D65 alone. On top, up to 1 level of
    # 8 bits in each component, 0.2 in the mean and 0.4 at worst.
    developed = patches_of(develop(written(shoot(illuminant), tmp_path)))
    error = difference(decoded(developed / 255), true_rgb(illuminant))
    print(f"{illuminant}: dE2000 mean {error.mean():.2f}, max {error.max():.2f}")
    assert error.mean() < mean
    assert error.max() < worst


def test_neutral_patches_are_neutral(tmp_path, shoot):
    grey = patches_of(develop(written(shoot("D50"), tmp_path)))[18:]
    # The patches themselves are within 0.01 of flat, 4 levels; white balance adds nothing.
    true = 255 * encode_srgb(true_rgb("D50"))[18:]
    assert_close(np.ptp(grey, axis=1), np.ptp(true, axis=1), atol=2.5)


@pytest.mark.parametrize("white_share", [0.05, 0.3, 0.9, 1.3])
def test_the_scenes_white_sets_the_brightness_not_the_exposure(tmp_path, shoot, white_share):
    shot = shoot("D65", white_share=white_share)
    light = patches_of(develop(written(shot, tmp_path)))
    reference = patches_of(develop(written(shoot("D65", white_share=0.6), tmp_path)))
    # Neutral 8 to black: none saturates at any of the exposures. At 0.05 the 16 bits of LibRaw's
    # scaled samples are magnified 20 times: 20 * 1.5e-5 * 12.92 * 255 = 1 level in the darkest.
    assert_close(light[19:], reference[19:], atol=2.0)


def test_a_picture_is_upright_and_of_the_raws_size(tmp_path, shoot):
    shot = shoot("D50")
    picture = develop(written(shot, tmp_path))
    assert picture.dtype == np.uint8
    assert picture.shape == (*shot.raw.shape, 3)


def test_a_dng_without_baseline_exposure_is_developed_to_saturation(tmp_path, shoot):
    shot = shoot("D65")
    path = written(shot, tmp_path)
    reference = patches_of(develop(path))
    data = path.read_bytes()
    with tifffile.TiffFile(path) as file:
        offset = file.pages.first.tags[TAGS["BaselineExposure"]].offset
    # Another, private tag number of the same order in place of BaselineExposure.
    path.write_bytes(data[:offset] + (50729).to_bytes(2, "little") + data[offset + 2 :])
    darker = patches_of(develop(path))
    ratio = decoded(darker / 255)[20:23] / decoded(reference / 255)[20:23]
    # White was at 0.6 of saturation; a level of 8 bits is up to 2 % of the darkest of these.
    assert_close(ratio, np.full((3, 3), 0.6), rtol=0.05)


def test_a_raw_that_is_no_tiff_has_no_baseline_exposure(tmp_path):
    path = tmp_path / "raw.raf"
    path.write_bytes(b"FUJIFILMCCD-RAW 0201" + bytes(1000))
    assert _baseline_exposure_ev(path) == 0.0


def test_a_missing_raw_is_a_clear_error(tmp_path):
    with pytest.raises(UserError, match="no such raw file") as caught:
        develop(tmp_path / "none.dng")
    assert caught.value.file == tmp_path / "none.dng"


@pytest.mark.parametrize("content", [b"", b"not a raw file\n" * 100, None])
def test_a_corrupt_raw_is_a_clear_error(tmp_path, shoot, content):
    path = written(shoot("D50"), tmp_path)
    path.write_bytes(path.read_bytes()[:2000] if content is None else content)
    with pytest.raises(UserError, match="LibRaw cannot develop") as caught:
        develop(path)
    assert caught.value.file == path
    assert caught.value.value


def test_libraw_is_as_new_as_the_conversion_was_checked_with():
    # The choice of ColorMatrix2 among two, and no automatic brightness.
    assert rawpy.libraw_version >= (0, 22)
