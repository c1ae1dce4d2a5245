"""The cache of what is known of lenses: bounded, the least recently used go first."""

import gc
import os
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray
from optics.made import bank as made_bank

from gpusim.formats.lens_file import load_prescription
from gpusim.psf import store
from gpusim.psf.bank import Bank
from gpusim.psf.store import Table, from_cache, load_dataset, prune, save_dataset

KIB = 1024


def aged(folder: Path, names: str) -> list[Path]:
    """Write files of 1 KiB, each used a second later than the one before."""
    paths = []
    for second, name in enumerate(names):
        path = folder / f"{name}.nc"
        path.write_bytes(bytes(KIB))
        os.utime(path, (second, second))
        paths.append(path)
    return paths


def names_in(folder: Path) -> str:
    return "".join(sorted(path.stem for path in folder.iterdir()))


@pytest.mark.parametrize(
    ("kib", "kept", "left"),
    [(4, "d", "abcd"), (3, "d", "bcd"), (2.5, "d", "cd"), (2, "a", "ad"), (0, "b", "b")],
)
def test_files_go_that_were_not_used_for_longest_and_never_the_one_just_made(
    tmp_path, kib, kept, left
):
    aged(tmp_path, "abcd")
    prune(tmp_path, int(kib * KIB), tmp_path / f"{kept}.nc")
    assert names_in(tmp_path) == left


@pytest.mark.parametrize(
    ("age_s", "kib", "left"), [(4000, 99, "bc"), (3000, 99, "abc"), (3000, 2, "bc")]
)
def test_what_a_killed_process_left_half_written_goes_after_an_hour_or_for_room(
    tmp_path, age_s, kib, left
):
    for number, path in enumerate(aged(tmp_path, "bc")):
        os.utime(path, (time.time() - number, time.time() - number))
    half = tmp_path / "a.part"
    half.write_bytes(bytes(KIB))
    os.utime(half, (time.time() - age_s, time.time() - age_s))
    prune(tmp_path, kib * KIB, tmp_path / "c.nc")
    assert names_in(tmp_path) == left


def test_many_may_prune_at_once(tmp_path):
    paths = aged(tmp_path, "abcdefghijklmnop")
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda kept: prune(tmp_path, 4 * KIB, kept), [paths[-1]] * 32))
    assert names_in(tmp_path) == "mnop"


def test_a_bank_that_was_used_again_outlives_one_that_was_not(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    lens, made = load_prescription("double-gauss"), []

    def compute(prescription, progress=None, number=0):
        made.append(number)
        return made_bank(size=16)

    def ask(number):
        from_cache(Bank, compute, lens, {"number": number})

    ask(0)
    (first,) = tmp_path.rglob("*.nc")
    os.utime(first, (0, 0))
    ask(1)
    (second,) = set(tmp_path.rglob("*.nc")) - {first}
    os.utime(second, (1, 1))
    ask(0)  # found, and now the younger of the two
    monkeypatch.setattr(store, "CACHE_BYTES", int(2.5 * first.stat().st_size))
    ask(2)
    assert made == [0, 1, 2]
    assert first.exists() and not second.exists()
    ask(1)
    assert made == [0, 1, 2, 1]


def test_what_a_process_uses_is_read_once_and_not_kept_for_it(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    lens = load_prescription("double-gauss")

    def ask():
        return from_cache(Bank, lambda prescription, progress=None: made_bank(size=16), lens, {})

    first = ask()
    assert ask() is first
    gone = weakref.ref(first)
    del first
    gc.collect()
    assert gone() is None
    (path,) = tmp_path.rglob("*.nc")
    read, load = [], Bank.load

    def counted(path, *, sealed):
        read.append(path)
        return load(path, sealed=sealed)

    monkeypatch.setattr(Bank, "load", counted)
    again = ask()
    assert ask() is again and read == [path]


def test_packed_numbers_are_refused_by_name(tmp_path):
    path, table = tmp_path / "a.nc", Table({"psf": (("x",), "1", "psf")}, {})
    save_dataset(xarray.Dataset({"psf": ("x", np.linspace(0, 1, 5))}), path)
    assert load_dataset(path, table)["psf"][-1] == 1
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        del data.attrs["sha256"]
        packed = {"psf": {"dtype": "i2", "scale_factor": 1e-4, "_FillValue": -1}}
        data.to_netcdf(tmp_path / "b.nc", engine="h5netcdf", encoding=packed)
    with pytest.raises(ValueError, match="psf is packed"):
        load_dataset(tmp_path / "b.nc", table)
