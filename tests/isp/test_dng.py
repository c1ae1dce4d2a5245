"""DNG files, as LibRaw, dcraw and a TIFF reader see them."""

import re
import shutil
import subprocess

import numpy as np
import pytest
import rawpy
import tifffile
from harness import assert_close

from gpusim.errors import UserError
from gpusim.isp import colour
from gpusim.isp.develop import develop, develops
from gpusim.isp.dng import (
    TAGS,
    has_dng,
    linearization_table,
    noise_profile,
    saturation_dn,
    span_dn,
    write_dng,
)
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.sensor.adc_model import GainStep, Linearity
from gpusim.sensor.load import load_sensor

PATTERNS = ["RGGB", "BGGR", "GRBG", "GBRG"]
WHITE_E = {"R": 3000.0, "G": 6000.0, "B": 4500.0}
HALF_DECIMAL = 0.5e-6  # rationals have six decimals

needs_dcraw = pytest.mark.skipif(shutil.which("dcraw") is None, reason="dcraw is not installed")


def sensor(pattern: str = "RGGB", **changes: object):
    base = load_sensor("imx477")
    cfa = base.cfa.model_copy(update={"pattern": [list(pattern[:2]), list(pattern[2:])]})
    return base.model_copy(update={"cfa": cfa} | changes)


def frame(rows: int = 48, cols: int = 64, top: int = 4095) -> np.ndarray:
    raw = np.random.default_rng(7).integers(0, top, (rows, cols), endpoint=True, dtype=np.uint16)
    raw[0, :2] = raw[-1, -2:] = 0, top
    return raw


def write(path, raw, camera, **changes):
    write_dng(path, raw, camera, **({"white_e": WHITE_E, "exposure_s": 1 / 60} | changes))
    return path


def values(path) -> dict:
    """Return the tags' values by name; rationals as numbers."""
    names = {number: name for name, number in TAGS.items()}
    with tifffile.TiffFile(path) as file:
        tags = {names[tag.code]: tag for tag in file.pages.first.tags if tag.code in names}
        result = {}
        for name, tag in tags.items():
            value = tag.value
            if tag.dtype.name in ("RATIONAL", "SRATIONAL"):
                value = np.array(value, np.float64).reshape(-1, 2)
                value = value[:, 0] / value[:, 1]
            result[name] = value
    return result


@pytest.mark.parametrize("pattern", PATTERNS)
def test_libraw_reads_every_sample_and_what_they_mean(tmp_path, pattern):
    raw = frame()
    with rawpy.imread(str(write(tmp_path / "a.dng", raw, sensor(pattern)))) as read:
        assert_close(read.raw_image.copy(), raw, atol=0)
        assert_close(read.raw_image_visible.copy(), raw, atol=0)
        assert read.black_level_per_channel == [256] * 4
        assert read.white_level == 4095
        names = read.color_desc.decode()
        letters = [[names[i] for i in row] for row in read.raw_pattern]
        assert letters == [list(pattern[:2]), list(pattern[2:])]
        gains = np.array(read.camera_whitebalance[:3])
        # 1 / AsShotNeutral, in float32 and six decimals of numbers above 0.5.
        assert_close(gains / gains[1], np.array([2.0, 1.0, 4 / 3]), rtol=3e-6)


@pytest.mark.parametrize(("rows", "cols"), [(22, 24), (33, 47), (64, 256)])
def test_sizes_odd_and_even_are_read(tmp_path, rows, cols):
    raw = frame(rows, cols)
    with rawpy.imread(str(write(tmp_path / "a.dng", raw, sensor()))) as read:
        assert_close(read.raw_image_visible.copy(), raw, atol=0)


@pytest.mark.parametrize("bits", [8, 10, 14, 16])
def test_bit_depths_keep_their_codes(tmp_path, bits):
    top = 2**bits - 1
    raw = frame(top=top)
    camera = sensor(bit_depth=bits, black_level_dn=16, system_gain_dn_per_e=top / 5000)
    with rawpy.imread(str(write(tmp_path / "a.dng", raw, camera))) as read:
        assert_close(read.raw_image.copy(), raw, atol=0)
        assert read.white_level == top
        assert read.black_level_per_channel == [16] * 4


# Optical black around a frame: its lit part, and its masked areas above, below, left and right.
LIT = (4, 6, 48, 64)
MASKED = [(0, 0, 4, 78), (52, 0, 2, 78), (4, 0, 48, 6), (4, 70, 48, 8)]


def framed_raw() -> np.ndarray:
    """Return a raw with a border, of 261 DN where each filter colour is even."""
    raw = np.full((54, 78), 261, np.uint16)
    raw[4:52, 6:70] = frame()
    return raw


@pytest.mark.parametrize("pattern", PATTERNS)
def test_libraw_crops_the_border_and_takes_its_level_for_black(tmp_path, pattern):
    raw = framed_raw()
    path = write(tmp_path / "a.dng", raw, sensor(pattern), active_area=LIT, masked_areas=MASKED)
    with rawpy.imread(str(path)) as read:
        assert_close(read.raw_image.copy(), raw, atol=0)
        assert_close(read.raw_image_visible.copy(), frame(), atol=0)
        assert read.black_level_per_channel == [261] * 4  # not the 256 of the data sheet
        names = read.color_desc.decode()
        letters = [[names[i] for i in row] for row in read.raw_pattern]
        assert letters == [list(pattern[:2]), list(pattern[2:])]
    assert develop(path).shape == (48, 64, 3)


def test_tags_say_where_the_border_lies(tmp_path):
    path = write(tmp_path / "a.dng", framed_raw(), sensor(), active_area=LIT, masked_areas=MASKED)
    tags = values(path)
    assert tags["ActiveArea"] == (4, 6, 52, 70)
    assert (tags["DefaultCropOrigin"], tags["DefaultCropSize"]) == ((0, 0), (64, 48))
    expected = [(0, 0, 4, 78), (52, 0, 54, 78), (4, 0, 52, 6), (4, 70, 52, 78)]
    assert tags["MaskedAreas"] == sum(expected, ())
    assert "MaskedAreas" not in values(write(tmp_path / "b.dng", frame(), sensor()))


@needs_dcraw
def test_dcraw_crops_the_border_and_takes_its_level_for_black(tmp_path):
    raw = framed_raw()
    path = write(tmp_path / "a.dng", raw, sensor("BGGR"), active_area=LIT, masked_areas=MASKED)
    for document_mode, expected in (("-D", frame()), ("-E", raw)):
        subprocess.run(["dcraw", document_mode, "-4", "-T", path], check=True)
        assert_close(tifffile.imread(tmp_path / "a.tiff"), expected, atol=0)
    command = ["dcraw", "-v", "-d", "-T", path]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stderr
    assert "darkness 261, saturation 4095" in text


# --- black levels, non-linearity, gain ---


@pytest.mark.parametrize("pattern", PATTERNS)
def test_libraw_has_the_black_level_of_each_channel(tmp_path, pattern):
    levels = {"R": 250.0, "G": 262.0, "B": 259.0}
    path = write(tmp_path / "a.dng", frame(), sensor(pattern, channel_black_level_dn=levels))
    tags = values(path)
    assert tags["BlackLevelRepeatDim"] == (2, 2)
    assert_close(tags["BlackLevel"], np.array([levels[name] for name in pattern]), atol=0)
    with rawpy.imread(str(path)) as read:
        names = read.color_desc.decode()
        found = {names[i]: read.black_level_per_channel[i] for i in range(4)}
        assert found == levels
    assert "BlackLevelRepeatDim" not in values(write(tmp_path / "b.dng", frame(), sensor()))


def bent(**changes):
    """Return a sensor that reads up to 5 % too little."""
    at = np.linspace(0, 9000, 30)
    curve = Linearity(electrons=list(at), read_e=list(at * (1 - 0.05 * at / 9000)))
    return sensor(linearity=curve, **changes)


def test_libraw_undoes_the_non_linearity(tmp_path):
    camera = bent()
    electrons = np.linspace(0, 8000, 48 * 64).reshape(48, 64)
    raw = np.round(256 + 0.47 * camera.linearity.read(electrons)).astype(np.uint16)
    path = write(tmp_path / "a.dng", raw, camera)
    table, scale = linearization_table(camera)
    assert scale == 15  # 4095 is 4297 of a linear converter: 15 times that is 64 458
    with rawpy.imread(str(path)) as read:
        linear, white = read.raw_image.astype(float), read.white_level
        black = np.array(read.black_level_per_channel)
    assert_close(linear, table[raw].astype(float), atol=0)
    assert_close(black, np.full(4, 15 * 256), atol=0)
    # Half a DN of the raw, times the slope's inverse of at most 1 / 0.9, and half a step of 1/15.
    below = raw < 4095
    found = (linear - black[0])[below] / 15
    assert_close(found, 0.47 * electrons[below], atol=0.5 / 0.9 + 0.5 / 15 + 1e-9)
    assert white == table[saturation_dn(camera)]
    assert np.abs(0.47 * electrons - (raw - 256.0)).max() > 90  # the control
    assert develop(path).shape == (48, 64, 3)


@needs_dcraw
def test_dcraw_undoes_the_non_linearity(tmp_path):
    path = write(tmp_path / "a.dng", frame(), bent())
    table, _ = linearization_table(bent())
    subprocess.run(["dcraw", "-D", "-4", "-T", path], check=True)
    assert_close(tifffile.imread(tmp_path / "a.tiff"), table[frame()], atol=0)


def test_a_bent_response_is_developed_as_a_straight_one(tmp_path):
    """A grey wedge: what the non-linearity took is back in the picture."""
    electrons = np.repeat(np.linspace(50, 5000, 32), 4)[None].repeat(32, axis=0)
    pictures = []
    for camera in (sensor(), bent(), sensor()):
        read = camera.linearity.read(electrons) if camera.linearity else electrons
        if len(pictures) == 2:  # the control: the bent raw without its table
            read = bent().linearity.read(electrons)
        raw = np.round(256 + 0.47 * read).astype(np.uint16)
        neutral = dict.fromkeys("RGB", 5000.0)
        path = write(tmp_path / "a.dng", raw, camera, white_e=neutral)
        pictures.append(develop(path).astype(float))
    straight, undone, left = pictures
    # A DN of the raw is at most 12.92 * 255 / 2350 = 1.4 levels of the picture, in the blacks.
    assert np.abs(undone - straight).max() <= 2
    assert np.abs(left - straight).max() >= 3


def test_the_span_of_a_bent_response_is_that_of_a_straight_one():
    camera = bent(full_well_e=6000.0)
    assert saturation_dn(camera) == int(256 + 0.47 * camera.linearity.read(6000.0))
    # The code is cut to a whole number; the response's slope is 0.93 there.
    assert 0 <= 0.47 * 6000 - span_dn(camera) < 1 / 0.93
    assert noise_profile(camera)[0] == pytest.approx(0.47 / span_dn(camera))


def test_codes_of_16_bits_have_a_table_of_16_bits(tmp_path):
    camera = bent(bit_depth=16, system_gain_dn_per_e=7.5, black_level_dn=4096.125)
    table, scale = linearization_table(camera)
    assert (scale, len(table), table[-1]) == (1, 65536, 65535)
    tags = values(write(tmp_path / "a.dng", frame(top=65535), camera))
    assert tags["BlackLevel"] == 4096.125
    assert len(tags["LinearizationTable"]) == 65536


@pytest.mark.parametrize("iso", [55, 800, 65535])
def test_the_iso_speed_is_in_the_exif_part(tmp_path, iso):
    steps = [GainStep(gain=1), GainStep(gain=8, iso=iso)]
    camera = sensor(analogue_gains=steps)
    path = write(tmp_path / "a.dng", frame(), camera.at_gain(8))
    with tifffile.TiffFile(path) as file:
        exif = file.pages.first.tags["ExifTag"].value
        assert (exif["ISOSpeedRatings"], exif["ExifVersion"]) == (iso, "0230")
    with rawpy.imread(str(path)) as read:
        assert_close(read.raw_image.copy(), frame(), atol=0)
    with tifffile.TiffFile(write(tmp_path / "b.dng", frame(), camera)) as file:
        assert "ExifTag" not in file.pages.first.tags


@needs_dcraw
def test_dcraw_has_the_iso_speed(tmp_path):
    camera = sensor(analogue_gains=[GainStep(gain=1, iso=160)])
    path = write(tmp_path / "a.dng", frame(33, 47), camera)
    text = subprocess.run(["dcraw", "-i", "-v", path], check=True, capture_output=True, text=True)
    assert "ISO speed: 160" in text.stdout


XTRANS = ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")


@pytest.mark.parametrize("shift", [(0, 0), (5, 3)])
def test_an_x_trans_pattern_opens_with_its_colours(tmp_path, shift: tuple[int, int]):
    pattern = np.roll([list(row) for row in XTRANS], shift, (0, 1))
    camera = sensor()
    cfa = camera.cfa.model_copy(update={"pattern": pattern.tolist()})
    camera = camera.model_copy(update={"cfa": cfa})
    assert has_dng(camera)
    site = np.tile(np.array([["RGB".index(c) for c in row] for row in pattern]), (86, 86))
    # A field of one colour, white being 2000 electrons in each channel.
    gain, black = camera.system_gain_dn_per_e, camera.black_level_dn
    raw = np.round(black + gain * np.array([1600.0, 800.0, 400.0])[site]).astype(np.uint16)
    path = write(tmp_path / "a.dng", raw, camera, white_e=dict.fromkeys("RGB", 2000.0))
    with rawpy.imread(str(path)) as read:
        assert_close(read.raw_image.copy(), raw, atol=0)
        seen = np.array(list(read.color_desc.decode()))[read.raw_colors]
        assert np.array_equal(seen, np.tile(pattern, (86, 86)))
    assert develops(camera, *raw.shape) and not develops(camera, 511, 516)
    # Red prevails, then green: a wrong phase of the pattern would mix them.
    picture = develop(path)[24:-24, 24:-24].reshape(-1, 3).astype(float)
    assert picture.std(axis=0).max() < 1.0
    red, green, blue = picture.mean(axis=0)
    assert red > green + 20 > blue + 20


@pytest.mark.parametrize(
    "pattern", [["RW", "WB"], ["RRGG", "RRGG", "GGBB", "GGBB"], ["W"], ["GRG"] * 3, XTRANS[:3]]
)
def test_what_no_reader_has_is_no_dng(pattern):
    camera = sensor()
    cfa = camera.cfa.model_copy(update={"pattern": [list(row) for row in pattern]})
    assert not has_dng(camera.model_copy(update={"cfa": cfa}))


def test_the_gain_is_in_noise_and_exposure(tmp_path):
    camera = sensor(analogue_gains=[GainStep(gain=1), GainStep(gain=4, temporal_dark_noise_e=2)])
    at_1, at_4 = (values(write(tmp_path / "a.dng", frame(), camera.at_gain(g))) for g in (1, 4))
    # Four times the DN of the same white: two stops less to bring it to white.
    assert at_1["BaselineExposure"] - at_4["BaselineExposure"] == pytest.approx(2, abs=2e-6)
    span = 4095 - 256
    expected = [4 * 0.47 / span, ((4 * 0.47 * 2) ** 2 + 1 / 12) / span**2]
    assert_close(np.array(at_4["NoiseProfile"]), np.array(expected), rtol=1e-12)


def dcraw_matrix(xyz_to_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return camera to sRGB, and the daylight multipliers, as dcraw and LibRaw derive them.

    They take the matrix as one for D65, X 0.95047 and Z 1.08883, and scale the camera's channels so
    that sRGB's white is (1, 1, 1).
    """
    total = 0.95047 + 1 + 1.08883
    from_rgb = xyz_to_camera @ rgb_to_xyz((*REC709_CHROMATICITIES[:6], 0.95047 / total, 1 / total))
    return np.linalg.inv(from_rgb / from_rgb.sum(axis=1, keepdims=True)), 1 / from_rgb.sum(axis=1)


def test_libraw_has_the_colour_matrix_of_d65(tmp_path):
    camera = sensor()
    with rawpy.imread(str(write(tmp_path / "a.dng", frame(), camera))) as read:
        expected, _ = dcraw_matrix(colour.colour_matrix(colour.response(camera.qe), "D65"))
        # The file's numbers have six decimals, LibRaw's sRGB matrix as many: 1e-6 in ten terms,
        # against elements of 0.05 and more, magnified by an inverse of norm 3.
        assert_close(read.color_matrix[:, :3], expected, atol=3e-5)


@needs_dcraw
@pytest.mark.parametrize("pattern", PATTERNS)
def test_dcraw_reads_every_sample_and_what_they_mean(tmp_path, pattern):
    raw, camera = frame(), sensor(pattern)
    path = write(tmp_path / "a.dng", raw, camera)
    for document_mode in ("-D", "-E"):
        subprocess.run(["dcraw", document_mode, "-4", "-T", path], check=True)
        assert_close(tifffile.imread(tmp_path / "a.tiff"), raw, atol=0)
    text = subprocess.run(
        ["dcraw", "-i", "-v", path], check=True, capture_output=True, text=True
    ).stdout
    assert f"Filter pattern: {pattern[:2]}/{pattern[2:]}" in text
    assert "Shutter: 1/60.0 sec" in text
    assert "DNG Version: 1.4.0.0" in text
    daylight = np.array(re.search("Daylight multipliers: (.*)", text)[1].split(), float)
    _, expected = dcraw_matrix(colour.colour_matrix(colour.response(camera.qe), "D65"))
    # dcraw's own sRGB matrix has a white of Z 1.088754, 7e-5 less. Six decimals in the file, in
    # that matrix and in what it prints, of numbers from 0.3: 1e-5 more.
    assert_close(daylight / daylight[1], expected / expected[1], rtol=8e-5)
    gains = np.array(re.search("Camera multipliers: (.*)", text)[1].split()[:3], float)
    assert_close(gains / gains[1], np.array([2.0, 1.0, 4 / 3]), rtol=3e-6)


@needs_dcraw
def test_dcraw_has_the_black_and_white_level(tmp_path):
    path = write(tmp_path / "a.dng", frame(), sensor())
    text = subprocess.run(
        ["dcraw", "-v", "-d", "-T", path],
        check=True,
        capture_output=True,
        text=True,
    ).stderr
    assert "darkness 256, saturation 4095" in text


def test_tags_say_what_the_sensor_is(tmp_path):
    camera = sensor("BGGR")
    tags = values(write(tmp_path / "a.dng", frame(33, 47), camera, exposure_s=1 / 250))
    assert tags["DNGVersion"] == bytes([1, 4, 0, 0])
    assert tags["CFAPattern"] == bytes([2, 1, 1, 0])
    assert tags["CFARepeatPatternDim"] == (2, 2)
    assert tags["ActiveArea"] == (0, 0, 33, 47)
    assert (tags["DefaultCropOrigin"], tags["DefaultCropSize"]) == ((0, 0), (47, 33))
    assert tags["ExposureTime"] == 1 / 250
    assert tags["BlackLevel"] == 256
    assert tags["WhiteLevel"] == 4095
    assert tags["UniqueCameraModel"] == "gpusim IMX477-like"
    assert (tags["CalibrationIlluminant1"], tags["CalibrationIlluminant2"]) == (17, 21)
    curves = colour.response(camera.qe)
    for number, illuminant in enumerate(("A", "D65"), start=1):
        expected = colour.colour_matrix(curves, illuminant)
        assert_close(tags[f"ColorMatrix{number}"], expected.ravel(), atol=HALF_DECIMAL * 1.01)
    assert_close(tags["AsShotNeutral"], np.array([0.5, 1.0, 0.75]), atol=0)
    # log2 of the span over the white's signal in green, the brightest.
    expected_ev = np.log2((4095 - 256) / (0.47 * 6000))
    assert tags["BaselineExposure"] == pytest.approx(expected_ev, abs=HALF_DECIMAL * 1.01)


def test_the_lens_is_part_of_the_colour_matrix(tmp_path):
    camera, lens = sensor(), np.linspace(0.3, 1.0, 61)
    tags = values(write(tmp_path / "a.dng", frame(), camera, transmission=lens))
    expected = colour.colour_matrix(colour.response(camera.qe, lens), "D65")
    assert_close(tags["ColorMatrix2"], expected.ravel(), atol=HALF_DECIMAL * 1.01)
    clear = colour.colour_matrix(colour.response(camera.qe), "D65")
    assert np.abs(expected - clear).max() > 0.01


@pytest.mark.parametrize(
    ("exposure_s", "rational"),
    [(1 / 60, (1, 60)), (0.4, (2, 5)), (1e-7, (1, 10**7)), (1.0, (1, 1)), (3600.5, (7201, 2))],
)
def test_exposure_times_short_and_long(tmp_path, exposure_s, rational):
    path = write(tmp_path / "a.dng", frame(), sensor(), exposure_s=exposure_s)
    with tifffile.TiffFile(path) as file:
        assert file.pages.first.tags.valueof(TAGS["ExposureTime"]) == rational


@pytest.mark.parametrize("white_e", [1e-12, 1e12])
def test_an_extreme_exposure_stays_in_range(tmp_path, white_e):
    tags = values(
        write(tmp_path / "a.dng", frame(), sensor(), white_e=dict.fromkeys("RGB", white_e))
    )
    assert abs(tags["BaselineExposure"]) == 10


def test_saturation_is_the_converters_or_the_wells():
    assert saturation_dn(sensor()) == 4095
    assert saturation_dn(sensor(full_well_e=4000)) == 256 + 1880  # 0.47 DN/e- * 4000 e-


def test_noise_profile_is_the_variance_of_a_simulated_pixel():
    camera = sensor(full_well_e=7000)
    scale, offset = noise_profile(camera)
    span = saturation_dn(camera) - 256
    rng, n = np.random.default_rng(8), 400_000
    for mean_e in (0, 20, 2000):
        electrons = rng.poisson(mean_e, n) + rng.normal(0, camera.temporal_dark_noise_e, n)
        x = np.round(camera.system_gain_dn_per_e * electrons) / span
        expected = scale * camera.system_gain_dn_per_e * mean_e / span + offset
        # The variance of n samples is off by sqrt(2 / n) for one sigma: 5 sigma. On top, rounding
        # adds 1/12 only on average: with sigma above 1.4 DN it is off by less than 1e-4 of it.
        assert x.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / n) + 1e-4)


def test_the_same_frame_gives_the_same_bytes(tmp_path):
    first = write(tmp_path / "a.dng", frame(), sensor()).read_bytes()
    again = write(tmp_path / "b.dng", frame().copy(), sensor()).read_bytes()
    assert first == again
    other = frame()
    other[5, 5] ^= 1
    assert write(tmp_path / "a.dng", other, sensor()).read_bytes() != first


def test_only_the_file_is_left_behind(tmp_path):
    write(tmp_path / "a.dng", frame(), sensor())
    write(tmp_path / "a.dng", frame(), sensor())
    assert [p.name for p in tmp_path.iterdir()] == ["a.dng"]


def test_a_failed_write_is_a_clear_error_and_leaves_the_old_file(tmp_path):
    with pytest.raises(UserError, match="cannot write") as caught:
        write(tmp_path / "none" / "a.dng", frame(), sensor())
    assert caught.value.file == tmp_path / "none" / "a.dng"
    (tmp_path / "a.dng").mkdir()  # cannot be replaced by a file
    with pytest.raises(UserError, match="cannot write"):
        write(tmp_path / "a.dng", frame(), sensor())
    assert [p.name for p in tmp_path.iterdir()] == ["a.dng"]


@pytest.mark.parametrize("pattern", [[["R", "G", "G", "B"]], [["R", "G"], ["G", "W"]]])
def test_filter_arrays_that_no_reader_knows_are_refused(tmp_path, pattern):
    camera = sensor()
    camera = camera.model_copy(update={"cfa": camera.cfa.model_copy(update={"pattern": pattern})})
    with pytest.raises(UserError, match="filter array") as caught:
        write(tmp_path / "a.dng", frame(), camera)
    assert caught.value.field == "cfa.pattern"
    assert list(tmp_path.iterdir()) == []
