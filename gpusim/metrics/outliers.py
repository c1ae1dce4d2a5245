"""Levels of light that contradict the others: a frame with a flicker, a wrong number of photons.

A level is compared with what the levels next to it say of its place: the parabola through eight.
Its distance counts in standard uncertainties of both, and against the usual distance of the levels,
since real light and real converters miss smooth curves by more than the noise of a mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.metrics.photon_transfer import Transfer

# Usual distances from the neighbours: a normal one this far is one in 1.7 million, a level in 30000
# measurements of 60.
CONTRADICTS = 5.0
NEIGHBOURS, DEGREE = 8, 2  # of the parabola: its own noise is half of a level's
LEAST_LEVELS = 10  # for a usual distance to be known
HIGHEST = 0.95  # of the signal at saturation: beyond, curves bend by what clips
MAD = 1.4826  # from the median of distances to a normal law's standard deviation


@dataclass(frozen=True)
class Outlier:
    """A level that contradicts the others.

    Attributes
    ----------
    photons, exposure_s : float
    quantity, unit : str
        What contradicts: the mean in DN, or the temporal variance in DN^2.
    value, expected : float
    sigmas : float
        Distance in standard uncertainties.
    """

    photons: float
    exposure_s: float
    quantity: str
    unit: str
    value: float
    expected: float
    sigmas: float

    def __str__(self) -> str:
        """Return a sentence without its full stop."""
        return (
            f"the level of {self.photons:g} photons, {self.exposure_s:g} s is left out: its "
            f"{self.quantity} is {self.value:.5g} {self.unit}, where the levels beside it say "
            f"{self.expected:.5g}, {abs(self.sigmas):.1f} standard uncertainties apart"
        )


def without_outliers(transfer: Transfer) -> tuple[Transfer, tuple[Outlier, ...]]:
    """Return the levels that agree, and those that do not.

    Parameters
    ----------
    transfer : Transfer
        In the order of the photons.
    """
    found = []
    for quantity, unit, of, u2 in (
        ("mean", "DN", transfer.signal, transfer.mean_u2 + transfer.dark_mean_u2),
        ("temporal variance", "DN^2", transfer.variance, transfer.variance_u2),
    ):
        for at, expected, sigmas in _contradicting(transfer, of, u2):
            found.append(
                (
                    at,
                    Outlier(
                        float(transfer.photons[at]),
                        float(transfer.exposure_s[at]),
                        quantity,
                        unit,
                        float(of[at]),
                        expected,
                        sigmas,
                    ),
                )
            )
    left = {at for at, _ in found}
    keep = np.array([at not in left for at in range(transfer.photons.size)])
    kept = Transfer(**{name: values[keep] for name, values in vars(transfer).items()})
    return kept, tuple(one for _, one in sorted(found, key=lambda pair: pair[0]))


def _contradicting(
    transfer: Transfer, of: np.ndarray, u2: np.ndarray
) -> list[tuple[int, float, float]]:
    """Return index, expected value and distance of levels that contradict, the worst first."""
    judged = list(np.flatnonzero(transfer.between(-np.inf, HIGHEST)))
    found: list[tuple[int, float, float]] = []
    while len(judged) >= LEAST_LEVELS:
        x = transfer.photons[judged]
        expected, sigmas = _beside(x, of[judged], u2[judged])
        usual = max(1.0, MAD * float(np.median(np.abs(sigmas))))
        worst = int(np.argmax(np.abs(sigmas)))
        if abs(sigmas[worst]) <= CONTRADICTS * usual:
            break
        rest = [at for number, at in enumerate(judged) if number != worst]
        again = _beside(transfer.photons[rest], of[rest], u2[rest])[1]
        near = again[max(worst - 2, 0) : worst + 2]
        # Beside a step of the curve, as where a sensor changes its gain, the next ones stand out
        # as well: that is the curve.
        if np.abs(near).max() > CONTRADICTS * usual:
            break
        found.append((int(judged[worst]), float(expected[worst]), float(sigmas[worst])))
        judged = rest
    return found


def _beside(x: np.ndarray, y: np.ndarray, u2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the neighbours of each level say of it, and its distance in uncertainties."""
    expected, sigmas = np.empty(len(x)), np.empty(len(x))
    for at in range(len(x)):
        others = np.delete(np.arange(len(x)), at)
        near = others[np.argsort(np.abs(x[others] - x[at]))[:NEIGHBOURS]]
        reach = np.abs(x[near] - x[at]).max()
        root = 1 / np.sqrt(np.maximum(u2[near], 1e-30))
        design = np.vander((x[near] - x[at]) / reach, DEGREE + 1) * root[:, None]
        # The parabola's value at the level itself is its last coefficient.
        weight = np.linalg.pinv(design)[-1] * root
        expected[at] = weight @ y[near]
        spread = np.sqrt(u2[at] + weight**2 @ u2[near])
        sigmas[at] = (y[at] - expected[at]) / max(spread, 1e-12)
    return expected, sigmas
