"""Scenes that one makes by hand: charts, pictures in files, arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from PIL import Image

from gpusim.library.notebook import facts, figure, picture
from gpusim.scene import scene
from gpusim.scene.arrays import rgb_scene, spectral_scene
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.make import make_scene
from gpusim.scene.preview import seen_rgb
from gpusim.scene.scene import DEFAULT_WHITE_LUMINANCE_CD_M2

if TYPE_CHECKING:
    from pathlib import Path

SHOWN_ROWS = 180  # of a scene's picture in a notebook


@dataclass(frozen=True, eq=False, repr=False)
class Scene(scene.Scene):
    """A scene: what stands before the camera, as spectral radiance in W m^-2 sr^-1 nm^-1.

    Made by `Scene.load`, `Scene.from_rgb` or `Scene.from_spectra`.

    Examples
    --------
    >>> from gpusim import Scene
    >>> Scene.load("siemens-star").white_luminance_cd_m2
    300.0
    """

    @classmethod
    def load(cls, name_or_path: str | Path, **options: Any) -> Self:
        """Return a chart by its name, or a chart or picture from a file.

        Parameters
        ----------
        name_or_path : str or path
            ``gpusim chart`` lists the charts.
        **options
            As of `gpusim.scene.make.make_scene`: ``illuminant``, ``luminance_cd_m2`` ...

        Raises
        ------
        UserError
            No such chart or file, or an option that it has not.

        Examples
        --------
        >>> from gpusim import Scene
        >>> Scene.load("colorchecker", illuminant="D65")
        Scene('colorchecker', chart, D65, white 300 cd/m^2)
        """
        return cls.of(make_scene(name_or_path, **options))

    @classmethod
    def from_rgb(
        cls,
        rgb: np.ndarray,
        white_cd_m2: float = DEFAULT_WHITE_LUMINANCE_CD_M2,
        name: str = "RGB array",
    ) -> Self:
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
        >>> from gpusim import Scene
        >>> Scene.from_rgb(np.full((40, 60, 3), 0.18), white_cd_m2=500).illuminant
        'D65'
        """
        return cls.of(rgb_scene(rgb, white_cd_m2, name))

    @classmethod
    def from_spectra(
        cls, radiance: np.ndarray, wavelengths_nm: np.ndarray, name: str = "spectral array"
    ) -> Self:
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

        Examples
        --------
        >>> import numpy as np
        >>> from gpusim import Scene
        >>> cube = np.full((40, 60, 3), 0.5)
        >>> Scene.from_spectra(cube, np.array([400.0, 550.0, 700.0])).notes
        ()
        """
        return cls.of(spectral_scene(radiance, wavelengths_nm, name))

    @classmethod
    def of(cls, made: scene.Scene) -> Self:
        """Return a scene as one that shows itself."""
        return cls(**{one.name: getattr(made, one.name) for one in fields(made)})

    def _repr_html_(self) -> str:
        """Return what the eye would see, and how bright it is, for notebooks."""
        seen = np.round(255 * encode_srgb(seen_rgb(self, SHOWN_ROWS))).astype(np.uint8)
        told = {
            "light": self.illuminant,
            "white": f"{self.white_luminance_cd_m2:.4g} cd/m²",
        }
        if self.illumination:
            told["lit"] = self.illumination
        return figure(picture(Image.fromarray(seen)), facts(self.name, told))
