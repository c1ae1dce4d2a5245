"""ISETCam's scenes (.mat): photons by wavelength, or coefficients of a spectral basis.

A file of `sceneToFile` or `save` holds ``mcCOEF`` and ``basis``, or a struct ``scene``; of MATLAB's
version 7 or 7.3. Photons are 1/(s sr m^2 nm), as are those of the illuminant, a perfect white's.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.config.matlab import read_matlab
from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.scene.bands import MOST_SAMPLES, RADIANCE, Bands, checked_size

HC_J_M = 6.62607015e-34 * 299_792_458.0  # of one photon, times its wavelength: SI 2019
MOST_BYTES = 512 << 20  # of a file, and of all that is packed in it
HDF5 = b"\x89HDF\r\n\x1a\n"
COMPRESSED = 15  # type of a packed element, MAT-File Format, table 1-1
ALLOWED = "a struct scene, or mcCOEF and basis, of ISETCam"


def read_isetcam_scene(path: Path) -> Bands:
    """Read a scene.

    Raises
    ------
    UserError
        Where the file cannot be read, or holds no scene, or one of other sizes than its own
        wavelengths.
    """
    content = read_bytes(path, "the scene", MOST_BYTES)
    try:
        found = _hdf5(content) if _is_hdf5(content) else _version_7(content)
        return _bands(path, found)
    except UserError:
        raise
    except Exception as error:  # SciPy and h5py raise whatever a damaged file leads them to
        reason = str(error) or type(error).__name__
        raise UserError(
            "no ISETCam scene that can be read", file=path, value=reason, allowed=ALLOWED
        ) from error


def _is_hdf5(content: bytes) -> bool:
    # MATLAB's own header of 512 bytes comes first.
    return content[:8] == HDF5 or content[512:520] == HDF5


def _version_7(content: bytes) -> dict[str, Any]:
    _check_unpacked(content)
    return read_matlab(content)


def _check_unpacked(content: bytes) -> None:
    """Refuse a file whose packed elements are too large, by what each says of itself."""
    order = ">" if content[126:128] == b"MI" else "<"
    at, total = 128, 0
    while at + 8 <= len(content):
        kind, size = struct.unpack(f"{order}II", content[at : at + 8])
        if kind == COMPRESSED:
            start = zlib.decompressobj().decompress(content[at + 8 : at + 8 + size], 8)
            total += struct.unpack(f"{order}II", start)[1] if len(start) == 8 else 0
        at += 8 + size
    if total > MOST_BYTES:
        raise ValueError(f"{total:,} bytes when unpacked, up to {MOST_BYTES:,} are read")


def _hdf5(content: bytes) -> dict[str, Any]:
    """Return the variables of a file of version 7.3; arrays as MATLAB has them."""
    import h5py

    left = [MOST_BYTES]

    def tree(group: h5py.Group, depth: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name in group:
            one = group[name]
            if isinstance(one, h5py.Group) and not name.startswith("#") and depth < 8:
                found[name] = tree(one, depth + 1)
            elif isinstance(one, h5py.Dataset) and one.dtype.kind in "fiu":
                left[0] -= one.size * 8
                if left[0] < 0:
                    raise ValueError(f"more than {MOST_BYTES:,} bytes")
                found[name] = np.asarray(one[()]).T
        return found

    with h5py.File(io.BytesIO(content), "r") as file:
        return tree(file, 0)


def _bands(path: Path, found: dict[str, Any]) -> Bands:
    scene = found.get("scene", found)
    if not isinstance(scene, dict):
        raise _no_scene(path, f"scene is {type(scene).__name__}")
    notes: tuple[str, ...] = ()
    if "mcCOEF" in scene:
        photons, nm = _from_basis(path, scene)
        lamp = _illuminant(scene.get("illuminant"), nm)
    else:
        data = scene.get("data", scene)
        photons = data.get("photons") if isinstance(data, dict) else None
        if photons is None:
            names = [name for name in scene if not name.startswith("_")]
            raise _no_scene(path, ", ".join(names))
        nm = _vector(_inside(scene, "spectrum.wave"), scene.get("wave"))
        photons = np.asarray(photons, np.float32)
        photons = photons[..., None] if photons.ndim == 2 else photons
        lamp = _illuminant(scene.get("illuminant"), nm)
    if photons.ndim != 3 or photons.shape[2] != len(nm) or not (nm > 0).all():
        sizes = " x ".join(map(str, photons.shape))
        raise _no_scene(path, f"photons of {sizes} at {len(nm)} wavelengths")
    energy = (HC_J_M / (nm * 1e-9)).astype(np.float32)
    planes = np.moveaxis(photons, -1, 0) * energy[:, None, None]
    if lamp is None:
        notes += ("the file has no illuminant",)
    else:
        lamp = lamp * energy
    return Bands(planes, nm, RADIANCE, notes, lamp)


def _from_basis(path: Path, scene: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return photons (rows, cols, wavelengths): coefficients times basis, and the mean."""
    basis = scene.get("basis")
    if not isinstance(basis, dict) or "basis" not in basis:
        raise _no_scene(path, "mcCOEF without a basis")
    nm = _vector(basis.get("wave"), scene.get("wave"))
    vectors = np.atleast_2d(np.asarray(basis["basis"], np.float32))
    vectors = vectors if vectors.shape[0] == len(nm) else vectors.T
    share = np.asarray(scene["mcCOEF"], np.float32)
    share = share[..., None] if share.ndim == 2 else share
    checked_size(path, (len(nm), *share.shape[:2]))
    if share.ndim != 3 or vectors.shape != (len(nm), share.shape[2]):
        raise _no_scene(path, f"mcCOEF of {share.shape} with a basis of {vectors.shape}")
    photons = share @ vectors.T
    mean = np.asarray(scene.get("imgMean", 0.0), np.float32).ravel()
    if mean.size not in (0, 1, len(nm)):
        raise _no_scene(path, f"imgMean of {mean.size} numbers")
    return (photons + mean if mean.size else photons), nm


def _illuminant(given: object, nm: np.ndarray) -> np.ndarray | None:
    """Return the photons (M,) of a perfect white; None where the file has none, or one by place."""
    if not isinstance(given, dict):
        return None
    data = given.get("data")
    photons = data.get("photons") if isinstance(data, dict) else None
    energy = data.get("energy") if isinstance(data, dict) else data
    own = _vector(_inside(given, "spectrum.wave"), given.get("wave"), given.get("wavelength"))
    values = _vector(photons if photons is not None else energy)
    if values.size != own.size or values.size < 2 or not np.all(np.diff(own) > 0):
        return None
    if not (np.isfinite(values).all() and values.min() >= 0 and values.max() > 0):
        return None
    if photons is None:
        values = values * own * 1e-9 / HC_J_M
    return np.interp(nm, own, values)


def _inside(values: dict[str, Any], dotted: str) -> object:
    for name in dotted.split("."):
        values = values.get(name) if isinstance(values, dict) else None
    return values


def _vector(*given: object) -> np.ndarray:
    """Return the first that is given as a vector of numbers."""
    one = next((one for one in given if one is not None), ())
    if np.size(one) > MOST_SAMPLES:
        return np.zeros(0)
    return np.asarray(one, np.float64).ravel()


def _no_scene(path: Path, value: str) -> UserError:
    return UserError("no ISETCam scene in the file", file=path, value=value, allowed=ALLOWED)
