"""A sensor, and a noise-free raw of the ColorChecker computed from its spectra."""

from dataclasses import dataclass

import numpy as np
import pytest

from gpusim.isp.colour import CHANNELS, response
from gpusim.scene.spectra import colorchecker, white_radiance
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor

PATCH = 40  # pixels


@dataclass(frozen=True)
class Shot:
    """A raw of the ColorChecker's patches side by side, and what is in it.

    Attributes
    ----------
    sensor : Sensor
    raw : ndarray (4 * PATCH, 6 * PATCH), uint16
    white_e : dict of str to float
    patches_e : ndarray (24, 3)
        Electrons of each patch in R, G, B.
    """

    sensor: Sensor
    raw: np.ndarray
    white_e: dict[str, float]
    patches_e: np.ndarray


def sixteen_bits(pattern: list[list[str]] | None = None) -> Sensor:
    """Return the IMX477-like sensor with finer steps: what is left is not quantisation."""
    sensor = load_sensor("imx477")
    cfa = sensor.cfa.model_copy(update={"pattern": pattern or sensor.cfa.pattern})
    return sensor.model_copy(
        update={"bit_depth": 16, "system_gain_dn_per_e": 7.5, "black_level_dn": 4096, "cfa": cfa}
    )


@pytest.fixture
def shoot():
    """Return a function that takes the ColorChecker under an illuminant."""

    def take(
        illuminant: str,
        pattern: list[list[str]] | None = None,
        white_share: float = 0.6,
        patch_px: int = PATCH,
    ) -> Shot:
        sensor = sixteen_bits(pattern)
        curves = response(sensor.qe)
        white = white_radiance(illuminant, 1.0)
        span_dn = 65535 - sensor.black_level_dn
        scale = white_share * span_dn / sensor.system_gain_dn_per_e / (curves @ white).max()
        patches = scale * (np.stack(list(colorchecker().values())) * white) @ curves.T
        site = np.array([[CHANNELS.index(c) for c in row] for row in sensor.cfa.pattern])
        site = np.tile(site, (2 * patch_px, 3 * patch_px))[: 4 * patch_px, : 6 * patch_px]
        number = np.kron(np.arange(24).reshape(4, 6), np.ones((patch_px, patch_px), int))
        raw = sensor.black_level_dn + sensor.system_gain_dn_per_e * patches[number, site]
        white_e = dict(zip(CHANNELS, scale * curves @ white, strict=True))
        return Shot(sensor, np.round(raw).astype(np.uint16), white_e, patches)

    return take
