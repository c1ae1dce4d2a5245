"""The medium that a picture comes from: film, print or screen, as a table from codes to light.

A table is a .cube file (Adobe, "Cube LUT Specification" 1.0, 2013) whose output is linear R, G, B
with the primaries of Rec. 709: three curves, or a cube of colours.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gpusim.config.text import read_bytes
from gpusim.errors import UserError

SUFFIX = ".cube"
MOST_BYTES = 64 * 2**20
LEAST, MOST_CURVE, MOST_CUBE = 2, 65_536, 129  # entries each way
ALLOWED = (
    f"a .cube file with LUT_1D_SIZE {LEAST} to {MOST_CURVE} or LUT_3D_SIZE {LEAST} to {MOST_CUBE}, "
    "and a line of three finite numbers for each entry"
)
_SIZE = re.compile(rb"^[ \t]*LUT_([13])D_SIZE[ \t]+(\d{1,9})[ \t\r]*$", re.M)


def is_table(name: str) -> bool:
    """Return whether the name of a transfer function is that of a table."""
    return Path(name).suffix.lower() == SUFFIX


def light_of(codes: np.ndarray, path: Path) -> np.ndarray:
    """Return the light that a picture's values from 0 to 1 stand for.

    Between a table's entries it is linear, in a cube along each of its axes; beyond its domain as
    at its ends.

    Parameters
    ----------
    codes : ndarray (..., 3) or (rows, cols)
        Grey has three equal values.
    path : Path
        The table.

    Returns
    -------
    ndarray (..., 3)

    Raises
    ------
    UserError
        The file is no such table.
    """
    table = _read(path)
    if codes.ndim == 2:
        codes = np.stack([codes] * 3, axis=-1)
    domain = np.asarray(table.domain)
    found = table.apply(np.clip(codes[..., :3], domain.min(axis=0), domain.max(axis=0)))
    return np.asarray(found, np.float64)


def _read(path: Path):
    import tempfile

    content = read_bytes(path, "the table")
    sizes = [(int(kind), int(size)) for kind, size in _SIZE.findall(content)]
    if len(content) > MOST_BYTES or len(sizes) != 1:
        raise _refused(path, f"{len(sizes)} lines with a size, {len(content):,} bytes")
    ((kind, size),) = sizes
    if not LEAST <= size <= {1: MOST_CURVE, 3: MOST_CUBE}[kind]:
        raise _refused(path, f"LUT_{kind}D_SIZE {size}")
    from colour.io import read_LUT_IridasCube

    try:
        # Read from a copy, so that nothing changes between the look at its size and this.
        with tempfile.TemporaryDirectory(prefix="gpusim-") as folder:
            copy = Path(folder) / "table.cube"
            copy.write_bytes(content)
            table = read_LUT_IridasCube(str(copy))
    except Exception as error:  # colour-science asserts, splits and converts
        raise _refused(path, str(error) or type(error).__name__) from None
    entries = size if kind == 1 else size**3
    domain = np.asarray(table.domain, float)
    if table.table.shape != ((size, 3) if kind == 1 else (size, size, size, 3)):
        raise _refused(path, f"{table.table.size // 3} entries in place of {entries}")
    if domain.shape != (2, 3) or not np.isfinite(domain).all() or (domain[1] <= domain[0]).any():
        raise _refused(path, f"domain {domain.tolist()}")
    if not np.isfinite(table.table).all():
        raise _refused(path, "an entry that is no number")
    return table


def _refused(path: Path, reason: str) -> UserError:
    return UserError(
        "no table that can be read", file=path, field="transfer", value=reason, allowed=ALLOWED
    )
