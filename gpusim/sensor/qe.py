"""The quantum efficiency of a sensor's channels at normal incidence."""

from __future__ import annotations

import warnings

import numpy as np
from pydantic import model_validator

from gpusim.config.model import Strict, Table, wrong
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.strict import NotNegative, Positive, check_grid


class QuantumEfficiency(Strict):
    """Quantum efficiency of each channel, filters included, on a wavelength grid of its own."""

    wavelengths_nm: tuple[Positive, ...]
    channels: Table[tuple[NotNegative, ...]]

    @model_validator(mode="after")
    def _on_one_grid(self) -> QuantumEfficiency:
        grid = self.wavelengths_nm
        check_grid(grid)
        first, last = WAVELENGTHS_NM[[0, -1]]
        for name, curve in self.channels.items():
            if len(curve) != len(grid):
                raise wrong(
                    f"channel {name} has {len(curve)} values", f"{len(grid)}, as wavelengths"
                )
            if not np.interp(WAVELENGTHS_NM, grid, curve).any():
                raise wrong(
                    f"channel {name} sees nothing",
                    f"values above 0 between {first:g} and {last:g} nm",
                    field=f"channels.{name}",
                )
            if (most := max(curve)) > 1:
                at = grid[curve.index(most)]
                warnings.warn(
                    f"the quantum efficiency of {name} exceeds 1: {most:g} at {at:g} nm",
                    stacklevel=2,
                )
        return self
