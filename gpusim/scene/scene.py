"""A scene: materials or coefficient planes with their absolute spectral radiance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gpusim.known import Known
from gpusim.lens.projection import RECTILINEAR, Projection
from gpusim.scene.chart import Chart
from gpusim.scene.raster import Raster
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.scene.spectra import luminance_cd_m2 as luminance

# A reading-lit chart: 300 cd/m^2 is a white diffuser under pi * 300 = 940 lux.
DEFAULT_WHITE_LUMINANCE_CD_M2 = 300.0
DEFAULT_ILLUMINANT = "D50"

# Spectra (M, K) of a scene and its white (K,) at wavelengths (K,), beyond what is known as at its
# ends.
Light = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Scene:
    """Spectral radiance L(u, lambda) = sum over j of a_j(u) b_j(lambda) on the ideal image plane.

    Attributes
    ----------
    name : str
        Chart name or file name.
    spectra : ndarray (M, K)
        b_j, W m^-2 sr^-1 nm^-1 per unit coefficient: of a chart, each material's radiance (its
        coefficient is 1 where it lies, else 0); of a raster, each plane's basis.
    source : Chart or Raster
        Where the materials lie, or the coefficients a_j.
    illuminant : str
        CIE name of the light.
    white : ndarray (K,)
        Spectral radiance of the scene's white: a perfect diffuser, or a photograph's RGB (1, 1, 1).
    notes : tuple of str
        What a reader of the result should know of how the scene was made.
    projection : Projection
        How it lies on the ideal image plane.
    wavelengths_nm : ndarray (K,)
        Wavelengths of spectra and white, as `gpusim.scene.spectra.grid_nm` returns them: 400 to 700
        nm in steps of 5, and farther where that is asked for (`on`).
    light : callable, optional
        Spectra and white at any wavelengths, of a scene that is known beyond its grid.
    made_of : tuple of Known
        How far what the light is made of is known.
    made_from : mapping, optional
        Name or file and options by which `gpusim.scene.make.made_again` makes it; None of others.
    illumination : str
        What uneven light is in the source's coefficients, in words; empty where there is none.
    """

    name: str
    spectra: np.ndarray
    source: Chart | Raster
    illuminant: str
    white: np.ndarray
    notes: tuple[str, ...] = ()
    projection: Projection = RECTILINEAR
    wavelengths_nm: np.ndarray = field(default_factory=lambda: WAVELENGTHS_NM)
    light: Light | None = None
    made_of: tuple[Known, ...] = ()
    illumination: str = ""
    made_from: Mapping[str, object] | None = None

    def __repr__(self) -> str:
        kind = "chart" if isinstance(self.source, Chart) else "picture"
        return (
            f"Scene({self.name!r}, {kind}, {self.illuminant}, "
            f"white {self.white_luminance_cd_m2:.4g} cd/m^2)"
        )

    @property
    def known(self) -> tuple[Known, ...]:
        """Over which wavelengths the scene's light is known; of spectra of one's own, theirs."""
        if self._goes_on:
            return self.made_of
        return (Known("the scene's spectra", *self.wavelengths_nm[[0, -1]].tolist()),)

    @property
    def _goes_on(self) -> bool:
        """Whether the light is that which the scene was made with: nobody changed the spectra."""
        if self.light is None:
            return False
        ours = zip(self.light(self.wavelengths_nm), (self.spectra, self.white), strict=True)
        return all(np.array_equal(one, other) for one, other in ours)

    def on(self, wavelengths_nm: np.ndarray) -> Scene:
        """Return the scene at other wavelengths, beyond what is known of it as at its ends."""
        if np.array_equal(wavelengths_nm, self.wavelengths_nm):
            return self
        if self._goes_on:
            spectra, white = self.light(wavelengths_nm)
        else:
            own = np.vstack([self.spectra, self.white])
            *rows, white = (np.interp(wavelengths_nm, self.wavelengths_nm, row) for row in own)
            spectra = np.stack(rows)
        return replace(self, spectra=spectra, white=white, wavelengths_nm=wavelengths_nm)

    def before(self, principal_mm: float) -> Scene:
        """Return the scene before a lens: what is laid by angle gets its size on the image plane.

        Parameters
        ----------
        principal_mm : float
            Principal distance: the focal length of a lens that looks to infinity.
        """
        source = self.source
        if isinstance(source, Chart) or source.half_efl is None:
            return self
        half_um = tuple(1e3 * principal_mm * half for half in source.half_efl)
        return replace(self, source=replace(source, half_um=half_um, half_efl=None))

    @property
    def white_luminance_cd_m2(self) -> float:
        """Luminance of the scene's white, cd/m^2."""
        return float(luminance(self.white, self.wavelengths_nm))
