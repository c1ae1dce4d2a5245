"""Quantum efficiency by the angle of incidence, averaged over the light that arrives.

At field f of the bank and bank wavelength l light arrives in a cone of rays d, of directions t_d
and shares s_d of the projected solid angle (`gpusim.psf.cone`). What a channel makes of it is

    q_c(lambda; f, l, psi) = sum_d s_d EQE_c(lambda, R(psi) (t_d - m))

with R(psi) the turn to the azimuth psi of the image point, and m the direction from which the
shifted micro-lenses there send light where the middle one sends that along the normal. Between the
fields the product of q, relative illumination and PSF is interpolated (`gpusim.psf.places`).

A pixel that answers alike from all sides has no psi. For any other pixel behind a lens with an
axis, the weights of a field become a sum over few terms: their mean over psi, and what a singular
value decomposition finds of the rest, each a function of psi times weights of its own, and so a
kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from gpusim.errors import UserError
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.lines import line_shares
from gpusim.psf.places import Blend, Blends, Heights, Places
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.filters_model import passed
from gpusim.sensor.sensor import Sensor

# Azimuths at which the mean is taken, with cubic splines between: cones blur the corners that
# straight lines between the map's azimuths have.
AZIMUTHS = 72
FEW = 4  # azimuths that stand for all where spectra are told apart
EVERYWHERE_UM = 1e9  # farther than any image reaches
# A pixel that answers alike from all sides: there the map's azimuths differ by rounding only.
ROUNDING = 1e-12


class AngularResponse:
    """Mean quantum efficiency at the fields of a bank.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
        With ``eqe_map``.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.

    Attributes
    ----------
    fields : tuple of int
        All fields of the bank, by number; `seen`: those between which the sensor lies.
    turning : bool
        Whether it goes with the azimuth of the image point, beside the field.

    Raises
    ------
    UserError
        Where the bank does not know its rays.
    """

    def __init__(
        self, bank: FieldBank, sensor: Sensor, wavelengths_nm: np.ndarray = WAVELENGTHS_NM
    ) -> None:
        self.bank, self.micro_lens = bank, sensor.micro_lens
        self.wavelengths_nm = wavelengths_nm
        self.map = sensor.eqe_map
        light, of_map = passed(sensor.filters, wavelengths_nm), self.map.on_grid(wavelengths_nm)
        table = np.stack([of_map[name] for name in sensor.channels])
        self.table = table * light[:, None, None]
        self.fields, self.places = bank.places(EVERYWHERE_UM)
        corner_um = float(np.hypot(sensor.rows, sensor.cols)) * sensor.pixel_pitch_um / 2
        self.seen = bank.places(corner_um)[0]
        uneven = np.ptp(self.table, axis=-1).max() > ROUNDING
        self.turning = bool(uneven) and isinstance(self.places, Heights)
        self._found: dict[int, np.ndarray] = {}

    @property
    def azimuths(self) -> np.ndarray:
        """Azimuths (A,) of `qe`, radians."""
        return np.arange(AZIMUTHS if self.turning else 1) * (2 * np.pi / AZIMUTHS)

    def qe(self, number: int) -> np.ndarray:
        """Return the mean quantum efficiency (A, C, L, K) of a field of the bank, by azimuth.

        Raises
        ------
        UserError
            Where light arrives at the sensor from angles that the map does not hold. Beyond the
            sensor, where nodes lie whose cells reach in, the map goes on as it ends.
        """
        if number not in self._found:
            shares = self._shares(number)
            self._found[number] = np.einsum("altp,cwtp->aclw", shares, self.table, optimize=True)
        return self._found[number]

    def _shares(self, number: int) -> np.ndarray:
        """Return how much each node of the map counts: (A, L, thetas, phis)."""
        place_um, _, cone = self.bank.rays(number)
        across, share = cone[..., :2].astype(float), cone[..., 2].astype(float)
        if self.micro_lens is not None:
            height = float(np.hypot(*place_um))
            across = across - self.micro_lens.sine(height) * place_um / max(height, 1e-9)
        theta = np.degrees(np.arcsin(np.minimum(np.hypot(across[..., 0], across[..., 1]), 1.0)))
        grid = np.array(self.map.theta_deg)
        if number in self.seen and (farthest := theta[share > 0].max()) > grid[-1]:
            raise UserError(
                "light arrives from angles that the quantum efficiency does not hold",
                file=self.map.file,
                field="theta_deg",
                value=f"up to {grid[-1]:g}",
                allowed=f"up to {farthest:.3g} degrees or more for this lens on this sensor",
            )
        theta = np.minimum(theta, grid[-1])
        low = np.clip(np.searchsorted(grid, theta, "right") - 1, 0, max(len(grid) - 2, 0))
        high = np.minimum(low + 1, len(grid) - 1)
        outwards = np.where(
            high > low, (theta - grid[low]) / np.maximum(grid[high] - grid[low], 1e-9), 0
        )
        phi = np.array([*self.map.phi_deg, self.map.phi_deg[0] + 360])
        azimuth = np.degrees(np.arctan2(across[..., 1], across[..., 0]))
        lines, thetas, phis = len(share), len(grid), len(phi) - 1
        line = np.arange(lines)[:, None] * thetas
        result = np.empty((len(self.azimuths), lines, thetas, phis))
        for turned, found in zip(np.degrees(self.azimuths), result, strict=True):
            at = (azimuth + turned - phi[0]) % 360 + phi[0]
            before = np.clip(np.searchsorted(phi, at, "right") - 1, 0, phis - 1)
            beyond = (at - phi[before]) / (phi[before + 1] - phi[before])
            total = np.zeros(result[0].size)
            for theta_node, one in ((low, 1 - outwards), (high, outwards)):
                for phi_node, other in ((before, 1 - beyond), (before + 1, beyond)):
                    node = (line + theta_node) * phis + phi_node % phis
                    total += np.bincount(node.ravel(), (share * one * other).ravel(), total.size)
            found[...] = total.reshape(found.shape)
        return result

    @property
    def on_axis(self) -> np.ndarray:
        """Mean quantum efficiency (C, L, K) at the middle of the image."""
        return self.qe(self.bank.probes[0]).mean(axis=0)

    def at(self, x_um: float, y_um: float) -> np.ndarray:
        """Return the mean quantum efficiency (C, K) at a real image point, for figures."""
        lines = self.bank.wavelengths_nm
        shares = line_shares(lines, self.bank.spectral_degree, self.wavelengths_nm)
        blend = self.places.at(x_um, y_um)
        azimuth = np.arctan2(blend.sin, blend.cos)
        total = np.zeros((len(self.table), self.wavelengths_nm.size))
        for field, weight in zip(blend.fields, blend.weights, strict=True):
            of_field = np.einsum("aclw,lw->acw", self.qe(self.fields[field]), shares)
            there = azimuth + np.pi * (field in self.places.opposite)
            total += weight * around(of_field)(there % (2 * np.pi))
        return total

    @property
    def largest(self) -> np.ndarray:
        """Largest mean quantum efficiency (C, 1, K) of any place and bank wavelength.

        One for all of these, for some count less than nothing between them.
        """
        return np.max([self.qe(number).max(axis=(0, 2)) for number in self.seen], axis=0)[:, None]

    def everywhere(self) -> np.ndarray:
        """Return the mean quantum efficiency (P, C, L, K) at places that stand for all."""
        step = -(-len(self.azimuths) // FEW)
        return np.concatenate([self.qe(number)[::step] for number in self.seen])


@dataclass(frozen=True)
class TurnedHeights:
    """Fields at image heights whose kernels are sums over terms: fields times terms of them.

    Attributes
    ----------
    heights : Heights
        Where the fields lie.
    gains : list of CubicSpline
        One for each field: how its terms count, by azimuth.
    """

    heights: Heights
    gains: tuple[CubicSpline, ...]
    quadrants = ((1, 1), (-1, 1), (-1, -1), (1, -1))

    @property
    def probes(self) -> tuple[int, ...]:
        """The mean over the azimuths, on the axis and at the rim."""
        return self.heights.probes

    @property
    def main(self) -> slice:
        """The means over the azimuths, which hold the light."""
        return self.heights.main

    @property
    def opposite(self) -> tuple[int, ...]:
        """The fields beyond the axis, in each term."""
        count = len(self.gains)
        terms = len(self.gains[0](0.0))
        return tuple(
            field + term * count for term in range(terms) for field in self.heights.opposite
        )

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the kernel at a real image point is made."""
        blend = self.heights.at(x_um, y_um)
        azimuth = float(np.arctan2(blend.sin, blend.cos)) % (2 * np.pi)
        count = len(self.gains)
        parts = [
            (field + term * count, float(weight * gain))
            for field, weight in zip(blend.fields, blend.weights, strict=True)
            for term, gain in enumerate(self.gains[field](azimuth))
        ]
        fields, weights = zip(*parts, strict=True)
        return Blend(fields, weights, blend.cos, blend.sin)

    def blends(self, x_um: np.ndarray, y_um: np.ndarray) -> Blends:
        """Return the same at many points (N,)."""
        fields, weights, cos, sin = self.heights.blends(x_um, y_um)
        azimuth = np.arctan2(sin, cos) % (2 * np.pi)
        gains = np.array([gain(azimuth) for gain in self.gains])  # (F, N, terms)
        own = gains[fields, np.arange(len(fields))[:, None]]
        terms = len(self.gains) * np.arange(own.shape[-1])
        flat = len(fields), -1
        return Blends(
            (fields[..., None] + terms).reshape(flat),
            (weights[..., None] * own).reshape(flat),
            cos,
            sin,
        )


class PlaceWeights:
    """Weights of the planes of a basis at the fields of a bank.

    Parameters
    ----------
    response : AngularResponse
    per_photon : ndarray (L, K)
        Electrons/s of a unit of spectral radiance at a quantum efficiency of 1, on the axis.
    spectra : ndarray (J, K)
        Spectra of the planes.
    error : float
        How much of a plane's light in a channel the terms may leave out, at any azimuth.
    """

    def __init__(
        self,
        response: AngularResponse,
        per_photon: np.ndarray,
        spectra: np.ndarray,
        error: float,
    ) -> None:
        self.response, self.error = response, error
        self.per_plane = per_photon * spectra[:, None, :]
        self._splines: dict[int, CubicSpline] = {}

    def of_field(self, number: int) -> np.ndarray:
        """Return electrons/s of each plane (A, J, C, L) at a field, by azimuth."""
        return np.einsum("jlw,aclw->ajcl", self.per_plane, self.response.qe(number), optimize=True)

    def of_field_at(self, number: int, azimuth: float) -> np.ndarray:
        """Return electrons/s of each plane (J, C, L) at a field and any azimuth, radians."""
        if not self.response.turning:
            return self.of_field(number)[0]
        if number not in self._splines:
            self._splines[number] = around(self.of_field(number))
        return self._splines[number](azimuth % (2 * np.pi))

    def terms(self, fields: tuple[int, ...], places: Places) -> tuple[list[np.ndarray], Places]:
        """Return the terms (R, J, C, L, K) of the rates of fields, and the places of all terms.

        Their sums over the samples of the spectra are those of the weights. Places of one term
        are those given.

        Parameters
        ----------
        fields : tuple of int
            By number, as the places list them.
        places : Places
        """
        answers = [self.response.qe(number) for number in fields]
        means = [one.mean(axis=0) for one in answers]
        if not self.response.turning:
            return [self._rates(mean[None]) for mean in means], places
        gains, rank = [], 0
        for number in fields:
            one = self.of_field(number)
            mean = one.mean(axis=0)
            rest = (one - mean).reshape(len(one), -1)
            left, size, right = np.linalg.svd(rest, full_matrices=False)
            allowed = self.error * np.abs(mean).sum(axis=-1)
            own = 0
            while own < len(size):
                lost = np.einsum("ak,k,kx->ax", left[:, own:], size[own:], right[own:])
                if (np.abs(lost.reshape(one.shape)).sum(axis=-1) <= allowed).all():
                    break
                own += 1
            rank = max(rank, own)
            gains.append(left)
        splines, terms = [], []
        for place, (left, answer, mean) in enumerate(zip(gains, answers, means, strict=True)):
            # Seen from beyond the axis, the azimuth is half a turn on.
            half = len(left) // 2 if place in places.opposite else 0
            table = np.concatenate([np.ones((len(left), 1)), left[:, :rank]], axis=1)
            splines.append(around(np.roll(table, -half, axis=0)))
            shapes = np.tensordot(left[:, :rank].T, answer - mean, axes=1)
            terms.append(self._rates(np.concatenate([mean[None], shapes])))
        return terms, TurnedHeights(places, tuple(splines)) if rank else places

    def _rates(self, answers: np.ndarray) -> np.ndarray:
        """Return electrons/s of each plane (..., J, C, L, K) for what channels answer."""
        return self.per_plane[:, None] * answers[:, None]

    def at(self, x_um: float, y_um: float) -> np.ndarray:
        """Return electrons/s of each plane (J, C, L) at a real image point, with the fall of light.

        Relative illumination included.
        """
        bank = self.response.bank
        blend = self.response.places.at(x_um, y_um)
        azimuth = float(np.arctan2(blend.sin, blend.cos))
        total = np.zeros(())
        for field, weight in zip(blend.fields, blend.weights, strict=True):
            number = self.response.fields[field]
            light = weight * bank.field(number).relative_illumination
            there = azimuth + np.pi * (field in self.response.places.opposite)
            total = total + light * self.of_field_at(number, there)
        return total


def around(table: np.ndarray) -> CubicSpline:
    """Return the spline through values (A, ...) evenly spaced over a turn."""
    closed = np.append(table, table[:1], axis=0)
    return CubicSpline(np.linspace(0, 2 * np.pi, len(closed)), closed, bc_type="periodic")
