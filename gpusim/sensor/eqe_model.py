"""Quantum efficiency by the angle of incidence, as an electromagnetic solver computes it.

The file is JSON, one object:

    {
      "source": "who computed it, of which pixel",
      "wavelengths_nm": [400, 420, ...],
      "theta_deg": [0, 5, 10, ...],
      "phi_deg": [0, 45, 90, ...],
      "channels": {
        "R":  [[[...]]],
        "Gr": {"oe": [[[...]]], "iqe": [[[...]]]},
        ...
      }
    }

`wavelengths_nm` rise over 400 to 700 nm or beyond. `theta_deg` is the angle from the sensor's
normal, rising from 0. `phi_deg` is the azimuth of the direction in which the light travels, from
the sensor's columns (x, to the right in the raw) towards its rows (y, down): at phi 0 it goes to
the right, as it does right of the lens's axis. It rises all the way around, 0 to below 360 in steps
of 180 or less, or is 0 alone where the pixel answers alike from all sides.

Each channel of the filter pattern has its external quantum efficiency [wavelength][theta][phi],
electrons collected per photon that falls on the pixel's area as a plane wave; or in its place the
optical efficiency `oe` (photons absorbed over photons incident) and the internal quantum efficiency
`iqe` (electrons collected over those made), whose product it is. Colour filters are included,
filters in front of the sensor are not. Between the values it is straight along each axis.
"""

from __future__ import annotations

import warnings
from itertools import pairwise
from pathlib import Path

import numpy as np
from pydantic import Field, field_validator, model_validator

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict, Table, wrong
from gpusim.config.text import read_json
from gpusim.sensor.strict import NotNegative, Positive, check_grid

Cube = tuple[tuple[tuple[NotNegative, ...], ...], ...]
KEYS = "source, wavelengths_nm, theta_deg, phi_deg, channels: see gpusim/sensor/eqe_model.py"
WIDEST_STEP_DEG = 180.0  # of phi: farther apart nothing is known between


class Efficiencies(Strict):
    """Efficiencies of a channel [wavelength][theta][phi]: the external one, or its two factors."""

    eqe: Cube | None = None
    oe: Cube | None = None
    iqe: Cube | None = None

    @model_validator(mode="before")
    @classmethod
    def _external(cls, data: object) -> object:
        return {"eqe": data} if isinstance(data, list | tuple) else data

    @model_validator(mode="after")
    def _one_or_two(self) -> Efficiencies:
        if set(self.tables) not in ({"eqe"}, {"oe", "iqe"}):
            raise wrong(", ".join(self.tables) or "nothing", "a table of the eqe, or oe and iqe")
        return self

    @property
    def tables(self) -> dict[str, Cube]:
        """Those that are given."""
        return {name: cube for name, cube in self if cube is not None}


class EqeMap(Strict):
    """External quantum efficiency over wavelength, theta and phi: see the module.

    ``file`` is the name of what it was read from.
    """

    file: str = ""
    source: str = ""
    wavelengths_nm: tuple[Positive, ...]
    theta_deg: tuple[float, ...]
    phi_deg: tuple[float, ...]
    channels: Table[Efficiencies]

    @field_validator("wavelengths_nm")
    @classmethod
    def _over_the_grid(cls, grid: tuple[float, ...]) -> tuple[float, ...]:
        check_grid(grid)
        return grid

    @field_validator("theta_deg")
    @classmethod
    def _from_the_normal(cls, theta: tuple[float, ...]) -> tuple[float, ...]:
        rises = all(b > a for a, b in pairwise(theta))
        if len(theta) < 2 or theta[0] != 0 or not rises or theta[-1] > 90:
            raise wrong(
                "the angles do not rise from the normal", "0, then rising, up to 90 degrees"
            )
        return theta

    @field_validator("phi_deg")
    @classmethod
    def _all_around(cls, phi: tuple[float, ...]) -> tuple[float, ...]:
        if phi == (0,):
            return phi
        around = [*phi, phi[0] + 360] if phi else []
        steps = [b - a for a, b in pairwise(around)]
        if len(phi) < 2 or phi[0] < 0 or min(steps) <= 0 or max(steps) > WIDEST_STEP_DEG:
            raise wrong(
                "the azimuths do not go around",
                f"0 alone, or rising from 0 to below 360 in steps of {WIDEST_STEP_DEG:g} or less",
            )
        return phi

    @model_validator(mode="after")
    def _of_one_shape(self) -> EqeMap:
        shape = (len(self.wavelengths_nm), len(self.theta_deg), len(self.phi_deg))
        for name, channel in self.channels.items():
            for kind, cube in channel.tables.items():
                try:
                    found = np.array(cube).shape
                except ValueError:  # ragged
                    found = None
                if found != shape:
                    raise wrong(
                        f"the values of channel {name} ({kind}) are no table of the three axes",
                        f"{shape[0]} wavelengths of {shape[1]} thetas of {shape[2]} phis",
                    )
            cube = self.eqe(name)
            if cube.max() > 1:
                line, theta, phi = np.unravel_index(cube.argmax(), cube.shape)
                warnings.warn(
                    f"quantum efficiency of {name} exceeds 1: {cube.max():g} at "
                    f"{self.wavelengths_nm[line]:g} nm, theta {self.theta_deg[theta]:g}, "
                    f"phi {self.phi_deg[phi]:g}",
                    stacklevel=2,
                )
        return self

    def eqe(self, name: str) -> np.ndarray:
        """Return the external quantum efficiency of a channel: (wavelengths, thetas, phis)."""
        return np.prod([np.array(cube) for cube in self.channels[name].tables.values()], axis=0)

    def on_grid(self, wavelengths_nm: np.ndarray) -> dict[str, np.ndarray]:
        """Return the same of each channel at wavelengths (K,): (K, thetas, phis)."""
        share = np.array(
            [
                np.interp(wavelengths_nm, self.wavelengths_nm, row)
                for row in np.eye(len(self.wavelengths_nm))
            ]
        )
        return {name: np.einsum("vw,vtp->wtp", share, self.eqe(name)) for name in self.channels}

    def at_normal_incidence(self) -> dict[str, object]:
        """Return the fields of a quantum efficiency without angles, as of theta 0."""
        channels = {name: self.eqe(name)[:, 0].mean(axis=1).tolist() for name in self.channels}
        return {"wavelengths_nm": self.wavelengths_nm, "channels": channels}


class MicroLens(Strict):
    """How far the micro-lenses are shifted towards the axis: for light from which angle.

    Attributes
    ----------
    heights_mm : tuple of float
        Distances from the middle of the sensor, rising from 0; beyond the last it stays.
    chief_ray_deg : tuple of float
        Angle from the normal, outwards, at which light there finds the pixel as light along the
        normal finds it in the middle; 0 in the middle. Its sine is taken off the direction cosines
        of the light: an aberration-free micro-lens moves its spot by f sin(theta) / n.
    """

    heights_mm: tuple[NotNegative, ...]
    chief_ray_deg: tuple[float, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _curve(self) -> MicroLens:
        heights, angles = self.heights_mm, self.chief_ray_deg
        if len(heights) != len(angles):
            raise wrong(f"{len(angles)} angles", f"{len(heights)}, as heights_mm")
        if heights[0] != 0 or angles[0] != 0 or any(b <= a for a, b in pairwise(heights)):
            raise wrong("the curve does not rise from the middle", "heights 0 ..., angles 0 ...")
        if max(map(abs, angles)) >= 90:
            raise wrong(f"an angle of {max(angles, key=abs):g}", "between -90 and 90 degrees")
        return self

    def sine(self, height_um: np.ndarray) -> np.ndarray:
        """Return the sine of the angle at distances from the middle."""
        angle = np.interp(1e-3 * height_um, self.heights_mm, self.chief_ray_deg)
        return np.sin(np.radians(angle))


def read_eqe(path: Path) -> EqeMap:
    """Read a quantum efficiency by angle.

    Raises
    ------
    UserError
        Where the file cannot be read, is no JSON, or an axis or a value is wrong.
    """
    data = read_json(path, "the quantum efficiency")
    if isinstance(data, dict):
        data["file"] = path.name
    return checked(EqeMap, data, path)
