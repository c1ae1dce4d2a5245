"""SNR and dynamic range: patches of known noise, shading, clipping, files, refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim

from gpusim.errors import UserError
from gpusim.metrics.picture import Plane
from gpusim.metrics.snr import measure_snr

READ, SHOT, UNLIKE = 2e-3, 4e-5, 5e-3  # noise of the scale, variance per signal, share
SIGNALS = 0.9 / 2.0 ** np.arange(9)
SIDE = 48
BOXES = [(SIDE * at + 4, 4, SIDE - 8, SIDE - 8) for at in range(len(SIGNALS))]


def sigma(signal):
    return np.sqrt(READ**2 + SHOT * signal + (UNLIKE * signal) ** 2)


def scale(seed=3, shading=0.03):
    """Return patches side by side, brighter to the right of each by some per cent."""
    rng = np.random.default_rng(seed)
    slope = 1 + shading * np.linspace(-1, 1, SIDE)
    light = np.concatenate([np.tile(one * slope, (SIDE, 1)) for one in SIGNALS], axis=1)
    level = np.repeat(SIGNALS, SIDE)
    return light + sigma(level) * rng.normal(size=light.shape)


def test_noise_is_that_of_the_patches_whatever_their_shading():
    found = measure_snr(Plane(scale(), None, (-np.inf, np.inf)), "Y", BOXES)
    for patch, signal in zip(found.patches, SIGNALS, strict=True):
        assert abs(patch.signal.value - signal) < 4 * patch.signal.u
        assert abs(patch.noise.value - sigma(signal)) < 4 * patch.noise.u
        assert patch.snr.value == pytest.approx(patch.signal.value / patch.noise.value)


def test_the_dynamic_range_is_that_of_the_law():
    # Where SNR is 1: S^2 = r + g S + p S^2.
    least = (SHOT + np.sqrt(SHOT**2 + 4 * (1 - UNLIKE**2) * READ**2)) / 2 / (1 - UNLIKE**2)
    found = measure_snr(Plane(scale(), None, (-np.inf, 1.0)), "Y", BOXES)
    assert found.to_scale_end
    # The noise of each patch is known to 1.8 %, that in the dark through four of them: 1 to 2 %,
    # 0.2 dB; three of those.
    assert found.decibels == pytest.approx(20 * np.log10(1 / least), abs=0.6)
    open_ended = measure_snr(Plane(scale(), None, (-np.inf, np.inf)), "Y", BOXES)
    assert not open_ended.to_scale_end
    assert open_ended.decibels == pytest.approx(found.decibels + 20 * np.log10(0.9), abs=0.1)


def test_clipped_patches_are_marked_and_not_counted():
    clipped = measure_snr(Plane(np.minimum(scale(), 0.4), None, (-np.inf, 0.4)), "Y", BOXES)
    assert [one.clipped for one in clipped.patches[:3]] == [True, True, False]
    few = measure_snr(Plane(scale(), None, (-np.inf, 1.0)), "Y", BOXES[:3])
    assert few.law is None and few.decibels is None


def test_a_filter_arrays_photosites_are_measured_where_they_lie():
    values = scale()
    values[::2] = -5.0  # other filters: none of it may be seen
    sites = np.array([[False, False], [True, True]])
    found = measure_snr(Plane(values, sites, (-np.inf, np.inf)), "G", BOXES)
    for patch, signal in zip(found.patches, SIGNALS, strict=True):
        assert abs(patch.noise.value - sigma(signal)) < 4 * patch.noise.u


def test_the_command_writes_its_files(tmp_path):
    np.save(tmp_path / "scale.npy", scale())
    boxes = [part for box in BOXES for part in ("--roi", ",".join(map(str, box)))]
    out = tmp_path / "out"
    ran = gpusim("measure", "snr", tmp_path / "scale.npy", *boxes, "--out", out)
    assert ran.code == 0, ran.err
    assert "dynamic range at least" in ran.out
    (channel,) = json.loads((out / "snr.json").read_text())["channels"]
    assert len(channel["patches"]) == len(BOXES)
    assert len(list(csv.reader((out / "snr.csv").open()))) == len(BOXES) + 1
    assert (out / "snr.png").stat().st_size > 20_000
    assert "Dynamic range" in (out / "snr.html").read_text()
    assert_refused(
        gpusim("measure", "snr", tmp_path / "scale.npy", "--roi", "0,0,999,5"), "leaves the picture"
    )
    assert_refused(gpusim("measure", "snr", tmp_path / "scale.npy"), "no red, green and blue")


def test_small_regions_are_refused():
    with pytest.raises(UserError, match="too small"):
        measure_snr(Plane(scale(), None, (-np.inf, np.inf)), "Y", [(0, 0, 7, 7)])
