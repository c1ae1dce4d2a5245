"""Quad Bayer: binned and remosaiced frames, and the other filter arrays that are developed here."""

import numpy as np
import pytest
import rawpy
from harness import assert_close

from gpusim.errors import UserError
from gpusim.isp.colour import response
from gpusim.isp.develop import develop
from gpusim.isp.dng import EXIF, TAGS, write_dng
from gpusim.isp.levels import saturation_dn
from gpusim.isp.libraw import develop_by_libraw
from gpusim.isp.quad import quad_phase, remosaiced, write_bayer
from gpusim.isp.rawfile import read_raw
from gpusim.isp.tiff import numbers
from gpusim.reference.quad import Remosaic
from gpusim.reference.quad import binned as cell_sums
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.spectra import white_radiance
from gpusim.sensor.adc_model import Linearity
from gpusim.sensor.load import load_sensor

QUAD = ("RRGG", "RRGG", "GGBB", "GGBB")
BLACK, GAIN = 256, 0.47
NEUTRAL = {"R": 0.4, "G": 1.0, "B": 0.7, "W": 1.0}


def shifted(pattern, shift):
    sites = np.roll(np.array([list(row) for row in pattern]), shift, (0, 1))
    return tuple("".join(row) for row in sites)


def camera_of(pattern, **changes):
    base = load_sensor("imx477")
    curves = dict(base.quantum_efficiency.channels)
    curves["W"] = [min(1.0, sum(values)) for values in zip(*curves.values(), strict=True)]
    used = {one: curves[one] for row in pattern for one in row}
    changes |= {
        "cfa": base.cfa.model_copy(update={"pattern": [list(row) for row in pattern]}),
        "quantum_efficiency": base.quantum_efficiency.model_copy(update={"channels": used}),
    }
    return base.model_copy(update=changes)


def sites_of(pattern, shape):
    rows, cols = len(pattern), len(pattern[0])
    return np.array(
        [[pattern[r % rows][c % cols] for c in range(shape[1])] for r in range(shape[0])]
    )


def written(path, pattern, light, **changes):
    """Write the raw of light (rows, cols), grey, in shares of 3000 DN of green."""
    camera = camera_of(pattern, **changes)
    share = np.vectorize(NEUTRAL.get)(sites_of(pattern, light.shape))
    raw = np.round(BLACK + 3000 * share * light).astype(np.uint16)
    white = {one: 6000 * NEUTRAL[one] for one in camera.channels}
    write_dng(path, raw, camera, white_e=white, exposure_s=0.01)
    return raw, camera


@pytest.mark.parametrize("shift", [(0, 0), (1, 0), (2, 1), (3, 3)])
def test_the_phase_of_the_cells(shift):
    pattern = shifted(QUAD, shift)
    assert quad_phase(pattern) == (shift[0] % 2, shift[1] % 2)


@pytest.mark.parametrize(
    "pattern", [("RG", "GB"), ("RRGG", "RRGG", "GGRR", "GGRR"), ("RGRG", "GBGB") * 2, QUAD[:2]]
)
def test_what_is_no_quad_bayer(pattern, tmp_path):
    assert quad_phase(pattern) is None
    written(tmp_path / "a.dng", pattern, np.full((32, 32), 0.5))
    with pytest.raises(UserError, match="bin"):
        develop(tmp_path / "a.dng", binned=True)


@pytest.mark.parametrize("shift", [(0, 0), (1, 2), (3, 1)])
def test_binned_cells_are_sums(tmp_path, shift):
    pattern = shifted(QUAD, shift)
    light = np.random.default_rng(2).uniform(0.1, 0.9, (54, 61))
    raw, _camera = written(tmp_path / "a.dng", pattern, light)
    write_bayer(read_raw(tmp_path / "a.dng"), tmp_path / "b.dng", binned=True)
    row, col = shift[0] % 2, shift[1] % 2
    expected = cell_sums(raw, (row, col))
    with rawpy.imread(str(tmp_path / "b.dng")) as read:
        assert_close(read.raw_image_visible.astype(float), expected, atol=0)
        assert (read.black_level_per_channel, read.white_level) == ([4 * BLACK] * 4, 4 * 4095)
        letters = np.array(list("RGBG"))[read.raw_pattern]
    assert np.array_equal(
        letters, sites_of(pattern, (54, 61))[row : row + 4 : 2, col : col + 4 : 2]
    )
    source, found = read_raw(tmp_path / "a.dng"), read_raw(tmp_path / "b.dng")
    assert_close(found.value("NoiseProfile"), source.value("NoiseProfile") / 4, rtol=1e-15)
    pitch = [numbers(one.exif[EXIF["FocalPlaneXResolution"]])[0] for one in (source, found)]
    assert pitch[0] == pytest.approx(2 * pitch[1], rel=1e-8)
    assert found.exif[EXIF["ExposureTime"]] == source.exif[EXIF["ExposureTime"]]


def test_sums_that_16_bits_do_not_hold_are_scaled(tmp_path):
    light = np.full((16, 16), 0.5)
    written(tmp_path / "a.dng", QUAD, light, bit_depth=15, system_gain_dn_per_e=3.0)
    write_bayer(read_raw(tmp_path / "a.dng"), tmp_path / "b.dng", binned=True)
    found = read_raw(tmp_path / "b.dng")
    (white,) = found.value("WhiteLevel")
    assert 32767 < white <= 65535
    assert found.signal_dn[0, 1] / found.span_dn == pytest.approx(
        1500 / (saturation_dn(camera_of(QUAD, bit_depth=15, system_gain_dn_per_e=3.0)) - BLACK),
        rel=1e-3,
    )


@pytest.mark.parametrize("shift", [(0, 0), (1, 2), (2, 3), (3, 1)])
def test_remosaiced_is_what_the_reference_makes(tmp_path, monkeypatch, shift):
    """Everywhere to the corners, in a frame of no whole periods, of rough light."""
    for letter, share in (("R", 0.5), ("B", 0.25)):  # shares that f32 holds and divides by exactly
        monkeypatch.setitem(NEUTRAL, letter, share)
    pattern = shifted(QUAD, shift)
    light = np.random.default_rng(7).uniform(0.05, 1.0, (14, 17))
    written(tmp_path / "a.dng", pattern, light)
    raw = read_raw(tmp_path / "a.dng")
    phase = quad_phase(pattern)
    share = dict(zip(raw.colours, raw.value("AsShotNeutral"), strict=True))
    twin = Remosaic(raw.signal_dn, pattern, phase, white=share, span=raw.span_dn)
    expected = np.array([[twin.at(r, c) for c in range(17)] for r in range(14)])
    found = remosaiced(raw, phase)
    # Some 60 roundings of f32: means of two lines, sums of 49 differences of up to 3000 DN.
    assert_close(found.astype(float), expected, atol=60 * 2**-24 * 3000)


@pytest.mark.parametrize("shift", [(0, 0), (1, 2), (2, 3)])
def test_remosaiced_keeps_what_is_there_and_slopes_are_straight(tmp_path, shift):
    pattern = shifted(QUAD, shift)
    y, x = np.mgrid[0:40, 0:48]
    light = 0.2 + 0.008 * x + 0.004 * y
    raw, _ = written(tmp_path / "a.dng", pattern, light)
    write_bayer(read_raw(tmp_path / "a.dng"), tmp_path / "b.dng", binned=False)
    found = read_raw(tmp_path / "b.dng")
    sites, wanted = sites_of(pattern, light.shape), sites_of(found.pattern, light.shape)
    same = sites == wanted
    assert same.mean() == 6 / 16  # of 16 sites four green ones, a red and a blue one
    codes = found.signal_dn + BLACK
    assert_close(codes[same], raw[same].astype(float), atol=0)
    # Half a code each of three photosites that are weighed, over a neutral of 0.4, and of the sum.
    inner = np.s_[6:-6, 6:-6]
    expected = BLACK + 3000 * np.vectorize(NEUTRAL.get)(wanted) * light
    assert_close(codes[inner], expected[inner], atol=0.5 / 0.4 + 1)
    assert (found.value("WhiteLevel"), found.value("BlackLevel")) == (4095, BLACK)


def test_a_grey_edge_has_no_colour(tmp_path):
    light = np.full((96, 96), 0.2)
    light[:, 41:] = 0.8
    light[:30] = 0.5
    written(tmp_path / "a.dng", QUAD, light)
    picture = develop(tmp_path / "a.dng").picture.astype(int)
    assert picture.shape == (96, 96, 3)
    inner = picture[8:-8, 8:-8]
    # A step of 106 levels; without balance before the differences the rims are 60 levels off.
    assert np.percentile(np.ptp(inner, axis=2), 99) <= 8
    even = develop(tmp_path / "a.dng", binned=True).picture
    assert even.shape == (48, 48, 3)
    for shown, at in ((picture, (60, 20)), (even, (30, 10))):
        expected = 255 * encode_srgb(np.array(0.2 * 3000 / (4095 - BLACK)))
        assert np.abs(shown[at] - expected).max() <= 1.5


def test_levels_and_table_are_in_the_bayer_frame(tmp_path):
    at = np.linspace(0, 9000, 30)
    curve = Linearity(electrons=list(at), read_e=list(at * (1 - 0.05 * at / 9000)))
    camera = camera_of(
        QUAD, full_well_e=9000.0, linearity=curve, channel_black_level_dn={"R": 250.0, "B": 262.0}
    )
    raw = np.round(BLACK + GAIN * curve.read(np.full((32, 32), 4000.0))).astype(np.uint16)
    more = np.vectorize({"R": -6, "G": 0, "B": 6}.get)(sites_of(QUAD, raw.shape))
    raw = (raw + more).astype(np.uint16)
    write_dng(
        tmp_path / "a.dng", raw, camera, white_e=dict.fromkeys("RGB", 6000.0), exposure_s=0.01
    )
    for binned in (False, True):
        write_bayer(read_raw(tmp_path / "a.dng"), tmp_path / "b.dng", binned=binned)
        found = read_raw(tmp_path / "b.dng")
        assert TAGS["LinearizationTable"] not in found.tags
        share = found.signal_dn / found.span_dn
        # 4000 of the electrons at the highest code, to a code and the table's slope.
        full = curve.collected((4095 - BLACK) / GAIN)
        assert_close(share, np.full(share.shape, 4000 / full), rtol=2e-3)


@pytest.mark.parametrize("pattern", [QUAD, ("W",)])
def test_the_border_is_cropped_and_its_dark_current_taken(tmp_path, pattern):
    """The pattern, of filters and of black levels, begins at the first lit pixel."""
    levels = {"R": 250.0, "B": 262.0} if pattern == QUAD else {}
    camera = camera_of(pattern, channel_black_level_dn=levels or None)
    sites = sites_of(shifted(pattern, (6, 3)), (46, 51))
    light = 0.2 + 0.005 * np.mgrid[0:40, 0:48][1]
    signal = np.round(3000 * np.vectorize(NEUTRAL.get)(sites[6:, 3:]) * light)
    raw = np.vectorize(lambda site: levels.get(site, BLACK))(sites) + 9  # of dark current
    raw[6:, 3:] += signal.astype(int)
    areas = {"active_area": (6, 3, 40, 48), "masked_areas": [(0, 0, 6, 51), (6, 0, 40, 3)]}
    white = {one: 6000 * NEUTRAL[one] for one in camera.channels}
    write_dng(tmp_path / "a.dng", raw, camera, white_e=white, exposure_s=0.01, **areas)
    found = read_raw(tmp_path / "a.dng")
    assert_close(found.signal_dn, signal, atol=1e-3)
    assert found.pattern == tuple(pattern)
    assert found.span_dn == pytest.approx(4095 - np.mean([*levels.values(), 256, 256][:4]) - 9)
    assert develop(tmp_path / "a.dng").picture.shape == (40, 48, 3)


# --- other filter arrays, and small frames ---


@pytest.mark.parametrize(
    "pattern", [("RW", "WB"), ("RG", "BW"), ("W",), ("RW", "WW"), ("RG", "GB"), QUAD]
)
@pytest.mark.parametrize("shape", [(5, 7), (32, 40)])
def test_a_grey_field_is_grey_at_any_size(tmp_path, pattern, shape):
    written(tmp_path / "a.dng", pattern, np.full(shape, 0.25))
    picture = develop(tmp_path / "a.dng").picture
    assert picture.shape == (*shape, 3)
    expected = 255 * encode_srgb(np.array(0.25 * 3000 / (4095 - BLACK)))
    # A code of 300 in the darkest channel, and rounding.
    assert np.abs(picture - expected).max() <= 0.5 + 0.3


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (2, 2), (21, 500)])
def test_the_smallest_frames_have_a_picture(tmp_path, shape):
    for pattern in (("RG", "GB"), QUAD, ("W",)):
        written(tmp_path / "a.dng", pattern, np.full(shape, 0.25))
        assert develop(tmp_path / "a.dng").picture.shape == (*shape, 3)


def test_a_colour_is_that_of_libraw(tmp_path):
    """A Bayer frame of less than LibRaw's least side, and a larger one."""
    camera = camera_of(("RG", "GB"))
    pictures = []
    for side in (20, 64):
        sites = sites_of(("RG", "GB"), (side, side))
        raw = np.vectorize({"R": 1500, "G": 1200, "B": 700}.get)(sites).astype(np.uint16)
        # Daylight's white, for which LibRaw's matrix is.
        white = dict(zip("RGB", response(camera.qe) @ white_radiance("D65", 1e4), strict=True))
        write_dng(tmp_path / "a.dng", raw, camera, white_e=white, exposure_s=0.01)
        pictures.append(develop(tmp_path / "a.dng").picture[side // 2, side // 2].astype(int))
    pictures.append(develop_by_libraw(tmp_path / "a.dng")[side // 2, side // 2].astype(int))
    assert np.ptp(pictures[1]) > 100
    for other in (pictures[0], pictures[2]):
        assert np.abs(other - pictures[1]).max() <= 1


@pytest.mark.parametrize("pattern", [("W",), ("RG", "BW"), QUAD])
def test_what_libraw_does_not_know_is_refused_with_the_other_engine(tmp_path, pattern):
    written(tmp_path / "a.dng", pattern, np.full((7, 20), 0.25))
    with pytest.raises(UserError, match="LibRaw") as caught:
        develop_by_libraw(tmp_path / "a.dng")
    assert caught.value.allowed == "--engine gpusim"


def test_a_cut_raw_of_ours_is_a_clear_error(tmp_path):
    for pattern in (QUAD, ("W",)):
        written(tmp_path / "a.dng", pattern, np.full((32, 32), 0.25))
        data = (tmp_path / "a.dng").read_bytes()
        for end in (len(data) - 1, 1500, 700):
            (tmp_path / "b.dng").write_bytes(data[:end])
            with pytest.raises(UserError, match="develop"):
                develop(tmp_path / "b.dng")
