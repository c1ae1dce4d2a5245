"""What of a sensor shapes the light on it; the rest acts when it is read."""

from __future__ import annotations

from gpusim.sensor.sensor import Sensor

OPTICAL = (
    "rows",
    "cols",
    "first_row",
    "first_col",
    "pixel_pitch_um",
    "fill_factor",
    "cfa",
    "quantum_efficiency",
    "veiling_glare",
    "eqe_map",
    "micro_lens",
    "filters",
    "aperture",
    "scan_motion_px",
)


def optical_differences(one: Sensor, other: Sensor) -> list[str]:
    """Return the fields by which other light comes onto two sensors; none where it is the same."""
    return [name for name in OPTICAL if getattr(one, name) != getattr(other, name)]
