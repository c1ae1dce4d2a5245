"""Sampling of highlights' kernels: against the splines of all samples."""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import FLAT, bank, monochrome
from scipy.ndimage import map_coordinates

from gpusim.optics.highlight_sampling import Sampling, sampling
from gpusim.optics.highlight_tables import Tables
from gpusim.psf.bank import Bank

PITCH = 1.55


def ringed() -> Bank:
    """Return PSFs whose light falls with the cube of the distance, in rings 4 samples apart."""
    plain = bank(size=128)
    at = np.arange(128) - 64
    radius = np.hypot(at, at[:, None])
    psf = (1 + 0.3 * np.cos(np.pi * radius / 2)) / (1 + (radius / 3) ** 3)
    psf *= np.clip((60 - radius) / 12, 0.0, 1.0)  # the window ends softly
    return replace(plain, psf=np.broadcast_to(psf / psf.sum(), plain.psf.shape).copy())


LENS = ringed()
FIELDS = [LENS.field(number) for number in (0, 2, 3)]


def tables() -> Tables:
    return Tables(LENS, monochrome(), FLAT[None], PITCH)


def table_of(kernels: Tables, number: int, angle: float) -> np.ndarray:
    field = FIELDS[number]
    given = kernels.spectra(field), kernels.weights, angle, PITCH * np.eye(2)
    return kernels.table(field, *given)[0, 0]


def lamp(coefficients: np.ndarray, places: np.ndarray, step: int) -> np.ndarray:
    """Return the mean of three by three squares side by side, at samples of the bank (P, 2)."""
    shifts = PITCH / LENS.pitch_um * np.stack(np.meshgrid(*[np.arange(-1, 2)] * 2), axis=-1)
    return np.mean(
        [values(coefficients, (places + one) / step) for one in shifts.reshape(-1, 2)], axis=0
    )


def values(coefficients: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return a spline at places (P, 2), samples from its middle."""
    middle = coefficients.shape[-1] // 2
    return map_coordinates(coefficients, (places + middle).T, order=3, prefilter=False)


def test_near_samples_are_the_tables_and_far_ones_go_through_its_values():
    table = table_of(tables(), 1, 0.3)
    one = Sampling(near=20, far=24, step=4, radius=7.0)
    near, far = np.split(one.of(table), [one.near**2])
    middle = len(table) // 2
    inner = slice(middle - 10, middle + 10)
    # Near samples are copied: no arithmetic, no rounding.
    assert_close(near.reshape(20, 20), table[inner, inner].copy(), atol=0)
    knots = np.stack(np.meshgrid(*[np.arange(-8, 8)] * 2), axis=-1).reshape(-1, 2).astype(float)
    expected = values(table, 4 * knots)
    # The prefilter's recursion and its sum of three: some ten roundings of what is largest.
    assert_close(values(far.reshape(24, 24), knots), expected, atol=10 * 2.0**-52 * table.max())


@pytest.mark.parametrize("allowed", [1e-1, 3e-2, 1e-2])
def test_far_samples_err_by_what_is_allowed(allowed: float):
    """At places between all samples, at every field and in every direction."""
    kernels = tables()
    chosen = sampling(kernels, FIELDS, allowed)
    assert chosen.far and chosen.samples < 0.6 * kernels.side**2
    rng = np.random.default_rng(3)
    for number, angle in ((0, 0.0), (1, 0.4), (2, 0.8)):
        table = table_of(kernels, number, angle)
        far = chosen.of(table)[chosen.near**2 :].reshape(chosen.far, chosen.far)
        for inner, outer in ((chosen.radius, chosen.radius + 8), (32, 40), (40, 48)):
            distance, turn = rng.uniform(inner, outer, 2000), rng.uniform(0, 2 * np.pi, 2000)
            places = distance[:, None] * np.stack([np.sin(turn), np.cos(turn)], axis=1)
            exact, found = lamp(table, places, 1), lamp(far, places, chosen.step)
            error = np.sqrt(np.mean(((found - exact) / exact) ** 2))
            # Rings have some 100 samples: their root mean square is known to 1 / sqrt(200).
            assert error < (1 + 3 / np.sqrt(200)) * allowed


def test_the_tighter_the_more_samples_up_to_all():
    kernels = tables()
    counts = [sampling(kernels, FIELDS, allowed).samples for allowed in (1e-1, 1e-2, 1e-3, 1e-4)]
    assert counts == sorted(counts) and counts[0] < counts[-1]
    whole = sampling(kernels, FIELDS, 1e-12)
    assert whole.near == kernels.side and not whole.far
    table = table_of(kernels, 2, 0.2)
    # Copied: no rounding.
    assert_close(whole.of(table).reshape(table.shape), table, atol=0)


def test_far_samples_reach_as_far_as_the_light():
    kernels = tables()
    chosen = sampling(kernels, FIELDS, 1e-2)
    assert chosen.far // 2 * chosen.step >= kernels.support + 2 * chosen.step
    assert chosen.near // 2 >= chosen.radius + 2
