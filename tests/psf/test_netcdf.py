"""A bank's file read as MATLAB's ``ncread`` and other plain NetCDF-4 readers do, by HDF5 alone."""

import h5py
import numpy as np
import pytest
import xarray

from gpusim.psf.compute import compute_bank

DIMENSIONS = {
    "field": 3,
    "wavelength": 2,
    "eta": 32,
    "xi": 32,
    "level": 3,
    "halo_eta": 128,
    "halo_xi": 128,
    "direction": 2,
    "cell": 576,
    "part": 3,
}
# NetCDF-4's own types that MATLAB knows as numbers: no bool (an HDF5 enum), no float16.
NUMBERS = {np.dtype(name) for name in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")}


@pytest.fixture(scope="module")
def bank(demo_lens):
    return compute_bank(demo_lens, [450.0, 550.0], [0.0, 7.0, 14.0], size=32)


@pytest.fixture
def file(bank, tmp_path):
    bank.save(tmp_path / "bank.nc")
    with h5py.File(tmp_path / "bank.nc") as file:
        yield file


def is_dimension_alone(variable):
    """Tell whether a dataset only stands for a dimension without coordinates."""
    name = variable.attrs.get("NAME", b"")
    return name.startswith(b"This is a netCDF dimension but not a netCDF variable")


def test_every_dimension_is_a_scale_with_its_length(file):
    for name, length in DIMENSIONS.items():
        assert file[name].attrs["CLASS"] == b"DIMENSION_SCALE", name
        assert file[name].shape == (length,), name


def test_every_variable_has_number_type_units_provenance_and_named_dimensions(file):
    variables = {n: v for n, v in file.items() if not is_dimension_alone(v)}
    lengths = DIMENSIONS | {"ray": file["ray_deg"].shape[0]}
    assert {"psf", "real_height_um", "relative_illumination", "eta", "xi"} <= set(variables)
    for name, variable in variables.items():
        assert variable.dtype.newbyteorder("=") in NUMBERS, name
        for attribute in ("units", "provenance"):
            text = variable.attrs[attribute]
            assert isinstance(text, str) and text, (name, attribute)
        if variable.attrs.get("CLASS") == b"DIMENSION_SCALE":
            continue
        # ncread finds the dimensions through the attached scales.
        scales = [[scale.name.lstrip("/") for scale in dim.values()] for dim in variable.dims]
        assert [len(names) for names in scales] == [1] * variable.ndim, name
        assert [lengths[names[0]] for names in scales] == list(variable.shape), name


def test_the_numbers_are_those_of_the_bank(file, bank):
    np.testing.assert_array_equal(file["psf"][:], bank.psf)
    np.testing.assert_array_equal(file["real_height_um"][:], bank.real_height_um)
    assert float(file["efl_mm"][()]) == bank.efl_mm
    np.testing.assert_allclose(file["xi"][:], (np.arange(32) - 16) * 0.5)
    assert file["psf"].attrs["units"] == "1"
    assert file["real_height_um"].attrs["units"] == "um"


def test_the_file_says_what_it_is_of(file):
    assert "Double Gauss" in file.attrs["title"]
    assert "closed to f/2.8" in file.attrs["history"]


def test_types_that_other_readers_do_not_know_would_be_seen(tmp_path):
    data = xarray.Dataset({"text": ("n", np.array(["a", "bc"], dtype=object))})
    data.to_netcdf(tmp_path / "odd.nc", engine="h5netcdf")
    with h5py.File(tmp_path / "odd.nc") as file:
        assert file["text"].dtype not in NUMBERS
