"""Pictures of PSFs, to one scale."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from scipy import ndimage

from gpusim.psf.bank import Bank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.report.drawing import SOFT, panel, write
from gpusim.report.lens.colours import wavelength_colour
from gpusim.report.lens_page import field_light, field_number, round_above, round_near
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, encode_srgb, rgb_to_xyz
from gpusim.scene.spectra import WAVELENGTHS_NM, colour_matching

# Parts of the largest field, by the bank's fields.
PSF_FIELDS = (0.0, 0.25, 0.5, 0.75, 1.0)


PSF_WAVELENGTHS_NM = (450.0, 550.0, 650.0)


# Decades of the PSFs' logarithmic stretch: down to Airy's third ring, 1.6e-3 of the peak.
DECADES = 3.0


# Share of the light that the pictures of the PSFs hold in the widest of them.
PSF_SHARE = 0.85


def draw_psfs(figure: Figure, bank: Bank, left: float, top: float, cell: float) -> None:
    """Draw PSFs over field (columns) and wavelength (rows), all to one scale."""
    fields = sorted({field_number(bank, part) for part in PSF_FIELDS})
    nearest = {int(np.abs(bank.wavelengths_nm - w).argmin()) for w in PSF_WAVELENGTHS_NM}
    lines = sorted(nearest)
    half_um = _psf_half_um(bank, fields)
    gap = 0.05
    rows = len(lines) + (len(lines) > 1)  # and all of them together
    bottom = top - rows * (cell + gap)
    for column, field in enumerate(fields):
        light = field_light(bank, field)
        shift = bank.real_height_um[field] - bank.real_height_um[field, bank.reference]
        white = np.stack(
            [
                weight * ndimage.shift(psf.astype(float), (0, by / bank.pitch_um), order=1)
                for weight, psf, by in zip(light, bank.psf[field], shift, strict=True)
            ]
        )
        for row in range(rows):
            axes = panel(
                figure,
                left + column * (cell + gap),
                bottom + (rows - 1 - row) * (cell + gap),
                cell,
                cell,
            )
            if row < len(lines):
                psf = bank.psf[field, lines[row]].astype(float)
                share = stretched(psf / psf.max())
                tones = _tones(bank.wavelengths_nm[lines[row]])
                image = tones(share)[..., :3]
            else:
                image = colour_image(white, bank)
            psf_image(axes, image, bank.pitch_um, half_um)
            if row == 0:
                angle = f"{bank.field_deg[field]:.3g}\N{DEGREE SIGN}"
                axes.set_title(angle, loc="center", fontsize=8.5, fontweight="normal", pad=3)
            if column == 0:
                label = f"{bank.wavelengths_nm[0]:g}\N{EN DASH}{bank.wavelengths_nm[-1]:g} nm"
                if row < len(lines):
                    label = f"{bank.wavelengths_nm[lines[row]]:g} nm"
                axes.set_ylabel(label, labelpad=3)
            if (row, column) == (rows - 1, 0):
                psf_bar(axes, half_um)
    up = top + 0.33
    write(figure, left, up, "Point spread", fontsize=9.5, fontweight="bold")
    note = f"log stretch over {DECADES:g} decades, each to its own peak; the radius points up"
    write(figure, left + 1.1, up, note, fontsize=7.5, color=SOFT)


def colour_image(psf: np.ndarray, bank: Bank | PlaneBank) -> np.ndarray:
    """Return a polychromatic PSF in its colours, white where all wavelengths have their share.

    Parameters
    ----------
    psf : ndarray, shape (L, n, n)
        Light of each wavelength.
    bank : Bank or PlaneBank

    Returns
    -------
    ndarray, shape (n, n, 3)
        sRGB; the brightness is stretched, the ratios of the colours are not.
    """
    matching = [
        np.interp(bank.wavelengths_nm, WAVELENGTHS_NM, curve) for curve in colour_matching()
    ]
    to_rgb = np.linalg.solve(rgb_to_xyz(REC709_CHROMATICITIES), matching)
    linear = np.tensordot(to_rgb, psf, 1)
    linear = np.maximum(linear / linear.sum(axis=(1, 2), keepdims=True), 0)
    bright = linear.max(axis=0)
    shown = stretched(bright / bright.max())
    ratio = encode_srgb(linear / np.maximum(bright, 1e-30))
    return np.moveaxis(ratio * shown, 0, -1)


def stretched(share: np.ndarray) -> np.ndarray:
    """Return the logarithmic stretch of light as a share of the peak: 0 to 1 over DECADES."""
    return 1 + np.log10(np.maximum(share, 10**-DECADES)) / DECADES


def _tones(wavelength_nm: float) -> LinearSegmentedColormap:
    """Return a scale from black over the colour of a wavelength to white."""
    colour = np.array(wavelength_colour(wavelength_nm, 0.4))
    return LinearSegmentedColormap.from_list(
        "", [(0.0, "#000000"), (0.6, tuple(0.08 + 0.92 * colour)), (1.0, "#ffffff")]
    )


def _psf_half_um(bank: Bank, fields: list[int]) -> float:
    """Return half the side of the pictures: round, and the widest PSF has PSF_SHARE within.

    The share is that of the light in the window.
    """
    n = bank.psf.shape[-1]
    at = (np.arange(n) - n // 2) * bank.pitch_um
    radius = np.maximum(np.abs(at)[:, None], np.abs(at)[None]).ravel()
    order = np.argsort(radius, kind="stable")
    mean = bank.psf[fields].mean(axis=1, dtype=float).reshape(len(fields), -1)[:, order]
    within = np.cumsum(mean, axis=1)
    needed = max(radius[order][np.searchsorted(line, PSF_SHARE * line[-1])] for line in within)
    return min(round_above(needed), n // 2 * bank.pitch_um)


def psf_image(axes: Axes, image: np.ndarray, pitch_um: float, half_um: float) -> None:
    """Show a picture (eta, xi, 3) with the radius pointing up."""
    half = len(image) / 2 * pitch_um
    extent = np.array([-half, half, -half, half]) - pitch_um / 2
    axes.imshow(
        image.transpose(1, 0, 2),
        extent=extent,
        origin="lower",
        interpolation="bicubic",
        aspect="equal",
    )
    axes.set(xlim=(-half_um, half_um), ylim=(-half_um, half_um), xticks=[], yticks=[])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def psf_bar(axes: Axes, half_um: float) -> None:
    """Draw a scale into a picture of a PSF."""
    length = round_near(0.7 * half_um, (1, 2, 5))
    x, y = -0.88 * half_um, -0.86 * half_um
    axes.plot([x, x + length], [y, y], color="white", linewidth=1.6, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} \N{MICRO SIGN}m",
        (x + length / 2, y),
        (0, 3),
        textcoords="offset points",
        color="white",
        ha="center",
        va="bottom",
        fontsize=7.5,
    )
