"""What the page on a lens without symmetry shows, as plain numbers: ``plane_figure`` draws them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.lens.section import Element, beam, elements
from gpusim.lens.system import System
from gpusim.psf import otf
from gpusim.psf.plane_bank import PlaneBank
from gpusim.report.lens_page import CURVE_FIELDS, RAYS, quadrature, round_near


@dataclass(frozen=True)
class PlanePage:
    """Everything that the page shows.

    Attributes
    ----------
    bank : PlaneBank
    system : System or None
        Its lens, where it was computed here.
    elements : list of Element
    beams : list of ndarray
        In the y-z plane, one for each of CURVE_FIELDS.
    frequency : float
        Cycles/mm of the maps of the MTF.
    mtf : ndarray, shape (2, Y, X)
        Polychromatic, for frequencies along x and along y.
    away_um : ndarray, shape (Y, X, 2)
        How far, in x and y, the chief ray of the reference wavelength lands from the ideal image
        f tan(theta) about the image of the axis.
    ideal_um : ndarray, shape (Y, X, 2)
        That ideal image; NaN from 90 degrees.
    lateral_um : ndarray, shape (Y, X)
        Largest distance between the chief rays of two wavelengths.
    """

    bank: PlaneBank
    system: System | None
    elements: list[Element]
    beams: list[np.ndarray]
    frequency: float
    mtf: np.ndarray
    away_um: np.ndarray
    ideal_um: np.ndarray
    lateral_um: np.ndarray


def plane_page(bank: PlaneBank, system: System | None) -> PlanePage:
    """Compute what the page shows.

    Parameters
    ----------
    bank : PlaneBank
    system : System, optional
        The lens of the bank.
    """
    reference = bank.reference
    chief = np.stack([bank.chief_x_um, bank.chief_y_um], axis=-1)
    apart = chief[:, :, :, None] - chief[:, :, None]
    x, y = np.meshgrid(np.radians(bank.field_x_deg), np.radians(bank.field_y_deg))
    theta, scale_um = np.hypot(x, y), 1e3 * bank.principal_distance_mm
    with np.errstate(invalid="ignore"):
        scale = np.where(theta < np.pi / 2, scale_um * np.tan(theta), np.nan)
        scale = np.where(theta > 0, scale / np.where(theta > 0, theta, 1), scale_um)
    ideal = scale[..., None] * np.stack([x, y], axis=-1) + chief[bank.middle][reference]
    number = 0.5 / float(np.sqrt(bank.projected_solid_angle_sr[reference] / np.pi))
    cut_off = min(1e6 / (bank.wavelengths_nm[0] * number), 500 / bank.pitch_um)
    tried = np.geomspace(cut_off / 500, cut_off, 120)
    middle = np.mean([np.abs(_otf(bank, tried, axis)[bank.middle]) for axis in ("x", "y")], axis=0)
    half = np.flatnonzero(middle < 0.5)
    frequency = min(round_near(tried[half[0]] if half.size else cut_off / 2), cut_off)
    at = np.array([frequency])
    angles = [] if system is None else _angles(bank)
    return PlanePage(
        bank=bank,
        system=system,
        elements=[] if system is None else elements(system),
        beams=[beam(system, theta, RAYS, 0.12 * system.image_z_mm) for theta in angles],
        frequency=float(frequency),
        mtf=np.stack([np.abs(_otf(bank, at, axis)[..., 0]) for axis in ("x", "y")]),
        away_um=chief[:, :, reference] - ideal,
        ideal_um=ideal,
        lateral_um=np.linalg.norm(apart, axis=-1).max(axis=(2, 3)),
    )


def _angles(bank: PlaneBank) -> list[float]:
    """Return the fields of the layout, rad: the axis, half of and the whole way along y."""
    return [np.radians(part * bank.field_y_deg[-1]) for part in CURVE_FIELDS.values()]


def field_light(bank: PlaneBank) -> np.ndarray:
    """Return the light of each wavelength in every image, shape (Y, X, L), of an even spectrum."""
    passed = bank.transmission * bank.projected_solid_angle_sr * quadrature(bank)
    return passed * bank.relative_illumination


def _otf(bank: PlaneBank, frequency: np.ndarray, axis: str) -> np.ndarray:
    """Return the polychromatic OTF of every field along x or y, shape (Y, X, K)."""
    # `otf` calls columns tangential, as in banks with an axis: here they are x.
    way, chief = ("tangential", bank.chief_x_um) if axis == "x" else ("sagittal", bank.chief_y_um)
    otfs = otf.otf(bank.psf, bank.pitch_um, frequency, way)
    shift = chief - chief[..., bank.reference, None]
    light = field_light(bank)
    fields = np.ndindex(light.shape[:2])
    found = [
        # The OTF is of one direction: its shift is that of the chief rays along it.
        otf.polychromatic(otfs[f], light[f], frequency, shift[f])
        for f in fields
    ]
    return np.array(found).reshape(*light.shape[:2], len(frequency))
