"""A camera small enough for tests: a lens made of Gaussians, a piece of a sensor, few shapes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from gpusim.gpu import Device
from gpusim.optics.convolve import Convolve, Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.psf.bank import Bank
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import Heights
from gpusim.psf.plane_bank import PlaneBank
from gpusim.scene.chart import Chart, Disc, Rect
from gpusim.scene.patterns import Frame
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.load import load_sensor
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor
from gpusim.stress.made import gaussian_bank

ULP = 2.0**-24  # largest relative error of one rounding to f32

# Blocks of 336 x 336 samples, for which the shaders' overrides have their defaults.
DEFAULT_GRID = SimGrid(248, 248, stride=4, period=2, length=512, half_size=88, cells=(2, 2))


def gaussian(position_um: np.ndarray, sigma_um: float) -> np.ndarray:
    """Return a normal density, per um."""
    return np.exp(-0.5 * (position_um / sigma_um) ** 2) / (sigma_um * np.sqrt(2 * np.pi))


def bank(
    fields: int = 4,
    size: int = 64,
    circle_um: float = 165.0,
    sigma_um: tuple[float, ...] = (0.95, 1.0, 1.15),
    coma_um: float = 3.0,
    halo: float = 0.0,
    distortion: float = -0.02,
    lateral: tuple[float, ...] = (-0.004, 0.0, 0.003),
    falloff: float = 0.3,
    skew_um: float = 0.0,
) -> Bank:
    """Return a lens of which everything is known.

    Parameters
    ----------
    fields, size : int
        Fields, and samples across a PSF of 0.5 um pitch.
    circle_um : float
        Radius of the image circle on the ideal plane.
    sigma_um : tuple of float
        Width of the PSF at 400, 550 and 700 nm, or of as many wavelengths between.
    coma_um : float
        Distance of a quarter of the light at the rim of the field, outwards.
    halo : float
        Share of the light in a Gaussian four times as wide.
    distortion : float
        Real over ideal height at the rim, less 1; it goes with the square of the height.
    lateral : tuple of float
        Relative magnification of each wavelength.
    falloff : float
        Loss of light at the rim, with the square of the height.
    skew_um : float
        Distance of the displaced light along the tangent, which no centred lens has.
    """
    wavelengths = (
        np.linspace(400.0, 700.0, len(sigma_um)) if len(sigma_um) > 1 else np.array([550.0])
    )
    ideal = np.linspace(0.0, circle_um, fields)
    share = ideal / circle_um
    real = (ideal * (1 + distortion * share**2))[:, None] * (
        1 + np.array(lateral)[: len(wavelengths)]
    )
    at = (np.arange(size) - size // 2) * 0.5
    psf = np.empty((fields, len(wavelengths), size, size))
    for number in range(fields):
        for place, sigma in enumerate(sigma_um):
            out, along = coma_um * share[number], skew_um * share[number]
            psf[number, place] = 0.75 * np.outer(
                gaussian(at, sigma), gaussian(at, sigma)
            ) + 0.25 * np.outer(gaussian(at - along, 1.2 * sigma), gaussian(at - out, 1.2 * sigma))
            wide = gaussian(at, 4 * sigma)
            psf[number, place] = (1 - halo) * psf[number, place] + halo * np.outer(wide, wide)
    psf /= psf.sum(axis=(2, 3), keepdims=True)
    given = {"size": size, "wavelengths": len(wavelengths), "circle_um": circle_um}
    return replace(
        gaussian_bank(**given, fields=fields, efl_mm=1.0),
        real_height_um=real,
        psf=psf.astype(np.float32),
        relative_illumination=1
        - falloff * share[:, None] ** 2 * np.linspace(1.0, 1.1, len(wavelengths)),
        projected_solid_angle_sr=np.linspace(0.10, 0.102, len(wavelengths)),
        transmission=np.linspace(0.58, 0.60, len(wavelengths)),
    )


def plane_bank(
    side: int = 9,
    size: int = 64,
    circle_um: float = 165.0,
    sigma_um: tuple[float, ...] = (0.95, 1.0, 1.15),
    coma_um: float = 3.0,
    halo: float = 0.0,
    distortion: float = -0.02,
    lateral: tuple[float, ...] = (-0.004, 0.0, 0.003),
    falloff: float = 0.3,
    axial_coma_um: tuple[float, float] = (0.0, 0.0),
    keystone: tuple[float, float] = (0.0, 0.0),
    boresight_um: tuple[float, float] = (0.0, 0.0),
    prism_um: tuple[float, float] = (0.0, 0.0),
) -> PlaneBank:
    """Return the lens of `bank` over both directions of the field, and what moved elements do.

    Parameters
    ----------
    side : int
        Fields each way.
    size, circle_um, sigma_um, coma_um, halo, distortion, lateral, falloff
        As for `bank`.
    axial_coma_um : (float, float)
        x, y by which the quarter of the light is displaced on the axis, and as much more elsewhere.
    keystone : (float, float)
        Real over ideal height grows by so much over the circle's radius, along x and along y.
    boresight_um : (float, float)
        Where the axis of the lens meets the image.
    prism_um : (float, float)
        By how much 700 nm lands farther than 400 nm on the axis.
    """
    wavelengths = np.linspace(400.0, 700.0, len(sigma_um))
    steps = np.linspace(-0.5, 0.5, len(sigma_um))

    def landed(x_deg: np.ndarray, y_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ideal and real points (..., 2)."""
        angle = np.hypot(x_deg, y_deg)
        ideal = (
            np.stack([x_deg, y_deg], -1)
            * (1000.0 * np.tan(np.radians(angle)) / np.maximum(angle, 1e-12))[..., None]
        )
        share2 = np.sum(ideal**2, axis=-1, keepdims=True) / circle_um**2
        grown = 1 + distortion * share2 + (ideal @ keystone)[..., None] / circle_um
        return ideal, ideal * grown + boresight_um

    edge_deg = float(np.degrees(np.arctan(circle_um / 1000.0)))
    axis_deg = np.linspace(-edge_deg, edge_deg, side)
    axis_deg[side // 2] = 0.0
    x_deg, y_deg = np.meshgrid(axis_deg, axis_deg)
    within = np.minimum(1.0, edge_deg / np.maximum(np.hypot(x_deg, y_deg), 1e-12))
    ideal, real = landed(x_deg * within, y_deg * within)
    off = real - boresight_um
    chief = real[:, :, None] + off[:, :, None] * np.array(lateral)[:, None]
    chief += steps[:, None] * np.array(prism_um)
    at = (np.arange(size) - size // 2) * 0.5
    psf = np.empty((side, side, len(sigma_um), size, size))
    for index in np.ndindex(side, side):
        flare = coma_um * ideal[index] / circle_um + axial_coma_um
        for place, sigma in enumerate(sigma_um):
            y, x = (gaussian(at - one, 1.2 * sigma) for one in flare[::-1])
            middle, wide = gaussian(at, sigma), gaussian(at, 4 * sigma)
            one = 0.75 * np.outer(middle, middle) + 0.25 * np.outer(y, x)
            psf[(*index, place)] = (1 - halo) * one + halo * np.outer(wide, wide)
    psf /= psf.sum(axis=(3, 4), keepdims=True)
    share2 = np.sum(ideal**2, axis=-1)[..., None] / circle_um**2
    spokes, rings = np.meshgrid(np.arange(16) * np.pi / 8, np.sin(np.pi / 16 * np.arange(1, 9)))
    rays = [np.append(0.0, edge_deg * (rings * turn(spokes)).ravel()) for turn in (np.cos, np.sin)]
    nothing = np.zeros((side, side, len(sigma_um)))
    ray_um = landed(*rays)[1]
    return PlaneBank(
        wavelengths_nm=wavelengths,
        field_x_deg=axis_deg,
        field_y_deg=axis_deg,
        chief_x_um=chief[..., 0],
        chief_y_um=chief[..., 1],
        psf=psf.astype(np.float32),
        relative_illumination=1 - falloff * share2 * np.linspace(1.0, 1.1, len(sigma_um)),
        projected_solid_angle_sr=np.linspace(0.10, 0.102, len(sigma_um)),
        transmission=np.linspace(0.58, 0.60, len(sigma_um)),
        outside_energy=nothing,
        folded_energy=nothing,
        fit_residual_waves=nothing,
        failed_rays=nothing,
        ray_x_deg=rays[0],
        ray_y_deg=rays[1],
        ray_x_um=ray_um[:, 0],
        ray_y_um=ray_um[:, 1],
        reference_nm=float(wavelengths[len(sigma_um) // 2]),
        efl_mm=1.0,
        f_number=2.8,
        pitch_um=0.5,
        provenance={"title": "Gaussians in a grid", "history": "made up"},
    )


# What moved elements do: coma on the axis, keystone, an image off the centre, lateral colour there.
MOVED = {
    "axial_coma_um": (1.6, -0.7),
    "keystone": (0.06, 0.025),
    "boresight_um": (6.0, -3.0),
    "prism_um": (0.7, 0.4),
}


def dots_image(
    places: list[tuple[float, float]],
    radius: float,
    shape: tuple[int, int],
    weights: np.ndarray,
    flip: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Return what `plane_bank(coma_um=0.6, falloff=0.1, **MOVED)` makes of dots.

    Sums over their points of Gaussians through apertures, of light 1 in a pixel of their area;
    `flip` has the signs with which x and y of all that moved elements do are taken.
    """
    half_um, circle = shape[0] * 1.55 / 2, 165.0
    steps = (np.arange(30) + 0.5) / 30
    r, phi = np.meshgrid(radius * half_um * np.sqrt(steps), 2 * np.pi * steps)  # equal areas
    around = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1).reshape(-1, 2)
    coma, keystone, shift, prism = (np.array(one) * flip for one in MOVED.values())
    image = np.zeros(shape)
    for place in np.array(places):
        ideal = place * half_um + around
        share2 = np.sum(ideal**2, axis=1, keepdims=True) / circle**2
        grown = 1 - 0.02 * share2 + (ideal @ keystone)[:, None] / circle
        off = ideal * grown
        # Radiance is preserved: light goes with the area in the image, det(g I + u v^T).
        slope = np.sum(ideal * (-0.04 * ideal / circle**2 + keystone / circle), axis=1)
        area = grown[:, 0] * (grown[:, 0] + slope)
        flare = 0.6 * ideal / circle + coma
        widths, colours = (0.95, 1.0, 1.15), (-0.004, 0.0, 0.003)
        lines = zip(weights, widths, colours, (-0.5, 0.0, 0.5), strict=True)
        for weight, sigma, colour, step in lines:
            real = off * (1 + colour) + shift + step * prism
            for part, width, at in ((0.75, sigma, real), (0.25, 1.2 * sigma, real + flare)):
                x, y = (
                    np.diff(
                        ndtr((1.55 * (np.arange(n + 1) - n / 2) - one[:, None]) / width), axis=1
                    )
                    for n, one in zip(shape[::-1], at.T, strict=True)
                )
                light = area * (1 - 0.1 * share2[:, 0] * (1 + 0.1 * (step + 0.5)))
                image += weight * part * np.einsum("p,py,px->yx", light, y, x) / len(real)
    return image


def sensor(rows: int = 96, cols: int = 128, **changes: object) -> Sensor:
    """Return the middle of the demonstration sensor, without veiling glare.

    Unchecked: tests of one stage combine what no sensor has, two gains beside their steps.
    """
    part = load_sensor("imx477").roi(rows, cols)
    return part.unchecked(**{"veiling_glare": 0.0, **changes})


def monochrome(rows: int = 96, cols: int = 128, **changes: object) -> Sensor:
    """Return a sensor without colour filters: one site, one channel."""
    green = load_sensor("imx477").quantum_efficiency
    one = QuantumEfficiency(
        wavelengths_nm=green.wavelengths_nm, channels={"W": green.channels["G"]}
    )
    pattern = ColourFilterArray(pattern=[["W"]])
    return sensor(rows, cols, **{"cfa": pattern, "quantum_efficiency": one, **changes})


@dataclass(frozen=True)
class StubCamera:
    """What the chain asks of a camera."""

    lens_bank: FieldBank
    sensor: Sensor
    title: str = "a small camera"
    lens: object = field(default_factory=lambda: SimpleNamespace(title="Gaussians"))

    def bank(self, progress: object = None) -> FieldBank:
        """Return the bank."""
        return self.lens_bank

    @property
    def frame(self) -> Frame:
        """What a chart is laid out for."""
        return Frame.of(self.sensor, self.lens_bank.principal_distance_mm)


def at_lines(lens: FieldBank, weights: np.ndarray) -> np.ndarray:
    """Return rates (J, C, L, 61) of light at the wavelengths of the bank alone."""
    rates = np.zeros((*weights.shape, WAVELENGTHS_NM.size))
    for place, line in enumerate(lens.wavelengths_nm):
        rates[..., place, list(WAVELENGTHS_NM).index(line)] = weights[..., place]
    return rates


FLAT = np.full(WAVELENGTHS_NM.size, 1e-3)  # W m^-2 sr^-1 nm^-1, the order of a lit room
RED = FLAT * (0.1 + 0.9 / (1 + np.exp((600 - WAVELENGTHS_NM) / 15)))
BLUE = FLAT * (0.1 + 0.9 / (1 + np.exp((WAVELENGTHS_NM - 480) / 15)))


def scene(
    primitives: tuple[Rect | Disc, ...] = (), spectra: np.ndarray | None = None, background: int = 0
) -> Scene:
    """Return a chart; its materials are white, dark, red and blue unless spectra are given."""
    if spectra is None:
        spectra = np.stack([FLAT, 0.1 * FLAT, RED, BLUE])
    names = tuple(f"material {number}" for number in range(len(spectra)))
    return Scene("made up", spectra, Chart(names, background, primitives), "E", FLAT)


def shapes() -> tuple[Rect | Disc, ...]:
    """Return shapes of all kinds over the field, one within another, in half-heights."""
    return (
        Rect(-0.6, -0.35, 0.42, 0.34, 0.1, 1),
        Disc(-0.62, -0.35, 0.2, 2),
        Rect(0.45, 0.3, 0.5, 0.3, -0.3, 3),
        Rect(0.45, 0.3, 0.2, 0.15, 0.6, 0),
        Disc(0.7, -0.5, 0.15, 1),
    )


def convolve_for(
    device: Device, grid: SimGrid, site_channels: list[int], channels: int
) -> Convolve:
    """Return the kernels of a sim grid as the chain makes them, without any PSF nodes."""
    nothing = FieldKernels(
        np.zeros((3, 1, channels, 4, 4), np.float32), Heights(np.array([0.0, 1.0])), 0.5
    )
    return Convolve(device, Scale("test", grid, 1.0, 0.0, nothing), {}, 1.0, site_channels)


def pieces_of(g, count: int = 24) -> np.ndarray:
    """Return a map u = x g(|x|^2 / R^2) as of `gpusim.reference.chief_ray`: pieces (n, 4), float32.

    `g`: coefficients of a polynomial, low to high. The pieces are a cubic spline's, near it.
    """
    knots = np.linspace(0, 1, count + 1)
    spline = CubicSpline(knots, np.polynomial.Polynomial(g)(knots) - 1)
    pieces = spline.c[::-1].T / float(count) ** np.arange(4)
    return pieces.astype(np.float32).astype(float)


def bent(seed: int, cells: int, radius: float, bend: float = 0.1) -> np.ndarray:
    """Return a map (n + 3, n + 3, 2) as of `gpusim.reference.chief_ray`, in samples, near u = x.

    `bend` is what it changes at most, over the radius; in different ways along x and y.
    """
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    line = (np.arange(cells + 3) - 1) / cells * 2 - 1
    x, y = line[:, None], line[None]
    waves = [
        np.sin(1.1 * x + one) * np.cos(1.7 * y + two) + 0.5 * np.sin(0.9 * x * y + three)
        for one, two, three in phase
    ]
    return np.stack(waves, axis=-1).astype(np.float32) * np.float64(np.float32(bend * radius / 1.5))


def shader_terms(distortion: np.ndarray) -> np.ndarray:
    """Return a map's numbers in the order of shaders/common/chief_ray."""
    rows = distortion.reshape(-1, distortion.shape[-1])
    return np.pad(rows, ((0, 0), (0, 4 - rows.shape[1]))).astype(np.float32)


def twiddles(length: int) -> np.ndarray:
    """Return exp(-2 pi i n / T), rounded to complex64."""
    return np.exp(-2j * np.pi * np.arange(length) / length).astype(np.complex64)


def complex_noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Return complex numbers with parts from -1 to 1, complex64."""
    parts = rng.uniform(-1, 1, (*shape, 2)).astype(np.float32)
    return parts.view(np.complex64)[..., 0]
