"""What the sim grid costs: it folds the scene's finest detail back, and its band ends.

A Gaussian G low-passes a scene a, which is sampled at a pitch p. The samples' spectrum is that of
the scene at f and, folded onto it, at f + k / p (Shannon 1949; Bracewell 2000, ch. 10). The kernels
are the PSF's spectrum H times the aperture's S, with the Gaussian divided out, up to the grid's
band B. So what a pixel sees errs by

    E(f) = sum_k A(f + k / p) G(f + k / p) / G(f) B(f) H(f) S(f) - A(f) H(f) S(f),

k = 0 included: what is left of it is the band's end, A H S (B - 1). B is 0 from 1 / (2 p) on.

A scene's spectrum differs from place to place, and so do the PSFs. So E is worked out where a
certificate would look: in patches of the scene around its steepest places, by transforms of a few
pixels, and turned back into the errors of pixels over what they see.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.optics.kernels import low_pass
from gpusim.parallel import each
from gpusim.plan.steep import steep_places
from gpusim.psf.places import Places
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.sensor.aperture import Response
from gpusim.sensor.sensor import Sensor

FINE = 4  # samples of a patch in one of the sim grid: its spectrum to four times the band's end
# Side of a patch, pixels: of a coarse grid the band's end rings over more of them.
PATCH_PX, COARSE_PATCH_PX = 16, 32
COARSE = 2  # samples a pixel up to which a grid is coarse
FINE_SIGMA = 0.8  # of the Gaussian by which a chart's patch is drawn, samples of it
STEEPEST = 0.9  # of the largest step between pixels, from which on a pixel counts as steepest
WHOLE = 0.25  # of a photograph's samples: patches that see more share a spline of all
ROUNDING = 1e-9  # of a pitch: what counts as equal


@dataclass(frozen=True, eq=False)
class Alias:
    """A scene before a lens and a sensor, whose sim grid is to be chosen.

    Attributes
    ----------
    images : ndarray (F, J, C, n, n)
        Channel kernels on the bank's grid, as `gpusim.optics.images.field_images` returns them.
    places : Places
        Places of the F fields.
    bank_pitch_um : float
    sensor : Sensor
    placed : Chart or PlacedRaster
        On the sensor, um on the ideal plane.
    coefficients : ndarray (M, J)
        Coefficients of the scene's spectra in the planes.
    chief_ray : ChiefRayMap
    sigma : float
        Sigma of the Gaussian, sim samples; 0 for none.
    period : int
        Pixels between two of one colour, along an axis.
    """

    images: np.ndarray
    places: Places
    bank_pitch_um: float
    sensor: Sensor
    placed: Chart | PlacedRaster
    coefficients: np.ndarray
    chief_ray: ChiefRayMap
    sigma: float
    period: int

    def error(self, oversampling: int) -> float:
        """Predict the root mean square error of the certificate's probes, relative to the signal.

        Half of them lie on the steepest edges.
        """
        if not self._sites:
            return 0.0
        found = each(lambda site: self._at(site[0], oversampling), self._sites)
        counts = [count for _, count in self._sites]
        return float(np.sqrt(np.average(np.square(found), weights=counts)))

    def _at(self, place: tuple[float, float], oversampling: int) -> float:
        """Return the same of the patch around a place (x, y), um on the real plane."""
        pitch, side = self.sensor.pixel_pitch_um, _side(oversampling)
        fine = side * max(FINE * oversampling, 2 * FINE)
        origin = self._corner(place, side)
        step = side * pitch / fine
        line = (np.arange(fine) + 0.5) * step
        x, y = np.meshgrid(origin[0] + line, origin[1] + line)
        shares = self._scene(x, y, step)
        f = scipy.fft.fftfreq(fine, step)
        # The first sample lies half a step from the corner.
        turn = np.exp(-1j * np.pi * f * step)
        worst = []
        for channel, rates in enumerate(self._rates):
            values = np.tensordot(rates, shares, axes=1)
            mean = float(values.mean())
            spectrum = scipy.fft.fft2(_window(fine) * (values - mean)) / fine**2
            spectrum *= turn * turn[:, None]
            if isinstance(self.placed, Chart):
                blur = np.exp(2 * (np.pi * FINE_SIGMA * step * f) ** 2)
                spectrum *= blur * blur[:, None]
            elif self.placed.pitch_um < (1 - ROUNDING) * pitch / oversampling:
                spectrum = _reduced(spectrum, f, pitch / oversampling, side * oversampling)
            transfer = self._transfer(place, channel, f)
            sigma = self.sigma * pitch / oversampling
            given = {"pitch": pitch, "oversampling": oversampling, "side": side, "sigma": sigma}
            signal, error = _through(spectrum, transfer, f, **given)
            worst.append(_relative(mean + signal, error, self.period))
        return float(np.sqrt(np.mean(np.square(worst))))

    def _corner(self, place: tuple[float, float], side: int) -> list[float]:
        """Return x and y of a patch's corner: between pixels, about a place."""
        pitch, sensor = self.sensor.pixel_pitch_um, self.sensor
        return [
            (round(at / pitch + count / 2) - side // 2 - count / 2) * pitch
            for at, count in zip(place, (sensor.cols, sensor.rows), strict=True)
        ]

    @cached_property
    def _rates(self) -> np.ndarray:
        """Return the electrons/s of each spectrum in each channel (C, M), on the axis."""
        sums = self.images[self.places.main][:1].sum(axis=(-2, -1), dtype=np.float64)[0]
        return (self.coefficients @ sums).T

    def _transfer(self, place: tuple[float, float], channel: int, f: np.ndarray) -> np.ndarray:
        """Return the PSF's and the aperture's transfer function [fy, fx] at a place, 1 at 0."""
        blend = self.places.at(*place)
        number = blend.fields[int(np.argmax(blend.weights))]
        spectrum = self._spectra(number, channel)
        fx, fy = f, f[:, None]
        tangential, sagittal = blend.cos * fx + blend.sin * fy, blend.cos * fy - blend.sin * fx
        inside = np.maximum(np.abs(tangential), np.abs(sagittal)) < 0.5 / self.bank_pitch_um
        at = np.stack([sagittal[inside], tangential[inside]]) * (len(spectrum) * self.bank_pitch_um)
        found = np.zeros(inside.shape, np.complex64)
        found[inside] = map_coordinates(spectrum, at, order=1, mode="grid-wrap")
        aperture = self.sensor.response_um
        if isinstance(aperture, Response):
            return found * aperture.spectrum(fx, fy)
        return found * np.sinc(fx * aperture) * np.sinc(fy * aperture)

    def _spectra(self, number: int, channel: int) -> np.ndarray:
        """Return the spectrum (2 n, 2 n) of a field's kernel of the first plane."""
        if (number, channel) not in self._kept:
            image = self.images[number, 0, channel].astype(np.float64)
            n = len(image)
            padded = np.pad(image / image.sum(), n // 2)
            self._kept[number, channel] = scipy.fft.fft2(scipy.fft.ifftshift(padded)).astype(
                np.complex64
            )
        return self._kept[number, channel]

    @cached_property
    def _kept(self) -> dict[tuple[int, int], np.ndarray]:
        return {}

    # The scene

    def _scene(self, x: np.ndarray, y: np.ndarray, step_um: float) -> np.ndarray:
        """Return the shares of the scene's spectra (M, rows, cols) at points of the real plane."""
        u, v = self.chief_ray.ideal_um(np.stack([x, y], axis=-1).reshape(-1, 2)).T
        u, v = u.reshape(x.shape), v.reshape(x.shape)
        if not isinstance(self.placed, Chart):
            return self._spline(u, v)
        stretch = np.sqrt(abs(np.ptp(u) * np.ptp(v) / (np.ptp(x) * np.ptp(y))))
        width = FINE_SIGMA * step_um * stretch
        shares = np.zeros((len(self.coefficients), *x.shape))
        shares[self.placed.background] = 1.0
        # What each column sees of u, and each row of v: a shape is drawn where it can be seen.
        columns, rows = (u.min(axis=0), u.max(axis=0)), (v.min(axis=1), v.max(axis=1))
        for shape, under in zip(self.placed.primitives, self.placed.under, strict=True):
            reach = shape.reach + 8 * width  # beyond, its share is below 1e-15
            part = _within(rows, shape.cy, reach), _within(columns, shape.cx, reach)
            if u[part].size:
                covered = ndtr(-shape.distance(u[part], v[part]) / width)
                shares[(shape.material, *part)] += covered
                shares[(under, *part)] -= covered
        return shares

    def _spline(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        placed = self.placed
        at = [
            (v - placed.y0_um) / placed.pitch_um - 0.5,
            (u - placed.x0_um) / placed.pitch_um - 0.5,
        ]
        ranges = []
        for line, size in zip(at, placed.planes.shape[1:], strict=True):
            np.clip(line, 0, size - 1, out=line)
            ranges.append(range(max(int(line.min()) - 2, 0), min(int(line.max()) + 4, size)))
        if math.prod(map(len, ranges)) > WHOLE * math.prod(placed.planes.shape[1:]):
            splines, there = self._whole_spline, at
        else:
            splines = placed.spline_in(*ranges)
            there = [line - part.start for line, part in zip(at, ranges, strict=True)]
        given = {"order": 3, "prefilter": False, "mode": "mirror"}
        return np.stack([map_coordinates(one, there, **given) for one in splines])

    @cached_property
    def _whole_spline(self) -> np.ndarray:
        return self.placed.spline_coefficients()

    @cached_property
    def _sites(self) -> list[tuple[tuple[float, float], int]]:
        """Return places (x, y) on the real plane where the scene is steep, each with its weight."""
        return steep_places(self.placed, self.chief_ray, self.sensor, self._rates)


def _side(oversampling: int) -> int:
    """Return the pixels across a patch."""
    return COARSE_PATCH_PX if oversampling <= COARSE else PATCH_PX


@lru_cache(maxsize=4)
def _window(count: int) -> np.ndarray:
    """Return a window over a patch: flat in its middle half, a raised cosine beyond."""
    place = np.abs((np.arange(count) + 0.5) / count - 0.5)
    line = 0.5 * (1 + np.cos(np.pi * np.clip(4 * place - 1, 0, 1)))
    return line * line[:, None]


def _reduced(spectrum: np.ndarray, f: np.ndarray, step: float, count: int) -> np.ndarray:
    """Return the spectrum of the nearest spline of a wider pitch: see `PlacedRaster`.

    Least squares (Unser 1999, eq. 24), by its transfer function and the images that it leaves.
    """
    spline = np.sinc(f * step) ** 4
    times = len(f) // count
    square = (spline**2).reshape(times, count).sum(axis=0)
    fitted = _folded(spectrum * spline * spline[:, None], f, step, count)
    fitted /= square * square[:, None]
    back = spline * np.exp(-1j * np.pi * f * step)
    return np.tile(fitted, (times, times)) * back * back[:, None]


def _folded(spectrum: np.ndarray, f: np.ndarray, step: float, count: int) -> np.ndarray:
    """Return the transform (count, count) of what lies at the middles of steps from the corner.

    Frequencies that such samples do not tell apart add up.
    """
    turn = np.exp(1j * np.pi * f * step)
    turned = spectrum * turn * turn[:, None]
    times = len(f) // count
    return turned.reshape(times, count, times, count).sum(axis=(0, 2))


def _through(
    spectrum: np.ndarray,
    transfer: np.ndarray,
    f: np.ndarray,
    *,
    pitch: float,
    oversampling: int,
    side: int,
    sigma: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the pixels of a patch see, and by how much the sim grid errs: (side, side).

    Parameters
    ----------
    spectrum, transfer : ndarray [fy, fx]
        Spectrum of the scene from the patch's corner; transfer of all that blurs it.
    f : ndarray
        Frequencies along an axis.
    pitch : float
        Pitch of the pixels.
    oversampling, side : int
        Sim samples a pixel, and pixels a side.
    sigma : float
        Sigma of the Gaussian, in the unit of the pitch.
    """
    true = spectrum * transfer
    error = -true
    count, step = side * oversampling, pitch / oversampling
    gauss = np.exp(-2 * (np.pi * sigma * f) ** 2)
    folded = _folded(spectrum * gauss * gauss[:, None], f, step, count)
    band = np.r_[: count // 2, len(f) - count // 2 : len(f)]
    of_band = f[band]
    back = np.exp(-1j * np.pi * of_band * step) / gauss[band]
    inside = np.ix_(band, band)
    limit = low_pass(np.hypot(of_band, of_band[:, None]), step)
    error[inside] += folded * back * back[:, None] * limit * transfer[inside]
    return tuple(
        scipy.fft.ifft2(_folded(one, f, pitch, side)).real * side**2 for one in (true, error)
    )


def _relative(signal: np.ndarray, error: np.ndarray, period: int) -> float:
    """Return the root mean square error of a patch's probes over their signal.

    Half of them lie anywhere in its middle, half where the step to the last pixel of the same
    colour is largest.
    """
    quarter = len(signal) // 4
    inner = np.s_[quarter:-quarter, quarter:-quarter]
    floor = 1e-12 * float(np.abs(signal).max()) + 1e-300
    squares = (error / np.maximum(signal, floor)) ** 2
    steps = np.maximum(
        *(np.abs(signal - np.roll(signal, period, axis=axis))[inner] for axis in (0, 1))
    )
    squares = squares[inner]
    steepest = steps >= STEEPEST * steps.max()
    return float(np.sqrt((squares[steepest].mean() + squares.mean()) / 2))


def _within(span: tuple[np.ndarray, np.ndarray], middle: float, reach: float) -> slice:
    """Return the lines, each from a least to a largest value, that come within reach of a value."""
    seen = np.flatnonzero((span[1] > middle - reach) & (span[0] < middle + reach))
    return slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(0)
