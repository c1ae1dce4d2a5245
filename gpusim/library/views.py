"""What one asks of a lens by hand: its PSF, MTF and layout, as values that can draw themselves."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.analysis.fields import WHITE_NM, WHITE_REFERENCE, white_light
from gpusim.lens.analysis.rays import airy_radius_um
from gpusim.lens.prescription import Prescription
from gpusim.lens.samples import sample_field
from gpusim.lens.system import build
from gpusim.lens.wavefront import pupils
from gpusim.psf import otf
from gpusim.psf.psf import intensity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gpusim.lens.system import System

# Half width of a PSF's window in Airy radii: 1 % of a perfect lens's light is beyond it.
WINDOW_AIRY = 16.0
SAMPLES = 160  # across that window: five a radius of the Airy disc


class _Drawn:
    """What draws itself, and is shown so where a notebook shows it."""

    def plot(self) -> Figure:
        """Return a picture of it."""
        raise NotImplementedError

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        self.plot().savefig(picture, format="png", dpi=110)
        return picture.getvalue()


@dataclass(frozen=True, eq=False)
class Psf(_Drawn):
    """A point-spread function.

    Attributes
    ----------
    values : ndarray (n, n)
        Share of the light per sample; rows along the sagittal direction, columns radially outwards;
        the chief ray lands on sample [n / 2, n / 2].
    pitch_um : float
        Distance between samples.
    field_deg, wavelength_nm : float
    outside : float
        Share of the light beyond the window.

    Examples
    --------
    >>> import gpusim as gs
    >>> psf = gs.Lens.load("double-gauss").psf(samples=32)
    >>> psf
    Psf(32 x 32 samples of 1.44 um, field 0 deg, 587.562 nm)
    >>> round(float(psf.values.sum()) + psf.outside, 6)
    1.0
    >>> figure = psf.plot()
    """

    values: np.ndarray
    pitch_um: float
    field_deg: float
    wavelength_nm: float
    outside: float

    def __repr__(self) -> str:
        return (
            f"Psf({len(self.values)} x {len(self.values)} samples of {self.pitch_um:.3g} um, "
            f"field {self.field_deg:.4g} deg, {self.wavelength_nm:g} nm)"
        )

    def plot(self) -> Figure:
        """Return a picture of it, on a scale of four decades."""
        from gpusim.report.views import psf_figure

        return psf_figure(self)


@dataclass(frozen=True, eq=False)
class Mtf(_Drawn):
    """A polychromatic modulation transfer function.

    Attributes
    ----------
    frequency_cy_mm : ndarray (K,)
    tangential, sagittal : ndarray (K,)
    field_deg : float
    limit : ndarray (K,) or None
        That of a perfect lens of the same f-number on the axis.

    Examples
    --------
    >>> import gpusim as gs
    >>> mtf = gs.Lens.load("double-gauss").mtf(frequency_cy_mm=[0.0, 30.0])
    >>> mtf
    Mtf(2 frequencies up to 30 cy/mm, field 0 deg)
    >>> tangential, sagittal = mtf.at(30.0)
    >>> figure = mtf.plot()
    """

    frequency_cy_mm: np.ndarray
    tangential: np.ndarray
    sagittal: np.ndarray
    field_deg: float
    limit: np.ndarray | None = None

    def __repr__(self) -> str:
        highest = max(self.frequency_cy_mm, default=0.0)
        return (
            f"Mtf({len(self.frequency_cy_mm)} frequencies up to {highest:.4g} cy/mm, "
            f"field {self.field_deg:.4g} deg)"
        )

    def at(self, frequency_cy_mm: float) -> tuple[float, float]:
        """Return tangential and sagittal contrast at a frequency."""
        tangential, sagittal = (
            float(np.interp(frequency_cy_mm, self.frequency_cy_mm, one))
            for one in (self.tangential, self.sagittal)
        )
        return tangential, sagittal

    def plot(self) -> Figure:
        """Return a picture of both curves."""
        from gpusim.report.views import mtf_figure

        return mtf_figure(self)


@dataclass(frozen=True, eq=False)
class Layout(_Drawn):
    """A section through a lens with its rays.

    Attributes
    ----------
    system : System
    title : str

    Examples
    --------
    >>> import gpusim as gs
    >>> figure = gs.Lens.load("double-gauss").layout().plot()
    """

    system: System
    title: str

    def __repr__(self) -> str:
        return f"Layout({self.title!r})"

    def plot(self) -> Figure:
        """Return a drawing to scale."""
        from gpusim.report.views import layout_figure

        return layout_figure(self)


class Views(Prescription):
    """A lens that can be traced, with its PSF, MTF and layout; a notebook shows the last."""

    def _repr_png_(self) -> bytes:
        return self.layout()._repr_png_()

    def psf(
        self,
        field: float = 0.0,
        wavelength_nm: float | None = None,
        *,
        window_um: float | None = None,
        samples: int = SAMPLES,
    ) -> Psf:
        """Return the PSF of a point, traced for it.

        Parameters
        ----------
        field : float
            Share of the lens's largest field angle, -1 to 1.
        wavelength_nm : float, optional
            By default the lens's reference wavelength.
        window_um : float, optional
            Width of the window; by default 32 Airy radii.
        samples : int
            Across the window, even.

        Raises
        ------
        UserError
            A field that does not pass the lens, a wavelength that its glasses have no data for, or
            a window without a width.

        Examples
        --------
        >>> from gpusim import Lens
        >>> round(Lens.load("double-gauss").psf(field=0.5, wavelength_nm=550).field_deg, 2)
        11.0
        """
        if samples < 2 or samples % 2:
            raise UserError("no such window", field="samples", value=samples, allowed="even")
        if window_um is not None and not 0 < window_um < math.inf:
            raise UserError(
                "no such window", field="window_um", value=window_um, allowed="um, above 0"
            )
        system = build(self)
        line = np.array([self.reference_nm if wavelength_nm is None else float(wavelength_nm)])
        theta = self._theta(field)
        if window_um is None:
            window_um = 2 * WINDOW_AIRY * airy_radius_um(system, float(line[0]))
        traced = sample_field(system, system.index(line), theta, 0.0)
        (pupil,) = pupils(traced, line, window_um, otf.PUPIL_NODES)
        pitch_um = window_um / samples
        values, outside = intensity(pupil, float(line[0]), samples, pitch_um)
        return Psf(values, pitch_um, math.degrees(theta), float(line[0]), outside)

    def mtf(self, field: float = 0.0, frequency_cy_mm: np.ndarray | None = None) -> Mtf:
        """Return the polychromatic MTF of a point in light of equal energy, 400 to 700 nm.

        Parameters
        ----------
        field : float
            Share of the lens's largest field angle, -1 to 1.
        frequency_cy_mm : ndarray (K,), optional
            By default 101 of them, to where the axis keeps a tenth of the contrast.

        Raises
        ------
        UserError
            A field that does not pass the lens, or frequencies that are none.

        Examples
        --------
        >>> from gpusim import Lens
        >>> Lens.load("double-gauss").mtf(field=0.7).at(30.0)[0] < 1
        True
        """
        system = build(self)
        theta = self._theta(field)
        light = white_light(system)
        traced = otf.field_pupils(system, theta, WHITE_NM, light, reference=WHITE_REFERENCE)
        number = airy_radius_um(system, self.reference_nm) / (1.22e-3 * self.reference_nm)
        if frequency_cy_mm is None:
            cut_off = 1e6 / (WHITE_NM[0] * number)
            tried = np.geomspace(cut_off / 500, cut_off, 120)
            lost = np.flatnonzero(np.abs(traced.otf(tried, "tangential")) < 0.1)
            frequency_cy_mm = np.linspace(0, tried[lost[0]] if lost.size else cut_off, 101)
        frequency = np.asarray(frequency_cy_mm, float)
        if frequency.ndim != 1 or not (frequency >= 0).all():
            raise UserError(
                "no such frequencies",
                field="frequency_cy_mm",
                allowed="an array (K,) of cycles per mm, none negative",
            )
        tangential, sagittal = (np.abs(traced.otf(frequency, way)) for way in otf.DIRECTIONS)
        perfect = np.array([otf.diffraction_mtf(frequency, one, number) for one in WHITE_NM])
        limit = traced.weight @ perfect / traced.weight.sum()
        return Mtf(frequency, tangential, sagittal, math.degrees(theta), limit)

    def layout(self) -> Layout:
        """Return the section through the lens with the rays of its fields.

        Examples
        --------
        >>> from gpusim import Lens
        >>> figure = Lens.load("double-gauss").layout().plot()
        """
        return Layout(build(self), self.title)

    def _theta(self, field: float) -> float:
        """Return the angle of a relative field, rad."""
        if not -1 <= field <= 1:
            raise UserError(
                "the field lies beyond the lens",
                field="field",
                value=field,
                allowed="-1 to 1: shares of the largest field angle",
            )
        return math.radians(field * self.max_field_deg)
