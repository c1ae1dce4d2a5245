"""Pictures of other programs: what they hold is what the scene has, and what is refused."""

from __future__ import annotations

import struct
import time
import zlib

import numpy as np
import pytest
import tifffile
from harness import assert_close
from PIL import Image
from scene.picture_files import (
    NM,
    cube,
    rgbe,
    write_envi,
    write_hdr,
    write_isetcam,
    write_png,
    write_spectral_exr,
    write_tiff,
)

from gpusim.errors import UserError
from gpusim.isp.files import write_picture
from gpusim.scene import make_scene
from gpusim.scene.bands import _hats
from gpusim.scene.spectra import WAVELENGTHS_NM, illuminant, luminance_cd_m2
from gpusim.scene.spectral_exr import wavelength_nm

F32 = 2.0**-23


def at_bands(scene) -> np.ndarray:
    """Return the scene's radiance (bands, rows, cols) at the file's wavelengths."""
    there = scene.on(NM)
    return np.einsum("mrc,mk->krc", scene.source.planes.astype(float), there.spectra)


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("kind", ["<f4", ">f4", "<u2", ">i2", "<f8"])
def test_envi_cubes_of_every_layout(tmp_path, interleave: str, kind: str):
    values = cube()
    whole = kind[1] != "f"
    stored = (values * 10_000).round().astype(kind) if whole else values.astype(kind)
    more = "data units = W/m^2/sr/um\n" + ("data gain values = {" + ", ".join(["1e-4"] * 8) + "}\n")
    header = write_envi(tmp_path / "a", stored, interleave, more if whole else more[:25])
    for file in (header, header.with_suffix(".img")):
        scene = make_scene(file)
        expected = 1e-3 * (stored.astype(float) * 1e-4 if whole else values)
        assert_close(at_bands(scene), expected, rtol=4 * F32)
    assert scene.illuminant == "the file's own"
    assert scene.known[0][1:] == (420.0, 700.0)


def test_a_relative_cube_has_the_white_asked_for_or_is_lit(tmp_path):
    header = write_envi(tmp_path / "a", cube())
    scene = make_scene(header, luminance_cd_m2=120.0)
    assert scene.white_luminance_cd_m2 == pytest.approx(120.0)
    assert any("no unit" in note for note in scene.notes)
    lit = make_scene(header, luminance_cd_m2=120.0, illuminant="A")
    lamp = illuminant("A", NM) * 120.0 / luminance_cd_m2(illuminant("A"))
    assert_close(at_bands(lit), cube() * lamp[:, None, None], rtol=4 * F32)


def test_a_cube_of_reflectances_is_lit_by_any_light(tmp_path):
    stored = (cube() * 10_000).round().astype("<u2")
    header = write_envi(tmp_path / "a", stored, more="reflectance scale factor = 10000\n")
    for name in (None, "FL2"):
        scene = make_scene(header, illuminant=name)
        lamp = illuminant(name or "D50", NM)
        lamp *= 300 / luminance_cd_m2(illuminant(name or "D50"))
        assert_close(at_bands(scene), stored / 1e4 * lamp[:, None, None], rtol=1e-6)
        assert scene.white_luminance_cd_m2 == pytest.approx(300)


def test_bands_are_straight_between_and_sorted_by_wavelength(tmp_path):
    values = cube()
    header = write_envi(tmp_path / "a", values)
    text = header.read_text()
    turned = ", ".join(f"{nm / 1000:g}" for nm in NM[::-1])
    text = text.replace(", ".join(f"{nm:g}" for nm in NM), turned)
    header.write_text(text.replace("Nanometers", "Micrometers"))
    scene = make_scene(header, luminance_cd_m2=1.0)
    found = np.einsum("mrc,mk->krc", scene.source.planes, scene.spectra)[:, 2, 3]
    expected = np.interp(WAVELENGTHS_NM, NM, values[::-1, 2, 3])
    assert_close(found / found[4], expected / expected[4], rtol=1e-5)


def test_fine_bands_are_averaged_to_the_grid(tmp_path):
    """Each 8 of 57 bands 5/8 nm apart make one: a line in one of them keeps its light."""
    nm = 450 + 0.625 * np.arange(57)
    values = np.zeros((57, 1, 2), np.float32)
    values[:, 0, 0], values[19, 0, 1] = 1.0, 8.0
    write_envi(tmp_path / "a", values)
    text = (tmp_path / "a.hdr").read_text()
    start = text.index("wavelength = {")
    (tmp_path / "a.hdr").write_text(
        text[:start] + f"wavelength = {{{', '.join(map(str, nm))}}}\ndata units = W/m^2/sr/nm\n"
    )
    scene = make_scene(tmp_path / "a.hdr")
    assert len(scene.spectra) == 8
    assert_close(scene.source.planes[:7, 0, 0], np.ones(7, np.float32), rtol=F32)
    assert_close(scene.source.planes[:, 0, 1], np.eye(8, dtype=np.float32)[2], rtol=F32)
    assert any("averaged to 8" in note for note in scene.notes)


def test_bands_sum_to_one_everywhere():
    assert_close(_hats(NM, WAVELENGTHS_NM).sum(axis=0), np.ones(61), atol=1e-14)


def test_spectral_exrs(tmp_path):
    values = cube()
    scene = make_scene(write_spectral_exr(tmp_path / "a.exr", values))
    assert_close(at_bands(scene), values.astype(float), rtol=4 * F32)
    reflective = make_scene(write_spectral_exr(tmp_path / "b.exr", values, "T"), illuminant="E")
    white = 300 / luminance_cd_m2(illuminant("E"))
    assert_close(at_bands(reflective), values * 100 * white, rtol=1e-5)


CHANNELS = {
    "S0.550,000000nm": ("S0", 550.0),
    "T.0,55um": ("T", 550.0),
    "S3.5,5e-7m": ("S3", 550.0),
    "T.500THz": ("T", 599.584916),  # c / 5e14 Hz
    "S0.550.0nm": None,
    "S4.550nm": None,
    "T.,nm": None,
    "S0.0Hz": None,
    "R": None,
}


@pytest.mark.parametrize(("name", "meant"), CHANNELS.items())
def test_channels_are_named_as_the_paper_has_it(name, meant):
    found = wavelength_nm(name)
    assert (found is None) == (meant is None)
    if meant:
        assert found[0] == meant[0]
        assert found[1] == pytest.approx(meant[1], rel=1e-9)


@pytest.mark.parametrize("kind", ["struct", "basis", "7.3"])
def test_isetcam_scenes(tmp_path, kind: str):
    values = cube()
    file = write_isetcam(tmp_path / "a.mat", values, kind)
    scene = make_scene(file)
    # Photons in float32, by way of the basis in float32 too: a sum of eight.
    assert_close(at_bands(scene), values.astype(float), rtol=2e-5)
    # The file's own white: 2 W m^-2 sr^-1 nm^-1, an energy or its photons.
    assert_close(scene.on(NM).white, np.full(8, 2.0), rtol=1e-5)
    lit = make_scene(file, illuminant="A", luminance_cd_m2=100.0)
    lamp = illuminant("A", NM) * 100.0 / luminance_cd_m2(illuminant("A"))
    assert_close(at_bands(lit), values / 2 * lamp[:, None, None], rtol=2e-5)


@pytest.mark.parametrize("packed", [True, False])
def test_radiance_pictures(tmp_path, packed: bool):
    rng = np.random.default_rng(2)
    rgb = rng.uniform(0.1, 1, (9, 300, 3)) * 10.0 ** rng.integers(-4, 5, (9, 300, 1))
    rgb[2, 10:200] = 0.75  # long runs
    rgb[4, 5] = 0
    file = write_hdr(tmp_path / "a.hdr", rgb, packed)
    scene = make_scene(file)
    # Each mantissa is cut to 8 bits, and read as the middle of its step; exposures multiply to 1/2.
    step = np.ldexp(1.0, rgbe(rgb)[..., 3].astype(int) - 136)[..., None]
    found = np.moveaxis(scene.source.planes, 0, -1).astype(float) / 2
    assert (np.abs(found - rgb) <= 0.5 * step * 1.0001).all()
    assert found[4, 5].max() == 0
    assert scene.white_luminance_cd_m2 == pytest.approx(179, rel=5e-3)  # Rec.709 spectra


@pytest.mark.parametrize(
    ("size", "turn"),
    [
        ("-Y {} +X {}", lambda a: a),
        ("+Y {} +X {}", lambda a: a[::-1]),
        ("-Y {} -X {}", lambda a: a[:, ::-1]),
        ("+X {} -Y {}", lambda a: a.transpose(1, 0, 2)),
        ("-X {} +Y {}", lambda a: a[::-1, ::-1].transpose(1, 0, 2)),
    ],
)
def test_radiance_pictures_stand_upright(tmp_path, size: str, turn):
    rgb = np.random.default_rng(3).uniform(0.5, 1, (4, 6, 3))
    found = make_scene(write_hdr(tmp_path / "a.hdr", rgb, False, size)).source.planes
    assert_close(np.moveaxis(found, 0, -1) / 2, turn(rgb), atol=2.0**-8)


TRANSFERS = {
    "linear": lambda v: v,
    "srgb": lambda v: np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4),
    "rec709": lambda v: np.where(v < 0.081, v / 4.5, ((v + 0.099) / 1.099) ** (1 / 0.45)),
    "gamma2.2": lambda v: v**2.2,
}


@pytest.mark.parametrize("transfer", TRANSFERS)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_tiffs_and_pngs_by_a_stated_transfer_function(tmp_path, transfer: str, kind):
    most = np.iinfo(kind).max
    levels = np.linspace(0, most, 18).astype(kind)
    picture = np.random.default_rng(1).permutation(levels).reshape(2, 3, 3)
    expected = TRANSFERS[transfer](picture / most)
    files = [write_tiff(tmp_path / "a.tif", picture)]
    if kind is np.uint8:
        files.append(write_png(tmp_path / "a.png", picture))
    for file in files:
        found = make_scene(file, transfer=transfer).source.planes
        assert_close(np.moveaxis(found, 0, -1), expected, atol=F32)
    grey = make_scene(write_tiff(tmp_path / "g.tif", picture[..., 0]), transfer=transfer)
    assert_close(grey.source.planes[2], expected[..., 0], atol=F32)


@pytest.mark.parametrize("samples", [3, 4])
def test_pngs_of_16_bits_a_colour_have_all_of_them(tmp_path, samples: int):
    """Ours of `develop --bits 16`, and one with transparency: what a TIFF of them gives."""
    values = np.random.default_rng(3).integers(0, 1 << 16, (5, 7, samples)).astype(np.uint16)
    write_picture(tmp_path / "a.png", values[..., :3])
    if samples == 4:
        lines = np.pad(values.astype(">u2").view(np.uint8).reshape(5, -1), ((0, 0), (1, 0)))
        head, content = struct.pack(">2I5B", 7, 5, 16, 6, 0, 0, 0), b"\x89PNG\r\n\x1a\n"
        for chunk in (b"IHDR" + head, b"IDAT" + zlib.compress(lines.tobytes()), b"IEND"):
            content += struct.pack(">I", len(chunk) - 4) + chunk
            content += struct.pack(">I", zlib.crc32(chunk))
        (tmp_path / "a.png").write_bytes(content)
    write_tiff(tmp_path / "a.tif", values[..., :3])
    found, expected = (
        make_scene(tmp_path / name, transfer="linear") for name in ("a.png", "a.tif")
    )
    np.testing.assert_array_equal(found.source.planes, expected.source.planes)
    assert found.notes == expected.notes and "16-bit" in found.notes[0]


def test_pngs_of_a_palette_are_its_colours_and_transparency_is_left_out(tmp_path):
    colours = np.random.default_rng(3).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    write_png(tmp_path / "rgb.png", colours)
    Image.fromarray(colours).quantize(64).save(tmp_path / "p.png")  # 35 colours: none is lost
    write_png(tmp_path / "rgba.png", np.concatenate([colours, colours[..., :1]], axis=2))
    expected = make_scene(tmp_path / "rgb.png", transfer="srgb").source.planes
    for name in ("p", "rgba"):
        found = make_scene(tmp_path / f"{name}.png", transfer="srgb").source.planes
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("grey", [False, True])
def test_jpegs_are_read_upright(tmp_path, grey: bool):
    """Even squares of 16 pixels survive JPEG's blocks within two codes; Exif turns them."""
    codes = np.array([[20, 90, 160], [200, 140, 60]], np.uint8).repeat(16, 0).repeat(16, 1)
    codes = codes if grey else np.stack([codes, codes, codes], axis=-1)
    exif = Image.Exif()
    exif[0x0112] = 6  # to be shown turned to the right
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=100, exif=exif)
    found = make_scene(tmp_path / "a.jpg", transfer="linear").source.planes
    expected = np.rot90(codes, -1)
    expected = np.stack([expected] * 3) if grey else np.moveaxis(expected, -1, 0)
    assert_close(found, expected / 255, atol=2 / 255)


def test_a_picture_of_print_colours_or_of_another_kind_is_refused(tmp_path):
    Image.new("CMYK", (8, 8)).save(tmp_path / "a.jpeg")
    Image.new("RGB", (8, 8)).save(tmp_path / "a.webp")
    with pytest.raises(UserError, match="no picture that can be read") as caught:
        make_scene(tmp_path / "a.jpeg", transfer="srgb")
    assert "CMYK" in str(caught.value.value)
    with pytest.raises(UserError, match="a kind that is not read") as caught:
        make_scene(tmp_path / "a.webp")
    assert ".jpg" in caught.value.allowed


def test_float_tiffs_are_linear_and_may_be_bright(tmp_path):
    picture = np.random.default_rng(1).uniform(0, 30, (4, 5, 3)).astype(np.float32)
    found = make_scene(write_tiff(tmp_path / "a.tiff", picture)).source.planes
    assert_close(np.moveaxis(found, 0, -1), picture, rtol=2 * F32)
    planar, apart = tmp_path / "p.tif", np.ascontiguousarray(np.moveaxis(picture, -1, 0))
    tifffile.imwrite(planar, apart, photometric="rgb", planarconfig="separate")
    assert_close(make_scene(planar).source.planes, np.moveaxis(picture, -1, 0), rtol=2 * F32)


def test_our_own_raw_is_a_scene(tmp_path):
    """An even raw, by way of LibRaw: even, and as bright as it is above black."""
    from gpusim.camera import load_camera
    from gpusim.isp.dng import write_dng

    sensor = load_camera("demo").sensor.model_copy(update={"rows": 64, "cols": 96})
    raw = np.full((64, 96), sensor.black_level_dn + 800, np.uint16)
    white = dict.fromkeys(sensor.channels, 1000.0)
    write_dng(tmp_path / "raw.dng", raw, sensor, exposure_s=0.01, white_e=white)
    planes = make_scene(tmp_path / "raw.dng").source.planes
    inner = planes[:, 8:-8, 8:-8]
    assert inner.min() > 0.01
    assert np.ptp(inner, axis=(1, 2)).max() < 0.02 * inner.mean()


REFUSED = {
    "no wavelengths": ("a.hdr", "wavelength"),
    "short": ("a.img", None),
    "no samples": ("a.hdr", None),
    "no transfer": ("a.tif", "transfer"),
    "transfer": ("a.tif", "transfer"),
    "not needed": ("a.mat", "transfer"),
    "nan": ("a.hdr", "band 3"),
    "empty mat": ("a.mat", None),
    "short png": ("a.png", None),
    "text": ("a.dng", None),
}


@pytest.mark.parametrize("case", REFUSED)
def test_mistakes_name_file_and_field(tmp_path, case: str):
    values, transfer = cube(), None
    name, field = REFUSED[case]
    file = tmp_path / name
    if name in ("a.hdr", "a.img"):
        if case == "nan":
            values[2, 1, 1] = np.nan
        header = write_envi(tmp_path / "a", values)
        data = header.with_suffix(".img")
        if case == "no wavelengths":
            header.write_text(header.read_text().replace("wavelength = ", "wave = "))
        elif case == "short":
            data.write_bytes(data.read_bytes()[:-1])
        elif case == "no samples":
            data.unlink()
        given = header
    else:
        given = file
        if name == "a.tif":
            write_tiff(file, np.zeros((3, 4, 3), np.uint8))
            transfer = "log" if case == "transfer" else None
        elif case == "not needed":
            write_isetcam(file, values)
            transfer = "srgb"
        elif case == "empty mat":
            from scipy.io import savemat

            savemat(file, {"a": 1})
        elif case == "short png":
            file.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x10\x02\0\0\0")
        else:
            file.write_text("no raw")
    started = time.process_time()
    with pytest.raises(UserError) as caught:
        make_scene(given, transfer=transfer)
    assert time.process_time() - started < 2
    assert caught.value.file == file
    assert caught.value.field == field


@pytest.mark.parametrize("option", ["transfer", "upsampling"])
def test_a_chart_has_no_use_for_what_pictures_are_read_by(option: str):
    with pytest.raises(UserError) as caught:
        make_scene("demo", **{option: "foo"})
    assert caught.value.field == option and caught.value.value == "foo"
