"""How a raw file is developed: the settings, and the file that holds them."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.text import read_mapping
from gpusim.errors import UserError
from gpusim.scene.spectra import illuminant

LARGEST_EV = 20.0
Share = Annotated[float, Field(ge=0, le=1)]
PATCH = re.compile(r"patch:(\d{1,6}),(\d{1,6}),(\d{1,6}),(\d{1,6})", re.ASCII)
WHITES = "as-shot, grey-world, patch:ROW,COLUMN,ROWS,COLUMNS, an illuminant (D65), 5100K"
LARGEST_ROLL_OFF = 0.9


class Settings(Strict):
    """How a raw file is developed by our own stages.

    Attributes
    ----------
    demosaic : str, optional
        ``bilinear``, ``malvar``, ``directional`` or ``guided``; None: directional for Bayer arrays,
        guided by the most frequent colour for all others.
    white_balance : str
        ``as-shot``, ``grey-world``, ``patch:ROW,COLUMN,ROWS,COLUMNS`` for what is white in the
        picture, or the name of an illuminant or a temperature.
    space : str
        ``srgb``, ``p3``, ``rec2020`` or ``linear``.
    matrix_fit : str
        ``xyz``: colours by the file's ColorMatrix, which our raws have by least squares of the
        camera's colours from XYZ; ``lab``: by its ForwardMatrix, which they have by least squares
        in CIE L*a*b*.
    ev : float
        Stops by which to show the picture brighter.
    roll_off : float
        Share of the range into which highlights are bent that exposure takes beyond white; 0 clips
        them.
    curve : tuple of (float, float), optional
        Points of a tone curve on stored values, from 0 to 1.
    like : str, optional
        A raw file of another camera: its pedestal, white balance and colour matrices are taken.
    defects : bool
        Whether pixels that stand out are mended.
    shading : bool
        Whether the lens's shading is undone where the file gives it.
    rectify : bool
        Whether its distortion and lateral colour are.
    """

    demosaic: Literal["bilinear", "malvar", "directional", "guided"] | None = None
    white_balance: str = "as-shot"
    space: Literal["srgb", "p3", "rec2020", "linear"] = "srgb"
    matrix_fit: Literal["xyz", "lab"] = "xyz"
    ev: Annotated[float, Field(ge=-LARGEST_EV, le=LARGEST_EV)] = 0.0
    roll_off: Annotated[float, Field(ge=0, le=LARGEST_ROLL_OFF)] = 0.0
    curve: Annotated[tuple[tuple[Share, Share], ...], Field(min_length=2)] | None = None
    like: str | None = None
    defects: bool = False
    shading: bool = True
    rectify: bool = False

    @field_validator("curve")
    @classmethod
    def _rises(cls, points: tuple | None) -> tuple | None:
        if points is not None:
            at = [given for given, _ in points]
            if at[0] != 0 or at[-1] != 1 or any(b <= a for a, b in pairwise(at)):
                raise PydanticCustomError("curve", "points whose first numbers rise from 0 to 1")
        return points

    @field_validator("white_balance")
    @classmethod
    def _known(cls, name: str) -> str:
        if name in ("as-shot", "grey-world") or PATCH.fullmatch(name):
            return name
        try:
            illuminant(name)
        except UserError as error:
            raise PydanticCustomError("white", WHITES) from error
        return name


def check_ev(ev: float) -> None:
    """Refuse what is no number of stops.

    Raises
    ------
    UserError
    """
    if not abs(ev) <= LARGEST_EV:
        raise UserError(
            "not a number of stops",
            field="--ev",
            value=ev,
            allowed=f"{-LARGEST_EV:g} to {LARGEST_EV:g}",
        )


def read_settings(path: Path) -> Settings:
    """Read a file of settings.

    Raises
    ------
    UserError
        It is missing, no YAML, or has a field that is unknown or wrong.
    """
    return checked(Settings, read_mapping(path, "the settings file"), path)


def settings_text(settings: Settings, notes: list[str]) -> str:
    """Return the YAML of settings, which `read_settings` reads, with notes above it."""
    values = settings.model_dump(mode="json", exclude_none=True)
    comments = "".join(f"# {note}\n" for note in notes)
    return comments + yaml.safe_dump(values, sort_keys=False)
