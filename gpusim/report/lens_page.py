"""What the page on a lens shows, as plain numbers: ``gpusim.report.lens`` draws them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gpusim.lens.samples import sample_rays
from gpusim.lens.section import Element, beam, elements
from gpusim.lens.system import System
from gpusim.lens.wavefront import Pupil
from gpusim.parallel import each
from gpusim.psf import otf
from gpusim.psf.bank import Bank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.report.lens_facts import working_f_number

# Parts of the largest field, by the bank's fields.
CURVE_FIELDS = {"axis": 0.0, "half field": 0.5, "full field": 1.0}
COLOUR_WAVELENGTHS_NM = (425.0, 475.0, 600.0, 650.0)
RAYS = 7
# Chief rays for distortion and lateral colour: more than the bank has fields, for smooth curves.
CHIEF_RAYS = 121


@dataclass(frozen=True)
class Curves:
    """MTF of one field against frequency, tangential and sagittal; shape (2, K)."""

    name: str
    field_deg: float
    against_frequency: np.ndarray


@dataclass(frozen=True)
class BankPage:
    """What a page shows of a bank alone.

    Attributes
    ----------
    bank : Bank
    frequency : ndarray, shape (K,)
        Cycles/mm.
    limit : ndarray, shape (K,)
        MTF of a perfect lens with the axial pupil and the same spectrum.
    curves : list of Curves
        One for each of CURVE_FIELDS that the bank tells apart.
    chief_deg : ndarray, shape (C,)
        Field angles of the chief rays.
    chief_nm : ndarray, shape (W,)
        Their wavelengths; the first is the reference.
    chief_um : ndarray, shape (C, W)
        Where they land.
    """

    bank: Bank
    frequency: np.ndarray
    limit: np.ndarray
    curves: list[Curves]
    chief_deg: np.ndarray
    chief_nm: np.ndarray
    chief_um: np.ndarray


@dataclass(frozen=True)
class LensPage(BankPage):
    """Everything that the page of a prescription shows.

    Attributes
    ----------
    system : System
    elements : list of Element
    beams : list of ndarray
        One for each of CURVE_FIELDS, see :func:`gpusim.lens.section.beam`.
    focus_frequency : float
        Cycles/mm of the through-focus curves.
    focus_mm : ndarray, shape (Z,)
        Shifts of the image plane.
    through_focus : list of ndarray, shape (2, Z)
        MTF of each of CURVE_FIELDS, tangential and sagittal.
    """

    system: System
    elements: list[Element]
    beams: list[np.ndarray]
    focus_frequency: float
    focus_mm: np.ndarray
    through_focus: list[np.ndarray]


def lens_page(
    bank: Bank,
    system: System,
    progress: Callable[[int, int], None] | None = None,
    *,
    frequency: float | None = None,
) -> LensPage:
    """Compute what the page shows.

    Parameters
    ----------
    bank : Bank
    system : System
        The lens of the bank.
    progress : callable, optional
        Called with (steps done, steps in all).
    frequency : float, optional
        Cycles/mm of the through-focus curves; without it where the axis keeps about half.
    """
    parts = CURVE_FIELDS.values()
    fields = [np.radians(bank.field_deg[field_number(bank, part)]) for part in parts]
    # Every other wavelength: 50 nm of the default bank, enough for a curve.
    lines = slice(bank.reference % 2, None, 2)
    wavelengths = bank.wavelengths_nm[lines]
    light = (bank.transmission * quadrature(bank))[lines]
    reference = bank.reference // 2
    steps = itertools.count(1)

    def advance(_done: int, _total: int) -> None:
        if progress is not None:
            progress(next(steps), 2 * len(fields) + 1)

    def traced(theta: float) -> otf.FieldPupils:
        return otf.field_pupils(system, theta, wavelengths, light, reference=reference)

    pupils = each(traced, fields, advance)
    top, half = _frequencies(bank, pupils[0])
    focus_frequency = half if frequency is None else frequency
    frequency = np.linspace(0, top, 101)
    depth_mm = _depth_mm(bank, pupils, focus_frequency)
    focus_mm = np.linspace(-depth_mm, depth_mm, 61)

    def curves(one: tuple[str, float, otf.FieldPupils]) -> tuple[Curves, np.ndarray]:
        name, theta, field = one
        mtf = Curves(name, float(np.degrees(theta)), _both(field.otf, frequency))
        return mtf, _through_focus(field, focus_frequency, focus_mm)

    drawn = each(curves, zip(CURVE_FIELDS, fields, pupils, strict=True), advance)
    chief_nm = np.append(bank.reference_nm, COLOUR_WAVELENGTHS_NM)
    chief_deg = np.linspace(0, bank.field_deg[-1], CHIEF_RAYS)
    chief_um = np.stack(each(_chief_um(system, chief_nm), np.radians(chief_deg)))
    advance(1, 1)
    return LensPage(
        bank=bank,
        system=system,
        elements=elements(system),
        beams=[beam(system, theta, RAYS, 0.12 * system.image_z_mm) for theta in fields],
        frequency=frequency,
        limit=_limit_of(pupils[0], wavelengths, frequency, working_f_number(bank)),
        focus_frequency=focus_frequency,
        focus_mm=focus_mm,
        curves=[one for one, _ in drawn],
        through_focus=[one for _, one in drawn],
        chief_deg=chief_deg,
        chief_nm=chief_nm,
        chief_um=chief_um,
    )


def ready_page(bank: Bank) -> BankPage:
    """Compute what the page of a bank without a prescription shows."""
    f_number = working_f_number(bank)
    cut_off = 1e6 / (bank.wavelengths_nm[0] * f_number)
    highest = min(cut_off, 500 / bank.pitch_um)  # the PSFs are sampled no finer
    tried = np.geomspace(highest / 500, highest, 120)
    lost = np.flatnonzero(np.abs(bank_otf(bank, 0, tried, "tangential")) < 0.1)
    top = min(round_above(tried[lost[0]]), highest) if lost.size else highest
    frequency = np.linspace(0, top, 101)
    fields = {field_number(bank, part): name for name, part in reversed(CURVE_FIELDS.items())}
    drawn = [
        Curves(
            name,
            float(bank.field_deg[number]),
            _both(lambda f, way, number=number: bank_otf(bank, number, f, way), frequency),
        )
        for number, name in sorted(fields.items())
    ]
    limits = [otf.diffraction_mtf(frequency, w, f_number) for w in bank.wavelengths_nm]
    light = field_light(bank, 0)
    others = [int(np.abs(bank.wavelengths_nm - w).argmin()) for w in COLOUR_WAVELENGTHS_NM]
    lines = [bank.reference, *sorted({*others} - {bank.reference})]
    chief_deg = np.linspace(0, bank.field_deg[-1], CHIEF_RAYS)
    chief_nm = bank.wavelengths_nm[lines]
    return BankPage(
        bank=bank,
        frequency=frequency,
        limit=light @ np.array(limits) / light.sum(),
        curves=drawn,
        chief_deg=chief_deg,
        chief_nm=chief_nm,
        chief_um=np.stack([bank.height_from_angle(chief_deg, w)[0] for w in chief_nm], axis=1),
    )


def field_light(bank: Bank, field: int) -> np.ndarray:
    """Return the light of each wavelength in one field's image, of an even spectrum."""
    passed = bank.transmission * bank.projected_solid_angle_sr * bank.relative_illumination[field]
    return passed * quadrature(bank)


def bank_otf(bank: Bank, field: int, frequency: np.ndarray, direction: otf.Direction) -> np.ndarray:
    """Return the polychromatic OTF of a field's PSFs and of the light beyond them; shape (K,)."""
    core, *halo = bank.levels
    otfs = otf.otf(core.psf[field], core.pitch_um, frequency, direction)
    for level in halo:
        # It is smooth: beyond what its samples tell there is nothing.
        told = np.abs(frequency) < 500 / level.pitch_um
        seen = otf.otf(level.psf[field], level.pitch_um, frequency * told, direction)
        otfs = otfs + told * seen
    shift = bank.real_height_um[field] - bank.real_height_um[field, bank.reference]
    tangential = direction == "tangential"
    return otf.polychromatic(
        otfs, field_light(bank, field), frequency, shift if tangential else 0.0
    )


def _chief_um(system: System, wavelengths_nm: np.ndarray) -> Callable[[float], np.ndarray]:
    """Return a function from field angle (rad) to where its chief rays land."""
    index, centre = system.index(wavelengths_nm), np.zeros(1)
    return lambda theta: 1e3 * sample_rays(system, index, theta, centre, centre).chief_y_mm


def _through_focus(field: otf.FieldPupils, frequency: float, focus_mm: np.ndarray) -> np.ndarray:
    """Return a field's MTF, tangential and sagittal, at shifts of the image plane; shape (2, Z)."""
    return _both(lambda f, direction: field.through_focus(f, direction, focus_mm), frequency)


def _limit_of(
    axis: otf.FieldPupils, wavelengths_nm: np.ndarray, frequency: np.ndarray, f_number: float
) -> np.ndarray:
    """Return the MTF of a perfect lens with the axial pupils, in the light of the lens."""
    limits = np.stack(
        [
            _limit(pupil, wavelength, frequency, f_number)
            for pupil, wavelength in zip(axis.fine, wavelengths_nm, strict=True)
        ]
    )
    return axis.weight @ limits / axis.weight.sum()


def _limit(
    pupil: Pupil, wavelength_nm: float, frequency: np.ndarray, f_number: float
) -> np.ndarray:
    """Return the MTF of a perfect lens with the axial pupil."""
    if np.isscalar(pupil.apodised):
        return otf.diffraction_mtf(frequency, wavelength_nm, f_number)
    perfect = replace(pupil, opd_mm=np.zeros_like(pupil.opd_mm))
    return np.abs(otf.pupil_otf(perfect, wavelength_nm, frequency, "tangential"))


def quadrature(bank: Bank | PlaneBank) -> np.ndarray:
    """Return the weights of the trapezoidal rule over the bank's wavelengths."""
    steps = np.diff(bank.wavelengths_nm)
    return (np.append(steps, 0.0) + np.insert(steps, 0, 0.0)) / 2 if steps.size else np.ones(1)


def field_number(bank: Bank, part: float) -> int:
    """Return the number of the bank's field that lies at a part of the largest."""
    return round(part * (len(bank.field_deg) - 1))


def _both(function: Callable, *arguments: object) -> np.ndarray:
    return np.abs([function(*arguments, direction) for direction in otf.DIRECTIONS])


def round_near(value: float, series: tuple[float, ...] = (1, 2, 3, 4, 5, 6, 8)) -> float:
    """Return the round number nearest to a value by ratio."""
    return _rounds(value, series)[np.abs(np.log(_rounds(value, series) / value)).argmin()]


def round_above(value: float, series: tuple[float, ...] = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)) -> float:
    """Return the least round number that is not below a value."""
    rounds = _rounds(value, series)
    return rounds[rounds >= value * (1 - 1e-9)][0]


def _rounds(value: float, series: tuple[float, ...]) -> np.ndarray:
    """Return the round numbers around a value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return np.concatenate([np.array(series) * decade, [10 * decade * series[0]]])


def _frequencies(bank: Bank, axis: otf.FieldPupils) -> tuple[float, float]:
    """Return round frequencies: where the axis keeps 10 %, or a little more; and about 50 %."""
    cut_off = 1e6 / (bank.wavelengths_nm[0] * working_f_number(bank))
    tried = np.geomspace(cut_off / 500, cut_off, 120)
    modulus = np.abs(axis.otf(tried, "tangential"))
    lost = np.flatnonzero(modulus < 0.1)
    half = np.flatnonzero(modulus < 0.5)
    top = tried[lost[0]] if lost.size else cut_off
    return round_above(top), round_near(tried[half[0]] if half.size else cut_off / 2)


def _depth_mm(bank: Bank, pupils: list[otf.FieldPupils], frequency: float) -> float:
    """Return how far to shift the image plane: until a perfect lens has lost the frequency.

    A disc of blur dz / N has its first zero at 1.22 N / dz: twice that, and the best focus of every
    field and direction where it lies within four times.
    """
    unit = 1.22 * working_f_number(bank) / frequency
    tried = np.linspace(-4, 4, 65) * unit
    best = [
        abs(tried[np.abs(field.through_focus(frequency, direction, tried)).argmax()])
        for field in pupils
        for direction in otf.DIRECTIONS
    ]
    return round_above(max(2 * unit, max(best) + unit))
