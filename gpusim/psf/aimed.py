"""Rays that are aimed at the stop: they tell where a beam's other rays enter, leave and end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from gpusim.lens.samples import RAY_OVERSIZE, no_light
from gpusim.lens.system import System
from gpusim.lens.tracer import Beams
from gpusim.lens.wavefront import within_hull

AIMED_ACROSS = 49  # rays across the stop that are aimed at it: 921 on half of 1.04 stops
# Degree of the polynomial from the directions in which rays leave to where they enter. It only has
# to lead rays to within 1e-3 of a node's direction: see shaders/psf/wavefront.
DEGREE = 9
NEAR = 1.05  # times the aimed rays' directions: where the polynomial may lead


@dataclass(frozen=True)
class AimedRays:
    """Rays of one beam that arrive, within its rim and a little beyond.

    Attributes
    ----------
    cosines : ndarray, shape (R, 2)
        Directions in which they leave.
    p_mm : ndarray, shape (R, 2)
        Where they enter, on the launch plane.
    reach : ndarray, shape (R,)
        Less than 1 within the rim.
    opd_waves : ndarray, shape (R,)
    rho2 : ndarray, shape (R,)
        Squared height in the stop, over its radius squared.
    apart : (float, float)
        From one ray to the next, of half their extent each way.
    """

    cosines: np.ndarray
    p_mm: np.ndarray
    reach: np.ndarray
    opd_waves: np.ndarray
    rho2: np.ndarray
    apart: tuple[float, float]

    @cached_property
    def side(self) -> np.ndarray:
        """The sign of alpha: by symmetry the mirror image of each ray is one too."""
        return np.where(self.cosines[:, 0] < 0, -1.0, 1.0)

    @cached_property
    def alpha(self) -> np.ndarray:
        """Direction cosines across the meridional plane, of the ray or mirror image above it."""
        return self.side * self.cosines[:, 0]

    @property
    def beta(self) -> np.ndarray:
        """Direction cosines along it."""
        return self.cosines[:, 1]

    @property
    def inside(self) -> np.ndarray:
        """Which lie within the rim."""
        return self.reach < 1


def aimed_rays(
    beams: Beams, system: System, field_deg: np.ndarray, lines: int
) -> tuple[np.ndarray, list[list[AimedRays]]]:
    """Aim rays at the stop and trace them.

    Returns
    -------
    failed : ndarray of int (F, L)
        Rays within the stop that did not arrive.
    rays : list of list of AimedRays
        By field and line.

    Raises
    ------
    UserError
        No light passes at a field.
    """
    line = np.linspace(-RAY_OVERSIZE, RAY_OVERSIZE, AIMED_ACROSS)
    x, y = (one.ravel() for one in np.meshgrid(line[line >= 0], line))
    keep = x**2 + y**2 <= RAY_OVERSIZE**2
    x, y = x[keep], y[keep]
    p, miss = beams.aim(system.stop_radius_mm * np.stack([x, y], axis=-1))
    number, count = miss.shape
    rays = beams.trace(p.reshape(-1, 2), np.repeat(np.arange(number), count))
    opd, reach = rays.opd_waves.reshape(miss.shape), rays.reach.reshape(miss.shape)
    ok = (miss >= 0) & (rays.failed_at == 0).reshape(miss.shape)
    failed = (~ok & (x**2 + y**2 < 1)).sum(axis=1).reshape(len(field_deg), lines)
    cosines = rays.cosines.reshape(number, count, 2).astype(float)
    spacing = line[1] - line[0]
    found = []
    for field, theta in enumerate(field_deg):
        of_field = range(field * lines, (field + 1) * lines)
        if not all((reach[beam][ok[beam]] < 1).any() for beam in of_field):
            raise no_light(system, np.radians(theta))
        found.append([])
        for beam in of_field:
            inside = ok[beam] & (reach[beam] < 1)
            extent = max(x[inside].max(), np.ptp(y[inside]) / 2, spacing)
            # Far outside a rim, rays turn back on others and only spoil the fit; but of a beam
            # that is vignetted to little there must be rays beyond it.
            keep = ok[beam] & (reach[beam] < max(RAY_OVERSIZE, 1 + spacing / extent) ** 2)
            apart = spacing / x[keep].max(), 2 * spacing / np.ptp(y[keep])
            of_beam = (values[beam][keep] for values in (cosines, p, reach, opd))
            found[-1].append(AimedRays(*of_beam, (x * x + y * y)[keep], apart))
    return failed, found


class Leads:
    """Polynomials from the directions in which rays of one beam leave to where they enter.

    Parameters
    ----------
    rays : AimedRays
    exponent : ndarray (R,), optional
        -ln of the amplitude that is left of each: one more polynomial.

    Attributes
    ----------
    half, half_height, centre : float
        What the rays span of alpha, from 0 on; and of beta, about its middle.
    """

    def __init__(self, rays: AimedRays, exponent: np.ndarray | None = None) -> None:
        self.rays = rays
        low, high = rays.beta.min(), rays.beta.max()
        self.half, self.half_height, self.centre = (
            rays.alpha.max(),
            (high - low) / 2,
            (low + high) / 2,
        )
        # A strongly vignetted beam has few rays: each coefficient takes at least two.
        self.degree = min(DEGREE, int(np.sqrt(len(rays.alpha))) - 1)
        i, j = np.meshgrid(np.arange(self.degree + 1), np.arange(self.degree + 1), indexing="ij")
        in_a, in_b = self._in(rays.alpha, rays.beta)
        targets = [(1, rays.side * rays.p_mm[:, 0]), (0, rays.p_mm[:, 1])]
        if exponent is not None:
            targets.append((0, exponent))
        self.coefficients = []
        for odd, target in targets:
            used = (i % 2 == odd) & (i + j <= self.degree)
            design = in_a[:, i[used]] * in_b[:, j[used]]
            found = np.zeros(i.shape)
            found[used] = np.linalg.solve(design.T @ design, design.T @ target)
            self.coefficients.append(found)

    def _scaled(self, alpha: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return alpha / self.half, (beta - self.centre) / self.half_height

    def _in(self, alpha: np.ndarray, beta: np.ndarray) -> list[np.ndarray]:
        return [chebyshev.chebvander(one, self.degree) for one in self._scaled(alpha, beta)]

    def at(self, alpha: np.ndarray, beta: np.ndarray) -> list[np.ndarray]:
        """Return each polynomial on a grid of directions (A, B)."""
        on_a, on_b = self._in(alpha, beta)
        return [on_a @ one @ on_b.T for one in self.coefficients]

    def entering(
        self,
        etendue: Callable[[np.ndarray, np.ndarray], np.ndarray],
        alpha: np.ndarray,
        beta: np.ndarray,
    ) -> np.ndarray:
        """Return E on a grid of directions (A, B): see `gpusim.lens.entering`.

        ``etendue``: returns the etendue of places on the launch plane, per area of it.
        """
        a, b = self._scaled(alpha, beta)
        led = self.coefficients[:2]
        value, by_a, by_b = (
            [chebyshev.chebgrid2d(a, b, one) for one in of]
            for of in (
                led,
                [chebyshev.chebder(one, axis=0) for one in led],
                [chebyshev.chebder(one, axis=1) for one in led],
            )
        )
        area = np.abs(by_a[0] * by_b[1] - by_a[1] * by_b[0])
        return area * etendue(*value) / (self.half * self.half_height)

    def near(self, alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Return which directions (A, B) they lead from: far beyond the rays, nowhere."""
        away = self.centre + NEAR * (self.rays.beta - self.centre)
        return within_hull(NEAR * self.rays.alpha, away, alpha, beta)
