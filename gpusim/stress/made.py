"""Lenses, sensors and scenes of which everything is known, and what is compared with them."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
from scipy.special import ndtr

from gpusim.camera import Camera
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.psf.bank import Bank
from gpusim.render import Renderer
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.load import load_sensor
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

FLAT = np.full(WAVELENGTHS_NM.size, 1e-3)  # W m^-2 sr^-1 nm^-1


def gaussian_bank(
    sigma_um: tuple[float, float] = (1.0, 1.0),
    *,
    size: int = 64,
    pitch_um: float = 0.5,
    wavelengths: int = 3,
    real_over_ideal: Callable[[np.ndarray], np.ndarray] = np.ones_like,
    rim_illumination: float = 1.0,
    circle_um: float = 150.0,
    fields: int = 12,
    efl_mm: float = 0.5,
) -> Bank:
    """Return a lens of Gaussian PSFs, as wide across and along the radius as `sigma_um` at the rim.

    On the axis both widths are the mean, from where they go with the square of the height, as does
    the illumination.
    """
    ideal = np.linspace(0.0, circle_um, fields)
    share = (ideal / circle_um) ** 2
    at = (np.arange(size) - size // 2) * pitch_um
    across, along = (np.mean(sigma_um) * (1 - share) + share * s for s in sigma_um)
    profile = [np.exp(-0.5 * (at / s[:, None]) ** 2) for s in (across, along)]
    psf = profile[0][:, :, None] * profile[1][:, None, :]
    psf /= psf.sum(axis=(1, 2), keepdims=True)
    lines = np.linspace(400.0, 700.0, wavelengths) if wavelengths > 1 else np.array([550.0])
    nothing = np.zeros((fields, wavelengths))
    light = 1 - (1 - rim_illumination) * share
    return Bank(
        wavelengths_nm=lines,
        reference_nm=float(lines[wavelengths // 2]),
        field_deg=np.degrees(np.arctan(ideal / (1e3 * efl_mm))),
        ideal_height_um=ideal,
        real_height_um=np.repeat((ideal * real_over_ideal(ideal))[:, None], wavelengths, axis=1),
        psf=np.repeat(psf[:, None], wavelengths, axis=1).astype(np.float32),
        relative_illumination=np.repeat(light[:, None], wavelengths, axis=1),
        projected_solid_angle_sr=np.full(wavelengths, 0.1),
        transmission=np.full(wavelengths, 0.6),
        outside_energy=nothing,
        folded_energy=nothing,
        fit_residual_waves=nothing,
        failed_rays=nothing,
        efl_mm=efl_mm,
        f_number=2.8,
        pitch_um=pitch_um,
        provenance={"title": "Gaussians", "history": "made up"},
    )


def mono(rows: int = 48, cols: int = 64) -> Sensor:
    """Return the middle of a sensor of one channel without veiling glare."""
    whole = load_sensor("imx477")
    curves = whole.quantum_efficiency
    one = QuantumEfficiency(
        wavelengths_nm=curves.wavelengths_nm, channels={"W": curves.channels["G"]}
    )
    changes = {
        "cfa": ColourFilterArray(pattern=[["W"]]),
        "quantum_efficiency": one,
        "veiling_glare": 0.0,
        "full_well_e": 1e7,
    }
    return whole.roi(rows, cols).model_copy(update=changes)


def camera_of(bank: Bank, sensor: Sensor) -> Camera:
    """Return a camera with a given bank."""
    lens = SimpleNamespace(title="Gaussians", bank=lambda progress=None: bank)
    return Camera(lens, sensor, "stress")


def edge_scene(position: float, dark: float = 0.05) -> Scene:
    """Return white left of a vertical edge, at a position in half-heights, and dark right of it."""
    white = Rect(position - 50.0, 0.0, 50.0, 60.0, 0.0, 1)
    chart = Chart(("dark", "white"), 0, (white,))
    return Scene("edge", np.stack([dark * FLAT, FLAT]), chart, "E", FLAT)


def rate_of(
    camera: Camera, scene: Scene, tolerance: float = 1e-3, tile_px: int | None = None
) -> np.ndarray:
    """Return the electrons/s (rows, cols) of a render."""
    renderer = Renderer(camera, scene, Accuracy(tolerance, 0))
    try:
        shot = renderer.capture(0.01, keep=("rate",), tile_px=tile_px)
        return shot.rate.astype(np.float64)
    finally:
        renderer.release()


def white_rate(bank: Bank, sensor: Sensor) -> float:
    """Return electrons/s of the white on the axis."""
    return float((spectral_weights(bank, sensor).sum(axis=1) @ FLAT)[0])


def edge_profile(
    position_um: float, sigma_um: float, sensor: Sensor, dark: float = 0.05
) -> np.ndarray:
    """Return what a row of pixels sees of the edge, over white: a normal law over the aperture."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    pitch = sensor.pixel_pitch_um
    width = pitch * np.sqrt(sensor.fill_factor)
    centre = (np.arange(sensor.cols) + 0.5 - sensor.cols / 2) * pitch
    distance = (position_um - centre[:, None] - nodes * width / 2) / sigma_um
    return dark + (1 - dark) * (ndtr(distance) @ weights) / 2


def compared(found: np.ndarray, expected: np.ndarray, bound: float, what: str) -> tuple:
    """Return expected, got and whether the largest difference is within a bound of white."""
    worst = float(np.abs(found - expected).max()) if np.isfinite(found).all() else np.inf
    return f"{what}, to {bound:.0e} of white", f"{worst:.1e} of white off", worst <= bound


def edge_case(
    bank: Bank,
    sigma_um: float,
    rows: int = 48,
    cols: int = 64,
    *,
    bound: float = 3e-3,
    tolerance: float = 1e-3,
) -> tuple:
    """Compare the middle row of an edge with its closed form."""
    sensor = mono(rows, cols)
    position = 0.137 * cols / rows
    half_um = rows * sensor.pixel_pitch_um / 2
    rate = rate_of(camera_of(bank, sensor), edge_scene(position), tolerance)
    middle = rate[rows // 2] / white_rate(bank, sensor)
    expected = edge_profile(position * half_um, sigma_um, sensor)
    return compared(middle, expected, bound, "normal law over the aperture")


def certified_case(bank: Bank, sensor: Sensor, scene: Scene, tolerance: float) -> tuple:
    """Hold a render against the exact model."""
    renderer = Renderer(camera_of(bank, sensor), scene, Accuracy(tolerance, 16))
    try:
        found = renderer.capture(0.01).certificate
    finally:
        renderer.release()
    got = f"RMS {found.rms_relative:.1e}, worst {found.worst_relative:.1e}"
    return f"exact model, RMS to {tolerance:g}", got, found.met
