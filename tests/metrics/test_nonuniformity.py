"""The spectrogram of a fixed pattern: white noise, and a period along each axis."""

import numpy as np
import pytest

from gpusim.metrics.nonuniformity import spectrogram


def test_the_spectrogram_of_white_noise_is_its_variance():
    rng = np.random.default_rng(1)
    image = 3 * rng.standard_normal((400, 200))
    for axis, lines in ((1, 400), (0, 200)):
        power = spectrogram([image], 0.0, axis)[1:-1]
        # The power of a line is exponential: its mean over the lines has the spread 1/sqrt(lines).
        assert np.abs(power / 9 - 1).max() < 5 / lines**0.5
        assert power.mean() == pytest.approx(9, rel=0.02)


def test_the_spectrogram_shows_a_periodic_pattern_along_its_own_axis():
    x = np.arange(128)
    image = np.tile(2 * np.cos(2 * np.pi * x / 8), (64, 1))
    along, across = spectrogram([image], 0.0, 1), spectrogram([image], 0.0, 0)
    assert np.argmax(along) == 128 // 8
    # A cosine of amplitude 2: |F|^2 / N = (2 N / 2)^2 / N.
    assert along[16] == pytest.approx(128)
    assert across[1:].max() < 1e-9
