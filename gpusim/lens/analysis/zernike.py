"""Zernike polynomials in Noll's order and norm: each has the root mean square 1 over the disc.

R. J. Noll, Zernike polynomials and atmospheric turbulence, J. Opt. Soc. Am. 66, 207 (1976), eq. 1
to 3. The angle counts from x towards y, so that even terms go with cos and lie along x.
"""

from __future__ import annotations

from math import factorial

import numpy as np

TERMS = 37
# By Noll's number, from 1.
NAMES = {
    1: "piston",
    2: "tilt x",
    3: "tilt y",
    4: "defocus",
    5: "astigmatism 45\N{DEGREE SIGN}",
    6: "astigmatism 0\N{DEGREE SIGN}",
    7: "coma y",
    8: "coma x",
    9: "trefoil y",
    10: "trefoil x",
    11: "spherical",
    12: "2nd astigmatism 0\N{DEGREE SIGN}",
    13: "2nd astigmatism 45\N{DEGREE SIGN}",
    14: "tetrafoil 0\N{DEGREE SIGN}",
    15: "tetrafoil 22.5\N{DEGREE SIGN}",
    16: "2nd coma x",
    17: "2nd coma y",
    22: "2nd spherical",
    37: "3rd spherical",
}


def orders(number: int) -> tuple[int, int]:
    """Return n and m of a term; m is negative where it goes with sin (odd numbers)."""
    n = 0
    while (n + 1) * (n + 2) // 2 < number:
        n += 1
    place = number - n * (n + 1) // 2  # from 1 within the row of n
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place - 1) // 2) + 1
    return n, -m if m and number % 2 else m


def zernike(number: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a term at points of the unit disc."""
    n, signed = orders(number)
    m = abs(signed)
    rho, phi = np.hypot(x, y), np.arctan2(y, x)
    radial = sum(
        (-1) ** s
        * factorial(n - s)
        / (factorial(s) * factorial((n + m) // 2 - s) * factorial((n - m) // 2 - s))
        * rho ** (n - 2 * s)
        for s in range((n - m) // 2 + 1)
    )
    if m == 0:
        return np.sqrt(n + 1) * radial
    turn = np.cos(m * phi) if signed > 0 else np.sin(m * phi)
    return np.sqrt(2 * (n + 1)) * radial * turn


def fit(values: np.ndarray, x: np.ndarray, y: np.ndarray, terms: int = TERMS) -> np.ndarray:
    """Return the coefficients that fit values best in the least-squares sense.

    Parameters
    ----------
    values, x, y : ndarray, shape (R,)
        Where light passes, evenly over the unit disc. In a vignetted pupil the terms are no longer
        orthogonal: their sum still is the wavefront where light passes.
    terms : int

    Returns
    -------
    ndarray, shape (terms,)
        The first is that of term 1.
    """
    basis = np.stack([zernike(number, x, y) for number in range(1, terms + 1)], axis=-1)
    return np.linalg.lstsq(basis, values, rcond=None)[0]
