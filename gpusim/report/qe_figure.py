"""Quantum efficiency over the field: each channel along the row through the sensor's middle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.scene.spectra import WAVELENGTHS_NM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gpusim.optics.angular import AngularResponse
    from gpusim.sensor.sensor import Sensor

POINTS = 41  # odd: one lies in the middle
_COLOURS = {
    "R": "#c62828",
    "G": "#2e7d32",
    "B": "#1f5fb8",
    "C": "#00838f",
    "M": "#ad1457",
    "Y": "#b8860b",
    "W": "#1b1f24",
}
_DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))


def qe_facts(response: AngularResponse, sensor: Sensor) -> dict[str, Any]:
    """Return the mean quantum efficiency of each channel against image height, in JSON types.

    Along the row through the middle, each channel at the wavelength at which it sees most there.
    """
    half_um = sensor.cols * sensor.pixel_pitch_um / 2
    heights = np.linspace(-half_um, half_um, POINTS)
    found = np.stack([response.at(x, 0.0) for x in heights])
    peaks = found[POINTS // 2].argmax(axis=1)
    return {
        "height_mm": (1e-3 * heights).tolist(),
        "channels": {
            name: {
                "wavelength_nm": float(WAVELENGTHS_NM[peak]),
                "quantum_efficiency": found[:, channel, peak].tolist(),
            }
            for channel, (name, peak) in enumerate(zip(sensor.channels, peaks, strict=True))
        },
    }


def labels(facts: Mapping[str, Any]) -> dict[str, str]:
    """Return what the curves of `qe_facts` are called, by channel."""
    return {
        name: f"{name} at {channel['wavelength_nm']:g} nm"
        for name, channel in facts["channels"].items()
    }


def draw(facts: Mapping[str, Any]) -> Figure:
    """Return the figure of what `qe_facts` found."""
    import matplotlib
    from matplotlib.figure import Figure

    from gpusim.report.drawing import LINE, STYLE

    with matplotlib.rc_context(STYLE):
        # So narrow that letters of 8.5 pt, 11 px of its 461, still have 8 on a phone's 342.
        figure = Figure(figsize=(4.8, 3.6), layout="constrained")
        axes = figure.subplots()
        seen: dict[str, int] = {}
        names = labels(facts)
        for name, channel in facts["channels"].items():
            number = seen[name[0]] = seen.get(name[0], -1) + 1
            axes.plot(
                facts["height_mm"],
                channel["quantum_efficiency"],
                color=_COLOURS[name[0]],
                linestyle=_DASHES[number % len(_DASHES)],
                label=names[name],
            )
        axes.axvline(0, color=LINE, linewidth=1, zorder=0)
        axes.set(
            xlabel="from the middle of the sensor to the right [mm]",
            ylabel="mean quantum efficiency",
            xlim=(facts["height_mm"][0], facts["height_mm"][-1]),
        )
        axes.set_ylim(0, 1.08 * axes.dataLim.ymax)
        figure.legend(loc="outside lower center", ncols=2)
    return figure
