"""A scene: materials or coefficient planes with their absolute spectral radiance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gpusim.config.names import perhaps
from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.lens.projection import ANGULAR, PROJECTIONS, RECTILINEAR, Projection
from gpusim.scene.chart import Chart
from gpusim.scene.charts import CHARTS, is_chart, load_chart
from gpusim.scene.fills import Fill
from gpusim.scene.panorama import PANORAMA, by_angle
from gpusim.scene.patterns import Frame
from gpusim.scene.raster import Raster
from gpusim.scene.spectra import (
    WAVELENGTHS_NM,
    illuminant_known,
    rgb_known,
    rgb_reflectances,
    white_radiance,
)
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
        Of spectra and white, as `gpusim.scene.spectra.grid_nm` returns them: 400 to 700 nm in steps
        of 5, and farther where that is asked for (`on`).
    light : callable, optional
        Spectra and white at any wavelengths, of a scene that is known beyond its grid.
    made_of : tuple of Known
        How far what the light is made of is known.
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

    @classmethod
    def load(cls, name_or_path: str | Path, **options: object) -> Scene:
        """Return a chart by its name, or a photograph from a file: see `make_scene`.

        Examples
        --------
        >>> Scene.load("colorchecker", illuminant="D65")
        Scene('colorchecker', chart, D65, white 300 cd/m^2)
        """
        return make_scene(name_or_path, **options)

    @staticmethod
    def from_rgb(
        rgb: np.ndarray,
        white_cd_m2: float = DEFAULT_WHITE_LUMINANCE_CD_M2,
        name: str = "RGB array",
    ) -> Scene:
        """Return a photograph that is an array, laid over the whole sensor.

        Parameters
        ----------
        rgb : ndarray (rows, cols, 3)
            Linear R, G, B with the primaries of Rec. 709, none negative.
        white_cd_m2 : float
            Luminance of RGB (1, 1, 1), cd/m^2. Spectra are those of Mallett and Yuksel (2019),
            under D65.
        name : str

        Raises
        ------
        UserError
            Another shape, a value that is no light, or a luminance that is not positive.

        Examples
        --------
        >>> import numpy as np
        >>> Scene.from_rgb(np.full((40, 60, 3), 0.18), white_cd_m2=500).illuminant
        'D65'
        """
        from gpusim.scene.arrays import rgb_scene

        return rgb_scene(rgb, white_cd_m2, name)

    @staticmethod
    def from_spectra(
        radiance: np.ndarray, wavelengths_nm: np.ndarray, name: str = "spectral array"
    ) -> Scene:
        """Return a scene of spectral radiance, laid over the whole sensor.

        Parameters
        ----------
        radiance : ndarray (rows, cols, bands)
            W m^-2 sr^-1 nm^-1, none negative; linear in wavelength between bands, and none beyond.
            White, for exposure and white balance, is the mean of the brightest hundredth.
        wavelengths_nm : ndarray (bands,)
            Rising.
        name : str

        Raises
        ------
        UserError
            Another shape, wavelengths that do not rise or are not seen, or a value that is no
            light.
        """
        from gpusim.scene.arrays import spectral_scene

        return spectral_scene(radiance, wavelengths_nm, name)

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

    def before(self, efl_mm: float) -> Scene:
        """Return the scene before a lens: what is laid by angle gets its size on the image plane.

        Parameters
        ----------
        efl_mm : float
            Focal length.
        """
        source = self.source
        if isinstance(source, Chart) or source.half_efl is None:
            return self
        half_um = tuple(1e3 * efl_mm * half for half in source.half_efl)
        return replace(self, source=replace(source, half_um=half_um, half_efl=None))

    @property
    def white_luminance_cd_m2(self) -> float:
        """Luminance of the scene's white, cd/m^2."""
        return float(luminance(self.white, self.wavelengths_nm))


def make_scene(
    name_or_path: str | Path,
    luminance_cd_m2: float | None = None,
    illuminant: str | None = None,
    projection: str = RECTILINEAR.name,
    frame: Frame | None = None,
) -> Scene:
    """Return a chart of the project, one of a YAML file, or a photograph from an EXR file.

    Parameters
    ----------
    name_or_path : str or path
        A name in `CHARTS`, the path of a chart's YAML, or of a linear RGB EXR.
    luminance_cd_m2 : float, optional
        Luminance of the white: of a chart's perfect diffuser; of a photograph's RGB (1, 1, 1),
        where it replaces the file's own ``whiteLuminance``. Without either, 300.
    illuminant : str, optional
        Light on a chart, D50 by default: a CIE name, or a blackbody's temperature ("5100K"). A
        photograph has its own light in it: its spectra are those of Mallett and Yuksel (2019),
        under D65.
    projection : str
        How it lies on the ideal image plane: "rectilinear", or "angular" for lenses that see far
        to the sides; "equirectangular" for a photograph that is a panorama of 360 x 180 degrees,
        in whose middle the camera stands and at whose centre it looks.
    frame : Frame, optional
        The sensor: for charts that count in its pixels, or are drawn on samples.

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
    panorama = projection == PANORAMA
    if projection not in PROJECTIONS and not panorama:
        raise UserError(
            "there is no such projection",
            field="projection",
            value=projection,
            allowed=f"{', '.join(PROJECTIONS)}; {PANORAMA} for photographs of 360 x 180 degrees",
        )
    name, plane = str(name_or_path), ANGULAR if panorama else PROJECTIONS[projection]
    if is_chart(name):
        if panorama:
            raise UserError(
                "a chart is no panorama",
                field="projection",
                value=projection,
                allowed=f"{', '.join(PROJECTIONS)} for charts",
            )
        level = luminance_cd_m2 or DEFAULT_WHITE_LUMINANCE_CD_M2
        scene = _chart(name, level, illuminant or DEFAULT_ILLUMINANT, frame)
        return replace(scene, projection=plane)
    path = Path(name_or_path)
    if path.suffix.lower() == ".exr":
        if illuminant is not None:
            raise UserError(
                "a photograph has its own light in it",
                file=path,
                field="illuminant",
                value=illuminant,
                allowed="none with a photograph; with a chart any",
            )
        scene = replace(_photograph(path, luminance_cd_m2), projection=plane)
        if panorama:
            whole = Raster(by_angle(scene.source.planes), half_efl=(np.pi, np.pi))
            scene = replace(scene, source=whole)
        return scene
    raise UserError(
        f"unknown scene{perhaps(name, CHARTS)}",
        field="scene",
        value=name,
        allowed=f"{', '.join(CHARTS)}; a chart's NAME.yaml; or a picture's NAME.exr",
    )


def _chart(name: str, level: float, lamp: str, frame: Frame | None) -> Scene:
    laid = load_chart(name, frame)
    source, fills = laid.source, laid.fills
    if isinstance(source, Raster) and all(fill.grey for fill in fills):
        # One spectrum, in one plane, in which points of light stand out from what is around them.
        shares = laid.reflectances(WAVELENGTHS_NM[:1], level)[:, 0]
        plane = sum(share * one for share, one in zip(shares, source.planes, strict=True))
        source, fills = replace(source, planes=plane[None]), (Fill("white", 1.0),)

    def light(wavelengths_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        white = white_radiance(lamp, level, wavelengths_nm)
        return np.stack([fill.reflectance(wavelengths_nm, level) for fill in fills]) * white, white

    spectra, white = light(WAVELENGTHS_NM)
    known = dict.fromkeys((illuminant_known(lamp), *(fill.known for fill in fills)))
    made_of = tuple(one for one in known if one is not None)
    given = {"notes": laid.notes, "light": light, "made_of": made_of}
    return Scene(Path(name).name, spectra, source, lamp, white, **given)


def _photograph(path: Path, luminance_cd_m2: float | None) -> Scene:
    from gpusim.scene.exr import read_exr

    photograph = read_exr(path, needs_luminance=luminance_cd_m2 is None)
    known = luminance_cd_m2 or photograph.white_luminance_cd_m2
    scale = known or DEFAULT_WHITE_LUMINANCE_CD_M2
    notes = photograph.notes
    if not known:
        notes += (f"the file gives no whiteLuminance: RGB (1, 1, 1) taken as {scale:g} cd/m^2",)
    return lit_rgb(path.name, photograph.rgb, np.asarray(photograph.white_rgb), scale, notes)


def lit_rgb(
    name: str, planes: np.ndarray, white_rgb: np.ndarray, scale_cd_m2: float, notes: tuple[str, ...]
) -> Scene:
    """Return a photograph: spectra of Mallett and Yuksel (2019), under D65.

    Parameters
    ----------
    name : str
    planes : ndarray (3, rows, cols), float32
        Linear R, G, B of Rec. 709.
    white_rgb : ndarray (3,)
        What is white in it.
    scale_cd_m2 : float
        Luminance of RGB (1, 1, 1).
    notes : tuple of str
    """

    def light(wavelengths_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        daylight = white_radiance("D65", scale_cd_m2, wavelengths_nm)
        spectra = rgb_reflectances(wavelengths_nm) * daylight
        return spectra, white_rgb @ spectra

    spectra, white = light(WAVELENGTHS_NM)
    given = {"light": light, "made_of": (rgb_known(), illuminant_known("D65"))}
    return Scene(name, spectra, Raster(planes), "D65", white, notes, **given)
