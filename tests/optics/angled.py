"""Pixels whose quantum efficiency goes with the angle of the light, and lenses that say it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from optics.made import bank, plane_bank, sensor

from gpusim.psf.bank import Bank
from gpusim.psf.cone import cone_of, with_exit_pupil
from gpusim.psf.plane_bank import PlaneBank
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.eqe_model import EqeMap, MicroLens
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

GREENS = [["R", "Gr"], ["Gb", "B"]]
EXIT_MM = 0.4  # from the image: the chief ray reaches 22 degrees at 160 um
THETA = np.linspace(0, 60, 31)
PHI = np.arange(0, 360, 15.0)
LINES = np.linspace(400, 700, 13)

Shape = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def curve(name: str, line: np.ndarray) -> np.ndarray:
    """Return the quantum efficiency of a channel at normal incidence."""
    middle = {"R": 610.0, "G": 540.0, "B": 460.0, "W": 540.0}[name[0]]
    return 0.6 * np.exp(-0.5 * ((line - middle) / 45) ** 2)


def round_pixel(power: float = 4.0) -> Shape:
    """Answer by cos(theta)^power, from all sides alike."""
    return lambda line, theta, phi: np.cos(np.radians(theta)) ** power


def leaning_pixel(lean: float) -> Shape:
    """Answer more to light that goes to the right, and more so in the blue."""

    def answer(line: np.ndarray, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        side = np.sin(np.radians(theta)) * np.cos(np.radians(phi))
        return np.cos(np.radians(theta)) ** 2 * (1 + lean * (2 - line / 550) * side)

    return answer


def eqe_map(phi: np.ndarray = PHI, theta: np.ndarray = THETA, **shapes: Shape) -> EqeMap:
    """Tabulate pixels by channel."""
    axes = np.meshgrid(LINES, theta, phi, indexing="ij")
    channels = {
        name: (curve(name, axes[0]) * shape(*axes)).tolist() for name, shape in shapes.items()
    }
    return EqeMap(
        wavelengths_nm=LINES.tolist(),
        theta_deg=theta.tolist(),
        phi_deg=phi.tolist(),
        channels=channels,
    )


def angled(
    found: EqeMap, rows: int = 96, cols: int = 128, pattern: object = None, **changes: object
) -> Sensor:
    """Return the middle of the demonstration sensor with a map, and greens that differ."""
    names = list(found.channels)
    pattern = pattern or (GREENS if len(names) == 4 else [names])
    plain = QuantumEfficiency(**found.at_normal_incidence())
    fields = {"cfa": ColourFilterArray(pattern=pattern), "quantum_efficiency": plain}
    return sensor(rows, cols, **fields, eqe_map=found, **changes)


def unlike(lean: float = 0.5) -> EqeMap:
    """Greens that lean to opposite sides between a red and a blue that do not lean."""
    return eqe_map(
        R=round_pixel(3.0), Gr=leaning_pixel(lean), Gb=leaning_pixel(-lean), B=round_pixel(5.0)
    )


def lens(exit_mm: float = EXIT_MM, **changes: object) -> Bank:
    """Return the lens of Gaussians with an exit pupil."""
    return with_exit_pupil(bank(**changes), exit_mm)


def plane_lens(exit_mm: float = EXIT_MM, **changes: object) -> PlaneBank:
    """Return the lens of Gaussians over both directions of the field with an exit pupil."""
    made = plane_bank(**changes)
    tangents = np.stack([made.chief_x_um, made.chief_y_um], axis=-1) / (1e3 * exit_mm)
    chief = tangents / np.sqrt(1 + np.sum(tangents**2, axis=-1, keepdims=True))
    at = (np.arange(192) + 0.5) / 96 - 1
    disc = cone_of(at, at, (np.hypot(at, at[:, None]) < 1).astype(float), False)
    cone = np.empty((*chief.shape[:3], *disc.shape), np.float32)
    cone[...] = disc
    radius = np.sqrt(made.projected_solid_angle_sr * made.relative_illumination / np.pi)
    cone[..., :2] *= radius[..., None, None]
    cone[..., :2] += chief[:, :, :, None]
    return replace(made, chief=chief, cone=cone)


def following(found: Bank) -> MicroLens:
    """Return micro-lenses that are shifted as the chief rays of a lens ask for."""
    heights = found.real_height_um[:, found.reference]
    angles = np.degrees(np.arcsin(found.chief[:, found.reference, 0]))
    return MicroLens(heights_mm=(1e-3 * heights).tolist(), chief_ray_deg=angles.tolist())


def sample() -> dict[str, object]:
    """Return the content of gpusim/data/sensors/eqe-sample.json: an analytic model, to 4 digits.

    EQE = Q_c(lambda) A(theta) (1 +- 0.3 lambda / 550 nm sin(theta) cos(phi)), + for Gr and - for Gb
    only; Q_c Gaussians over a floor, A cos(theta) times what a micro-lens still sends into the
    photodiode, 1 / (1 + exp((sin(theta) - 0.5) / 0.08)), over that at 0.
    """
    lines, theta, phi = np.arange(400, 701, 25), np.arange(0, 51, 5), np.arange(0, 360, 30)
    line, angle, azimuth = np.meshgrid(lines, np.radians(theta), np.radians(phi), indexing="ij")
    lost = np.exp((np.sin(angle) - 0.5) / 0.08)
    answer = np.cos(angle) * (1 + np.exp(-0.5 / 0.08)) / (1 + lost)
    lean = 0.3 * line / 550 * np.sin(angle) * np.cos(azimuth)
    peaks = {
        "R": (0.45, 605, 40),
        "Gr": (0.55, 535, 42),
        "Gb": (0.55, 535, 42),
        "B": (0.5, 460, 35),
    }
    channels = {}
    for name, (height, middle, width) in peaks.items():
        side = {"Gr": 1, "Gb": -1}.get(name, 0)
        curve_there = 0.02 + height * np.exp(-0.5 * ((line - middle) / width) ** 2)
        channels[name] = np.round(curve_there * answer * (1 + side * lean), 4).tolist()
    return {
        "source": "made up for demonstration by an analytic model (sample in "
        "tests/optics/angled.py): of no real pixel. Gr and Gb are mirror images of one another "
        "along the rows.",
        "wavelengths_nm": lines.tolist(),
        "theta_deg": theta.tolist(),
        "phi_deg": phi.tolist(),
        "channels": channels,
    }
