"""DNG files, as LibRaw, dcraw and a TIFF reader see them."""

import re
import shutil
import struct
import subprocess
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
import rawpy
import tifffile
from harness import assert_close

from gpusim.errors import UserError
from gpusim.isp import colour
from gpusim.isp.develop import develop
from gpusim.isp.dng import BLACK_IS_ZERO, CFA, LINEAR_RAW, TAGS, has_dng, photometric, write_dng
from gpusim.isp.lens_tags import Optics
from gpusim.isp.levels import linearization_table, noise_profile, saturation_dn, span_dn
from gpusim.isp.quad import write_bayer
from gpusim.isp.rawfile import read_raw
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.sensor.adc_model import DualGain, GainStep, Linearity
from gpusim.sensor.cfa import PATTERNS as NAMED
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise_model import LineNoise, ResetNoise

PATTERNS = ["RGGB", "BGGR", "GRBG", "GBRG"]
WHITE_E = {"R": 3000.0, "G": 6000.0, "B": 4500.0}
NEAREST = 1e-9  # relative, of rationals of 32 bits
TAKEN = datetime(2026, 2, 3, 4, 5, 6, tzinfo=timezone(timedelta(hours=-3, minutes=-30)))
HEIGHT_UM = np.linspace(0, 5000, 129)
LENS = Optics("a lens", 8.3, 2.8, HEIGHT_UM, HEIGHT_UM, np.ones(129))

needs_dcraw = pytest.mark.skipif(shutil.which("dcraw") is None, reason="dcraw is not installed")
needs_exiftool = pytest.mark.skipif(
    shutil.which("exiftool") is None, reason="exiftool is not installed"
)


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


def exif(path) -> dict:
    """Return the values of the Exif part by their names in Exif."""
    with tifffile.TiffFile(path) as file:
        return file.pages.first.tags["ExifTag"].value


def with_pattern(name: str, **changes: object):
    """Return the sensor with a filter array by name; what is not red, green or blue sees all."""
    base = sensor()
    curves = base.quantum_efficiency.channels
    clear = [min(1.0, sum(values)) for values in zip(*curves.values(), strict=True)]
    pattern = [list(row) for row in NAMED.get(name, name.split("/"))]
    used = {letter: curves.get(letter, clear) for row in pattern for letter in row}
    changes |= {
        "cfa": base.cfa.model_copy(update={"pattern": pattern}),
        "quantum_efficiency": base.quantum_efficiency.model_copy(update={"channels": used}),
    }
    return load_sensor("imx477").model_copy(update=changes)


def white_of(camera) -> dict[str, float]:
    return {name: WHITE_E.get(name, 9000.0) for name in camera.channels}


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
        # 1 / AsShotNeutral, in float32.
        assert_close(gains / gains[1], np.array([2.0, 1.0, 4 / 3]), rtol=3e-7)


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
    assert develop(path).picture.shape == (48, 64, 3)


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
    # Without it RawTherapee takes none of X-Trans's black: pink.
    assert values(write(tmp_path / "b.dng", frame(), sensor()))["BlackLevelRepeatDim"] == (1, 1)


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
    assert develop(path).picture.shape == (48, 64, 3)


@needs_dcraw
def test_dcraw_undoes_the_non_linearity(tmp_path):
    path = write(tmp_path / "a.dng", frame(), bent())
    table, _ = linearization_table(bent())
    subprocess.run(["dcraw", "-D", "-4", "-T", path], check=True)
    assert_close(tifffile.imread(tmp_path / "a.tiff"), table[frame()], atol=0)


def test_a_bent_response_is_developed_as_a_straight_one(tmp_path):
    """A grey wedge: what the non-linearity took is back in the picture."""
    electrons = np.linspace(50, 5000, 128)[None].repeat(32, axis=0)
    pictures = []
    for camera in (sensor(), bent(), sensor()):
        read = camera.linearity.read(electrons) if camera.linearity else electrons
        if len(pictures) == 2:  # the control: the bent raw without its table
            read = bent().linearity.read(electrons)
        raw = np.round(256 + 0.47 * read).astype(np.uint16)
        neutral = dict.fromkeys("RGB", 5000.0)
        path = write(tmp_path / "a.dng", raw, camera, white_e=neutral)
        pictures.append(develop(path).picture.astype(float))
    straight, undone, left = pictures
    # A DN of the raw is at most 12.92 * 255 / 2350 = 1.4 levels of the picture, in the blacks.
    assert np.abs(undone - straight).max() <= 2
    assert np.abs(left - straight).max() >= 3


def test_the_span_of_a_bent_response_is_that_of_a_straight_one():
    camera = bent(full_well_e=6000.0)
    least_e = 6000 - 3 * np.hypot(3.0, 1.1)  # of read noise and fixed offsets
    assert saturation_dn(camera) == int(256 + 0.47 * camera.linearity.read(least_e))
    # The code is cut to a whole number; the response's slope is 0.93 there.
    assert 0 <= 0.47 * least_e - span_dn(camera) < 1 / 0.93
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
    assert exif(path)["ISOSpeedRatings"] == iso
    with rawpy.imread(str(path)) as read:
        assert_close(read.raw_image.copy(), frame(), atol=0)


def test_a_sensor_that_names_no_speed_has_its_saturation_based_one(tmp_path):
    """ISO 12232: 78 over the lux seconds of daylight that saturate a pixel, here of a mean eta."""
    cie = pytest.importorskip("colour", reason="for the illuminant and the observer")
    camera = with_pattern("monochrome", analogue_gains=[], pixel_pitch_um=10.0)
    flat = camera.quantum_efficiency.model_copy(
        update={"wavelengths_nm": [400.0, 700.0], "channels": {"W": [0.5, 0.5]}}
    )
    camera = camera.model_copy(update={"quantum_efficiency": flat})
    power = cie.SDS_ILLUMINANTS["D55"]
    seen = cie.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    nm = np.arange(400, 701, 5)
    lux = 683 * np.trapezoid([power[n] * seen[n][1] for n in nm], nm)
    joules = 6.62607e-34 * 2.99792e8 / (nm * 1e-9)
    photons = 1e-10 * np.trapezoid([power[n] for n in nm] / joules, nm)  # of (10 um)^2
    expected = 78 * 0.5 * photons / lux / camera.saturation_e
    found = exif(write(tmp_path / "a.dng", frame(), camera, white_e=white_of(camera)))
    assert found["ISOSpeedRatings"] == pytest.approx(expected, rel=1e-5, abs=0.5)
    assert found["SensitivityType"] == 3  # Exif 2.3: ISO speed


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
    # Red prevails, then green: a wrong phase of the pattern would mix them.
    picture = develop(path).picture[24:-24, 24:-24].reshape(-1, 3).astype(float)
    assert picture.std(axis=0).max() < 1.0
    red, green, blue = picture.mean(axis=0)
    assert red > green + 20 > blue + 20


@pytest.mark.parametrize(
    ("pattern", "kind"),
    [
        ("RCCB", CFA),
        ("RGBW", CFA),
        ("quad Bayer", CFA),
        ("GRG/GRG/GRB", CFA),
        ("monochrome", LINEAR_RAW),
        ("G", LINEAR_RAW),
        ("RGB/CMY", BLACK_IS_ZERO),  # six colours
        ("RGBRGBRGB", BLACK_IS_ZERO),  # nine columns
    ],
)
def test_every_filter_array_has_its_file(tmp_path, pattern: str, kind: int):
    camera = with_pattern(pattern)
    assert (photometric(camera), has_dng(camera)) == (kind, kind != BLACK_IS_ZERO)
    path = write(tmp_path / "a.dng", frame(), camera, white_e=white_of(camera))
    tags = values(path)
    with tifffile.TiffFile(path) as file:
        assert file.pages.first.photometric == kind
        assert_close(file.pages.first.asarray(), frame(), atol=0)
    assert ("DNGVersion" in tags) == (kind != BLACK_IS_ZERO)
    # Readers can tell what a plain TIFF is, too.
    assert (tags["BlackLevel"], tags["WhiteLevel"], tags["Make"]) == (256, 4095, "gpusim")
    assert exif(path)["ExposureTime"] == (1, 60)
    if kind == LINEAR_RAW:
        assert not {"CFAPattern", "ColorMatrix1", "AsShotNeutral"} & tags.keys()
        return
    rows = NAMED.get(pattern, pattern.split("/"))
    assert tags["CFARepeatPatternDim"] == (len(rows), len(rows[0]))
    assert bytes(tags["CFAPattern"]) == bytes("RGBCMYW".index(site) for site in "".join(rows))
    colours = sorted(set("".join(rows)), key="RGBCMYW".index)
    assert bytes(tags["CFAPlaneColor"]) == bytes("RGBCMYW".index(one) for one in colours)
    matrix = colour.colour_matrix(colour.response(camera.colour_qe), "D65")
    assert_close(tags["ColorMatrix2"], matrix.ravel(), rtol=NEAREST)
    white = np.array([white_of(camera)[one] for one in colours])
    assert_close(tags["AsShotNeutral"], white / white.max(), rtol=NEAREST)


def test_libraw_reads_monochrome_and_four_colours(tmp_path):
    for pattern in ("monochrome", "RGBW"):
        camera = with_pattern(pattern)
        path = write(tmp_path / "a.dng", frame(), camera, white_e=white_of(camera))
        with rawpy.imread(str(path)) as read:
            assert_close(read.raw_image_visible.copy(), frame(), atol=0)
            assert read.white_level == 4095
            assert set(read.black_level_per_channel[: read.num_colors]) == {256}


def test_the_gain_is_in_the_noise_and_not_in_the_brightness(tmp_path):
    camera = sensor(analogue_gains=[GainStep(gain=1), GainStep(gain=4, temporal_dark_noise_e=2)])
    at_1, at_4 = (values(write(tmp_path / "a.dng", frame(), camera.at_gain(g))) for g in (1, 4))
    # Four times the DN of the same light are shown as four times as bright.
    assert at_1["BaselineExposure"] == at_4["BaselineExposure"] == 0
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
    path = write(tmp_path / "a.dng", frame(33, 47), camera, exposure_s=1 / 250)
    tags = values(path)
    assert tags["DNGVersion"] == bytes([1, 4, 0, 0])
    assert tags["CFAPattern"] == bytes([2, 1, 1, 0])
    assert tags["CFARepeatPatternDim"] == (2, 2)
    assert tags["ActiveArea"] == (0, 0, 33, 47)
    assert (tags["DefaultCropOrigin"], tags["DefaultCropSize"]) == ((0, 0), (47, 33))
    assert exif(path)["ExposureTime"] == (1, 250)
    assert tags["BlackLevel"] == 256
    assert tags["WhiteLevel"] == 4095
    assert tags["UniqueCameraModel"] == "gpusim IMX477-like"
    assert (tags["CalibrationIlluminant1"], tags["CalibrationIlluminant2"]) == (17, 21)
    curves = colour.response(camera.qe)
    for number, illuminant in enumerate(("A", "D65"), start=1):
        expected = colour.colour_matrix(curves, illuminant)
        assert_close(tags[f"ColorMatrix{number}"], expected.ravel(), rtol=NEAREST)
    assert_close(tags["AsShotNeutral"], np.array([0.5, 1.0, 0.75]), atol=0)
    assert tags["BaselineExposure"] == 0
    brighter = write(tmp_path / "b.dng", frame(), camera, ev=-1.25)
    assert values(brighter)["BaselineExposure"] == -1.25


def test_the_file_says_who_took_it_when_and_with_what(tmp_path):
    camera = sensor(serial_number=12345)
    lens = Optics("a lens of \u00c6on", 8.297, 2.8, HEIGHT_UM, HEIGHT_UM, np.ones(129))
    path = write(tmp_path / "a.dng", frame(), camera, taken=TAKEN, optics=lens, exposure_s=0.4)
    tags, more = values(path), exif(path)
    assert (tags["Make"], tags["Model"]) == ("gpusim", "IMX477-like")  # rawspeed needs both
    assert tags["CameraSerialNumber"] == more["BodySerialNumber"] == "12345"
    assert tags["DateTime"] == more["DateTimeOriginal"] == "2026:02:03 04:05:06"
    assert more["OffsetTimeOriginal"] == "-03:30"
    assert more["LensModel"] == "a lens of ?on"  # Exif has ASCII alone
    assert more["FNumber"] == (14, 5)
    assert np.divide(*more["FocalLength"]) == pytest.approx(8.297, rel=NEAREST)
    assert_close(tags["LensInfo"], np.array([8.297, 8.297, 2.8, 2.8]), rtol=NEAREST)
    # Pixels per centimetre.
    assert np.divide(*more["FocalPlaneXResolution"]) == pytest.approx(1e4 / 1.55, rel=NEAREST)
    assert "FNumber" not in exif(write(tmp_path / "b.dng", frame(), camera))


DUAL = DualGain(
    system_gain_dn_per_e=0.047, temporal_dark_noise_e=120.0, black_level_dn=200, switch_dn=3800
)
EVERY_FILE = {
    "bayer": {},
    "a border": {"raw": "framed"},
    "black levels": {"sensor": {"channel_black_level_dn": {"R": 250.0, "B": 259.0}}},
    "monochrome": {"pattern": "monochrome"},
    "quad Bayer": {"pattern": "quad Bayer"},
    "clear and red": {"pattern": "RCCC"},
    "plain TIFF": {"pattern": "RGB/CMY"},
    "X-Trans": {"pattern": "X-Trans"},
    "dual gain": {"sensor": {"dual_gain": DUAL, "analogue_gains": (), "full_well_e": 80_000.0}},
    "binned": {"pattern": "quad Bayer", "binned": True},
    "a nonlinear response": {"bent": True},
    "a short exposure": {"exposure_s": 1e-12},
}


@needs_exiftool
@pytest.mark.parametrize("name", EVERY_FILE)
def test_exiftool_has_nothing_to_say(tmp_path, name):
    case = dict(EVERY_FILE[name])
    camera = with_pattern(case.pop("pattern", "BGGR"), **case.pop("sensor", {}))
    raw, areas = frame(), {}
    if case.pop("bent", False):
        camera = bent()
    if case.pop("raw", None):
        raw, areas = framed_raw(), {"active_area": LIT, "masked_areas": MASKED}
    path = tmp_path / ("a.dng" if has_dng(camera) else "a.tif")
    binned = case.pop("binned", False)
    write(path, raw, camera, white_e=white_of(camera), optics=LENS, **areas, **case)
    if binned:
        write_bayer(read_raw(path), path := tmp_path / "binned.dng", binned=True)
    command = ["exiftool", "-validate", "-warning", "-error", "-a", path]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert said.split(":")[1].strip() == "OK", said


def test_the_lens_is_part_of_the_colour_matrix(tmp_path):
    camera, lens = sensor(), np.linspace(0.3, 1.0, 61)
    tags = values(write(tmp_path / "a.dng", frame(), camera, transmission=lens))
    expected = colour.colour_matrix(colour.response(camera.qe, lens), "D65")
    assert_close(tags["ColorMatrix2"], expected.ravel(), rtol=NEAREST)
    clear = colour.colour_matrix(colour.response(camera.qe), "D65")
    assert np.abs(expected - clear).max() > 0.01


@pytest.mark.parametrize(
    ("exposure_s", "rational"),
    [
        (1 / 60, (1, 60)),
        (0.4, (2, 5)),
        (1e-7, (1, 10**7)),
        (1.0, (1, 1)),
        (3600.5, (7201, 2)),
        # A rational of 32 bits is 0 or 2.3e-10 and more.
        (1e-12, (1, 2**32 - 1)),
        (1e12, (2**32 - 1, 1)),
    ],
)
def test_exposure_times_short_and_long(tmp_path, exposure_s, rational):
    path = write(tmp_path / "a.dng", frame(), sensor(), exposure_s=exposure_s)
    assert exif(path)["ExposureTime"] == rational
    above, below = exif(path)["ShutterSpeedValue"]  # APEX: minus log2 of the seconds
    assert 2 ** (-above / below) == pytest.approx(exposure_s, rel=1e-6)


@pytest.mark.parametrize("white_e", [1e-12, 1e12])
def test_an_extreme_exposure_has_its_neutral(tmp_path, white_e):
    light = {"R": 0.5 * white_e, "G": white_e, "B": 1e-8 * white_e}
    tags = values(write(tmp_path / "a.dng", frame(), sensor(), white_e=light))
    assert_close(tags["AsShotNeutral"], np.array([0.5, 1, 1e-8]), rtol=1e-6)
    assert tags["BaselineExposure"] == 0


def test_saturation_is_the_converters_or_the_wells():
    assert saturation_dn(sensor()) == 4095
    # 0.47 DN/e- of 4000 e-, less 3 sigma of read noise and fixed offsets.
    assert saturation_dn(sensor(full_well_e=4000)) == int(256 + 0.47 * (4000 - 3 * 3.1953))


@pytest.mark.parametrize("full_well_e", [4000, 40])
def test_pixels_with_a_full_well_are_saturated(full_well_e):
    camera = sensor(full_well_e=full_well_e)
    noise_e = np.random.default_rng(3).normal(0, np.hypot(3.0, 1.1), 100_000)
    codes = np.round(256 + 0.47 * (full_well_e + noise_e))
    # 1 in 741 is below 3 sigma; a step of the converter is 0.67 sigma more or less.
    assert np.mean(codes >= saturation_dn(camera)) > 1 - 1 / 741 - 0.01
    half = np.round(256 + 0.47 * (full_well_e / 2 + noise_e))
    assert np.mean(half >= saturation_dn(camera)) < (0.001 if full_well_e == 4000 else 0.01)


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


TEMPORAL = {
    "reset noise": ({"reset_noise": ResetNoise(noise_e=9.0)}, 9.0),
    "rows": ({"lines": LineNoise(row_noise_e=6.0)}, 6.0),
    "columns": ({"lines": LineNoise(column_noise_e=7.0, dsnu_column_e=50.0)}, 7.0),
}


@pytest.mark.parametrize("name", TEMPORAL)
def test_every_temporal_part_is_in_the_noise_profile(tmp_path, name):
    changes, noise_e = TEMPORAL[name]
    steps = [GainStep(gain=1), GainStep(gain=4, temporal_dark_noise_e=2.0)]
    camera = sensor(analogue_gains=steps, **changes).at_gain(4)
    scale, offset = values(write(tmp_path / "a.dng", frame(), camera))["NoiseProfile"]
    span = saturation_dn(camera) - 256
    # Fixed patterns are no noise.
    expected = ((4 * 0.47) ** 2 * (2.0**2 + noise_e**2) + 1 / 12) / span**2
    assert (scale, offset) == pytest.approx((4 * 0.47 / span, expected), rel=1e-12)


def test_reset_noise_in_the_noise_profile_is_that_of_the_temperature(tmp_path):
    camera = sensor(reset_noise=ResetNoise(capacitance_ff=2.0))
    path = write(tmp_path / "a.dng", frame(), camera, temperature_c=80.0)
    kelvin, charge = 353.15, 1.602176634e-19
    reset_e = np.sqrt(1.380649e-23 * kelvin * 2e-15) / charge
    expected = (0.47**2 * (9 + reset_e**2) + 1 / 12) / (saturation_dn(camera) - 256) ** 2
    assert values(path)["NoiseProfile"][1] == pytest.approx(expected, rel=1e-12)


def test_a_noise_of_two_numbers_is_in_the_noise_profile():
    camera = sensor(gaussian_variance_per_e=1.8)
    span = 4095 - 256
    expected = (1.8 * 0.47 / span, ((0.47 * 3) ** 2 + 1 / 12) / span**2)
    assert noise_profile(camera) == pytest.approx(expected, rel=1e-12)


def test_two_merged_reads_have_the_noise_of_the_one_that_counts():
    camera = sensor(dual_gain=DUAL, analogue_gains=(), full_well_e=80_000.0)
    scale, offset = noise_profile(camera)
    span = saturation_dn(camera) - 256
    rng, n = np.random.default_rng(9), 400_000
    for mean_e, gain, noise_e in ((0, 0.47, 3.0), (3000, 0.47, 3.0), (79_000, 0.047, 120.0)):
        electrons = rng.poisson(mean_e, n) + rng.normal(0, noise_e, n)
        x = 0.47 / gain * np.round(gain * electrons) / span
        found = scale * 0.47 * mean_e / span + offset
        # The variance of n samples to 5 sigma. Between the ends the line lies above, by the
        # signal's share of the span times the 120^2 e-^2 that the second read has more.
        more = 120**2 * mean_e / 80_000 / (mean_e + 9) if gain == 0.47 else 0.02 * 120**2 / 79_000
        assert x.var() == pytest.approx(found, rel=5 * np.sqrt(2 / n) + more + 1e-4)


def opcode_list(data: bytes) -> dict[int, tuple[int, bytes]]:
    """Return flags and parameters by number: DNG 1.4, chapter 7."""
    (count,), found = struct.unpack(">I", data[:4]), {}
    data = data[4:]
    for _ in range(count):
        number, version, flags, size = struct.unpack(">I4s2I", data[:16])
        assert version == bytes((1, 3, 0, 0))
        found[number] = flags, data[16 : 16 + size]
        data = data[16 + size :]
    assert data == b""
    return found


def test_the_opcodes_undo_shading_and_distortion(tmp_path):
    camera = sensor().roi(800, 1000)
    ideal = HEIGHT_UM * (1 - 0.08 * (HEIGHT_UM / 1000) ** 2)  # barrel
    light = np.cos(np.arctan(HEIGHT_UM / 1500)) ** 4
    seen = HEIGHT_UM < 1200
    lens = Optics("a lens", 1.5, 2.0, HEIGHT_UM[seen], ideal[seen], light[seen])
    raw = np.zeros((600, 700), np.uint16)
    place = 150, 250  # of a rectangle, off the middle
    path = write(tmp_path / "a.dng", raw, camera, optics=lens, place=place)
    with tifffile.TiffFile(path) as file:
        found = opcode_list(file.pages.first.tags[TAGS["OpcodeList3"]].value)
    assert list(found) == [3, 1]  # what was distorted last is undone last
    flags, data = found[3]
    *k, x, y = struct.unpack(">7d", data)
    assert (flags, x, y) == (1, (500 - 250) / 700, (400 - 150) / 600)
    corner_um = 1.55 * np.hypot(450, 350)
    um = np.linspace(0, corner_um, 50)
    gain = 1 + sum(c * (um / corner_um) ** (2 * n) for n, c in enumerate(k, start=1))
    assert_close(gain * np.cos(np.arctan(um / 1500)) ** 4, np.ones(50), atol=1e-4)
    planes, *k, _, _, x, y = struct.unpack(">I8d", found[1][1])
    assert (planes, x, y) == (1, (500 - 250) / 700, (400 - 150) / 600)
    straight = um * (1 - 0.08 * (um / 1000) ** 2)  # ideal distances of real ones
    r = straight / corner_um
    back = sum(c * r ** (1 + 2 * n) for n, c in enumerate(k)) * corner_um
    assert_close(back, um, atol=0.05)  # a thirtieth of a pixel


@pytest.mark.parametrize(
    ("lens", "place"),
    [(LENS, (1000, 0)), (Optics("x", 8.0, 2.0, *[np.zeros(0)] * 3), (0, 0))],
    ids=["the axis is not in the picture", "no axis"],
)
def test_what_no_opcode_can_undo_has_none(tmp_path, lens, place):
    path = write(tmp_path / "a.dng", frame(), sensor().roi(800, 1000), optics=lens, place=place)
    assert "OpcodeList3" not in values(path)
    assert exif(path)["LensModel"] == lens.name


def test_the_same_frame_gives_the_same_bytes(tmp_path):
    first = write(tmp_path / "a.dng", frame(), sensor(), taken=TAKEN).read_bytes()
    again = write(tmp_path / "b.dng", frame().copy(), sensor(), taken=TAKEN).read_bytes()
    assert first == again
    other = frame()
    other[5, 5] ^= 1
    assert write(tmp_path / "a.dng", other, sensor(), taken=TAKEN).read_bytes() != first
    before = datetime.now(UTC).replace(microsecond=0)
    taken = values(write(tmp_path / "a.dng", frame(), sensor()))["DateTime"]
    found = datetime.strptime(taken, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    assert before <= found <= datetime.now(UTC)


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
