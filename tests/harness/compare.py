"""Comparison of arrays: no default tolerance, no vacuous success, a picture of what failed."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

SHOWN = 8  # bad values in a message
PICTURES = Path("out/test-failures")


def assert_close(
    actual: np.ndarray,
    reference: np.ndarray,
    *,
    atol: float | np.ndarray | None = None,
    rtol: float | np.ndarray | None = None,
    outliers: float = 0.0,
    outlier_atol: float | None = None,
) -> None:
    """Fail unless |actual - reference| <= atol + rtol |reference| everywhere.

    Parameters
    ----------
    actual, reference : array
        Arrays of the same shape; they must not share memory. The reference must be finite.
    atol, rtol : float or array
        One of them must be given; an array gives each element its own derived bound. ``atol=0``
        asks for equality.
    outliers : float
        Share of the elements that may exceed the tolerance, for values at a rounding boundary.
    outlier_atol : float
        Bound for those; needed where ``outliers`` is not 0.

    Raises
    ------
    AssertionError
        With the number of bad elements, their box, the worst and the first of them.
    ValueError
        The comparison would prove nothing.
    """
    if actual is reference:
        raise ValueError("actual and reference are the same object")
    actual, reference = np.asarray(actual), np.asarray(reference)
    if np.shares_memory(actual, reference):
        raise ValueError("actual and reference share memory")
    if atol is None and rtol is None:
        raise ValueError("give a tolerance: atol or rtol")
    if (outliers != 0.0) != (outlier_atol is not None) or not 0.0 <= outliers < 1.0:
        raise ValueError("outliers is a share below 1, and goes with outlier_atol")
    if reference.size == 0:
        raise ValueError("there is nothing to compare")
    if not np.isfinite(reference).all():
        raise ValueError("the reference is not finite")
    assert actual.shape == reference.shape, f"shape {actual.shape}, expected {reference.shape}"
    wide = np.complex128 if np.iscomplexobj(reference) or np.iscomplexobj(actual) else np.float64
    expected = reference.astype(wide)
    allowed = np.broadcast_to((atol or 0.0) if np.ndim(atol) == 0 else atol, reference.shape)
    if rtol is not None:
        allowed = allowed + np.asarray(rtol) * np.abs(expected)
    if not (np.isfinite(allowed).all() and (allowed >= 0).all()):
        raise ValueError("the tolerance must be finite and not negative")
    error = np.abs(actual.astype(wide) - expected)
    bad = ~(error <= allowed)  # so that NaN is bad
    if not bad.any():
        return
    if outlier_atol is not None and bad.mean() <= outliers and (error <= outlier_atol).all():
        return
    message = _explained(actual, reference, error, allowed, bad)
    raise AssertionError(message + _picture(actual, reference))


def _explained(
    actual: np.ndarray,
    reference: np.ndarray,
    error: np.ndarray,
    allowed: np.ndarray,
    bad: np.ndarray,
) -> str:
    places = np.argwhere(bad)
    box = " x ".join(
        f"{low}..{high}" for low, high in zip(places.min(0), places.max(0), strict=True)
    )
    excess = np.where(np.isfinite(error), error - allowed, np.inf)
    worst = np.unravel_index(np.argmax(excess), excess.shape)
    rows = [
        f"{len(places)} of {bad.size} elements are bad, in the box {box or 'of a scalar'}",
        f"worst at {tuple(map(int, worst))}; then the first bad ones:",
        f"{'index':>20} {'actual':>22} {'expected':>22} {'|error|':>12} {'allowed':>12}",
    ]
    for place in [worst, *map(tuple, places[:SHOWN])]:
        index = str(tuple(map(int, place)))
        rows.append(
            f"{index:>20} {actual[place]!s:>22} {reference[place]!s:>22} "
            f"{error[place]:>12.4g} {allowed[place]:>12.4g}"
        )
    return "\n".join(rows)


def _picture(actual: np.ndarray, reference: np.ndarray) -> str:
    """Write actual, expected and the magnified difference of images side by side; say where."""
    test = os.environ.get("PYTEST_CURRENT_TEST")
    image = actual.ndim == 2 and min(actual.shape) > 1 and not np.iscomplexobj(actual)
    if not image or test is None or "GPUSIM_SHADERS_DIR" in os.environ:
        return ""  # mutants fail by the hundred, on purpose
    from matplotlib import image as images

    top = float(np.abs(reference).max()) or 1.0
    difference = np.nan_to_num(actual.astype(float) - reference, posinf=0.0, neginf=0.0)
    scale = float(np.abs(difference).max()) or 1.0
    panels = [actual / top, reference / top, 0.5 + 0.5 * difference / scale]
    shown = np.nan_to_num(np.hstack(panels)).clip(0.0, 1.0)
    PICTURES.mkdir(parents=True, exist_ok=True)
    file = PICTURES / (re.sub(r"[^\w.-]+", "_", test.partition(" ")[0]) + ".png")
    images.imsave(file, shown, cmap="gray", vmin=0.0, vmax=1.0)
    return f"\nactual | expected | difference x {top / scale:.3g} of the range: {file}"
