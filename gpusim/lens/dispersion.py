"""Dispersion: the laws by which glasses bend light of each wavelength.

Those are the formulas of catalogues, and the mean law of glasses that nd and Vd alone tell.
"""

from __future__ import annotations

import numpy as np

# Spectral lines of the definition of the Abbe number (ISO 7944), nm.
D_LINE_NM, F_LINE_NM, C_LINE_NM = 587.5618, 486.1327, 656.2725
_GF = np.array([435.8343, F_LINE_NM])
# Sellmeier coefficients (data sheets of Schott) of the glasses that model glasses are derived from.
# K7 and F2 define the normal line. N-SF66 (Vd 20.9) and N-FK58 (Vd 90.9) show how glasses bend away
# from it at both ends. N-LAF35 lies 0.0085 off the line in P_g,F.
_N_SF66 = (2.0245976, 0.0147053225, 0.470187196, 0.0692998276, 2.59970433, 161.817601)
_F2 = (1.34533359, 0.00997743871, 0.209073176, 0.0470450767, 0.937357162, 111.886764)
_K7 = (1.1273555, 0.00720341707, 0.124412303, 0.0269835916, 0.827100531, 100.384588)
_N_FK58 = (0.738042712, 0.00339065607, 0.363371967, 0.0117551189, 0.989296264, 212.842145)
_N_LAF35 = (1.51697436, 0.00750943203, 0.455875464, 0.0260046715, 1.07469242, 80.5945159)
# Where all of them have data; of N-SF66, which is opaque there, the formula goes on below 390 nm.
MODEL_RANGE_NM = (365.0, 2325.0)
# Dispersion formulas by their number in Zemax catalogues. The equations are those of the Zemax
# manual (chapter on glass catalogues); all but 4 and 10, of which there are none, give the nd and
# Vd that the makers' catalogues state, to the digits.
FORMULAS = {
    1: "Schott",
    2: "Sellmeier 1",
    3: "Herzberger",
    4: "Sellmeier 2",
    5: "Conrady",
    6: "Sellmeier 3",
    7: "Handbook of Optics 1",
    8: "Handbook of Optics 2",
    9: "Sellmeier 4",
    10: "Extended",
    11: "Sellmeier 5",
    12: "Extended 2",
    13: "Extended 3",
}
# Powers of the wavelength in n^2, in the order of the coefficients.
_POWERS = {
    1: (0, 2, -2, -4, -6, -8),
    10: (0, 2, -2, -4, -6, -8, -10, -12),
    12: (0, 2, -2, -4, -6, -8, 4, 6),
    13: (0, 2, 4, -2, -4, -6, -8, -10, -12),
}
_RESONANCES = {2: 3, 6: 4, 11: 5}  # terms of the Sellmeier formulas n^2 = 1 + sum K w^2/(w^2 - L)


def formula_index(
    formula: int, coefficients: tuple[float, ...], wavelengths_nm: np.ndarray | float
) -> np.ndarray:
    """Return the index by a dispersion formula; NaN where it has no real value.

    Parameters
    ----------
    formula : int
        Number in ``FORMULAS``.
    coefficients : tuple of float
        In the catalogue's order, for wavelengths in um; those that are missing are 0.
    wavelengths_nm : ndarray or float
        Wavelengths in nm.
    """
    w = np.asarray(wavelengths_nm, dtype=float) / 1e3
    w2 = w * w
    k = (*coefficients, *[0.0] * 10)
    with np.errstate(all="ignore"):
        if formula in _POWERS:
            return np.sqrt(sum(c * w**p for c, p in zip(k, _POWERS[formula], strict=False)))
        if formula in _RESONANCES:
            terms = range(_RESONANCES[formula])
            return np.sqrt(1 + sum(k[2 * i] * w2 / (w2 - k[2 * i + 1]) for i in terms))
        if formula == 3:
            pole = 1 / (w2 - 0.028)
            ends = k[3] * w2 + k[4] * w2**2 + k[5] * w2**3
            return k[0] + k[1] * pole + k[2] * pole**2 + ends
        if formula == 4:
            first = k[1] * w2 / (w2 - k[2] ** 2)
            return np.sqrt(1 + k[0] + first + k[3] / (w2 - k[4] ** 2))
        if formula == 5:
            return k[0] + k[1] / w + k[2] / w**3.5
        if formula == 7:
            return np.sqrt(k[0] + k[1] / (w2 - k[2]) - k[3] * w2)
        if formula == 8:
            return np.sqrt(k[0] + k[1] * w2 / (w2 - k[2]) - k[3] * w2)
        return np.sqrt(k[0] + k[1] * w2 / (w2 - k[2]) + k[3] * w2 / (w2 - k[4]))  # 9


def _relative(
    coefficients: tuple[float, ...], wavelengths_nm: np.ndarray | float
) -> tuple[np.ndarray, float]:
    """Return (n - nd) / (nF - nC) of a Sellmeier glass, and its Abbe number."""
    nd, nf, nc = formula_index(2, coefficients, np.array([D_LINE_NM, F_LINE_NM, C_LINE_NM]))
    index = formula_index(2, coefficients, wavelengths_nm)
    return (index - nd) / (nf - nc), float((nd - 1) / (nf - nc))


def _normal_line(vd: float, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return (n - nd) / (nF - nC) of a glass on the normal line, shape (L,).

    A straight line in Vd at each wavelength, through the glasses K7 and F2 (Schott, TIE-29, 2016,
    sec. 2.3): P_g,F = 0.644 - 0.00169 Vd, P_C,t = 0.547 + 0.00471 Vd, and so on.
    """
    (k7, k7_vd), (f2, f2_vd) = (_relative(one, wavelengths_nm) for one in (_K7, _F2))
    return f2 + (vd - f2_vd) / (k7_vd - f2_vd) * (k7 - f2)


def _mean_dispersion(vd: float, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return (n - nd) / (nF - nC) of a glass as most are, shape (L,).

    Glasses lie on the normal line about K7 and F2, and above it where they disperse much or little.
    This is the cubic in Vd through K7, F2 and a glass at each end; beyond the ends of the
    catalogues, Vd 16 and 98, as at the ends.
    """
    vd = min(max(vd, 16.0), 98.0)
    glasses = [_relative(one, wavelengths_nm) for one in (_N_SF66, _F2, _K7, _N_FK58)]
    total = np.zeros(np.shape(wavelengths_nm))
    for law, own in glasses:
        others = [other for _, other in glasses if other != own]
        total += law * np.prod([(vd - other) / (own - other) for other in others])
    return total


def _anomaly(wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return what (n - nd) / (nF - nC) gains where P_g,F gains 1, shape (L,).

    The shape of N-LAF35 against the normal line. Other glasses deviate alike: over those of Schott,
    Ohara and Hoya, deviations from the mean correlate with that of P_g,F by 0.99 at the g and h
    lines, 0.65 at the s line and 0.56 at the t line.
    """
    law, vd = _relative(_N_LAF35, wavelengths_nm)
    return (law - _normal_line(vd, wavelengths_nm)) / _departure(_relative(_N_LAF35, _GF)[0], vd)


def mean_dpgf(vd: float) -> float:
    """Return how far glasses of an Abbe number lie above the normal line in P_g,F, most of them."""
    return _departure(_mean_dispersion(vd, _GF), vd)


def _departure(law: np.ndarray, vd: float) -> float:
    """Return how far P_g,F lies from the normal line, from the law at the lines g and F."""
    g, f = law - _normal_line(vd, _GF)
    return float(g - f)


def model_index(
    nd: float, vd: float, wavelengths_nm: np.ndarray, dpgf: float | None = None
) -> np.ndarray:
    """Return the index of a model glass, shape (L,): through nd and Vd, else as most glasses are.

    n = nd + (nd - 1) / Vd q(lambda), with q the mean of glasses of that Vd. Those of Schott, Ohara
    and Hoya scatter about it by 0.004 in P_g,F, one standard deviation, and by an index of 1.1e-4
    at the g line, 2.8e-4 at h and 2.2e-4 at t.

    Parameters
    ----------
    nd, vd : float
        Index at the d line, and (nd - 1) / (nF - nC).
    wavelengths_nm : ndarray, shape (L,)
    dpgf : float, optional
        How far the partial dispersion (ng - nF) / (nF - nC) lies above the normal line, where that
        is known.
    """
    wavelengths = np.asarray(wavelengths_nm, dtype=float)
    law = _mean_dispersion(vd, wavelengths)
    if dpgf is not None:
        law += (dpgf - mean_dpgf(vd)) * _anomaly(wavelengths)
    return nd + (nd - 1) / vd * law
