"""``gpusim lens``."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from gpusim.cli.files import whole_file
from gpusim.cli.screen import progress_bar, texts
from gpusim.lens.bank import Bank, cached_bank
from gpusim.lens.prescription import Prescription, load_prescription
from gpusim.lens.system import first_order


def run(name: str, focal_length_mm: float | None, f_number: float | None, out: Path | None) -> None:
    """Show the data of a lens; write its bank or its figures where `out` asks for them."""
    lens = load_prescription(name)
    if focal_length_mm is not None:
        lens = lens.scaled(focal_length_mm)
    if f_number is not None:
        lens = lens.stopped(f_number)
    with ExitStack() as stack:
        file = None if out is None else stack.enter_context(whole_file(out, (".nc", ".png")))
        with progress_bar() as progress:
            bank = cached_bank(lens, progress=lambda done, all_: progress("PSF bank", done, all_))
        if file is not None and file.suffix.lower() == ".nc":
            bank.save(file)
        elif file is not None:
            from gpusim.cli.lens_figure import save

            save(bank, file)
    Console().print(texts(data(lens, bank)))
    if out is not None:
        print(out)


def data(lens: Prescription, bank: Bank) -> list[tuple[str, str]]:
    """Return what there is to know of a lens at first glance, as names and texts."""
    order = first_order(lens)
    reference = bank.reference
    lateral_um = bank.real_height_um[-1].max() - bank.real_height_um[-1].min()
    return [
        ("lens", lens.title),
        ("patent", lens.patent or "none"),
        ("source", lens.source),
        ("changes", "; ".join(lens.history) or "none: as published"),
        ("wavelength", f"{order.wavelength_nm:g} nm, for the paraxial data"),
        ("focal length", f"{order.efl_mm:.4f} mm"),
        ("f-number", f"{order.f_number:.4g}"),
        ("back focal length", f"{order.bfl_mm:.4f} mm"),
        ("length, first to last vertex", f"{order.length_mm:.4f} mm"),
        (
            "entrance pupil",
            _pupil(order.entrance_pupil_diameter_mm, order.entrance_pupil_z_mm, "first"),
        ),
        ("exit pupil", _pupil(order.exit_pupil_diameter_mm, order.exit_pupil_z_mm, "last")),
        ("largest field", f"{bank.field_deg[-1]:g} deg"),
        ("image circle", f"{2e-3 * bank.image_circle_um:.3f} mm diameter"),
        ("transmission", f"{bank.transmission[reference]:.3f} at {bank.reference_nm:g} nm"),
        ("relative illumination", f"{bank.relative_illumination[-1, reference]:.3f} at the edge"),
        ("distortion", f"{bank.distortion[-1]:+.2%} at the edge"),
        (
            "lateral colour",
            f"{lateral_um:.2f} um at the edge, {bank.wavelengths_nm[0]:g} to "
            f"{bank.wavelengths_nm[-1]:g} nm",
        ),
    ]


def _pupil(diameter_mm: float, z_mm: float, vertex: str) -> str:
    return f"{diameter_mm:.4f} mm wide, {z_mm:+.4f} mm from the {vertex} vertex"
