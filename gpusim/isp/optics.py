"""What a raw file says of the lens: its figures, and how readers undo its shading and distortion.

Opcodes of chapter 7 of the DNG specification 1.4: FixVignetteRadial and WarpRectilinear, both
polynomials of the distance from the optical axis over that of the farthest corner of the picture.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from gpusim.psf.bank import Bank
from gpusim.psf.field_bank import FieldBank
from gpusim.sensor.frame import Rect
from gpusim.sensor.sensor import Sensor

WARP_RECTILINEAR, FIX_VIGNETTE_RADIAL = 1, 3
OPCODE_VERSION = (1, 3, 0, 0)
OPTIONAL = 1  # flag: readers that do not know the opcode go on without it
HEIGHTS = 129  # at which the lens is sampled, from the axis to the rim


@dataclass(frozen=True, eq=False)
class Optics:
    """A lens as files of photographs know it.

    Attributes
    ----------
    name : str
    focal_length_mm, f_number : float
    real_um, ideal_um : ndarray (n,)
        Distance from the axis at which light lands, and at which it would without distortion, at
        the reference wavelength, rising from 0; none (n = 0) of a lens without an axis.
    light : ndarray (n,)
        Relative illumination there.
    """

    name: str
    focal_length_mm: float
    f_number: float
    real_um: np.ndarray
    ideal_um: np.ndarray
    light: np.ndarray


def optics_of(name: str, bank: FieldBank) -> Optics:
    """Return what files say of a lens, from its bank."""
    none = np.zeros(0)
    given = name, bank.efl_mm, bank.f_number
    if not isinstance(bank, Bank):
        return Optics(*given, none, none, none)
    real = np.linspace(0, bank.rectilinear_circle_um, HEIGHTS)
    ideal, _ = bank.ideal_from_real(real)
    light = bank.illumination_at(real, np.zeros(HEIGHTS))[bank.reference]
    return Optics(*given, real, ideal, light)


def opcodes(optics: Optics, sensor: Sensor, rect: Rect) -> bytes:
    """Return the OpcodeList3 that undoes a lens's shading and distortion.

    Parameters
    ----------
    optics : Optics
    sensor : Sensor
        Gives pitch and size; the axis meets its middle.
    rect : (row, col, rows, cols)
        The picture, counted from the sensor's first lit pixel.

    Returns
    -------
    bytes
        Empty where the lens has no axis or the picture does not have it within: DNG has no way
        then.
    """
    row, col, rows, cols = rect
    x, y = (sensor.cols / 2 - col) / cols, (sensor.rows / 2 - row) / rows
    if not (optics.real_um.size and 0 <= x <= 1 and 0 <= y <= 1):
        return b""
    farthest = np.hypot(max(x, 1 - x) * cols, max(y, 1 - y) * rows) * sensor.pixel_pitch_um
    listed = [
        _opcode(FIX_VIGNETTE_RADIAL, struct.pack(">7d", *shading(optics, farthest), x, y)),
        _opcode(WARP_RECTILINEAR, struct.pack(">I8d", 1, *warp(optics, farthest), 0, 0, x, y)),
    ]
    return struct.pack(">I", len(listed)) + b"".join(listed)


def shading(optics: Optics, farthest_um: float) -> np.ndarray:
    """Return k of the gain 1 + k0 r^2 + k1 r^4 + ... + k4 r^10 that undoes the shading: (5,)."""
    seen = optics.real_um <= farthest_um * 1.001
    r = optics.real_um[seen] / farthest_um
    powers = r[:, None] ** (2 * np.arange(1, 6))
    # Relative errors of the picture are those of gain times light.
    light = optics.light[seen]
    return np.linalg.lstsq(powers * light[:, None], 1 - light, rcond=None)[0]


def warp(optics: Optics, farthest_um: float) -> np.ndarray:
    """Return k of real = r (k0 + k1 r^2 + k2 r^4 + k3 r^6) for an ideal distance r: (4,)."""
    seen = optics.ideal_um <= farthest_um * 1.001
    r = optics.ideal_um[seen] / farthest_um
    powers = r[:, None] ** (1 + 2 * np.arange(4))
    return np.linalg.lstsq(powers, optics.real_um[seen] / farthest_um, rcond=None)[0]


def _opcode(number: int, parameters: bytes) -> bytes:
    """Return an opcode; of whatever order the file is, opcodes are big-endian."""
    return struct.pack(">I4B2I", number, *OPCODE_VERSION, OPTIONAL, len(parameters)) + parameters
