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

import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.optics.kernels import low_pass
from gpusim.psf.places import Places
from gpusim.scene.chart import Chart, Polygon, Primitive, Rect
from gpusim.scene.raster import PlacedRaster
from gpusim.sensor.aperture import Response
from gpusim.sensor.sensor import Sensor

FINE = 4  # samples of a patch in one of the sim grid: its spectrum to four times the band's end
# Side of a patch, pixels: of a coarse grid the band's end rings over more of them.
PATCH_PX, COARSE_PATCH_PX = 16, 32
COARSE = 2  # samples a pixel up to which a grid is coarse
FINE_SIGMA = 0.8  # of the Gaussian by which a chart's patch is drawn, samples of it
STEEPEST = 0.9  # of the largest step between pixels, from which on a pixel counts as steepest
RINGS = 3  # of the field, in each of which there are
ALONG = 15  # places along a side that is long beside a ring
PLACES_EACH = 2  # places where an outline is steepest, of different directions
# A photograph is cut into as many cells as a certificate has probes on edges. Few of them, beside
# lamps, may make up all of the sum of squares. So cells are ordered by their steepest step, over
# the darker side's light, and a few are worked out, each of which stands for so many.
CELLS = 128
STANDS_FOR = (1, 1, 2, 2, 4, 4, 8, 8, 16, 16, 32, 34)
WHOLE = 0.25  # of a photograph's samples: patches that see more share a spline of all
MOST_SHAPES = 512  # of a chart, that are looked at
ROUNDING = 1e-9  # of a pitch: what counts as equal
DARK = 1e-4  # of the brightest: nothing is darker where it is a matter of contrast


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
        found = [self._at(place, oversampling) for place, _ in self._sites]
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
            spectrum = scipy.fft.fft2(_window(fine) * (values - mean), workers=2) / fine**2
            spectrum *= turn * turn[:, None]
            if isinstance(self.placed, Chart):
                blur = np.exp(2 * (np.pi * FINE_SIGMA * step * f) ** 2)
                spectrum *= blur * blur[:, None]
            elif self.placed.pitch_um < (1 - ROUNDING) * pitch / oversampling:
                spectrum = _reduced(spectrum, f, pitch / oversampling, side * oversampling)
            transfer = self._transfer(place, channel, f)
            signal, error = _through(
                spectrum, transfer, f, pitch, oversampling, side, self.sigma * pitch / oversampling
            )
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
        radial, tangential = blend.cos * fx + blend.sin * fy, blend.cos * fy - blend.sin * fx
        inside = np.maximum(np.abs(radial), np.abs(tangential)) < 0.5 / self.bank_pitch_um
        at = np.stack([tangential[inside], radial[inside]]) * (len(spectrum) * self.bank_pitch_um)
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
            self._kept[number, channel] = scipy.fft.fft2(
                scipy.fft.ifftshift(padded), workers=2
            ).astype(np.complex64)
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
        if isinstance(self.placed, Chart):
            return [(place, 1) for place in self._at_outlines()]
        return self._at_steps()

    def _at_outlines(self) -> list[tuple[float, float]]:
        """Return where the largest steps of a chart are: in each ring of the field a few."""
        chart, half = self.placed, self._half_um
        corner = np.abs(self.chief_ray.ideal_um(np.array(half)))
        every = -(-len(chart.primitives) // MOST_SHAPES) or 1
        points = [
            (int(under), shape.material, *point)
            for shape, under in zip(chart.primitives[::every], chart.under[::every], strict=True)
            for point in _outline(shape, tuple(corner.tolist()))
        ]
        if not points:
            return []
        outer, inner, u, v, along_u, along_v = np.array(points).T
        outer, inner = outer.astype(int), inner.astype(int)
        rates = self._rates / self._rates.max(axis=1, keepdims=True).clip(1e-300)
        low, high = (np.sort(rates[:, [outer, inner]], axis=1)[:, side] for side in (0, 1))
        contrast = ((high - low) / (low + DARK)).max(axis=0)
        # Straight up or down is one direction, and so is along; an edge of another crosses more.
        turned = np.round(np.degrees(np.arctan2(along_v, along_u))) % 90
        real = self._real(np.stack([u, v], axis=1))
        radius = np.max(np.abs(real) / half, axis=1)
        chosen = []
        for ring in range(RINGS):
            seen: list[float] = []
            inside = (radius >= ring / RINGS) & (radius < (ring + 1) / RINGS)
            order = np.flatnonzero(inside & (contrast > 0))
            for number in order[np.argsort(-contrast[order], kind="stable")]:
                if turned[number] not in seen:
                    seen.append(float(turned[number]))
                    chosen.append(tuple(real[number].tolist()))
                if len(seen) == PLACES_EACH:
                    break
        return chosen

    def _at_steps(self) -> list[tuple[tuple[float, float], int]]:
        """Return where a photograph is steepest in its cells, and for how many each stands."""
        placed = self.placed
        half = np.abs(self.chief_ray.ideal_um(np.array(self._half_um)))
        rates = self._rates.sum(axis=0).astype(np.float32)
        light = np.tensordot(rates, placed.planes.astype(np.float32, copy=False), axes=1)
        light = np.maximum(light, DARK * light.max() + np.float32(1e-30))
        steps = np.zeros(light.shape, np.float32)
        for axis in (0, 1):
            before, after = (np.delete(light, end, axis) for end in (-1, 0))
            step = np.abs(after - before) / np.minimum(before, after)
            steps[tuple(slice(size) for size in step.shape)] += step
        across = math.ceil(math.sqrt(CELLS * half[0] / half[1]))
        down = math.ceil(CELLS / across)
        found = []
        for row in _cut(placed.y0_um, half[1], placed.pitch_um, light.shape[0], down):
            for col in _cut(placed.x0_um, half[0], placed.pitch_um, light.shape[1], across):
                part = steps[row, col]
                if part.size:
                    y, x = np.unravel_index(np.argmax(part), part.shape)
                    x_um = placed.x0_um + (col.start + x + 1) * placed.pitch_um
                    y_um = placed.y0_um + (row.start + y + 1) * placed.pitch_um
                    found.append((float(part[y, x]), x_um, y_um))
        found.sort(reverse=True)
        chosen, first = [], 0
        for count in STANDS_FOR:
            own = found[first : first + count]
            if own:
                _, *place = own[len(own) // 2]
                chosen.append((tuple(self._real(np.array([place]))[0].tolist()), len(own)))
            first += count
        return chosen

    @cached_property
    def _half_um(self) -> tuple[float, float]:
        pitch = self.sensor.pixel_pitch_um
        return self.sensor.cols * pitch / 2, self.sensor.rows * pitch / 2

    def _real(self, ideal_um: np.ndarray) -> np.ndarray:
        """Return about where points (N, 2) of the ideal plane land; beyond the sensor, its edge."""
        half = np.array(self._half_um)
        return np.clip(self.chief_ray.real_um(ideal_um), -half, half)


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


def _outline(shape: Primitive, half_um: tuple[float, float]) -> list[tuple[float, ...]]:
    """Return points of an outline, with the directions outwards.

    Sides that are long beside the frame give several points: their middle may lie beyond it.
    """
    turns = [2.4 * (shape.cx + shape.cy) / shape.reach]  # any direction
    near = min(half_um) / RINGS
    if isinstance(shape, Polygon):
        return _sides(shape, half_um, near)
    if isinstance(shape, Rect):
        found = []
        whole = float(np.hypot(*half_um))
        for quarter in range(4 if shape.reach > near else 2):
            angle = shape.angle_rad + quarter * np.pi / 2
            cos, sin = float(np.cos(angle)), float(np.sin(angle))
            out, along = (shape.half_w, shape.half_h)[:: 1 if quarter % 2 == 0 else -1]
            x, y = shape.cx + out * cos, shape.cy + out * sin
            places = [0.0]
            if along > near:
                # Where the side passes the frame's middle, and as far as the frame reaches.
                middle = x * sin - y * cos
                places += list(np.clip(middle + whole * _middles(ALONG, 1.0), -along, along))
            found += [(x - at * sin, y + at * cos, cos, sin) for at in places]
        return found
    if shape.radius > near:
        turns = list(2 * np.pi * np.arange(ALONG) / ALONG)
    return [
        (shape.cx + shape.radius * cos, shape.cy + shape.radius * sin, cos, sin)
        for cos, sin in ((float(np.cos(turn)), float(np.sin(turn))) for turn in turns)
    ]


def _sides(shape: Polygon, half_um: tuple[float, float], near: float) -> list[tuple[float, ...]]:
    """Return the same of a polygon."""
    found = []
    corners = shape.corners()
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        places = [length / 2]
        if length > 2 * near:
            middle = -float(start @ along)
            reach = float(np.hypot(*half_um)) * _middles(ALONG, 1.0)
            places += list(np.clip(middle + reach, 0.0, length))
        out = (float(along[1]), float(-along[0]))
        found += [(*(start + at * along).tolist(), *out) for at in places]
    return found


def _within(span: tuple[np.ndarray, np.ndarray], middle: float, reach: float) -> slice:
    """Return the lines, each from a least to a largest value, that come within reach of a value."""
    seen = np.flatnonzero((span[1] > middle - reach) & (span[0] < middle + reach))
    return slice(int(seen[0]), int(seen[-1]) + 1) if len(seen) else slice(0)


def _cut(start_um: float, half_um: float, pitch_um: float, size: int, count: int) -> list[slice]:
    """Return the samples of an axis that the sensor sees, cut into so many parts."""
    ends = (np.linspace(-half_um, half_um, count + 1) - start_um) / pitch_um
    at = np.clip(np.round(ends), 0, size).astype(int).tolist()
    return [slice(*pair) for pair in itertools.pairwise(at)]


def _middles(count: int, half: float) -> np.ndarray:
    return (2 * np.arange(count) + 1 - count) / count * half
