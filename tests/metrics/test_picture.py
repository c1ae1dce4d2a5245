"""Pictures of all kinds are read as linear channels, and what is no picture is refused."""

from __future__ import annotations

import numpy as np
import pytest
import rawpy
import tifffile
from fake_capture import fake_capture
from PIL import Image

from gpusim.errors import UserError
from gpusim.isp.dng import write_dng
from gpusim.metrics.picture import _raw, read_picture

LIGHT = np.linspace(0, 1, 12).reshape(3, 4)


def encoded(light: np.ndarray) -> np.ndarray:
    """Return sRGB codes from 0 to 1 (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def test_codes_of_a_png_follow_the_srgb_curve_unless_they_are_said_to_be_linear(tmp_path):
    file = tmp_path / "a.png"
    Image.fromarray((65535 * encoded(LIGHT)).round().astype(np.uint16)).save(file)
    # Half a code of 16 bits, at the curve's steepest 2.3 times as much light.
    np.testing.assert_allclose(read_picture(file)["Y"].values, LIGHT, atol=2e-5)
    np.testing.assert_allclose(
        read_picture(file, linear=True)["Y"].values, encoded(LIGHT), atol=1e-5
    )


def test_a_colour_tiff_has_its_channels_and_their_luminance(tmp_path):
    file = tmp_path / "a.tif"
    rgb = np.stack([LIGHT, LIGHT**2, np.zeros_like(LIGHT)], axis=-1)
    tifffile.imwrite(file, rgb.astype(np.float32), photometric="rgb")
    planes = read_picture(file, linear=True)
    assert list(planes) == ["Y", "R", "G", "B"]
    np.testing.assert_allclose(planes["Y"].values, 0.2126 * LIGHT + 0.7152 * LIGHT**2, atol=1e-6)
    np.testing.assert_allclose(planes["G"].values, LIGHT**2, atol=1e-7)


def test_an_array_is_taken_as_it_is(tmp_path):
    np.save(tmp_path / "a.npy", LIGHT)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.npy")["Y"].values, LIGHT)


def test_filters_of_our_raw_and_of_libraws_reading_of_it_are_the_same(tmp_path):
    taken = fake_capture()
    file = tmp_path / "a.dng"
    white_e = dict.fromkeys("RGB", 4000.0)
    write_dng(file, taken.raw, taken.camera.sensor, white_e=white_e, exposure_s=1 / 60)
    own = read_picture(file)
    with rawpy.imread(str(file)) as raw:
        other = _raw(raw)
    assert set(own) == set(other) == {"R", "G", "B"}
    for name, plane in own.items():
        rows, cols = np.indices(plane.values.shape) % 2
        there = plane.sites[rows, cols]
        np.testing.assert_array_equal(there, other[name].sites[rows, cols])
        np.testing.assert_allclose(plane.values[there], other[name].values[there], atol=0.5)
        assert plane.clip[1] == pytest.approx(other[name].clip[1], abs=0.5)


@pytest.mark.parametrize("name", ["a.png", "a.dng", "a.tif", "a.npy", "a.exr", "a.txt"])
def test_what_is_no_picture_is_one_clear_error(tmp_path, name):
    file = tmp_path / name
    file.write_bytes(b"no picture at all" * 20)
    with pytest.raises(UserError) as caught:
        read_picture(file)
    assert name in caught.value.screen()
    with pytest.raises(UserError):
        read_picture(tmp_path / f"absent-{name}")


def test_a_png_with_a_damaged_chunk_and_an_array_with_a_damaged_header_are_refused(tmp_path):
    """Pillow raises a SyntaxError of the one, NumPy a TokenError of the other."""
    values = np.random.default_rng(1).integers(0, 256, (64, 64)).astype(np.uint8)
    Image.fromarray(values).save(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", values)
    png, npy = ((tmp_path / name).read_bytes() for name in ("a.png", "a.npy"))
    at = png.index(b"IDAT") - 4  # its length: now it ends amid its data
    (tmp_path / "a.png").write_bytes(png[:at] + (50).to_bytes(4, "big") + png[at + 4 :])
    (tmp_path / "a.npy").write_bytes(npy.replace(b"}", b" "))
    for name in ("a.png", "a.npy"):
        with pytest.raises(UserError, match="cannot be read") as caught:
            read_picture(tmp_path / name)
        assert caught.value.file == tmp_path / name


def test_arrays_of_text_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([["a", "b"]]))
    with pytest.raises(UserError, match="shape"):
        read_picture(tmp_path / "a.npy")
