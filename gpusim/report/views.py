"""Figures of single values: a PSF, an MTF, a lens's section."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from gpusim.report.drawing import INK, SOFT
from gpusim.report.lens.colours import PALETTE

if TYPE_CHECKING:
    from gpusim.library.views import Layout, Mtf, Psf

DECADES = 4


def psf_figure(psf: Psf) -> Figure:
    """Draw a PSF on a logarithmic scale, tangential direction across."""
    figure = Figure(figsize=(4.4, 3.8), layout="constrained")
    axes = figure.subplots()
    half = psf.values.shape[0] / 2 * psf.pitch_um
    shown = np.log10(np.maximum(psf.values / psf.values.max(), 10.0**-DECADES))
    image = axes.imshow(
        shown, extent=(-half, half, half, -half), cmap="magma", vmin=-DECADES, vmax=0
    )
    figure.colorbar(image, ax=axes, label="log10 of the irradiance over its peak")
    axes.set(
        title=f"PSF at {psf.field_deg:.3g} deg, {psf.wavelength_nm:.4g} nm",
        xlabel="radially outwards [um]",
        ylabel="sagittally [um]",
    )
    return figure


def mtf_figure(mtf: Mtf) -> Figure:
    """Draw an MTF with the diffraction limit."""
    figure = Figure(figsize=(5.2, 3.4), layout="constrained")
    axes = figure.subplots()
    if mtf.limit is not None:
        axes.plot(mtf.frequency_cy_mm, mtf.limit, color=SOFT, label="diffraction limit")
    axes.plot(mtf.frequency_cy_mm, mtf.tangential, color=PALETTE[0], label="tangential")
    axes.plot(mtf.frequency_cy_mm, mtf.sagittal, color=PALETTE[0], dashes=(4, 2), label="sagittal")
    axes.set(
        title=f"MTF at {mtf.field_deg:.3g} deg",
        xlabel="spatial frequency [cycles/mm]",
        ylabel="MTF",
        xlim=(0, mtf.frequency_cy_mm[-1]),
        ylim=(0, 1.02),
    )
    axes.legend(frameon=False, labelcolor=INK)
    return figure


def layout_figure(layout: Layout) -> Figure:
    """Draw a section through a lens, to scale."""
    from gpusim.report.lens.geometry import draw_section
    from gpusim.report.lens.study import Study

    return draw_section([Study(layout.title, layout.system)])
