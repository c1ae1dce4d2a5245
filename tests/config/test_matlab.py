"""MATLAB files: variables come as they are, and a reader that crashes is an error, not the end."""

from __future__ import annotations

import io

import numpy as np
import pytest
from scipy.io import savemat

from gpusim.config import matlab
from gpusim.config.matlab import read_matlab


def written(**variables: object) -> bytes:
    file = io.BytesIO()
    savemat(file, variables)
    return file.getvalue()


def test_variables_come_as_they_were_written():
    found = read_matlab(written(a=np.arange(6.0).reshape(2, 3), s={"name": "it", "n": 3}))
    assert found.keys() == {"a", "s"}
    assert np.array_equal(found["a"], np.arange(6.0).reshape(2, 3))
    assert found["s"] == {"name": "it", "n": 3}


def test_what_is_no_matlab_file_is_an_error():
    for content in (b"", b"nonsense" * 40, written(a=1.0)[:150]):
        with pytest.raises(ValueError, match=r"\w"):
            read_matlab(content)


def test_a_file_of_version_7_3_is_told():
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    with pytest.raises(NotImplementedError):
        read_matlab(header + bytes(600))


def test_a_reader_that_crashes_leaves_an_error(monkeypatch):
    crash = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    monkeypatch.setattr(matlab, "CHILD", crash)
    with pytest.raises(ValueError, match="damaged"):
        read_matlab(written(a=1.0))
