"""What a raw file says of the lens: its figures, and how readers undo its shading and distortion.

Opcodes of chapter 7 of the DNG specification 1.4: FixVignetteRadial and WarpRectilinear, both
polynomials of the distance from the optical axis over that of the farthest corner of the picture.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from gpusim.isp.colour import CHANNELS, response
from gpusim.psf.bank import Bank
from gpusim.psf.field_bank import FieldBank
from gpusim.scene.spectra import WAVELENGTHS_NM, white_radiance
from gpusim.sensor.frame import Rect
from gpusim.sensor.sensor import Sensor

WARP_RECTILINEAR, FIX_VIGNETTE_RADIAL = 1, 3
OPCODE_VERSION = (1, 3, 0, 0)
OPTIONAL = 1  # flag: readers that do not know the opcode go on without it
# Bends of a straight edge that finders of corners tell from their own errors: DNG's map of four
# numbers is to be nearer to the chief rays.
VISIBLE_PX = 0.2
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
    lines_nm : ndarray (L,)
        Wavelengths at which the lateral colour is known.
    shift_um : ndarray (L, n)
        By how much farther from the axis light of these wavelengths lands.
    """

    name: str
    focal_length_mm: float
    f_number: float
    real_um: np.ndarray
    ideal_um: np.ndarray
    light: np.ndarray
    lines_nm: np.ndarray = field(default_factory=lambda: np.zeros(0))
    shift_um: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def optics_of(name: str, bank: FieldBank) -> Optics:
    """Return what files say of a lens, from its bank."""
    none = np.zeros(0)
    given = name, bank.efl_mm, bank.f_number
    if not isinstance(bank, Bank):
        return Optics(*given, none, none, none)
    real = np.linspace(0, bank.rectilinear_circle_um, HEIGHTS)
    ideal, _ = bank.ideal_from_real(real)
    light = bank.illumination_at(real, np.zeros(HEIGHTS))[bank.reference]
    angle, _ = bank.angle_from_height(real)
    lands = [bank.height_from_angle(angle, line)[0] for line in bank.wavelengths_nm]
    return Optics(*given, real, ideal, light, bank.wavelengths_nm, np.stack(lands) - real)


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
    curves = response(sensor.colour_qe)
    return _listed(optics, farthest, (x, y), curves.tobytes())


@lru_cache(maxsize=8)  # frames of one camera have the same
def _listed(optics: Optics, farthest_um: float, at: tuple[float, float], curves: bytes) -> bytes:
    """Return the opcodes for a sensor's curves (colours, 61)."""
    seen = np.frombuffer(curves).reshape(-1, WAVELENGTHS_NM.size)
    maps = [
        (*warp(optics, farthest_um, shift_um), 0.0, 0.0) for shift_um in colour_shifts(optics, seen)
    ]
    packed = struct.pack(f">I{6 * len(maps) + 2}d", len(maps), *sum(maps, ()), *at)
    listed = [
        _opcode(FIX_VIGNETTE_RADIAL, struct.pack(">7d", *shading(optics, farthest_um), *at)),
        _opcode(WARP_RECTILINEAR, packed),
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


def warp(optics: Optics, farthest_um: float, shift_um: np.ndarray) -> np.ndarray:
    """Return k of real = r (k0 + k1 r^2 + k2 r^4 + k3 r^6) for an ideal distance r: (4,).

    ``shift_um`` (n,) is by how much farther than at the reference wavelength light lands.
    """
    seen = optics.ideal_um <= farthest_um * 1.001
    r = optics.ideal_um[seen] / farthest_um
    powers = r[:, None] ** (1 + 2 * np.arange(4))
    lands = (optics.real_um + shift_um)[seen] / farthest_um
    return np.linalg.lstsq(powers, lands, rcond=None)[0]


def misfit_um(optics: Optics, farthest_um: float) -> float:
    """Return by how much the map of `warp` is off the chief rays at most, within a picture.

    ``farthest_um`` is the distance from the axis to its farthest corner.
    """
    k = warp(optics, farthest_um, np.zeros(optics.real_um.size))
    r = optics.ideal_um / farthest_um
    off = farthest_um * r[:, None] ** (1 + 2 * np.arange(4)) @ k - optics.real_um
    # Its largest is often that of the corner, which lies between two heights.
    reach = np.maximum(optics.ideal_um, optics.real_um)
    seen = np.append(off[reach <= farthest_um], np.interp(farthest_um, reach, off))
    return float(np.abs(seen).max())


def correction_notes(optics: Optics, sensor: Sensor) -> tuple[str, ...]:
    """Return what the corrections in a sensor's raws lack of the lens; nothing where they hold."""
    if not optics.real_um.size:
        return (
            "raws say nothing of the lens's shading and distortion: it has no axis, and DNG no way",
        )
    pitch_um = sensor.pixel_pitch_um
    off_px = misfit_um(optics, np.hypot(sensor.rows, sensor.cols) / 2 * pitch_um) / pitch_um
    if off_px <= VISIBLE_PX:
        return ()
    return (
        f"the distortion in raws, a polynomial of four numbers, is up to {off_px:.2g} px off the "
        "lens's chief rays",
    )


def colour_shifts(optics: Optics, seen: np.ndarray) -> np.ndarray:
    """Return by how much farther from the axis colours that a camera sees lie, um: (colours, n).

    ``seen`` (colours, 61) are their curves: see `gpusim.isp.colour.response`.

    The mean over what a colour collects of daylight (D65). Red, green and blue each; of other
    filters one for all, since DNG has a map for each plane of the picture or one.
    """
    if not optics.lines_nm.size:
        return np.zeros((1, optics.real_um.size))
    curves = seen * white_radiance("D65", 1.0)
    if curves.shape[0] != len(CHANNELS):
        curves = curves.sum(axis=0, keepdims=True)
    shifts = np.stack(
        [np.interp(WAVELENGTHS_NM, optics.lines_nm, one) for one in optics.shift_um.T], axis=1
    )
    return curves @ shifts / curves.sum(axis=1, keepdims=True)


def _opcode(number: int, parameters: bytes) -> bytes:
    """Return an opcode; of whatever order the file is, opcodes are big-endian."""
    return struct.pack(">I4B2I", number, *OPCODE_VERSION, OPTIONAL, len(parameters)) + parameters
