"""The TIFF writer as another reader sees it, and rationals."""

import struct

import numpy as np
import pytest
import tifffile

from gpusim.errors import UserError
from gpusim.isp import tiff

RAW = np.arange(35, dtype=np.uint16).reshape(5, 7) * 1000
TAGS = {
    262: (tiff.SHORT, (1,)),
    270: (tiff.ASCII, "odd"),
    282: (tiff.RATIONAL, (72, 1)),
    50714: (tiff.SRATIONAL, (-3, 4)),
    51041: (tiff.DOUBLE, (1e-300, 0.25)),
    50706: (tiff.BYTE, (1, 4, 0, 0)),
    51022: (tiff.UNDEFINED, b"abcde"),
}
EXIF = {33434: (tiff.RATIONAL, (1, 60)), 34855: (tiff.SHORT, (100,))}


def test_another_reader_finds_all(tmp_path):
    path = tmp_path / "a.tif"
    tiff.write_tiff(path, RAW, TAGS, EXIF)
    with tifffile.TiffFile(path) as file:
        page = file.pages.first
        np.testing.assert_array_equal(page.asarray(), RAW)
        found = {tag.code: tag.value for tag in page.tags}
    assert (found[270], found[50714], found[51041]) == ("odd", (-3, 4), (1e-300, 0.25))
    assert (found[50706], found[51022]) == (bytes((1, 4, 0, 0)), b"abcde")
    assert found[34665] == {"ExposureTime": (1, 60), "ISOSpeedRatings": 100}
    tags, exif = tiff.read_tags(path)
    assert {tag: tags[tag] for tag in TAGS if tag != 51022} == {
        tag: entry for tag, entry in TAGS.items() if tag != 51022
    }
    assert bytes(tags[51022][1]) == b"abcde"
    assert exif == EXIF
    # Written again, it is the same file.
    own = {tag: entry for tag, entry in tags.items() if tag in TAGS}
    tiff.write_tiff(tmp_path / "b.tif", RAW, own, exif)
    assert (tmp_path / "b.tif").read_bytes() == path.read_bytes()


def test_big_endian_files_are_read_too(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, RAW, byteorder=">", extratags=[(50730, 10, 1, (-1, 3), True)], metadata=None
    )
    tags, exif = tiff.read_tags(path)
    assert exif == {}
    assert tiff.numbers(tags[50730]) == pytest.approx(-1 / 3)
    assert tags[tiff.WIDTH][1] == (7,)


@pytest.mark.parametrize("value", [1e-9, 3.3e-7, 1 / 3, 0.999, 1, np.pi, 1e4 / 1.55, 1e9])
@pytest.mark.parametrize("sign", [1, -1])
def test_rationals_are_the_nearest(value, sign):
    above, below = tiff.rational(sign * value, tiff.SRATIONAL)
    struct.pack("<2i", above, below)
    assert above / below == pytest.approx(sign * value, rel=1e-9)
    above, below = tiff.rational(value)
    struct.pack("<2I", above, below)
    assert above / below == pytest.approx(value, rel=1e-9)


def test_rationals_have_ends():
    assert tiff.rational(0.0) == (0, 1)
    assert tiff.rational(1e-12) == (1, 2**32 - 1)
    assert tiff.rational(-1e-30, tiff.SRATIONAL) == (-1, 2**31 - 1)
    assert tiff.rational(1e30) == (2**32 - 1, 1)
    assert tiff.rational(1 / 60) == (1, 60)


@pytest.mark.parametrize(
    "content", [b"", b"II*\0", b"MM\0*\0\0", b"FUJIFILM" * 9, b"II*\0\xff\xff\xff\x7f"]
)
def test_what_is_no_tiff_is_told(tmp_path, content):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(ValueError, match="TIFF"):
        tiff.read_tags(tmp_path / "a")


def test_every_cut_of_a_file_is_read_or_told(tmp_path):
    tiff.write_tiff(tmp_path / "a.tif", RAW, TAGS, EXIF)
    whole = (tmp_path / "a.tif").read_bytes()
    for end in range(len(whole)):
        (tmp_path / "b.tif").write_bytes(whole[:end])
        try:
            tiff.read_tags(tmp_path / "b.tif")
        except ValueError as error:
            assert "TIFF" in str(error)


def test_more_than_a_tiff_can_count_is_refused(tmp_path):
    huge = np.broadcast_to(np.uint16(0), (65535, 65535))
    with pytest.raises(UserError, match="cannot write"):
        tiff.write_tiff(tmp_path / "a.tif", huge, {}, {})
    assert list(tmp_path.iterdir()) == []
