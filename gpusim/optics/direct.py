"""Space-variant convolution of one frame as a sum over taps: for small supports.

The same model as `gpusim.optics.convolve`: every source sample is spread by the PSF interpolated
bilinearly between the four nodes of its cell. Only the kernels, pixel aperture and all, are cut to
a support.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.gpu.pool import size_class
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernel_spectra import aperture_spectra
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.nodes import NodeStore, Outputs, Rates, Scale, outputs_of
from gpusim.optics.sampling import sampled_kernels
from gpusim.sensor.aperture import Response

# By how much kernels are sampled beyond the support, sim samples: the aperture and the inverse of
# the scene's Gaussian carry what lies there into it.
MARGIN = 16


@dataclass(frozen=True)
class TapLayout:
    """How shaders/optics/direct lays out a grid's taps; names are its overrides'.

    Attributes
    ----------
    low, high : int
        First and last tap, samples from a source to the photosites' first sample.
    stride : int
        Samples from one of an invocation's eight photosites to the next.
    places, columns : int
        Places of photosites within a stride, over all sites side by side, and how many of them an
        invocation takes.
    offsets : tuple of int
        Offsets of the places, samples.
    groups : int
        vec4f in a line of taps.
    eights : int
        Invocations side by side.
    """

    low: int
    high: int
    stride: int
    places: int
    columns: int
    offsets: tuple[int, ...]
    groups: int
    eights: int

    @property
    def lines(self) -> int:
        """Taps along one axis."""
        return self.high - self.low + 1

    def first_group(self, place: int) -> int:
        """Return the vec4f of the source at which the taps of an invocation's places begin."""
        return (self.offsets[place // self.columns * self.columns] - self.high) // 4


def tap_layout(grid: SimGrid, support: int, outputs: Outputs) -> TapLayout:
    """Lay out taps up to `support` samples from a photosite's centre."""
    shifts = [shift for _, *both in outputs.places for shift in both]
    low, high = math.ceil(-max(shifts) - support), math.floor(support - min(shifts))
    stride, across = max(grid.stride, 4), grid.sites_across
    places = across * stride // grid.stride
    columns = 1 if places % 2 else 2
    offsets = tuple(
        place // across * grid.stride + place % across * outputs.step for place in range(places)
    )
    layout = TapLayout(low, high, stride, places, columns, offsets, 0, 0)
    last = max(
        (offset - low) // 4 - layout.first_group(place) for place, offset in enumerate(offsets)
    )
    groups = math.ceil((last + 1) / (stride // 4)) * (stride // 4)
    eights = math.ceil((grid.block[0] + 2 * grid.half_size) / stride / 8)
    return TapLayout(low, high, stride, places, columns, offsets, groups, eights)


def spatial_kernels(
    sampled: np.ndarray,
    aperture: float | Response,
    sigma: float,
    places: list[tuple[int, float, float]],
    *,
    ringing: bool = False,
) -> np.ndarray:
    """Return what a source sample gives to the photosites around it, aperture folded in.

    Parameters
    ----------
    sampled : ndarray (J, C, 2 R, 2 R)
        As `sampled_kernels` returns them.
    aperture, sigma, ringing
        See `aperture_spectra`; sim samples.
    places
        See `Outputs`.

    Returns
    -------
    ndarray (J, len(places), 2 R, 2 R)
        [d_y, d_x]; d = 0 is at R.
    """
    size = sampled.shape[-1]
    # Even, for the Nyquist frequency to be one sample; padded for the ringing of the aperture.
    length = 2 * scipy.fft.next_fast_len(size // 2 + MARGIN, real=True)
    spectra = scipy.fft.rfft2(sampled, s=(length, length))
    result = np.empty((len(sampled), len(places), size, size))
    for number, (channel, shift_x, shift_y) in enumerate(places):
        through = aperture_spectra(length, aperture, sigma, shift_x, shift_y, ringing=ringing).T
        whole = scipy.fft.irfft2(spectra[:, channel] * through, s=(length, length))
        result[:, number] = whole[:, :size, :size]
    return result


def packed_taps(taps: np.ndarray, layout: TapLayout, across: int, of_site: list[int]) -> np.ndarray:
    """Return taps as shaders/optics/direct reads them.

    Parameters
    ----------
    taps : ndarray (J, kernels, n, n)
        [d_y, d_x] from `layout.low` to `layout.high`.
    layout : TapLayout
    across : int
        Sites side by side.
    of_site : list of int
        Kernel of each site.

    Returns
    -------
    ndarray (J, sites / across, places / columns, n, groups, columns, 4), float32
    """
    columns, lines = layout.columns, layout.lines
    down = len(of_site) // across
    shape = (len(taps), down, layout.places // columns, lines, columns, 4 * layout.groups)
    packed = np.zeros(shape, np.float32)
    backwards = taps[:, :, ::-1, ::-1]
    for row, place in np.ndindex(down, layout.places):
        kernel = of_site[across * row + place % across]
        first = layout.offsets[place] - layout.high - 4 * layout.first_group(place)
        pair, column = divmod(place, columns)
        packed[:, row, pair, :, column, first : first + lines] = backwards[:, kernel]
    return np.moveaxis(packed.reshape(*shape[:-1], layout.groups, 4), 4, 5).copy()


def support_within(
    kernels: FieldKernels,
    pitch_um: float,
    reach_um: float,
    half_um: tuple[float, float],
    allowed: float,
    *,
    oversampling: float,
    aperture_um: float | Response,
    sigma: float,
) -> tuple[int, float]:
    """Return the smallest support that keeps an error, and the error it leaves.

    The error is that of an edge response, of what lies beyond the support: its marginals along x
    and y, low-passed as the scene is, on the axis, at half field and in the corner of the sensor;
    the root of the mean square over these and all channels, relative to what the kernel holds.

    Parameters
    ----------
    kernels : FieldKernels
    pitch_um : float
        Pitch of the sim grid.
    reach_um : float
        As far as the kernels go.
    half_um : (float, float)
        Half the sensor's width and height.
    allowed : float
    oversampling : float
        Samples per pixel.
    aperture_um, sigma
        Side of the pixel aperture; Gaussian low-pass of the scene, sim samples.

    Returns
    -------
    support : int
        Sim samples from a photosite's centre: 2 `support` taps along each axis.
    error : float
    """
    size = math.ceil(reach_um / pitch_um) + MARGIN
    first = (oversampling - 1) / 2
    channels = kernels.splines.shape[2]
    places = [(channel, first, first) for channel in range(channels)]
    at = [
        sampled_kernels(kernels, f * half_um[0], f * half_um[1], pitch_um, size, planes=1)
        for f in (0.0, 0.5, 1.0)
    ]
    spread = np.concatenate(
        [
            spatial_kernels(one, aperture_um / pitch_um, sigma, places, ringing=kernels.ringing)[0]
            for one in at
        ]
    )
    spread /= spread.sum(axis=(1, 2), keepdims=True)
    frequency = scipy.fft.rfftfreq(2 * size)
    smooth = np.exp(-2 * np.pi**2 * sigma**2 * frequency**2)
    whole = [spread.sum(axis=axis) for axis in (1, 2)]

    def error(support: int) -> float:
        kept = slice(math.ceil(size - first - support), math.floor(size - first + support) + 1)
        squares = []
        for axis, marginal in zip((1, 2), whole, strict=True):
            outside = marginal.copy()
            outside[:, kept] -= spread[:, kept, kept].sum(axis=axis)
            edge = np.cumsum(scipy.fft.irfft(scipy.fft.rfft(outside) * smooth, 2 * size), axis=1)
            squares.append(np.abs(edge).max(axis=1) ** 2)
        return float(np.sqrt(np.mean(squares)))

    largest = size - math.ceil(abs(first)) - 1
    # Rings of the inverse Gaussian make the error waver: the smallest of all that keep it.
    for support in range(1, largest):
        found = error(support)
        if found <= allowed:
            return support, found
    return largest, error(largest)


def direct_work(
    grid: SimGrid,
    support: int,
    needed: dict[tuple[int, int], int],
    site_channels: list[int],
) -> int:
    """Return the multiply-adds of a frame, those that meet zeros included."""
    layout = tap_layout(grid, support, outputs_of(grid, site_channels, max(site_channels) + 1))
    across = layout.eights * 8 * layout.stride // grid.stride
    down = grid.block[1] * layout.lines // grid.stride
    each = grid.sites * across * down * 4 * layout.groups * 2
    return each * sum(needed.values())


@dataclass(frozen=True)
class Source:
    """What one block needs on the device: its coefficient planes."""

    planes: Array


class Direct(NodeStore):
    """Taps of one scale, and the pass that uses them: see `KernelStore`.

    Parameters
    ----------
    device : Device
    scale : Scale
        Its grid's `half_size` is a multiple of 4 and exceeds the support by 2 or more; `length`
        only bounds the blocks here, there are no transforms.
    needed : dict
        Coefficient planes that each block needs.
    aperture_um : float or Response
        Side of the square pixel aperture, or any other's response.
    site_channels : list of int
        Colour channel of each CFA site, row by row.
    support : int
        Sim samples from a photosite's centre to the last tap: see `support_within`.
    """

    def __init__(
        self,
        device: Device,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        aperture_um: float | Response,
        site_channels: list[int],
        *,
        support: int,
    ) -> None:
        super().__init__(device, scale, needed)
        grid = scale.grid
        self.outputs = outputs_of(grid, site_channels, scale.kernels.splines.shape[2])
        self.layout = layout = tap_layout(grid, support, self.outputs)
        if grid.half_size % 4 or not -grid.half_size <= layout.low <= layout.high <= grid.half_size:
            raise ValueError(f"half_size {grid.half_size} does not hold a support of {support}")
        self.kernel = Kernel(
            "optics/direct",
            EIGHTS=layout.eights,
            BX=grid.block[0],
            BY=grid.block[1],
            R=grid.half_size,
            D=grid.stride,
            STRIDE=layout.stride,
            PERIOD=grid.sites_across,
            DOWN=grid.period,
            STEP=self.outputs.step,
            PLACES=layout.places,
            COLUMNS=layout.columns,
            HIGH=layout.high,
            LINES=layout.lines,
            GROUPS=layout.groups,
        )
        self.aperture = aperture_um / scale.pitch_um  # sim samples
        self.half_size = support + MARGIN
        self.plane_bytes = 16 * layout.groups * layout.lines * layout.places * grid.period

    def made_of(self, kernels: np.ndarray) -> np.ndarray:
        """Return the taps of a node."""
        layout = self.layout
        given = self.aperture, self.scale.sigma, self.outputs.places
        spread = spatial_kernels(kernels, *given, ringing=self.scale.kernels.ringing)
        kept = slice(self.half_size + layout.low, self.half_size + layout.high + 1)
        return packed_taps(
            spread[:, :, kept, kept], layout, self.grid.sites_across, self.outputs.of_site
        )

    def scratch(self, rec: Recording, planes: int) -> Source:
        """Declare what one block needs on the device."""
        shape = (planes, self.grid.block[1], self.grid.block[0])
        return Source(rec.buffer(f"planes {self.scale.name}", shape, np.float32))

    def scratch_bytes(self, planes: int) -> int:
        """Return the device memory that `scratch` takes."""
        return size_class(4 * planes * math.prod(self.grid.block))

    def record(
        self,
        rec: Recording,
        block: tuple[int, int],
        needed: int,
        scratch: Source,
        rates: Rates,
    ) -> None:
        """Add one block to the planes of the CFA sites: see `Convolve.record`."""
        grid, layout = self.grid, self.layout
        (first_s, step_s), (first_t, step_t) = grid.node_weights(block)
        row0, col0, rows, cols = rates.cells(grid.period)
        origin = tuple(o - c for o, c in zip(grid.window_origin(block), (col0, row0), strict=True))
        # The lines of photosites that the rectangle holds.
        first = max(0, -origin[1])
        last = min((grid.block[1] + 2 * grid.half_size) // grid.stride, rows - origin[1])
        lines = max(last - first, 0)
        x, y = grid.cell_of(block)
        self.kernel.record(
            rec,
            groups=self.kernel.cover(
                layout.eights * lines, grid.period * layout.places // layout.columns
            ),
            params={
                "first_s": first_s,
                "step_s": step_s,
                "first_t": first_t,
                "step_t": step_t,
                "planes": needed,
                "first_line": first,
                "lines": lines,
                "origin": origin,
                "size": (cols, rows),
            },
            planes=scratch.planes,
            taps_00=self.nodes[x, y],
            taps_10=self.nodes[x + 1, y],
            taps_01=self.nodes[x, y + 1],
            taps_11=self.nodes[x + 1, y + 1],
            rates=rates.planes,
        )
