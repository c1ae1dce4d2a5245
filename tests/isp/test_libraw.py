"""LibRaw's development against the same conversion in float64; brightness by both engines."""

import shutil
import subprocess

import numpy as np
import pytest
import rawpy
import tifffile
from harness import assert_close

from gpusim.errors import UserError
from gpusim.isp.colour import colour_matrix, response
from gpusim.isp.develop import develop
from gpusim.isp.dng import write_dng
from gpusim.isp.levels import saturation_dn
from gpusim.isp.libraw import develop_by_libraw, toned
from gpusim.isp.settings import Settings
from gpusim.isp.source import baseline_ev
from gpusim.scene.colorimetry import (
    REC709_CHROMATICITIES,
    adaptation,
    encode_srgb,
    rgb_to_xyz,
)
from gpusim.scene.spectra import colorchecker, white_radiance, xyz

PATCH = 40


def developed_here(path, ev=0.0):
    return develop(path, Settings(ev=ev)).picture


ENGINES = {"gpusim": developed_here, "libraw": develop_by_libraw}
both = pytest.mark.parametrize("engine", ENGINES.values(), ids=ENGINES)
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
    developed = patches_of(develop_by_libraw(written(shot, tmp_path)))
    # LibRaw's conversion: the camera's channels balanced to the as-shot white, then the inverse of
    # ColorMatrix2 with its rows scaled so that the white of sRGB is (1, 1, 1).
    from_rgb = colour_matrix(response(shot.sensor.qe), "D65") @ SPACE
    to_rgb = np.linalg.inv(from_rgb / from_rgb.sum(axis=1, keepdims=True))
    white = np.array([shot.white_e[c] for c in "RGB"])
    span_e = (saturation_dn(shot.sensor) - 4096) / 7.5
    expected = 255 * encode_srgb(white.max() / span_e * (shot.patches_e / white) @ to_rgb.T)
    # Rounding to 8 bits. Before that, LibRaw's 16-bit steps of 1.5e-5, times 3 for matrix and white
    # balance, times 12.92 * 255, are 0.15 level in the darkest patches.
    assert_close(developed, expected, atol=0.5 + 0.15)


@pytest.mark.parametrize(
    ("illuminant", "mean", "worst"), [("D50", 1.3, 3.1), ("D65", 1.1, 3.2), ("A", 3.1, 8.5)]
)
def test_developed_patches_have_their_true_colours(tmp_path, shoot, illuminant, mean, worst):
    # What a 3 x 3 matrix can do with these spectra, in float64: D65 0.84 mean, 2.83 worst; D50
    # 1.12, 2.74; A 2.86, 8.09, since LibRaw uses the matrix for D65 alone. On top, up to 1 level of
    # 8 bits in each component, 0.2 in the mean and 0.4 at worst.
    developed = patches_of(
        develop_by_libraw(written(shoot(illuminant), tmp_path), np.log2(1 / 0.6))
    )
    error = difference(decoded(developed / 255), true_rgb(illuminant))
    print(f"{illuminant}: dE2000 mean {error.mean():.2f}, max {error.max():.2f}")
    assert error.mean() < mean
    assert error.max() < worst


@both
def test_neutral_patches_are_neutral(tmp_path, shoot, engine):
    grey = patches_of(engine(written(shoot("D50"), tmp_path), np.log2(1 / 0.6)))[18:]
    # The patches themselves are within 0.01 of flat, 4 levels; white balance adds nothing.
    true = 255 * encode_srgb(true_rgb("D50"))[18:]
    assert_close(np.ptp(grey, axis=1), np.ptp(true, axis=1), atol=2.5)


@both
@pytest.mark.parametrize("white_share", [0.05, 0.3, 0.9, 1.3])
def test_the_exposure_sets_the_brightness(tmp_path, shoot, engine, white_share):
    light = decoded(
        patches_of(engine(written(shoot("D65", white_share=white_share), tmp_path))) / 255
    )
    whole = decoded(patches_of(engine(written(shoot("D65", white_share=0.9), tmp_path))) / 255)
    # Neutral 8, 6.5 and 5: none saturates at any of the exposures. Two roundings to 8 bits, of a
    # curve that is at most 1 / 12.92 there and 2.4 times as steep as straight at white.
    ratio = light[19:22] / whole[19:22]
    step = 2.4 * 0.5 / 255 / np.minimum(encode_srgb(light[19:22]), encode_srgb(whole[19:22]))
    assert np.all(np.abs(ratio * 0.9 / white_share - 1) < 2 * step)


@both
@pytest.mark.parametrize("ev", [-3.0, -1.0, 0.0, 1.5])
@pytest.mark.parametrize("by", ["option", "file"])
def test_stops_move_the_brightness_and_saturation_stays_white(tmp_path, shoot, engine, ev, by):
    """Patches up to a quarter of saturation are 2^EV times as bright."""
    shot = shoot("D65", white_share=0.25)
    shot.raw[:16, :16] = 65535
    path = written(shot, tmp_path)
    plain = decoded(patches_of(engine(path)) / 255)
    if by == "file":
        write_dng(path, shot.raw, shot.sensor, white_e=shot.white_e, exposure_s=0.01, ev=ev)
    picture = engine(path, ev if by == "option" else 0.0)
    assert picture[:12, :12].min() == 255
    moved = decoded(patches_of(picture) / 255)[20:22]
    step = 2.4 * 0.5 / 255 / np.minimum(encode_srgb(moved), encode_srgb(plain[20:22]))
    assert np.all(np.abs(moved / plain[20:22] / 2**ev - 1) < 2 * step)


@pytest.mark.parametrize("ev", [-8.0, -1.0, -0.1, 0.0, 0.3, 5.0])
def test_light_that_is_moved_rises_to_white(ev):
    light = np.linspace(0, 1, 1001)
    shown = toned(light, ev)
    assert (shown[0], shown[-1]) == (0, pytest.approx(1))
    assert np.all(np.diff(shown) >= 0)
    assert_close(shown[:200] * 2**-ev, np.minimum(light[:200], 2**-ev), atol=1e-15)
    # No step in value or slope where the parabola begins.
    slopes = np.diff(shown) * 1000
    assert np.abs(np.diff(slopes[240:260])).max() < 4 / 1000 + (ev > 0) * 2**ev


@pytest.mark.parametrize("ev", [-20.1, 21, np.nan, np.inf])
def test_stops_out_of_range_are_refused(tmp_path, shoot, ev):
    with pytest.raises(UserError, match="stops") as caught:
        develop_by_libraw(written(shoot("D65"), tmp_path), ev)
    assert caught.value.field == "--ev"


@pytest.mark.parametrize("changes", [{}, {"full_well_e": 3000.0, "temporal_dark_noise_e": 20.0}])
@pytest.mark.parametrize("pattern", ["RGGB", "W", "RGBW"])
def test_a_saturated_frame_is_white(tmp_path, shoot, pattern, changes):
    """Where the converter ends, and where the well is full and read noise spreads the codes."""
    shot = shoot("D65")
    base = shot.sensor.model_copy(update=changes)
    curves = dict(base.quantum_efficiency.channels)
    curves |= {"W": [min(1.0, sum(values)) for values in zip(*curves.values(), strict=True)]}
    letters = [list(pattern[:2]), list(pattern[2:])] if len(pattern) == 4 else [["W"]]
    used = {one: curves[one] for row in letters for one in row}
    camera = base.model_copy(
        update={
            "cfa": base.cfa.model_copy(update={"pattern": letters}),
            "quantum_efficiency": base.quantum_efficiency.model_copy(update={"channels": used}),
        }
    )
    top = min(65535, 4096 + 7.5 * camera.full_well_e)
    noise = np.random.default_rng(1).normal(0, 7.5 * camera.temporal_dark_noise_e, (64, 80))
    raw = np.clip(np.round(top + noise), 0, 65535).astype(np.uint16)
    if top == 65535:
        raw[:] = 65535
    white = dict.fromkeys(used, 1e5)
    path = tmp_path / "a.dng"
    write_dng(path, raw, camera, white_e=white, exposure_s=0.01)
    assert raw.min() > 0.9 * saturation_dn(camera)
    for ev in (-2.0, 0.0, 2.0):
        assert np.mean(developed_here(path, ev) == 255) > 0.98


@pytest.mark.parametrize("program", ["LibRaw", "dcraw"])
def test_other_programs_show_the_same_brightness(tmp_path, shoot, program):
    """Without the automatic brightness that the two of them have."""
    path = written(shoot("D65", white_share=0.2), tmp_path)
    ours = decoded(patches_of(develop_by_libraw(path)) / 255)
    if program == "LibRaw":
        with rawpy.imread(str(path)) as raw:
            theirs = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16)
    else:
        if shutil.which("dcraw") is None:
            pytest.skip("dcraw is not installed")
        subprocess.run(["dcraw", "-w", "-W", "-6", "-T", path], check=True)
        theirs = tifffile.imread(path.with_suffix(".tiff"))
    # Their curve is that of BT.709: linear below 0.018, power 1 / 0.45 above.
    shown = patches_of(theirs) / 65535
    light = np.where(shown < 0.081, shown / 4.5, ((shown + 0.099) / 1.099) ** (1 / 0.45))
    luminance = np.array([0.2126, 0.7152, 0.0722])
    stops = np.log2(ours @ luminance) - np.log2(light @ luminance)
    # 8 bits of our darkest patch: 0.06 EV.
    assert np.abs(stops).max() < 0.08


@both
def test_a_picture_is_upright_and_of_the_raws_size(tmp_path, shoot, engine):
    shot = shoot("D50")
    picture = engine(written(shot, tmp_path))
    assert picture.dtype == np.uint8
    assert picture.shape == (*shot.raw.shape, 3)


def test_a_raw_that_is_no_tiff_has_no_baseline_exposure(tmp_path):
    path = tmp_path / "raw.raf"
    path.write_bytes(b"FUJIFILMCCD-RAW 0201" + bytes(1000))
    assert baseline_ev(path) == 0.0


def test_a_missing_raw_is_a_clear_error(tmp_path):
    with pytest.raises(UserError, match="no such raw file") as caught:
        develop_by_libraw(tmp_path / "none.dng")
    assert caught.value.file == tmp_path / "none.dng"


@pytest.mark.parametrize("content", [b"", b"not a raw file\n" * 100, None])
def test_a_corrupt_raw_is_a_clear_error(tmp_path, shoot, content):
    path = written(shoot("D50"), tmp_path)
    path.write_bytes(path.read_bytes()[:2000] if content is None else content)
    with pytest.raises(UserError, match="LibRaw cannot develop") as caught:
        develop_by_libraw(path)
    assert caught.value.file == path
    assert caught.value.value


def test_libraw_is_as_new_as_the_conversion_was_checked_with():
    # The choice of ColorMatrix2 among two, and no automatic brightness.
    assert rawpy.libraw_version >= (0, 22)
