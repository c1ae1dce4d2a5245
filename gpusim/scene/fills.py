"""What the shapes of a chart are filled with: reflectances by number, name or file, and lamps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.config.names import perhaps
from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.scene.spd import read_spectrum
from gpusim.scene.spectra import patch_known, patch_names, patch_reflectance

# Reflectances: beyond 1 for what fluoresces or shines like a mirror.
MOST_REFLECTANCE, MOST_DENSITY = 2.0, 6.0
MOST_LUMINANCE_CD_M2 = 1e12  # the sun has 1.6e9
KINDS = ("reflectance", "density", "luminance_cd_m2", "patch", "spectrum")


@dataclass(frozen=True)
class Fill:
    """One fill.

    Attributes
    ----------
    name : str
    value : float or tuple of (float, float)
        A reflectance for all wavelengths, or pairs of wavelength (nm) and reflectance; None for a
        patch of the ColorChecker.
    luminance_cd_m2 : float or None
        Luminance of what shines by itself, in the colour of the scene's light.
    """

    name: str
    value: float | tuple[tuple[float, float], ...] | None = None
    luminance_cd_m2: float | None = None

    @property
    def patch(self) -> bool:
        """Whether it is a patch of the ColorChecker."""
        return self.value is None and self.luminance_cd_m2 is None

    @property
    def grey(self) -> bool:
        """Whether its spectrum is that of the light, scaled."""
        return isinstance(self.value, float) or self.luminance_cd_m2 is not None

    def reflectance(self, wavelengths_nm: np.ndarray, white_luminance_cd_m2: float) -> np.ndarray:
        """Return the reflectance (K,), beyond what is known as at its ends.

        What shines by itself has its luminance over that of the scene's white.
        """
        if self.luminance_cd_m2 is not None:
            share = self.luminance_cd_m2 / white_luminance_cd_m2
            return np.full(len(wavelengths_nm), share)
        if self.patch:
            return patch_reflectance(self.name, wavelengths_nm)
        if isinstance(self.value, float):
            return np.full(len(wavelengths_nm), self.value)
        return np.interp(wavelengths_nm, *np.array(self.value).T)

    @property
    def known(self) -> Known | None:
        """Over which wavelengths it is measured; None for one that is the same at all."""
        if self.grey:
            return None
        if self.patch:
            return patch_known(self.name)
        return Known(f"the reflectance of {self.name}", self.value[0][0], self.value[-1][0])


def read_fill(given: object, name: str | None, field: str, path: Path) -> Fill:
    """Return the fill that a chart's file describes.

    Parameters
    ----------
    given : object
        A number, a reflectance at all wavelengths; the name of a patch of the ColorChecker; or a
        mapping of one of `KINDS` to its value.
    name : str or None
        Under which the file lists it.
    field : str
        Where it stands, for the message.
    path : Path
        The file; spectra lie beside it.

    Raises
    ------
    UserError
    """
    if isinstance(given, int | float) and not isinstance(given, bool):
        value = _number(given, MOST_REFLECTANCE, field, path)
        return Fill(name or f"neutral {100 * value:.6g} %", value)
    if isinstance(given, str):
        if given not in patch_names():
            raise UserError(
                f"there is no fill of that name{perhaps(given, patch_names())}",
                file=path,
                field=field,
                value=given,
                allowed="a name under fills, a patch of the ColorChecker (SG A1 to SG N10: of its "
                "Digital SG), or a reflectance",
            )
        return Fill(given)
    if not isinstance(given, dict) or len(given) != 1 or next(iter(given)) not in KINDS:
        raise UserError(
            "a fill is wrong",
            file=path,
            field=field,
            value=given,
            allowed=f"a number, or one of {', '.join(KINDS)}: reflectance: 0.18",
        )
    ((kind, value),) = given.items()
    place = f"{field}.{kind}"
    if kind == "patch":
        found = read_fill(str(value), None, place, path)
        return found
    if kind == "spectrum":
        return Fill(name or str(value), _spectrum(value, place, path))
    most = {"density": MOST_DENSITY, "luminance_cd_m2": MOST_LUMINANCE_CD_M2}
    number = _number(value, most.get(kind, MOST_REFLECTANCE), place, path)
    if kind == "luminance_cd_m2":
        return Fill(name or f"{number:.6g} cd/m^2", None, number)
    if kind == "density":
        number = 10**-number
    return Fill(name or f"neutral {100 * number:.6g} %", number)


def _number(given: object, most: float, field: str, path: Path) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0 <= given <= most:
        raise UserError(
            "a fill is wrong", file=path, field=field, value=given, allowed=f"0 to {most:g}"
        )
    return float(given)


def _spectrum(given: object, field: str, path: Path) -> tuple[tuple[float, float], ...]:
    """Return the pairs of a table of wavelength, nm, and reflectance, which lies beside a file."""
    if not isinstance(given, str):
        raise UserError("a fill is wrong", file=path, field=field, value=given, allowed="a file")
    found = read_spectrum(path.parent / given, "the reflectance", MOST_REFLECTANCE)
    return tuple((float(nm), float(value)) for nm, value in zip(*found, strict=True))
