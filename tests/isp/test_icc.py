"""ICC profiles: what LittleCMS and exiftool make of them, and files that have them."""

from __future__ import annotations

import io
import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import tifffile
from harness import assert_close
from PIL import Image, ImageCms

from gpusim.isp.files import write_picture
from gpusim.isp.icc import profile
from gpusim.isp.transfer import SPACES
from gpusim.scene.colorimetry import encode_srgb, rgb_to_xyz


def cms(name: str) -> ImageCms.ImageCmsProfile:
    return ImageCms.ImageCmsProfile(io.BytesIO(profile(name)))


@pytest.mark.parametrize("name", SPACES)
def test_littlecms_finds_the_space(name: str):
    found = cms(name).profile
    assert found.profile_description == SPACES[name].title
    assert found.version == 4.4
    assert found.is_matrix_shaper
    chad = np.array(found.chromatic_adaptation[0])
    given = np.reshape(SPACES[name].chromaticities, (4, 2))
    colorants = found.red_colorant, found.green_colorant, found.blue_colorant
    for xy, colorant in zip(given[:3], colorants, strict=True):
        primary = np.linalg.solve(chad, colorant[0])
        # Rounded to 1/65536, and the green one has what all rounding leaves.
        assert_close(primary[:2] / primary.sum(), xy, atol=2e-4)
    white = rgb_to_xyz(SPACES[name].chromaticities).sum(axis=1)
    assert_close(chad @ white, np.array([0.9642, 1.0, 0.8249]), atol=1e-4)


@pytest.mark.parametrize("name", SPACES)
def test_littlecms_shows_the_colours_that_were_meant(name: str):
    """A picture in each space, taken to LittleCMS's own sRGB, is the light that it holds."""
    space = SPACES[name]
    codes = np.random.default_rng(1).integers(0, 256, (64, 3)).astype(np.uint8)
    codes[:4] = [[0, 0, 0], [255, 255, 255], [128, 128, 128], [3, 3, 3]]
    light = codes / 255
    if space.transfer is not None:
        curve = space.transfer
        high = ((light + curve.offset) / (1 + curve.offset)) ** (1 / curve.power)
        light = np.where(light <= curve.slope * curve.cut, light / curve.slope, high)
    srgb = rgb_to_xyz(SPACES["srgb"].chromaticities)
    shown = light @ np.linalg.solve(srgb, rgb_to_xyz(space.chromaticities)).T
    seen = ImageCms.profileToProfile(
        Image.fromarray(codes[None]),
        cms(name),
        ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")),
        ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )
    # LittleCMS rounds to 8 bits, and once before, within its tables.
    assert_close(np.asarray(seen)[0].astype(float), 255 * encode_srgb(shown), atol=1)


def test_the_file_is_whole():
    content = profile("p3")
    assert struct.unpack_from(">I", content)[0] == len(content)
    (count,) = struct.unpack_from(">I", content, 128)
    ends = []
    for number in range(count):
        _, place, size = struct.unpack_from(">4s2I", content, 132 + 12 * number)
        assert place % 4 == 0
        ends.append(place + size)
    assert len(content) - 4 < max(ends) <= len(content)
    assert profile("p3") == content != profile("srgb")


@pytest.mark.parametrize(
    ("name", "dtype"), [("a.png", 8), ("a.png", 16), ("a.tif", 16), ("a.jpg", 8)]
)
def test_a_picture_comes_back_with_its_profile(tmp_path: Path, name: str, dtype: int):
    top = 2**dtype - 1
    picture = np.random.default_rng(2).integers(0, top, (13, 7, 3)).astype(f"uint{dtype}")
    path = tmp_path / name
    write_picture(path, picture, "rec2020")
    if name == "a.tif":
        with tifffile.TiffFile(path) as file:
            assert file.pages.first.tags["InterColorProfile"].value == profile("rec2020")
            np.testing.assert_array_equal(file.asarray(), picture)
        return
    with Image.open(path) as image:
        assert image.info["icc_profile"] == profile("rec2020")
    if dtype == 16:
        cv2 = pytest.importorskip("cv2")
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
        np.testing.assert_array_equal(found, picture)
    elif name == "a.png":
        np.testing.assert_array_equal(np.asarray(Image.open(path)), picture)


@pytest.mark.skipif(shutil.which("exiftool") is None, reason="exiftool is not installed")
@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_exiftool_reads_the_profile_and_has_nothing_to_say(tmp_path: Path, name: str):
    path = tmp_path / name
    write_picture(path, np.full((6, 8, 3), 999, np.uint16), "p3")
    command = ["exiftool", "-j", "-validate", "-warning", "-ProfileDescription", "-ColorSpaceData"]
    text = subprocess.run([*command, path], capture_output=True, text=True, check=True).stdout
    (found,) = json.loads(text)
    assert found["ProfileDescription"] == "Display P3"
    assert found["ColorSpaceData"].strip() == "RGB"
    # It knows TIFF 6.0 alone: Deflate came with Adobe's supplement 2 of 2002.
    deflate = "Invalid value for IFD0 tag 0x0103 Compression"
    assert found.get("Warning") == (deflate if name == "a.tif" else None)
