"""What there is to know of a lens at first glance, as names and texts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpusim.formats.ready import ReadyLens
from gpusim.lens.checks import Checked
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import Conjugates, System, conjugates, first_order
from gpusim.psf.bank import Bank
from gpusim.psf.plane_bank import PlaneBank

THETA = "\N{GREEK SMALL LETTER THETA}"
# Beyond this half field f tan(theta) says little, and from the second nothing.
WIDE_DEG, VERY_WIDE_DEG = 45.0, 75.0


def lens_facts(bank: Bank, system: System) -> list[tuple[str, str]]:
    """Return first-order data and the main properties of the image.

    Parameters
    ----------
    bank : Bank
    system : System
        The lens of the bank.
    """
    return [*first_order_facts(system), *_apodisation(system), *_image_facts(bank)]


def ready_facts(bank: Bank) -> list[tuple[str, str]]:
    """Return what a bank without a prescription says of its lens."""
    return [
        ("focal length", f"{bank.efl_mm:.4f} mm"),
        ("largest field", f"{bank.field_deg[-1]:.4g}\N{DEGREE SIGN} from the axis"),
        ("f-number", f"f/{bank.f_number:.4g}"),
        *_image_facts(bank),
        ("fields, wavelengths", f"{len(bank.field_deg)}, {len(bank.wavelengths_nm)}"),
        (
            "PSFs",
            f"{bank.psf.shape[-1]} x {bank.psf.shape[-1]} samples at {bank.pitch_um:.4g} "
            "\N{MICRO SIGN}m",
        ),
    ]


def _image_facts(bank: Bank) -> list[tuple[str, str]]:
    """Return the main properties of the image."""
    edge = f"at {bank.field_deg[-1]:.4g}\N{DEGREE SIGN}"
    reference = bank.reference
    lateral_um = np.ptp(bank.real_height_um[-1])
    return [
        ("working f-number, NA", _working(working_f_number(bank))),
        ("T-stop", f"T/{t_stop(bank):.4g}"),
        ("image circle", f"{2e-3 * bank.image_circle_um:.3f} mm diameter"),
        *(
            (f"distortion, {name}", f"{curve[-1]:+.2f} % {edge}, against the scale on axis")
            for name, curve in distortions(
                bank.field_deg, bank.real_height_um[:, reference]
            ).items()
        ),
        (
            "lateral colour",
            f"{lateral_um:.2f} \N{MICRO SIGN}m {edge}, {bank.wavelengths_nm[0]:g} to "
            f"{bank.wavelengths_nm[-1]:g} nm",
        ),
        ("relative illumination", f"{bank.relative_illumination[-1, reference]:.3f} {edge}"),
        ("transmission", f"{bank.transmission[reference]:.3f} at {bank.reference_nm:g} nm"),
        (
            "light beyond the PSFs' window",
            f"up to {percent(bank.outside_energy)}; past the period {percent(bank.folded_energy)}",
        ),
        (
            "rays that failed",
            "not known" if np.isnan(bank.failed_rays).any() else f"{bank.failed_rays.sum():.0f}",
        ),
    ]


def plane_facts(bank: PlaneBank, system: System | None) -> list[tuple[str, str]]:
    """Return the data of a lens without symmetry: first order where it is known, and the image.

    Parameters
    ----------
    bank : PlaneBank
    system : System, optional
        The lens of the bank.
    """
    micro = "\N{MICRO SIGN}m"
    reference = bank.reference
    row, column = bank.middle
    x_um, y_um = bank.chief_x_um[row, column, reference], bank.chief_y_um[row, column, reference]
    light = bank.relative_illumination[..., reference]
    number = 0.5 / float(np.sqrt(bank.projected_solid_angle_sr[reference] / np.pi))
    order = (
        [
            ("focal length", f"{bank.efl_mm:.4f} mm, centred"),
            ("f-number", f"f/{bank.f_number:.4g}, centred"),
        ]
        if system is None
        else [*first_order_facts(system), *_apodisation(system)]
    )
    return [
        *order,
        ("working f-number, NA", _working(number)),
        ("image of the axis", f"x {x_um:+.2f} {micro}, y {y_um:+.2f} {micro}"),
        (
            "fields",
            f"{bank.field_x_deg[0]:.4g} to {bank.field_x_deg[-1]:.4g}\N{DEGREE SIGN} in x, "
            f"{bank.field_y_deg[0]:.4g} to {bank.field_y_deg[-1]:.4g}\N{DEGREE SIGN} in y",
        ),
        ("relative illumination", f"{light.min():.3f} to {light.max():.3f}"),
        (
            "transmission",
            f"{bank.transmission[reference]:.3f} at {bank.wavelengths_nm[reference]:g} nm",
        ),
        (
            "light beyond the PSFs' window",
            f"up to {percent(bank.outside_energy)}; past the period {percent(bank.folded_energy)}",
        ),
        ("rays that failed", f"{bank.failed_rays.sum():.0f}"),
    ]


def first_order_facts(system: System) -> list[tuple[str, str]]:
    """Return what needs no bank: paraxial data, image plane and field."""
    lens = system.prescription
    order = first_order(lens)
    looks = conjugates(lens)
    entrance = _pupil(order.entrance_pupil_diameter_mm, order.entrance_pupil_z_mm, 1)
    exit_ = _pupil(order.exit_pupil_diameter_mm, order.exit_pupil_z_mm, len(lens.surfaces))
    return [
        ("focal length", f"{order.efl_mm:.4f} mm"),
        ("back focal length", f"{order.bfl_mm:.4f} mm"),
        ("image plane", f"{behind(system):.4f} mm behind the last vertex"),
        *_distances(lens, looks),
        ("length, vertex to vertex", f"{order.length_mm:.4f} mm"),
        ("entrance pupil", entrance),
        ("exit pupil", exit_),
        ("largest field", f"{lens.max_field_deg:.4g}\N{DEGREE SIGN} from the axis"),
        ("f-number", f"f/{order.f_number:.4g}"),
    ]


def _distances(lens: Prescription, looks: Conjugates) -> list[tuple[str, str]]:
    """Return where the object is and what follows from it, unless all is set to infinity."""
    if lens.object_distance_mm is None and lens.focused_mm is None:
        return []
    object_, focus = (
        "infinity" if one is None else f"{1e-3 * one:.4g} m from the first surface"
        for one in (lens.object_distance_mm, lens.focused_mm)
    )
    return [
        ("object", object_),
        ("focused on", focus),
        ("magnification", f"{looks.magnification:.5g}"),
        ("principal distance", f"{looks.principal_distance_mm:.4f} mm"),
        ("paraxial working f-number", f"f/{looks.working_f_number:.4g}"),
    ]


def identity(lens: Prescription) -> list[tuple[str, str]]:
    """Return what the lens is and where it comes from."""
    return [
        ("lens", lens.title),
        ("patent", lens.patent or "none"),
        ("source", lens.source),
        ("changes", "; ".join(lens.history) or "none: as published"),
        ("paraxial data at", f"{lens.reference_nm:g} nm"),
    ]


def ready_identity(lens: ReadyLens) -> list[tuple[str, str]]:
    """Return what a ready-made lens is and where it comes from."""
    return [
        ("lens", lens.title),
        ("source", lens.source),
        ("read from", f"{lens.file}, {lens.kind}"),
    ]


def checks_table(checks: Sequence[Checked]) -> list[tuple[str, str, str, str, str]]:
    """Return quantity, indices, the source's figure, the one found, and the verdict."""
    return [
        (
            one.check.quantity,
            one.check.indices,
            f"{one.check.value:g} \N{PLUS-MINUS SIGN} {one.check.tolerance:g}",
            f"{one.found:.6g}",
            "ok" if one.met else "FAILED",
        )
        for one in checks
    ]


def working_f_number(bank: Bank) -> float:
    """Return 1 / (2 sin theta') of the axial pupil at the reference wavelength."""
    return 0.5 / float(np.sqrt(bank.projected_solid_angle_sr[bank.reference] / np.pi))


def t_stop(bank: Bank) -> float:
    """Return the f-number of a lossless lens that is as bright on axis, at the reference."""
    return working_f_number(bank) / float(np.sqrt(bank.transmission[bank.reference]))


def behind(system: System) -> float:
    """Return how far the image plane lies behind the last vertex, mm."""
    return system.image_z_mm - float(system.geometry.vertex_z[-1])


def distortions(field_deg: np.ndarray, height_um: np.ndarray) -> dict[str, np.ndarray]:
    """Return the distortion of chief rays by each law of projection that says much of the lens.

    Against the image's own scale on axis, as lens designers calibrate it: the distance of the image
    plane changes that scale and bends no line.

    Parameters
    ----------
    field_deg, height_um : ndarray, shape (F,)
        Rising from 0.

    Returns
    -------
    dict of str to ndarray, shape (F,)
        Percent, by the name of the law; 0 on axis.
    """
    theta = np.radians(field_deg[1:])
    laws = {}
    if field_deg[-1] < VERY_WIDE_DEG:
        laws[f"f tan {THETA}"] = np.tan(theta)
    if field_deg[-1] > WIDE_DEG:
        laws[f"f {THETA}"] = theta
    found = {}
    for name, law in laws.items():
        scale = height_um[1:] / law
        # On axis: even in theta, so straight in theta^2 through the first two fields.
        axis = scale[0]
        if len(scale) > 1:
            square = theta**2
            axis -= (scale[1] - scale[0]) * square[0] / (square[1] - square[0])
        found[name] = np.concatenate([[0.0], 100 * (scale / axis - 1)])
    return found


def _apodisation(system: System) -> list[tuple[str, str]]:
    """Return a line on a stop that is apodised."""
    factor = system.prescription.gaussian_apodisation
    text = f"amplitude exp(-{factor:g} \N{GREEK SMALL LETTER RHO}\N{SUPERSCRIPT TWO})"
    return [("apodised stop", f"{text}; NA: of an even one as bright")] if factor else []


def percent(shares: np.ndarray) -> str:
    """Return the largest share in words."""
    return "not known" if np.isnan(shares).any() else f"{100 * shares.max():.2g} %"


def _working(number: float) -> str:
    return f"f/{number:.4g}, NA {0.5 / number:.4g}"


def _pupil(diameter_mm: float, z_mm: float, surface: int) -> str:
    if not np.isfinite(z_mm):
        return "at infinity: telecentric"
    return f"{diameter_mm:.4f} mm wide, {z_mm:+.4f} mm from surface {surface}"
