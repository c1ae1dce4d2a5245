"""Banks that are asked for: computed once, kept on disk, refused where they make no sense."""

import numpy as np
import pytest
import xarray
from optics.made import bank as made_bank

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.psf import compute, store
from gpusim.psf.bank import Bank
from gpusim.psf.compute import cached_bank, compute_bank
from gpusim.psf.store import from_cache


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Give an empty cache, and a count of the banks computed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    computed = []

    def counted(*args, **kwargs):
        computed.append(args)
        return compute_bank(*args, **kwargs)

    monkeypatch.setattr(compute, "compute_bank", counted)
    return tmp_path / "gpusim" / "banks", computed


TINY = {"wavelengths_nm": [550.0], "field_deg": [0.0, 10.0], "size": 32}


def test_the_second_call_finds_the_bank_in_the_cache(cache, demo_lens):
    folder, computed = cache
    first = cached_bank(demo_lens, **TINY)
    second = cached_bank(demo_lens, **TINY)
    assert len(computed) == 1
    np.testing.assert_array_equal(first.psf, second.psf)
    assert len(list(folder.iterdir())) == 1


def test_another_lens_or_setting_is_another_bank(cache, demo_lens):
    folder, computed = cache
    cached_bank(demo_lens, **TINY)
    cached_bank(demo_lens, **TINY | {"size": 34})
    cached_bank(demo_lens.stopped(4.0), **TINY)
    cached_bank(demo_lens.model_copy(update={"gaussian_apodisation": 0.5}), **TINY)
    surfaces = list(demo_lens.surfaces)
    surfaces[3] = surfaces[3].model_copy(update={"glass": "SCHOTT/N-SF15"})
    cached_bank(demo_lens.model_copy(update={"surfaces": tuple(surfaces)}), **TINY)
    assert len(computed) == 5
    assert len(list(folder.iterdir())) == 5


@pytest.mark.parametrize("damage", ["garbage", "truncated", "empty", "foreign"])
def test_a_corrupt_cache_file_is_computed_again(cache, demo_lens, damage):
    folder, computed = cache
    cached_bank(demo_lens, **TINY)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    if damage == "foreign":
        xarray.Dataset({"other": 1}).to_netcdf(file, engine="h5netcdf")
    else:
        file.write_bytes({"garbage": b"x" * 5000, "truncated": whole[:9000], "empty": b""}[damage])
    again = cached_bank(demo_lens, **TINY)
    assert len(computed) == 2
    np.testing.assert_array_equal(again.psf, Bank.load(file).psf)


def test_one_bit_that_flips_in_a_cached_file_is_noticed(cache, demo_lens):
    """Wherever the data lie: each flip gives a file that is not loaded, or loads what was saved."""
    folder, computed = cache
    sound = cached_bank(demo_lens, **TINY)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    at = whole.index(sound.psf[1, 0, 16].tobytes()) + 4 * 16  # the PSF's middle
    flipped = bytearray(whole)
    flipped[at + 2] ^= 0x40
    file.write_bytes(flipped)
    with pytest.raises(ValueError, match="not those that were saved"):
        Bank.load(file)
    store._in_use.clear()  # as another process finds it
    again = cached_bank(demo_lens, **TINY)
    assert len(computed) == 2
    np.testing.assert_array_equal(again.psf, sound.psf)
    np.testing.assert_array_equal(Bank.load(file).psf, sound.psf)
    refused = 0
    random = np.random.default_rng(3)
    for place in random.integers(len(whole), size=20):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << random.integers(8)
        file.write_bytes(flipped)
        try:
            found = Bank.load(file)
        except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError):
            refused += 1
            continue
        for name in (*Bank.table.variables, *Bank.table.optional):
            np.testing.assert_array_equal(getattr(found, name), getattr(sound, name))
    # Nearly all of the file are data.
    assert refused >= 15


def test_a_cache_that_cannot_be_written_is_said_and_does_no_harm(cache, demo_lens):
    folder, _ = cache
    folder.parent.write_text("a file where the folder should be")
    bank = cached_bank(demo_lens, **TINY)
    assert bank.provenance["cache"].startswith("not written")


def test_progress_counts_up_to_the_number_of_fields(demo_lens):
    calls = []
    compute_bank(demo_lens, **TINY, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 2), (2, 2)]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"reference_nm": 555.0}, ["reference_nm", "555"]),
        ({"field_deg": [0.0, 20.0]}, ["beyond the lens", "0 to 14.3"]),
        ({"field_deg": [5.0, 10.0]}, ["rise from 0"]),
        ({"field_deg": [0.0]}, ["rise from 0"]),
        ({"wavelengths_nm": [550.0, 450.0]}, ["wavelengths must rise"]),
        ({"wavelengths_nm": [300.0, 550.0]}, ["300 nm", "outside the data", "N-BAF10"]),
        ({"pitch_um": 1.5}, ["too coarse", "1.5", "<= "]),
        ({"size": 33}, ["even", "33"]),
    ],
)
def test_settings_that_make_no_bank_are_refused(demo_lens, settings, words):
    with pytest.raises(UserError) as caught:
        compute_bank(demo_lens, **TINY | settings)
    for word in words:
        assert word in caught.value.screen()


def test_a_damaged_file_of_the_cache_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    whole, computed = made_bank(size=16), []

    def compute(prescription, progress=None):
        computed.append(1)
        return whole

    lens = load_prescription("double-gauss")
    from_cache(Bank, compute, lens, {})
    (file,) = tmp_path.rglob("*.nc")
    content = file.read_bytes()
    rng = np.random.default_rng(17)
    damages = [content[:100], b"", content[: len(content) // 2], content + content]
    for _ in range(10):  # 16 bytes anywhere: header, groups, names, data
        at = int(rng.integers(0, len(content) - 16))
        damages.append(content[:at] + rng.bytes(16) + content[at + 16 :])
    for damaged in damages:
        file.write_bytes(damaged)
        for _ in range(2):
            store._in_use.clear()  # as another process finds it
            found = from_cache(Bank, compute, lens, {})
            np.testing.assert_array_equal(found.psf, whole.psf)
            np.testing.assert_array_equal(found.real_height_um, whole.real_height_um)
            assert found.provenance == whole.provenance
    # Once for each damage that counts: not fatal, nor for ever.
    assert 8 < len(computed) <= 1 + len(damages)
