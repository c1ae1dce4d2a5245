"""The loader of ready-made lenses: banks survive the formats, and no garbage makes a traceback."""

import dataclasses
import gc
import json
import sys

import numpy as np
import pytest
import xarray
import yaml
from optics.made import bank as made_bank

from gpusim.errors import UserError
from gpusim.formats.contract import check_bank
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.ready import NPZ_ARRAYS, load_ready
from gpusim.psf.bank import Bank
from gpusim.psf.compute import compute_bank

TEXTS = {"title": "Gaussians", "source": "made up"}


def arrays(bank):
    """Return what an .npz file must hold."""
    numbers = {name: getattr(bank, name) for name in NPZ_ARRAYS if name not in TEXTS}
    return numbers | TEXTS


@pytest.fixture
def bank():
    """Give a lens of 4 fields that is lopsided in both directions."""
    return made_bank(skew_um=2.0)


def test_a_saved_bank_is_the_bank(bank, tmp_path):
    bank.save(tmp_path / "a.nc")
    lens = load_ready(tmp_path / "a.nc")
    for field in dataclasses.fields(bank):
        np.testing.assert_array_equal(getattr(lens.bank(), field.name), getattr(bank, field.name))
    assert (lens.title, lens.kind, lens.file) == ("Gaussians", "saved bank", "a.nc")
    assert lens.history == ()
    json.dumps(lens.model_dump())  # it goes into the report


def test_a_saved_bank_of_a_lens_keeps_the_light_beyond_its_window(demo_lens, tmp_path):
    computed = compute_bank(demo_lens, [550.0], [0.0, 7.0, 14.0], size=64)
    assert computed.outside_energy.min() > 0.01  # so its PSFs do not sum to 1
    computed.save(tmp_path / "a.nc")
    found = load_ready(tmp_path / "a.nc").bank()
    np.testing.assert_array_equal(found.psf, computed.psf)
    np.testing.assert_array_equal(found.halo, computed.halo)
    for change, words in (
        ({"psf": computed.psf / (1 - computed.outside_energy)[..., None, None]}, "outside_energy"),
        ({"halo": np.zeros_like(computed.halo)}, "1 less beyond_energy"),
        ({"halo": computed.halo[:, :2]}, "shape (3, 3, 1, 128, 128)"),
    ):
        with pytest.raises(UserError) as caught:
            check_bank(dataclasses.replace(computed, **change), tmp_path / "a.nc")
        assert words in caught.value.screen()


def test_a_saved_bank_that_was_changed_says_so_and_without_its_checksum_is_taken(bank, tmp_path):
    bank.save(tmp_path / "a.nc")
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        dim = data.assign(transmission=0.5 * data["transmission"])
        dim.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        del dim.attrs["sha256"]
        dim.to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
        del data.attrs["sha256"]
        data.to_netcdf(tmp_path / "older.nc", engine="h5netcdf")
    with pytest.raises(UserError, match="not those that were saved") as caught:
        load_ready(tmp_path / "b.nc")
    assert "remove the global attribute sha256" in " ".join(caught.value.screen().split())
    dim = load_ready(tmp_path / "c.nc").bank()
    np.testing.assert_array_equal(dim.transmission, 0.5 * bank.transmission)
    older = load_ready(tmp_path / "older.nc").bank()
    np.testing.assert_array_equal(older.psf, bank.psf)
    assert "sha256" not in older.provenance


def test_numpy_arrays_are_the_bank(bank, tmp_path):
    """The PSFs in any norm; what the circle cuts of them is accounted for."""
    given = arrays(bank) | {"psf": 17.0 * bank.psf.astype(float)}
    np.savez(tmp_path / "a.npz", **given)
    found = load_ready(tmp_path / "a.npz").bank()
    for name in arrays(bank).keys() - {"psf", *TEXTS}:
        np.testing.assert_array_equal(getattr(found, name), getattr(bank, name))
    # The corners of the window hold less than 1e-9 of these PSFs; float32.
    np.testing.assert_allclose(found.psf, bank.psf, rtol=0, atol=1e-7 * bank.psf.max())
    assert np.abs(found.psf - found.psf.swapaxes(2, 3)).max() > 0.01 * bank.psf.max()
    assert np.isnan(found.failed_rays).all()
    assert found.provenance["title"] == "Gaussians"

    uniform = np.ones((4, 3, 64, 64))
    np.savez(tmp_path / "b.npz", **given | {"psf": uniform + 3e4 * bank.psf * 64**2})
    found = load_ready(tmp_path / "b.npz").bank()
    cut = (1 - np.pi / 4) / (1 + 3e4)
    np.testing.assert_allclose(found.outside_energy, cut, rtol=0.02)


def test_what_the_arrays_lack_may_stand_in_a_text_beside_them(bank, tmp_path):
    given = arrays(bank)
    beside = {"title": "Gaussians", "source": "made up", "efl_mm": 1.0, "f_number": 2.8}
    np.savez(tmp_path / "a.npz", **{name: given[name] for name in given.keys() - beside.keys()})
    with pytest.raises(UserError) as caught:
        load_ready(tmp_path / "a.npz")
    assert "efl_mm is missing" in caught.value.screen()
    assert "a.yaml" in caught.value.screen()
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(beside))
    assert load_ready(tmp_path / "a.npz").bank().efl_mm == 1.0


@pytest.mark.parametrize("name", NPZ_ARRAYS)
def test_every_array_is_asked_for_by_name(bank, tmp_path, name):
    given = arrays(bank)
    del given[name]
    np.savez(tmp_path / "a.npz", **given)
    with pytest.raises(UserError, match=f"{name} is missing"):
        load_ready(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("psf", lambda a: a[:, :2], ["psf", "(4, 2, 64, 64)", "(4, 3, 64, 64)"]),
        ("psf", lambda a: a[:, :, :40], ["psf", "(4, 3, 40, 64)"]),
        ("psf", lambda a: a[:, :, 1:, 1:], ["psf", "63 samples"]),
        ("psf", lambda a: 0 * a, ["psf", "no light"]),
        ("psf", lambda a: np.where(a == a.max(), np.nan, a), ["psf", "no numbers"]),
        ("psf", lambda a: -a, ["psf", "no light"]),
        ("real_height_um", lambda a: a[::-1], ["real_height_um", "rising from 0"]),
        ("real_height_um", lambda a: a.T, ["real_height_um", "(3, 4)", "(4, 3)"]),
        ("ideal_height_um", lambda a: a + 1, ["ideal_height_um", "tan(field_deg)"]),
        ("efl_mm", lambda a: 1.1 * a, ["ideal_height_um", "efl_mm"]),
        ("field_deg", lambda a: np.full_like(a, np.inf), ["field_deg", "numbers"]),
        ("wavelengths_nm", lambda a: a[::-1], ["wavelengths_nm", "rising"]),
        ("reference_nm", lambda a: 500.0, ["reference_nm", "500"]),
        ("reference_nm", lambda a: [1.0, 2.0], ["reference_nm", "2 numbers"]),
        ("transmission", lambda a: 2 * a, ["transmission", "0 to 1"]),
        ("projected_solid_angle_sr", lambda a: 90 * a, ["projected_solid_angle_sr"]),
        ("relative_illumination", lambda a: 0.5 * a, ["relative_illumination", "1 on the axis"]),
        ("relative_illumination", lambda a: a - 0.9, ["relative_illumination", "0 to 2"]),
        ("pitch_um", lambda a: 0.0, ["pitch_um", "above 0"]),
        ("efl_mm", lambda a: np.nan, ["efl_mm", "above 0"]),
        ("f_number", lambda a: "fast", ["f_number", "number"]),
    ],
)  # fmt: skip
def test_a_bank_that_breaks_its_contract_is_refused_by_name(bank, tmp_path, name, change, words):
    given = arrays(bank)
    np.savez(tmp_path / "a.npz", **given | {name: change(given[name])})
    with pytest.raises(UserError) as caught:
        load_ready(tmp_path / "a.npz")
    for word in [*words, "a.npz"]:
        assert word in caught.value.screen()


def test_objects_in_arrays_are_not_unpickled(tmp_path):
    np.savez(tmp_path / "a.npz", psf=np.array([{"a": 1}], object))
    with pytest.raises(UserError, match="not a whole"):
        load_ready(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["a.nc", "a.npz"])
@pytest.mark.parametrize("keep", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(bank, tmp_path, name, keep):
    if name == "a.nc":
        bank.save(tmp_path / name)
    else:
        np.savez_compressed(tmp_path / name, **arrays(bank))
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(keep * len(content))])
    with pytest.raises(UserError, match="not a whole"):
        load_ready(tmp_path / name)


def test_a_broken_head_is_refused_and_nothing_else_is_said(tmp_path, monkeypatch):
    """What h5netcdf leaves of such a file complains when it is collected."""
    path = tmp_path / "a.nc"
    made_bank(size=16).save(path)
    content = bytearray(path.read_bytes())
    content[128] ^= 0xFF
    path.write_bytes(content)
    said = []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    with pytest.raises(UserError, match="not a whole bank"):
        load_ready(path)
    gc.collect()
    assert said == []
    # A control: without a look at the file beforehand it does.
    with pytest.raises(KeyError):
        Bank.load(path)
    gc.collect()
    assert said


@pytest.mark.parametrize("suffix", [".nc", ".npz", ".yaml", ".txt", ".zmx", ".mat", ""])
@pytest.mark.parametrize(
    "content", [b"", b"hello\n", b"\x89PNG\r\n\x1a\n\x00\x00", bytes(range(256)) * 8, b"[1, 2]"]
)
def test_garbage_is_refused(tmp_path, suffix, content):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        load_ready(path)
    assert path.name in caught.value.screen()


def test_a_bank_of_another_kind_of_data_is_refused(bank, tmp_path):
    bank.save(tmp_path / "a.nc")
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        del data.attrs["sha256"]
        data.drop_vars("psf").to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
        data.assign_attrs(title="").drop_attrs().to_netcdf(tmp_path / "c.nc", engine="h5netcdf")
        dim = data.assign(psf=0.5 * data["psf"])
        dim.to_netcdf(tmp_path / "d.nc", engine="h5netcdf")
    for name, words in {
        "b.nc": ["not a whole bank", "psf"],
        "c.nc": ["does not say what it is of", "history"],
        "d.nc": ["psf", "sum 1"],
    }.items():
        with pytest.raises(UserError) as caught:
            load_ready(tmp_path / name)
        for word in [*words, name]:
            assert word in caught.value.screen()


def test_what_is_not_there_and_what_is_no_lens_is_said(tmp_path):
    with pytest.raises(UserError, match="no such lens"):
        load_ready(tmp_path / "none.nc")
    with pytest.raises(UserError, match="no ISETPARMS"):
        load_ready(tmp_path)
    (tmp_path / "one.txt").write_text("Listing of FFT PSF Data\n", encoding="utf-16")
    with pytest.raises(UserError, match="one Zemax export is not a lens") as caught:
        load_ready(tmp_path / "one.txt")
    assert "psf_files" in caught.value.screen()
    (tmp_path / "other.yaml").write_text("surfaces: []\n")
    with pytest.raises(UserError, match="no ready-made lens") as caught:
        load_ready(tmp_path / "other.yaml")
    assert "surfaces" in caught.value.screen()


def test_a_computed_bank_and_its_prescription_agree_with_the_interface(demo_lens):
    """What `gpusim.camera.Lens` asks for is there on both kinds of lens."""
    ready = load_ready("diffraction-limited")
    for lens in (demo_lens, ready, load_prescription("double-gauss")):
        assert lens.title and lens.source and isinstance(lens.history, tuple)
        assert isinstance(lens.known, tuple)
        assert {"title", "source"} <= lens.model_dump().keys()


def test_a_saved_fisheye_is_read(bank, tmp_path):
    """Its ideal heights have no end from 90 degrees on."""
    angles = np.array([0.0, 35.0, 70.0, 100.0])
    f_um = 1e3 * bank.efl_mm
    real = f_um * np.radians(angles)
    fisheye = dataclasses.replace(
        bank,
        field_deg=angles,
        ideal_height_um=np.append(f_um * np.tan(np.radians(angles[:3])), np.inf),
        real_height_um=np.repeat(real[:, None], 3, axis=1),
    )
    fisheye.save(tmp_path / "fisheye.nc")
    assert load_ready(tmp_path / "fisheye.nc").bank().field_deg[-1] == 100
    # Between the fields it must rise, too.
    real = f_um * np.array([0.0, 1.0, 1.01, 3.0])
    folded = dataclasses.replace(fisheye, real_height_um=np.repeat(real[:, None], 3, axis=1))
    folded.save(tmp_path / "folded.nc")
    with pytest.raises(UserError) as caught:
        load_ready(tmp_path / "folded.nc")
    assert "real_height_um" in caught.value.screen() and "between" in caught.value.screen()
