"""How densely a bank samples a lens: its wavelengths, its fields, and the window of its PSFs."""

from __future__ import annotations

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.prescription import Prescription
from gpusim.lens.samples import sample_field
from gpusim.lens.system import System, first_order
from gpusim.psf.field_map import WIDE_DEG

WAVELENGTHS_NM = tuple(range(400, 701, 25))
REFERENCE_NM = 550.0
FIELDS = 15
SIDE = 9  # fields each way
PITCH_UM = 0.5
SIZE = 256
SIZES = (SIZE, SIZE * 3 // 2, SIZE * 2)
# Share of the rays that the window should catch; caustics leave a few far out.
CAUGHT = 0.98


def check_reference(reference_nm: float, wavelengths_nm: np.ndarray) -> None:
    """Refuse a reference wavelength that is not one of a bank's."""
    if reference_nm not in wavelengths_nm:
        raise UserError(
            "the reference wavelength is not one of the bank's",
            field="reference_nm",
            value=reference_nm,
            allowed=", ".join(f"{w:g}" for w in wavelengths_nm),
        )


def default_fields_deg(prescription: Prescription, count: int = FIELDS) -> np.ndarray:
    """Return field angles from 0 to the lens's largest.

    They are evenly spaced in tan(theta), or in theta where the lens sees farther than
    ``WIDE_DEG``: either is nearly even in image height.
    """
    if prescription.max_field_deg > WIDE_DEG:
        return np.linspace(0, prescription.max_field_deg, count)
    edge = np.tan(np.radians(prescription.max_field_deg))
    fields_deg = np.degrees(np.arctan(np.linspace(0, edge, count)))
    fields_deg[-1] = prescription.max_field_deg
    return fields_deg


def default_sides_deg(prescription: Prescription, count: int = SIDE) -> np.ndarray:
    """Return an odd number of angles, evenly spaced, from the largest field to the other."""
    half = np.linspace(0, prescription.max_field_deg, (count + 1) // 2)
    return np.concatenate([-half[:0:-1], half])


def default_pitch_um(prescription: Prescription, wavelengths_nm: np.ndarray) -> float:
    """Return 0.5 um, halved as often as the aperture needs at the shortest wavelength.

    The finest pattern of a PSF has a period of lambda / (2 sin theta') = lambda N, and two samples
    to a period are needed. Real apertures exceed the paraxial f-number's by some percent.
    """
    needed = 0.95 * 1e-3 * float(np.min(wavelengths_nm)) * first_order(prescription).f_number / 2
    pitch = PITCH_UM
    while pitch > needed:
        pitch /= 2
    return pitch


def window(system: System, wavelengths_nm: np.ndarray) -> tuple[int, float]:
    """Return size and pitch (um) of the window that holds a lens's PSFs: what a bank takes itself.

    The size is the least of SIZES, with the lens's default pitch, that catches the rays of the
    shortest wavelength at the axis, half, three quarters and the whole of the field. Where the
    largest does not, the pitch is the widest that still samples the PSF, in steps of 0.05 um.
    Light beyond the window is the halo's: see ``gpusim.psf.halo``.

    Raises
    ------
    UserError
        Where a field does not pass the lens.
    """
    shortest_nm = float(np.min(wavelengths_nm))
    index = system.index(np.array([shortest_nm]))
    needed_um = width = 0.0
    for part in (0.0, 0.5, 0.75, 1.0):
        theta = np.radians(part * system.prescription.max_field_deg)
        samples = sample_field(system, index, theta)
        inside = samples.inside
        landing_mm = np.hypot(samples.landing_x_mm, samples.landing_y_mm)[inside]
        needed_um = max(needed_um, 2e3 * float(np.quantile(landing_mm, CAUGHT)))
        width = max(width, 2 * np.abs(samples.alpha[inside]).max(), np.ptp(samples.beta[inside]))
    pitch_um = default_pitch_um(system.prescription, wavelengths_nm)
    size = next((size for size in SIZES if size * pitch_um >= needed_um), SIZES[-1])
    if size * pitch_um >= needed_um:
        return size, pitch_um
    # Nyquist: lambda / (2 width), less 5 % for the rim between the rays.
    widest_um = 0.05 * np.floor(0.95 * 1e-3 * shortest_nm / (2 * width) / 0.05)
    return size, round(float(np.clip(widest_um, pitch_um, PITCH_UM)), 2)
