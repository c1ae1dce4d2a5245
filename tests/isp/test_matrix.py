"""The colour matrix's stage against the reference."""

import numpy as np
import pytest
from harness import assert_close
from isp.stages import F32, ULP, through

from gpusim.gpu import Device
from gpusim.isp.matrix import record_matrix
from gpusim.reference.matrix import matrix


@pytest.mark.parametrize("colours", [1, 2, 3, 4, 5, 7])
@pytest.mark.parametrize("shape", [(1, 4), (13, 20), (160, 444)])
def test_colours_are_those_of_the_reference(device: Device, colours: int, shape):
    rng = np.random.default_rng(colours)
    rows = rng.normal(0, 1.5, (3, colours))
    planes = rng.uniform(-0.1, 1, (colours, *shape)).astype(F32)
    found = through(device, planes, lambda rec, given: record_matrix(rec, given, rows))
    # Entries, products and sums of seven at most, of magnitudes up to 7.
    assert_close(found, matrix(planes, rows), atol=14 * 7 * ULP)


def test_a_frame_without_filters_is_one_plane(device: Device):
    light = np.linspace(0, 1, 48).reshape(6, 8).astype(F32)
    found = through(device, light, lambda rec, given: record_matrix(rec, given, np.ones((3, 1))))
    assert_close(found, np.repeat(light[None], 3, axis=0), atol=0)


def test_more_samples_than_one_line_of_workgroups_has(device: Device, monkeypatch):
    monkeypatch.setattr("gpusim.isp.line.MOST_GROUPS", 3)
    planes = np.random.default_rng(1).uniform(0, 1, (3, 30, 44)).astype(F32)
    rows = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    found = through(device, planes, lambda rec, given: record_matrix(rec, given, rows))
    assert_close(found, planes[[1, 2, 0]], atol=0)
