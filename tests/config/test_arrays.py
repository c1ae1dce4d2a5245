"""Arrays that claim more than they hold, or more than any of ours: refused before they are made."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import tifffile

from gpusim.config import arrays
from gpusim.config.arrays import read_npy, read_npz, read_tiff

CLAIM = (40_000, 40_000)  # 12.8 GB of float64


def claiming(shape: tuple[int, ...], nbytes: int = 64) -> bytes:
    """Return a .npy file of a few bytes whose header has a large shape."""
    buffer = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue() + bytes(nbytes)


@pytest.fixture
def little_memory():
    """Fail where more than 64 MiB are allocated."""
    tracemalloc.start()
    yield
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 64 << 20


def test_arrays_come_back(tmp_path: Path):
    plane = np.arange(12, dtype=np.float32).reshape(3, 4)
    np.save(tmp_path / "a.npy", plane)
    np.savez_compressed(tmp_path / "a.npz", one=plane, two=np.float64(3), text="title")
    tifffile.imwrite(tmp_path / "a.tif", plane, compression="zlib")
    assert np.array_equal(read_npy(tmp_path / "a.npy"), plane)
    assert np.array_equal(read_tiff(tmp_path / "a.tif"), plane)
    found = read_npz(tmp_path / "a.npz")
    assert (
        np.array_equal(found["one"], plane) and found["two"] == 3 and str(found["text"]) == "title"
    )


def test_a_npy_that_claims_more_than_it_holds_is_refused(tmp_path: Path, little_memory):
    (tmp_path / "a.npy").write_bytes(claiming(CLAIM))
    with pytest.raises(ValueError):
        read_npy(tmp_path / "a.npy")


@pytest.mark.parametrize("size", [64, 1_000_000])
def test_a_npz_that_claims_more_than_it_holds_is_refused(tmp_path: Path, size, little_memory):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("psf.npy", claiming(CLAIM, size))
    with pytest.raises(ValueError, match=r"psf.npy|more than"):
        read_npz(tmp_path / "a.npz")


def test_a_npz_that_unpacks_to_more_than_any_bank_is_refused(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(arrays, "MOST_BYTES", 1000)
    np.savez(tmp_path / "a.npz", one=np.zeros(70), two=np.zeros(50))
    assert len(read_npz(tmp_path / "a.npz")) == 2
    np.savez(tmp_path / "a.npz", one=np.zeros(70), two=np.zeros(70))  # each is within bounds
    with pytest.raises(ValueError, match="more than"):
        read_npz(tmp_path / "a.npz")


def test_a_tiff_that_claims_more_than_it_holds_is_refused(tmp_path: Path, little_memory):
    file = tmp_path / "a.tif"
    tifffile.imwrite(file, np.zeros((8, 8), np.uint16), rowsperstrip=8)
    content = bytearray(file.read_bytes())
    with tifffile.TiffFile(file) as tiff:
        for tag in ("ImageLength", "ImageWidth"):
            offset = tiff.pages[0].tags[tag].offset
            content[offset + 2 : offset + 4] = (4).to_bytes(2, "little")  # LONG
            content[offset + 8 : offset + 12] = (60_000).to_bytes(4, "little")
    file.write_bytes(content)
    with pytest.raises(ValueError, match="more than it can have"):
        read_tiff(file)
