"""MATLAB files of versions 4 to 7, read in a process of their own.

SciPy's reader ends the process that calls it on some damaged files: a segmentation fault in its
compiled part (SciPy 1.17.1, found by tests/test_fuzz.py). A child's end is an error like others.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

# What the child does: a MATLAB file comes in, a pickle of its variables or of its error goes out.
CHILD = """
import io, pickle, sys, warnings
warnings.simplefilter("ignore")
from scipy.io import loadmat
try:
    found = loadmat(io.BytesIO(sys.stdin.buffer.read()), simplify_cells=True)
    sent = pickle.dumps((None, found))
except Exception as error:
    sent = pickle.dumps((type(error).__name__, str(error)))
sys.stdout.buffer.write(sent)
"""


def read_matlab(content: bytes) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name, structs as dicts, cells as lists.

    Raises
    ------
    NotImplementedError
        The file is of version 7.3, which is HDF5.
    ValueError
        It is damaged, or no MATLAB file.
    """
    done = subprocess.run(
        [sys.executable, "-c", CHILD], input=content, capture_output=True, check=False
    )
    if done.returncode != 0:
        raise ValueError("its structure is damaged")
    kind, found = pickle.loads(done.stdout)  # of our own child
    if kind == "NotImplementedError":
        raise NotImplementedError(found)
    if kind is not None:
        raise ValueError(found or kind)
    return {name: value for name, value in found.items() if not name.startswith("__")}
