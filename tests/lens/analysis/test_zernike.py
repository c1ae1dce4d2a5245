"""Zernike terms: Noll's table, his norm, and the terms of wavefronts that are known."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.lens.analysis.zernike import TERMS, fit, orders, zernike

# Noll 1976, table I: Cartesian forms.
TABLE = {
    1: lambda x, y: 1 + 0 * x,
    2: lambda x, y: 2 * x,
    3: lambda x, y: 2 * y,
    4: lambda x, y: np.sqrt(3) * (2 * (x * x + y * y) - 1),
    5: lambda x, y: np.sqrt(6) * 2 * x * y,
    6: lambda x, y: np.sqrt(6) * (x * x - y * y),
    7: lambda x, y: np.sqrt(8) * (3 * (x * x + y * y) - 2) * y,
    8: lambda x, y: np.sqrt(8) * (3 * (x * x + y * y) - 2) * x,
    9: lambda x, y: np.sqrt(8) * (3 * x * x * y - y**3),
    10: lambda x, y: np.sqrt(8) * (x**3 - 3 * x * y * y),
    11: lambda x, y: np.sqrt(5) * (6 * (x * x + y * y) ** 2 - 6 * (x * x + y * y) + 1),
    12: lambda x, y: np.sqrt(10) * (4 * (x * x + y * y) - 3) * (x * x - y * y),
    13: lambda x, y: np.sqrt(10) * (4 * (x * x + y * y) - 3) * 2 * x * y,
}


def disc(radial: int = 12, around: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes and weights that integrate polynomials to degree 23 over the disc exactly."""
    t, weight = np.polynomial.legendre.leggauss(radial)
    rho = np.sqrt((t + 1) / 2)[:, None]
    phi = 2 * np.pi * np.arange(around) / around
    weights = np.repeat(weight / 2 / around, around)
    return (rho * np.cos(phi)).ravel(), (rho * np.sin(phi)).ravel(), weights


@pytest.mark.parametrize("number", TABLE)
def test_terms_are_those_of_nolls_table(number: int):
    x, y, _ = disc()
    np.testing.assert_allclose(zernike(number, x, y), TABLE[number](x, y), atol=1e-13)


def test_terms_are_orthogonal_with_a_root_mean_square_of_1():
    x, y, weights = disc()
    terms = np.stack([zernike(number, x, y) for number in range(1, TERMS + 1)])
    np.testing.assert_allclose((terms * weights) @ terms.T, np.eye(TERMS), atol=1e-12)


def test_orders_go_on_as_noll_numbers_them():
    assert [orders(j) for j in (14, 15, 16, 17, 22, 23, 24, 36, 37)] == [
        *((4, 4), (4, -4), (5, 1), (5, -1), (6, 0), (6, -2), (6, 2), (7, 7), (8, 0))
    ]


def test_the_terms_of_a_known_wavefront_come_back():
    # Seidel's rho^4 is (1/3, 1/(2 sqrt 3), 1/(6 sqrt 5)) of terms 1, 4 and 11; coma in y, rho^3
    # sin phi, is 1/3 of term 3 and 1/(3 sqrt 8) of term 7 (Mahajan, table of the same).
    x, y, _ = disc()
    rho2 = x * x + y * y
    found = fit(0.7 * rho2**2 - 0.3 * rho2 * y, x, y)
    expected = np.zeros(TERMS)
    expected[[0, 3, 10]] = 0.7 * np.array([1 / 3, 1 / (2 * np.sqrt(3)), 1 / (6 * np.sqrt(5))])
    expected[[2, 6]] = -0.3 * np.array([1 / 3, 1 / (3 * np.sqrt(8))])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_what_is_vignetted_is_still_fitted():
    x, y, _ = disc(20, 60)
    passes = (y < 0.4) & (y > -0.7)
    values = 0.3 * zernike(4, x, y) + 0.1 * zernike(7, x, y)
    found = fit(values[passes], x[passes], y[passes], 15)
    np.testing.assert_allclose(found[[3, 6]], [0.3, 0.1], atol=1e-9)
