"""Cubes of other programs' own writers, and ours read by them: spectral (ENVI), colour (EXR).

spectral and OpenImageIO, by which colour reads and writes spectral EXR, are in the extra
``judges``; without them these are skipped.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scene.picture_files import NM, cube, write_envi

from gpusim.scene.envi import read_envi
from gpusim.scene.spectral_exr import RADIANCE_UNITS, read_spectral_exr, write_spectral_exr

pytestmark = pytest.mark.slow

LAYOUTS = tuple(product(("bsq", "bil", "bip"), "<>", ("u1", "i2", "i4", "f4", "f8", "u2")))


def stored(kind: str) -> np.ndarray:
    """Return a cube (bands, rows, cols), in whole numbers from 0 up where the type has those."""
    whole = np.dtype(kind).kind in "iu"
    top = min(np.iinfo(kind).max, 30_000) if whole else 1
    return (cube() * top).astype(kind)


@pytest.mark.parametrize(("interleave", "order", "kind"), LAYOUTS)
def test_envi_cubes_that_spectral_writes_are_read(tmp_path: Path, interleave, order, kind):
    envi = pytest.importorskip("spectral.io.envi")
    values = stored(kind)
    file = tmp_path / "a.hdr"
    envi.save_image(
        str(file),
        values.transpose(1, 2, 0),
        interleave=interleave,
        byteorder=int(order == ">"),
        dtype=np.dtype(kind),
        metadata={"wavelength": list(NM), "wavelength units": "Nanometers"},
    )
    found = read_envi(file)
    # Whole numbers below 2^24, and float32's own, are kept; a float64 is rounded once.
    np.testing.assert_array_equal(found.planes, values.astype(np.float32))
    np.testing.assert_array_equal(found.wavelengths_nm, NM)


@pytest.mark.parametrize(("interleave", "order", "kind"), LAYOUTS)
def test_spectral_reads_the_envi_cubes_that_our_tests_are_made_of(
    tmp_path: Path, interleave, order, kind
):
    envi = pytest.importorskip("spectral.io.envi")
    values = stored(kind).astype(order + kind)
    header = write_envi(tmp_path / "a", values, interleave)
    opened = envi.open(str(header), str(header.with_suffix(".img")))
    read = np.array(opened.load(dtype=np.float64))
    np.testing.assert_array_equal(read, values.transpose(1, 2, 0))
    np.testing.assert_array_equal(opened.bands.centers, NM)


def test_colour_reads_the_spectral_exr_that_we_write(tmp_path: Path):
    pytest.importorskip("OpenImageIO")
    colour = pytest.importorskip("colour")
    values = cube().transpose(1, 2, 0)
    file = tmp_path / "a.exr"
    write_spectral_exr(file, values, NM, RADIANCE_UNITS)
    found, said = colour.io.read_spectral_image_Fichet2021(str(file), additional_data=True)
    assert list(found) == ["S0"] and said.is_emissive
    nm, planes = found["S0"]
    order = np.argsort(nm)
    np.testing.assert_array_equal(nm[order], NM)
    np.testing.assert_array_equal(planes[..., order], values)
    attributes = {one.name: one.value for one in said.attributes}
    assert attributes["spectralLayoutVersion"] == "1.0"
    assert attributes["emissiveUnits"] == "W.m^-2.sr^-1"  # as colour itself writes it


@pytest.mark.parametrize("emissive", [True, False])
def test_spectral_exrs_that_colour_writes_are_read(tmp_path: Path, emissive: bool):
    pytest.importorskip("OpenImageIO")
    colour = pytest.importorskip("colour")
    values = cube().transpose(1, 2, 0)
    file = tmp_path / "a.exr"
    said = colour.io.Specification_Fichet2021(is_emissive=emissive, attributes=None)
    kind = "S0" if emissive else "T"
    colour.io.write_spectral_image_Fichet2021(
        {kind: (NM, values)}, str(file), "float32", said, shape=values.shape
    )
    found = read_spectral_exr(file)
    assert found.kind == ("radiance" if emissive else "reflectance")
    np.testing.assert_array_equal(found.wavelengths_nm, NM)
    np.testing.assert_array_equal(found.planes, cube())
