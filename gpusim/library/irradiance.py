"""Spectral irradiance on a sensor: out of the optics, and into the sensor in their place.

A band is the mean of the irradiance by a tent about its wavelength, which reaches to the next bands
on either side; of the first and the last one as far beyond as within, where the chain goes on
there. Going back, the irradiance is
linear between bands, which is the same tents.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.config.arrays import MOST_BYTES, read_npz
from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.isp.lens_tags import Optics
from gpusim.library.expose import expose
from gpusim.library.light import Light
from gpusim.plan.stages import sensor_runs
from gpusim.plan.tiles import aligned
from gpusim.render.reading import lit_for, taken_for
from gpusim.render.recipe import exact, made_by
from gpusim.scene.bands import RADIANCE
from gpusim.scene.chart import Chart
from gpusim.scene.exr import units_of
from gpusim.scene.spectra import STEP_NM, WAVELENGTHS_NM
from gpusim.scene.spectral_exr import read_spectral_exr, write_spectral_exr
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.checks import MAX_CHANNELS
from gpusim.sensor.planes import PERIODS, planes_of
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.camera import Camera
    from gpusim.scene.scene import Scene

PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299792458.0  # exact in the SI of 2019
FINE_NM = 1.0  # step in which quantum efficiencies are integrated against tents
WHITE_SHARE = 0.99  # of the pixels, which are darker than what counts for white
LEAST_NM, MOST_NM = 200.0, 1200.0
LARGEST_W_M2_NM = 1e9
# Channels at once of a photograph: a highlight's tables of so many fit one binding of 128 MiB,
# for PSFs of up to 512 samples.
BESIDE_HIGHLIGHTS = 4
# What of a sensor its bands are seen with: its pixels, what is in front of them, and no effect.
OF_LIGHT = (
    "name",
    "rows",
    "cols",
    "first_row",
    "first_col",
    "pixel_pitch_um",
    "fill_factor",
    "system_gain_dn_per_e",
    "black_level_dn",
    "bit_depth",
    "full_well_e",
    "temporal_dark_noise_e",
    "dark_current_e_per_s",
    "reference_temperature_c",
    "doubling_temperature_c",
    "dsnu_e",
    "prnu_percent",
    "veiling_glare",
    "filters",
    "aperture",
    "scan_motion_px",
)
UNITS = "W m^-2 nm^-1"
ALLOWED = (
    "an .npz with irradiance_w_m2_nm (rows, cols, bands) and wavelengths_nm (bands,); or a "
    f"spectral .exr with units {UNITS}"
)


@dataclass(frozen=True, eq=False)
class Irradiance:
    """Spectral irradiance on the photosites of a sensor.

    Attributes
    ----------
    values : ndarray (rows, cols, bands), float32
        W m^-2 nm^-1, the mean over each pixel's aperture, behind all filters but the sensor's own.
    wavelengths_nm : ndarray (bands,)
        Rising.
    path : Path or None
        The file that it was read from.

    Raises
    ------
    UserError
        Shapes that do not fit, wavelengths that do not rise, or what is no light.

    Examples
    --------
    >>> import numpy as np
    >>> import gpusim as gs
    >>> even = gs.Irradiance(np.full((24, 32, 2), 1e-4, np.float32), np.array([400.0, 700.0]))
    >>> even.save("even.npz")
    >>> gs.Irradiance.load("even.npz")
    Irradiance(32 x 24 pixels, 2 bands, 400 to 700 nm)
    """

    values: np.ndarray
    wavelengths_nm: np.ndarray
    path: Path | None = None

    def __post_init__(self) -> None:
        """Check shapes and numbers."""
        values, lines = np.asarray(self.values), np.asarray(self.wavelengths_nm, np.float64)
        if values.ndim != 3 or lines.shape != values.shape[2:] or values.size == 0:
            raise _wrong("shapes that do not fit", f"{values.shape} and {lines.shape}")
        if lines.size < 2 or not (np.diff(lines) > 0).all():
            raise _wrong("wavelengths that do not rise", f"{lines.size} of them")
        if not (lines[0] >= LEAST_NM and lines[-1] <= MOST_NM):
            said = f"{lines[0]:g} to {lines[-1]:g} nm"
            raise _wrong(f"wavelengths beyond {LEAST_NM:g} to {MOST_NM:g} nm", said)
        if not (values.dtype.kind in "fiu" and 0 <= values.min() <= values.max() < LARGEST_W_M2_NM):
            raise _wrong("values that are no irradiance", f"{values.min()} to {values.max()}")

    def __repr__(self) -> str:
        rows, cols, bands = self.values.shape
        first, last = self.wavelengths_nm[[0, -1]]
        return f"Irradiance({cols} x {rows} pixels, {bands} bands, {first:g} to {last:g} nm)"

    @classmethod
    def of(
        cls,
        camera: Camera,
        scene: Scene,
        wavelengths_nm: Sequence[float],
        tolerance: float | str = 1e-3,
        *,
        tile: tuple[int, int, int, int] | None = None,
        progress: Callable[[str, int, int], None] | None = None,
    ) -> Irradiance:
        """Return what a camera's optics bring onto its sensor.

        Parameters
        ----------
        camera : Camera
        scene : Scene
        wavelengths_nm : sequence of float
            Middles of the bands, rising; multiples of 5 nm, in which the chain counts.
        tolerance : float or str
            As of `gpusim.expose`.
        tile : (x, y, width, height), optional
            The rectangle of lit pixels to make.
        progress : callable, optional
            Called with (what, done, total).

        Raises
        ------
        UserError
            As of `gpusim.expose`, or wavelengths that do not rise or are none of these.

        Examples
        --------
        >>> import gpusim as gs
        >>> small = gs.Camera.load("mtf-only")
        >>> small = gs.Camera(small.lens, small.sensor.roi(24, 32), "small")
        >>> gs.Irradiance.of(small, gs.Scene.load("colorchecker"), [450, 550, 650], 1e-2)
        Irradiance(32 x 24 pixels, 3 bands, 450 to 650 nm)
        """
        lines = np.asarray(wavelengths_nm, np.float64)
        cls(np.zeros((1, 1, lines.size)), lines)  # refuses what is none
        sensor = camera.sensor
        area_m2 = sensor.fill_factor * (1e-6 * sensor.pixel_pitch_um) ** 2
        if (lines % STEP_NM).any():
            raise UserError(
                "bands between the wavelengths in which the chain counts",
                field="wavelengths_nm",
                value=", ".join(f"{one:g}" for one in lines[lines % STEP_NM > 0]),
                allowed=f"multiples of {STEP_NM:g} nm",
            )
        beyond = [2 * lines[0] - lines[1], *lines, 2 * lines[-1] - lines[-2]]
        first, last = WAVELENGTHS_NM[[0, -1]]
        fine = np.arange(min(lines[0], first), max(lines[-1], last) + STEP_NM, STEP_NM)
        tents = np.stack([np.interp(fine, beyond, one) for one in np.eye(len(beyond))[1:-1]])
        # A quantum efficiency that falls as 1/wavelength counts joules in place of photons.
        curves = tents * fine[0] / fine
        joules = PLANCK_J_S * LIGHT_M_S / (1e-9 * fine[0]) / area_m2
        spans = np.trapezoid(tents, fine, axis=1)
        rates = band_images(camera, scene, fine, curves, tolerance, tile=tile, progress=progress)
        return cls(np.ascontiguousarray((rates * joules) / spans, np.float32), lines)

    def light(self, sensor: Sensor, title: str = "irradiance") -> Light:
        """Return the light that it is to a sensor, which reads it: see `Light.capture`.

        White, for exposure and white balance, is the mean of the brightest hundredth.

        Raises
        ------
        UserError
            It has another size than the lit pixels of the sensor, or the sensor's quantum
            efficiency goes with the angle of light.

        Examples
        --------
        >>> import numpy as np
        >>> import gpusim as gs
        >>> even = gs.Irradiance(np.full((24, 32, 2), 1e-4, np.float32), np.array([400.0, 700.0]))
        >>> even.light(gs.Sensor.load("imx477").roi(24, 32)).capture(1/100).raw.shape
        (24, 32)
        """
        if self.values.shape[:2] != (sensor.rows, sensor.cols):
            raise UserError(
                "the irradiance is of another size than the sensor",
                field="irradiance",
                value=f"{self.values.shape[1]} x {self.values.shape[0]}",
                allowed=f"{sensor.cols} x {sensor.rows} pixels",
            )
        if sensor.eqe_map is not None:
            raise UserError(
                "an irradiance says nothing of angles",
                field="sensor.eqe_map",
                allowed="a sensor with one quantum efficiency for all angles",
            )
        counted = self._counted(sensor)
        planes, runs, rect = planes_of(sensor), sensor_runs(sensor), sensor.frame.read
        area = aligned(lit_for(taken_for(rect, sensor, runs), sensor, runs), planes.period)
        row, col, rows, cols = area
        beyond = max(row + rows - sensor.rows, 0), max(col + cols - sensor.cols, 0)
        whole = np.pad(self.values, ((0, beyond[0]), (0, beyond[1]), (0, 0)), mode="edge")
        seen, period = whole[row : row + rows, col : col + cols], planes.period
        places = [divmod(n, period) for n in range(period**2)] if period > 1 else None
        rates = np.stack(
            [
                seen[slice(*(places[n][0] if places else 0, None, period)),
                     slice(*(places[n][1] if places else 0, None, period))] @ counted[channel]
                for n, channel in enumerate(planes.channels)
            ]
        )  # fmt: skip
        total = self.values.sum(axis=2)
        white = self.values[total >= np.quantile(total, WHITE_SHARE)].mean(axis=0)
        return Light(
            title=title,
            scene=title,
            sensor=sensor,
            rect=rect,
            area=area,
            rates=rates.astype(np.float32),
            glare=np.zeros(sensor.period[0] * sensor.period[1], np.float32),
            white_e_per_s=dict(zip(sensor.channels, map(float, counted @ white), strict=True)),
            transmission=np.ones(61),
            optics=Optics(title, 0.0, 0.0, *(np.zeros(0) for _ in range(3))),
            tolerance="none: an irradiance that was given",
            recipe=self._recipe(sensor, title),
        )

    def _recipe(self, sensor: Sensor, title: str) -> dict[str, Any]:
        """Return what makes its light again: see `gpusim.render.recipe`."""
        found = hashlib.blake2b(digest_size=16)
        for values in (self.values, self.wavelengths_nm):
            found.update(np.ascontiguousarray(values).data)
        camera = {"title": title, "lens": None, "sensor": sensor.model_dump(mode="json")}
        return exact(
            {
                "camera": camera,
                "irradiance": None if self.path is None else str(self.path.resolve()),
                "made_by": made_by(default_device().report(), irradiance=found.hexdigest()),
            }
        )

    def _counted(self, sensor: Sensor) -> np.ndarray:
        """Return the electrons/s of a unit in each band: (channels, bands)."""
        fine, tents = _tents(self.wavelengths_nm)
        own = sensor.quantum_efficiency
        area_m2 = sensor.fill_factor * (1e-6 * sensor.pixel_pitch_um) ** 2
        photons = area_m2 * 1e-9 * fine / (PLANCK_J_S * LIGHT_M_S)
        curves = [
            np.interp(fine, own.wavelengths_nm, own.channels[name]) for name in sensor.channels
        ]
        return np.asarray(np.trapezoid(np.stack(curves)[:, None] * photons * tents, fine, axis=2))

    def save(self, path: str | Path) -> None:
        """Write it to an ``.npz``, or an ``.exr`` with a channel for each band.

        Raises
        ------
        UserError
            Another suffix, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() == ".exr":
            write_spectral_exr(path, self.values, self.wavelengths_nm, UNITS)
            return
        if path.suffix.lower() != ".npz":
            raise UserError("no such kind of file", file=path, allowed=".npz, .exr")
        try:
            np.savez(path, irradiance_w_m2_nm=self.values, wavelengths_nm=self.wavelengths_nm)
        except OSError as error:
            raise UserError(
                f"the irradiance cannot be written: {error.strerror}", file=path
            ) from error

    @classmethod
    def load(cls, path: str | Path) -> Irradiance:
        """Read what `save` writes, or another program.

        An ``.npz`` has irradiance_w_m2_nm (rows, cols, bands) and wavelengths_nm (bands,); an
        ``.exr`` a channel for each band, and ``units`` of W m^-2 nm^-1.

        Raises
        ------
        UserError
            There is none, or it is no irradiance.
        """
        path = Path(path)
        if not os.path.isfile(path):
            raise UserError("no such irradiance", file=path, allowed=ALLOWED)
        try:
            if path.suffix.lower() == ".exr":
                return cls(*_of_exr(path), path)
            arrays = read_npz(path)
            return cls(arrays["irradiance_w_m2_nm"], arrays["wavelengths_nm"], path)
        except UserError as error:
            error.file = path
            raise
        except Exception as error:  # whatever a broken archive makes of NumPy and zipfile
            raise UserError(f"no irradiance: {error}", file=path, allowed=ALLOWED) from None


def is_irradiance(path: Path) -> bool:
    """Return whether a file is one of irradiance: an .npz, or an .exr that says so."""
    if path.suffix.lower() == ".exr" and os.path.isfile(path):
        return units_of(path) == UNITS
    return path.suffix.lower() == ".npz"


def _of_exr(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return values (rows, cols, bands) and wavelengths of a spectral EXR of irradiance."""
    units = units_of(path)
    if units != UNITS:
        raise _wrong("an EXR of something else", f"units {units or 'not said'}")
    bands = read_spectral_exr(path, most=MOST_BYTES // 4)
    if bands.kind != RADIANCE:
        raise _wrong("channels of no light", bands.kind)
    return np.ascontiguousarray(np.moveaxis(bands.planes, 0, -1)), bands.wavelengths_nm


def band_images(
    camera: Camera,
    scene: Scene,
    wavelengths_nm: np.ndarray,
    curves: np.ndarray,
    tolerance: float | str,
    *,
    tile: tuple[int, int, int, int] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> np.ndarray:
    """Return full images without a filter array, electrons/s: (rows, cols, curves).

    Parameters
    ----------
    camera : Camera
    scene : Scene
    wavelengths_nm : ndarray (K,)
    curves : ndarray (curves, K)
        Quantum efficiency of every pixel, image by image; filters apart.
    tolerance, tile, progress
        As of `gpusim.expose`.
    """
    found = []
    whole = tile or (0, 0, camera.sensor.cols, camera.sensor.rows)
    most = MAX_CHANNELS if isinstance(scene.source, Chart) else BESIDE_HIGHLIGHTS
    for first in range(0, len(curves), most):
        part = curves[first : first + most]
        seen = without_array(camera, wavelengths_nm, part)
        light = expose(seen, scene, tolerance, probes=0, tile=whole, progress=progress)
        found.append(on_tile(light, whole) + light.glare[: len(part), None, None])
    return np.concatenate(found).transpose(1, 2, 0)


def without_array(camera: Camera, wavelengths_nm: np.ndarray, curves: np.ndarray) -> Camera:
    """Return a camera whose light has a plane of all pixels for each curve: see `band_images`."""
    sensor = camera.sensor
    names = [f"W{number:02d}" for number in range(len(curves))]
    # A period that no grid has: each channel is a plane of all pixels: see `planes_of`.
    length = next(n for n in count(len(curves)) if n not in PERIODS)
    pattern = ((*names, *names[:1] * (length - len(names))),)
    efficiency = QuantumEfficiency(
        wavelengths_nm=tuple(map(float, wavelengths_nm)),
        channels={name: tuple(map(float, one)) for name, one in zip(names, curves, strict=True)},
    )
    fields = {name: getattr(sensor, name) for name in OF_LIGHT}
    bare = Sensor(**fields, cfa=ColourFilterArray(pattern=pattern), quantum_efficiency=efficiency)
    return type(camera)(camera.lens, bare, camera.title)


def on_tile(light: Light, tile: tuple[int, int, int, int]) -> np.ndarray:
    """Return the planes (S, rows, cols) of a light that has one for every pixel, on its tile."""
    x, y, width, height = tile
    top, left = y - light.area[0], x - light.area[1]
    return light.rates[:, top : top + height, left : left + width]


def _tents(lines_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return fine wavelengths, and the tent of each band there: (bands, wavelengths)."""
    steps = max(int(np.ceil((lines_nm[-1] - lines_nm[0]) / FINE_NM)), 1)
    fine = np.union1d(np.linspace(lines_nm[0], lines_nm[-1], steps + 1), lines_nm)
    return fine, np.stack([np.interp(fine, lines_nm, one) for one in np.eye(len(lines_nm))])


def _wrong(problem: str, value: str) -> UserError:
    return UserError(problem, field="irradiance", value=value, allowed=ALLOWED)
