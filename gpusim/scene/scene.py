"""A scene: materials or coefficient planes with their absolute spectral radiance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gpusim.config.names import perhaps
from gpusim.errors import UserError
from gpusim.lens.projection import PROJECTIONS, RECTILINEAR, Projection
from gpusim.scene.chart import Chart
from gpusim.scene.charts import CHARTS
from gpusim.scene.raster import Raster
from gpusim.scene.spectra import luminance_cd_m2 as luminance
from gpusim.scene.spectra import rgb_reflectances, white_radiance

# A reading-lit chart: 300 cd/m^2 is a white diffuser under pi * 300 = 940 lux.
DEFAULT_WHITE_LUMINANCE_CD_M2 = 300.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Spectral radiance L(u, lambda) = sum over j of a_j(u) b_j(lambda) on the ideal image plane.

    Attributes
    ----------
    name : str
        Chart name or file name.
    spectra : ndarray (M, 61)
        b_j, W m^-2 sr^-1 nm^-1 per unit coefficient: of a chart, each material's radiance (its
        coefficient is 1 where it lies, else 0); of a raster, each plane's basis.
    source : Chart or Raster
        Where the materials lie, or the coefficients a_j.
    illuminant : str
        CIE name of the light.
    white : ndarray (61,)
        Spectral radiance of the scene's white: a perfect diffuser, or a photograph's RGB (1, 1, 1).
    notes : tuple of str
        What a reader of the result should know of how the scene was made.
    projection : Projection
        How it lies on the ideal image plane.
    """

    name: str
    spectra: np.ndarray
    source: Chart | Raster
    illuminant: str
    white: np.ndarray
    notes: tuple[str, ...] = ()
    projection: Projection = RECTILINEAR

    @property
    def white_luminance_cd_m2(self) -> float:
        """Luminance of the scene's white, cd/m^2."""
        return float(luminance(self.white))


def make_scene(
    name_or_path: str | Path,
    luminance_cd_m2: float | None = None,
    illuminant: str = "D50",
    projection: str = RECTILINEAR.name,
) -> Scene:
    """Return a chart of the project or a photograph from an EXR file.

    Parameters
    ----------
    name_or_path : str or path
        A name in `CHARTS`, or the path of a linear RGB EXR.
    luminance_cd_m2 : float, optional
        Luminance of the white: of a chart's perfect diffuser; of a photograph's RGB (1, 1, 1),
        where it replaces the file's own ``whiteLuminance``. Without either, 300.
    illuminant : str
        CIE name of the light on a chart. A photograph's spectra are those of Mallett and Yuksel
        (2019), under D65.
    projection : str
        How it lies on the ideal image plane: "rectilinear", or "angular" for lenses that see far
        to the sides.

    Raises
    ------
    UserError
        For an unknown name, illuminant or projection, a luminance that is not positive, or an
        unusable file.
    """
    if luminance_cd_m2 is not None and not 0 < luminance_cd_m2 < np.inf:
        raise UserError(
            "impossible luminance",
            field="luminance_cd_m2",
            value=luminance_cd_m2,
            allowed="above 0",
        )
    if projection not in PROJECTIONS:
        raise UserError(
            "there is no such projection",
            field="projection",
            value=projection,
            allowed=", ".join(PROJECTIONS),
        )
    name, plane = str(name_or_path), PROJECTIONS[projection]
    if name in CHARTS:
        chart, reflectances = CHARTS[name]()
        white = white_radiance(illuminant, luminance_cd_m2 or DEFAULT_WHITE_LUMINANCE_CD_M2)
        return Scene(name, reflectances * white, chart, illuminant, white, projection=plane)
    path = Path(name_or_path)
    if path.suffix.lower() == ".exr":
        return replace(_photograph(path, luminance_cd_m2), projection=plane)
    raise UserError(
        f"unknown scene{perhaps(name, CHARTS)}",
        field="scene",
        value=name,
        allowed=f"{', '.join(CHARTS)}, or a file NAME.exr",
    )


def _photograph(path: Path, luminance_cd_m2: float | None) -> Scene:
    from gpusim.scene.exr import read_exr

    photograph = read_exr(path, needs_luminance=luminance_cd_m2 is None)
    known = luminance_cd_m2 or photograph.white_luminance_cd_m2
    scale = known or DEFAULT_WHITE_LUMINANCE_CD_M2
    notes = photograph.notes
    if not known:
        notes += (f"the file gives no whiteLuminance: RGB (1, 1, 1) taken as {scale:g} cd/m^2",)
    spectra = rgb_reflectances() * white_radiance("D65", scale)
    white = np.asarray(photograph.white_rgb) @ spectra
    return Scene(path.name, spectra, Raster(photograph.rgb), "D65", white, notes)
