"""One page on a lens: PSFs over the field, MTF, distortion, illumination, lateral colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gpusim.lens.bank import Bank

# Parts of the largest field shown, by image height.
FIELDS = (0.0, 0.5, 0.75, 1.0)
# Half of the side of a PSF's picture: 24 times the Airy radius of an f/2.8 lens's blue, 1.1 um.
PSF_HALF_UM = 24.0
# Cycles/mm up to which the MTF is drawn: the Nyquist frequency of 1.25 um pixels.
MTF_TOP_CY_MM = 400.0


def save(bank: Bank, file: Path) -> None:
    """Write the page as PNG."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    figure.suptitle(
        f"{bank.provenance['title']}: f = {bank.efl_mm:.3g} mm, f/{bank.f_number:.3g}", fontsize=14
    )
    axes = figure.subplot_mosaic(
        [
            ["psf0", "psf1", "psf2", "psf3"],
            ["mtf", "mtf", "light", "light"],
            ["distortion", "distortion", "colour", "colour"],
        ],
        height_ratios=(1.15, 1, 1),
    )
    chosen = [round(part * (len(bank.field_deg) - 1)) for part in FIELDS]
    for number, field in enumerate(chosen):
        draw_psf(axes[f"psf{number}"], bank, field)
    draw_mtf(axes["mtf"], bank, chosen)
    height_mm = 1e-3 * bank.real_height_um[:, bank.reference]
    draw_light(axes["light"], bank, height_mm)
    # On the axis it is 0 by definition and says nothing of the focal length's own scale.
    axes["distortion"].plot(height_mm[1:], 100 * bank.distortion[1:])
    axes["distortion"].set(title="Distortion", ylabel="%")
    draw_colour(axes["colour"], bank, height_mm)
    for name in ("light", "distortion", "colour"):
        axes[name].set_xlabel("image height [mm]")
    for name in ("mtf", "light", "distortion", "colour"):
        axes[name].grid(alpha=0.3)
    figure.savefig(file, dpi=110, format="png")


def white_psf(bank: Bank, field: int) -> np.ndarray:
    """Return the PSF of a field over all wavelengths, each weighted by its light; shape (n, n)."""
    weight = bank.transmission * bank.relative_illumination[field]
    return np.tensordot(weight / weight.sum(), bank.psf[field].astype(float), 1)


def draw_psf(axes: Axes, bank: Bank, field: int) -> None:
    """Draw a PSF on a logarithmic scale; the radial direction points to the right."""
    psf = white_psf(bank, field)
    half_um = len(psf) / 2 * bank.pitch_um
    extent = np.array([-half_um, half_um, half_um, -half_um]) - bank.pitch_um / 2
    # Four decades, as much as the eye tells apart.
    log = np.log10(np.maximum(psf / psf.max(), 1e-4))
    axes.imshow(log, cmap="magma", vmin=-4, vmax=0, extent=extent)
    axes.set(
        title=f"PSF at {bank.field_deg[field]:.3g} deg",
        xlim=(-PSF_HALF_UM, PSF_HALF_UM),
        ylim=(PSF_HALF_UM, -PSF_HALF_UM),
        xlabel="radial [um]",
    )


def draw_mtf(axes: Axes, bank: Bank, fields: list[int]) -> None:
    """Draw the MTF over all wavelengths: radial solid, tangential dashed."""
    for colour, field in enumerate(fields):
        psf = white_psf(bank, field)
        frequency = 1e3 * np.fft.rfftfreq(len(psf), bank.pitch_um)
        for axis, style in ((0, "-"), (1, "--")):
            mtf = np.abs(np.fft.rfft(psf.sum(axis=axis)))
            label = f"{bank.field_deg[field]:.3g} deg" if style == "-" else None
            axes.plot(frequency, mtf, style, color=f"C{colour}", label=label)
    axes.set(
        title="MTF, radial (solid) and tangential (dashed)",
        xlabel="cycles/mm",
        xlim=(0, MTF_TOP_CY_MM),
        ylim=(0, 1),
    )
    axes.legend()


def draw_light(axes: Axes, bank: Bank, height_mm: np.ndarray) -> None:
    """Draw the relative illumination beside the cos^4 law."""
    axes.plot(height_mm, bank.relative_illumination[:, bank.reference], label="traced")
    axes.plot(height_mm, np.cos(np.radians(bank.field_deg)) ** 4, "--", color="0.5", label="cos^4")
    axes.set(title=f"Relative illumination at {bank.reference_nm:g} nm", ylim=(0, None))
    axes.legend()


def draw_colour(axes: Axes, bank: Bank, height_mm: np.ndarray) -> None:
    """Draw where each wavelength's chief ray lands beside that of the reference."""
    shift_um = bank.real_height_um - bank.real_height_um[:, [bank.reference]]
    for wavelength, colour in ((450, "tab:blue"), (600, "tab:orange"), (650, "tab:red")):
        nearest = int(np.abs(bank.wavelengths_nm - wavelength).argmin())
        label = f"{bank.wavelengths_nm[nearest]:g} nm"
        axes.plot(height_mm, shift_um[:, nearest], color=colour, label=label)
    axes.set(title=f"Lateral colour, against {bank.reference_nm:g} nm", ylabel="um")
    axes.legend()
