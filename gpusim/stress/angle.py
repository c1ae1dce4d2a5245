"""Cases of a quantum efficiency that goes with the angle of the light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.psf.bank import Bank
from gpusim.psf.cone import with_exit_pupil
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.eqe_model import EqeMap
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor
from gpusim.stress.made import FLAT, camera_of, compared, gaussian_bank, mono, rate_of
from gpusim.stress.table import Case

PEAK = 0.5
GRAZING_MM = 0.03  # from the exit pupil to the image: at 48 um the chief ray lies 58 degrees off


def map_of(answer: Callable[[np.ndarray, np.ndarray], np.ndarray], most_deg: float = 80) -> EqeMap:
    """Tabulate a pixel of one channel, of cos(theta) and phi in radians."""
    theta, phi = np.arange(0, most_deg + 1, 2.0), np.arange(0, 360, 10.0)
    cube = PEAK * answer(np.cos(np.radians(theta))[:, None], np.radians(phi))
    return EqeMap(
        wavelengths_nm=[400, 700],
        theta_deg=theta.tolist(),
        phi_deg=phi.tolist(),
        channels={"W": [np.broadcast_to(cube, (len(theta), len(phi))).tolist()] * 2},
    )


def angled(found: EqeMap) -> Sensor:
    """Return a sensor of one channel with a map."""
    even = QuantumEfficiency(**found.at_normal_incidence())
    changes = {"cfa": ColourFilterArray(pattern=[["W"]]), "quantum_efficiency": even}
    return mono().model_copy(update=changes | {"eqe_map": found})


def slow_bank(exit_pupil_mm: float) -> Bank:
    """Return a lens whose cones are narrow, f/28, so that the chief ray stands for them."""
    # Fields 3 um apart: between them the mean is linear.
    bank = gaussian_bank(fields=48)
    bank.projected_solid_angle_sr[:] = 1e-3
    return with_exit_pupil(bank, exit_pupil_mm)


def white(bank: Bank, sensor: Sensor) -> np.ndarray:
    """Return electrons/s (rows, cols) of an even white scene."""
    scene = Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
    return rate_of(camera_of(bank, sensor), scene, tolerance=1e-3)


def chief_ray(sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Return cos(theta) and sin(theta) cos(phi) of the chief ray at each pixel, row by row."""
    y, x = (
        (np.arange(count) + 0.5 - count / 2) * sensor.pixel_pitch_um
        for count in (sensor.rows, sensor.cols)
    )
    x, y = np.meshgrid(x, y)
    distance = np.hypot(np.hypot(x, y), 1e3 * GRAZING_MM)
    return 1e3 * GRAZING_MM / distance, x / distance


def grazing() -> tuple:
    """Light at up to 64 degrees on a pixel that answers by cos^2."""
    sensor = angled(map_of(lambda cosine, phi: cosine**2))
    rate = white(slow_bank(GRAZING_MM), sensor)
    cosine, _ = chief_ray(sensor)
    middle = rate[sensor.rows // 2, sensor.cols // 2]
    # Fields: (3 / 30)^2 / 8 times second derivatives of 2; steps of 2 degrees; the cone's width.
    return compared(rate / middle, cosine**2, 1e-2, "cos^2 of the chief ray")


def one_sided() -> tuple:
    """Light on a pixel that is blind to one side, and sees twice as much from the other."""
    sensor = angled(map_of(lambda cosine, phi: 1 + np.sqrt(1 - cosine**2) * np.cos(phi)))
    rate = white(slow_bank(GRAZING_MM), sensor)
    _, side = chief_ray(sensor)
    at = sensor.rows // 2, sensor.cols // 2
    expected = (1 + side) / (1 + side[at])
    return compared(rate / rate[at], expected, 1e-2, "1 + sin(theta) cos(phi) of the chief ray")


def telecentric() -> tuple:
    """Light along the normal everywhere: as a sensor without angles."""
    sensor = angled(map_of(lambda cosine, phi: cosine**4))
    bank = slow_bank(np.inf)
    plain = sensor.model_copy(update={"eqe_map": None})
    # <cos^4> = 1 - s^2 over a cone of sine s.
    expected = white(bank, plain) * (1 - 1e-3 / np.pi)
    return compared(
        white(bank, sensor) / expected.mean(), expected / expected.mean(), 1e-3, "as without angles"
    )


def beyond_the_map() -> tuple:
    """Light from angles that nobody computed."""
    white(slow_bank(GRAZING_MM), angled(map_of(lambda cosine, phi: cosine, 40)))
    return "refused", "rendered", False


def without_rays() -> tuple:
    """Light of which nobody knows the angles."""
    white(gaussian_bank(), angled(map_of(lambda cosine, phi: cosine)))
    return "refused", "rendered", False


CASES: tuple[Case, ...] = (
    ("QE by angle, light at 60 degrees", grazing, None),
    ("QE by angle, pixel blind to one side", one_sided, None),
    ("QE by angle, telecentric lens", telecentric, None),
    ("QE by angle, light beyond the map", beyond_the_map, "theta_deg"),
    ("QE by angle, lens without rays", without_rays, "exit_pupil_mm"),
)
