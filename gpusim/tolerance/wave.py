"""The wavefront of one field and how it changes with the lens: differentials in the pupil.

A change of the lens makes W + dW of W(alpha, beta) of `gpusim.lens.wavefront`. Rays are aimed at
the same points of the stop in both lenses. They leave in directions that differ by d alpha, and
the slope of W is where the ray lands, so that at the directions of the unchanged lens

    dW = W' + x' d alpha + y' d beta - W,

short of (d alpha)^2 d x / d alpha / 2. dW is smooth; a polynomial of `DEGREE` follows it. The
pupil's outline and transmission stay those of the unchanged lens. Image points count from the chief
ray of the reference line: a shift of the whole image blurs nothing, lateral colour does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.lens.samples import Samples, sample_field, sample_rays
from gpusim.lens.system import System, build
from gpusim.lens.wavefront import Pupil, pupils

DEGREE = 8  # of dW: residual below 1e-3 waves for 0.02 mm and 0.05 deg (tests/tolerance)
ACROSS = 23  # rays across the stop: 8 a coefficient
# The PSF repeats beyond this: lenses whose rays land farther out than half of it are not for it.
WINDOW_UM, NODES = 80.0, 64


@dataclass(frozen=True)
class Line:
    """The pupil of one wavelength: whole, on a grid.

    ``basis`` (K, A, B) are the polynomials of dW, ``gamma`` (A, B) the change of W
    where the image plane moves by 1 mm along the reference line's chief ray,
    ``step`` the grid's along alpha and beta, ``fit`` (K, R) takes dW at the rays to coefficients.
    """

    wavelength_mm: float
    amplitude: np.ndarray
    opd_mm: np.ndarray
    gamma: np.ndarray
    basis: np.ndarray
    step: tuple[float, float]
    fit: np.ndarray
    at_rays: np.ndarray


@dataclass(frozen=True)
class Wave:
    """One field of the unchanged lens.

    Attributes
    ----------
    theta, azimuth : float
        rad, azimuth from y towards x.
    stop_x, stop_y : ndarray (R,)
        Points of the stop, mm, which rays are aimed at.
    samples : Samples
        Rays of the unchanged lens.
    lines : tuple of Line
    reference : int
        The line whose chief ray is the origin.
    wavelengths_nm : ndarray (L,)
    """

    theta: float
    azimuth: float
    stop_x: np.ndarray
    stop_y: np.ndarray
    samples: Samples
    lines: tuple[Line, ...]
    reference: int
    wavelengths_nm: np.ndarray

    def change(self, lens: Prescription) -> tuple[np.ndarray, float]:
        """Trace a changed lens.

        Returns
        -------
        coefficients : ndarray (L, K)
            Coefficients of dW, mm.
        residual_mm : float
            RMS of what the polynomials miss.

        Raises
        ------
        UserError
            A ray of the unchanged lens's pupil does not pass the changed one.
        """
        system = build(lens)
        now = _rays(
            system, self.wavelengths_nm, self.theta, self.azimuth, x=self.stop_x, y=self.stop_y
        )
        if not now.ok.all():
            raise UserError(
                f"rays at {np.degrees(self.theta):.4g} deg do not pass the perturbed lens: "
                f"{lens.history[-1]}",
                field="tolerances",
                allowed="smaller changes",
            )
        was = self.samples
        opd = now.opd_mm - was.opd_mm
        opd = opd + now.landing_x_mm * (now.alpha - was.alpha)
        opd = opd + now.landing_y_mm * (now.beta - was.beta)
        shift = _lateral(now, self.reference) - _lateral(was, self.reference)
        opd = opd - was.alpha * shift[:, :1] - was.beta * shift[:, 1:]
        found = np.array([line.fit @ one for line, one in zip(self.lines, opd, strict=True)])
        missed = [
            one - row @ line.at_rays for line, one, row in zip(self.lines, opd, found, strict=True)
        ]
        return found, float(np.sqrt(np.mean(np.square(missed))))


def wave_of(lens: Prescription, theta: float, azimuth: float, wavelengths_nm: np.ndarray) -> Wave:
    """Trace the unchanged lens at one field.

    Parameters
    ----------
    lens : Prescription
    theta, azimuth : float
        rad.
    wavelengths_nm : ndarray (L,)
    """
    system = build(lens)
    index = system.index(wavelengths_nm)
    dense = sample_field(system, index, theta, azimuth)
    radius = system.stop_radius_mm
    x, y = (one.ravel() for one in np.meshgrid(*[np.linspace(-radius, radius, ACROSS)] * 2))
    inside = x**2 + y**2 <= radius**2
    x, y = x[inside], y[inside]
    lit = _rays(system, wavelengths_nm, theta, azimuth, x=x, y=y).inside.all(axis=0)
    x, y = x[lit], y[lit]
    rays = _rays(system, wavelengths_nm, theta, azimuth, x=x, y=y)
    reference = int(np.argmin(np.abs(wavelengths_nm - lens.reference_nm)))
    lateral, chief = _lateral(dense, reference), dense.chief_direction[reference]
    lines = tuple(
        _line(
            pupil,
            rays.alpha[k],
            rays.beta[k],
            1e-6 * wavelengths_nm[k],
            lateral=lateral[k],
            chief=chief,
        )
        for k, pupil in enumerate(pupils(dense, wavelengths_nm, WINDOW_UM, NODES))
    )
    return Wave(theta, azimuth, x, y, rays, lines, reference, wavelengths_nm)


def _rays(
    system: System,
    wavelengths_nm: np.ndarray,
    theta: float,
    azimuth: float,
    *,
    x: np.ndarray,
    y: np.ndarray,
) -> Samples:
    index = system.index(wavelengths_nm)
    return sample_rays(system, index, theta, x, y, azimuth=azimuth, whole=True)


def _lateral(samples: Samples, reference: int) -> np.ndarray:
    """Return where each line's chief ray lands from the reference line's, (L, 2), mm."""
    place = np.stack([samples.chief_x_mm, samples.chief_y_mm], axis=-1)
    return place - place[reference]


def _line(
    pupil: Pupil,
    ray_alpha: np.ndarray,
    ray_beta: np.ndarray,
    wavelength_mm: float,
    *,
    lateral: np.ndarray,
    chief: np.ndarray,
) -> Line:
    alpha, amplitude, opd = pupil.alpha, pupil.amplitude, pupil.opd_mm
    if pupil.half:  # alpha > 0 alone, half a cell from the plane of symmetry
        alpha = np.concatenate([-alpha[::-1], alpha])
        amplitude, opd = (np.concatenate([one[::-1], one]) for one in (amplitude, opd))
    a, b = np.meshgrid(alpha, pupil.beta, indexing="ij")
    opd = np.where(amplitude > 0, opd - a * lateral[0] - b * lateral[1], 0.0)
    middle = np.array([ray_alpha.mean(), ray_beta.mean()])
    reach = max(np.abs(ray_alpha - middle[0]).max(), np.abs(ray_beta - middle[1]).max())
    at_rays = _polynomials((ray_alpha - middle[0]) / reach, (ray_beta - middle[1]) / reach)
    # Beyond the outermost ray lies half a spacing of pupil: the polynomials go on into it.
    on_grid = _polynomials((a - middle[0]) / reach, (b - middle[1]) / reach)
    return Line(
        wavelength_mm=wavelength_mm,
        amplitude=amplitude,
        opd_mm=opd,
        # Less what only moves the image: an OTF that turns fast is badly interpolated.
        gamma=np.sqrt(np.maximum(1 - a**2 - b**2, 0))
        + (chief[0] * a + chief[1] * b) / np.sqrt(1 - (chief**2).sum()),
        basis=np.where(amplitude > 0, on_grid, 0.0),
        step=(float(alpha[1] - alpha[0]), float(pupil.beta[1] - pupil.beta[0])),
        fit=np.linalg.pinv(at_rays.T),
        at_rays=at_rays,
    )


def _polynomials(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the Chebyshev products of total degree up to `DEGREE`, (K, ...)."""
    along_x, along_y = (
        np.moveaxis(np.polynomial.chebyshev.chebvander(one, DEGREE), -1, 0) for one in (x, y)
    )
    return np.array(
        [along_x[i] * along_y[j] for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    )
