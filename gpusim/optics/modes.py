"""Space-variant convolution with PSFs that are sums of few modes: for banks that change smoothly.

The kernels of all channels and planes at the nodes of a map are decomposed together,

    H_cj(x; s) = sum_r m_r(s) h_rcj(x),

so that one set of maps m_r, interpolated bilinearly between the nodes, serves them all. Blocks need
not lie between nodes, and only the modes' spectra stay on the device.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft

from gpusim.gpu import Device, Kernel, Recording
from gpusim.gpu.pool import size_class
from gpusim.optics.convolve import Scratch, Transforms, block_transform, spectra_bytes
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernel_spectra import kernel_spectra
from gpusim.optics.kernels import FieldKernels, sharpened
from gpusim.optics.nodes import KernelStore, Node, Rates, Scale, outputs_of
from gpusim.optics.sampling import sampled_kernels
from gpusim.parallel import each
from gpusim.sensor.aperture import Response

# Modes of less are rounding errors: of the kernels' own float32, and of the eigenvalues.
SMALLEST = 1e-7


@dataclass(frozen=True)
class Decomposition:
    """Modes of the kernels over the nodes of a map, the strongest first.

    Attributes
    ----------
    modes : ndarray of float32 (R, J, C, 2 half_size, 2 half_size)
        Kernels, as `sampled_kernels` returns them.
    maps : ndarray (R, ny, nx)
        Weights at the nodes, from one end of the source region to the other; of mean square one.
    singular_values : ndarray (R,)
        Those of the kernels relative to each channel's signal. Each frequency counts by how edges
        see it.
    errors : ndarray (R,)
        Predicted error of an edge response when the first 1, 2, ... modes are kept, relative to
        the signal: the root of the mean square over nodes, channels and both axes.
    """

    modes: np.ndarray
    maps: np.ndarray
    singular_values: np.ndarray
    errors: np.ndarray

    @property
    def rank(self) -> int:
        """Modes that are kept."""
        return len(self.modes)

    def rank_within(self, allowed: float) -> tuple[int, float]:
        """Return the fewest modes that keep an error, and the error they leave."""
        kept = np.flatnonzero(self.errors <= allowed)
        rank = int(kept[0]) + 1 if len(kept) else self.rank
        return rank, float(self.errors[rank - 1])

    def truncated(self, rank: int) -> Decomposition:
        """Return the first modes only."""
        return Decomposition(
            self.modes[:rank], self.maps[:rank], self.singular_values[:rank], self.errors[:rank]
        )


def _least_squares(cells: tuple[int, int]) -> tuple[list[tuple[int, int]], np.ndarray]:
    """Return the points around and at a map's nodes, and the nodes as sums of them.

    The sums are those of `gpusim.optics.sampling.node_kernels`; nodes in the order (y, x).
    """
    across, down = (count + 1 for count in cells)
    points = [
        (x, y)
        for y in range(-1, down + 1)
        for x in range(-1, across + 1)
        if 0 <= x < across or 0 <= y < down
    ]
    place = {point: number for number, point in enumerate(points)}
    sums = np.zeros((down * across, len(points)))
    for number, (y, x) in enumerate(np.ndindex(down, across)):
        sums[number, place[x, y]] = 1 + 4 / 12
        for neighbour in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
            sums[number, place[neighbour]] = -1 / 12
    return points, sums


def mode_decomposition(
    kernels: FieldKernels,
    grid: SimGrid,
    pitch_um: float,
    cells: tuple[int, int],
    planes: int,
    *,
    most: int = 24,
) -> Decomposition:
    """Decompose the kernels of all planes and channels over the nodes of one map.

    Parameters
    ----------
    kernels : FieldKernels
    grid : SimGrid
        Its blocks cover what the map covers; kernels reach as far as its `half_size`.
    pitch_um : float
        Pitch of the sim grid.
    cells : (int, int)
        Between the map's nodes in x and in y.
    planes : int
    most : int
        Modes to keep, at most.

    Notes
    -----
    Singular values and weights come from the products of the nodes' kernels with one another, a
    matrix of as many rows as nodes: its time goes with nodes^2 and with planes, channels and taps.
    How many modes a tolerance needs hardly depends on the nodes: to estimate it, take 8 x 6 cells
    and the kernels of one plane.
    """
    region = np.array([b * n for b, n in zip(grid.block, grid.blocks, strict=True)])
    points, sums = _least_squares(cells)

    def sample(point: tuple[int, int]) -> np.ndarray:
        at = np.array(point) * region / cells + grid.start - grid.centre
        sampled = sampled_kernels(
            kernels, *(at * pitch_um), pitch_um, grid.half_size, planes=planes
        )
        return sampled.astype(np.float32)

    sampled = np.stack(each(sample, points))
    # What is left out is sharpened with the rest.
    seen = sharpened(sampled) if kernels.ringing else sampled
    # Each channel in units of its own signal, that of the first plane in the mean.
    signal = sampled[:, 0].sum(axis=(2, 3), dtype=np.float64).mean(axis=0)
    products = sum(
        _products(seen[:, j, c]) / signal[c] ** 2 for j, c in np.ndindex(planes, len(signal))
    )
    squares, vectors = np.linalg.eigh(sums @ products @ sums.T)
    squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
    count = len(sums)
    rank = min(most, int(np.sum(squares > SMALLEST**2 * squares[0])))
    maps = vectors[:, :rank] * np.sqrt(count)
    # Positive where the map is strongest: signs of vectors are arbitrary.
    maps *= np.sign(maps[np.argmax(np.abs(maps), axis=0), np.arange(rank)])
    # Nodes = maps modes; the maps are orthogonal.
    of_nodes = (maps.T @ sums / count).astype(np.float32)
    modes, seen_modes = (np.tensordot(of_nodes, one, axes=1) for one in (sampled, seen))
    shape = (rank, cells[1] + 1, cells[0] + 1)
    return Decomposition(
        modes,
        maps.T.reshape(shape).copy(),
        np.sqrt(squares[:rank] / count),
        _edge_errors(np.tensordot(sums, _marginals(seen), axes=1), _marginals(seen_modes), maps),
    )


def _products(kernels: np.ndarray) -> np.ndarray:
    """Return the products of kernels with one another as edges see them, summed in float64.

    An edge response is the integral of a kernel, so its spectrum goes with 1 / f: weighted so, 14
    modes keep the error of 23 without (the demonstration lens, half a per cent).
    """
    size = kernels.shape[-1]
    f = np.hypot(scipy.fft.rfftfreq(size), scipy.fft.fftfreq(size)[:, None])
    weights = 1 / np.maximum(f, 0.5 / size)
    weights[:, 1 : size // 2] *= np.sqrt(2)  # and their mirrors
    spectra = scipy.fft.rfft2(kernels) * (weights / size).astype(np.float32)
    flat = spectra.reshape(len(kernels), -1).view(np.float32).astype(np.float64)
    return flat @ flat.T


def _marginals(kernels: np.ndarray) -> np.ndarray:
    """Return the sums of the first plane's kernels along y and along x: (n, C, 2, size)."""
    first = kernels[:, 0]
    return np.stack([first.sum(axis=axis, dtype=np.float64) for axis in (2, 3)], axis=2)


def _edge_errors(nodes: np.ndarray, modes: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """Return the error of the nodes' edge responses with the first 1, 2, ... modes."""
    rest = np.cumsum(nodes, axis=-1)
    whole = rest[..., -1:].copy()
    edges = np.cumsum(modes, axis=-1)
    errors = []
    for mode, weights in zip(edges, maps.T, strict=True):
        rest = rest - weights[:, None, None, None] * mode
        errors.append(np.sqrt(np.mean(np.max(np.abs(rest / whole), axis=-1) ** 2)))
    return np.array(errors)


class Modes(Transforms, KernelStore):
    """Modes of one scale, and the passes that use them: see `KernelStore`.

    All blocks use all modes: they come onto the device together, even lines and odd lines apart.

    Parameters
    ----------
    device : Device
    scale : Scale
        Its grid's cells only bound the blocks: with one, blocks are as large as transforms allow.
        The kernels are those of the decomposition.
    needed : dict
        Coefficient planes that each block needs.
    aperture_um : float or Response
        Side of the square pixel aperture, or any other's response.
    site_channels : list of int
        Colour channel of each CFA site, row by row.
    decomposition : Decomposition
        Decomposition of kernels on the scale's grid, with at least the planes that are needed.
    """

    def __init__(
        self,
        device: Device,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        aperture_um: float | Response,
        site_channels: list[int],
        *,
        decomposition: Decomposition,
    ) -> None:
        KernelStore.__init__(self, device)
        self.scale, self.decomposition = scale, decomposition
        self.rank = decomposition.rank
        self.lines = max(needed.values(), default=0) * self.rank
        self.outputs = outputs_of(scale.grid, site_channels, decomposition.modes.shape[2])
        Transforms.__init__(self, device, scale, self.outputs, 2 if self.lines > 1 else 1)
        _, self._down, self._across = decomposition.maps.shape
        self.modes = Kernel(
            "optics/modes",
            **block_transform(scale.grid),
            RANK=self.rank,
            MAP_X=self._across,
            MAP_Y=self._down,
        )
        self.aperture = aperture_um / scale.pitch_um  # sim samples
        self.maps = device.resident("maps", decomposition.maps.astype(np.float32))

    def nodes_of(self, blocks: Iterable[tuple[int, int]]) -> set[Node]:
        """Return (0, 0) for the even lines, and (1, 0) for the odd ones if there are any."""
        return {(parity, 0) for _ in blocks for parity in range(min(self.lines, 2))}

    def node_bytes(self, node: Node) -> int:
        """Return the device memory that the spectra of even or odd lines take."""
        return self._bytes(self.lines)

    def block_bytes(self, planes: int) -> int:
        """Return the device memory that the kernels of one block take: those of all planes."""
        return min(self.lines, 2) * self._bytes(self.lines)

    def _bytes(self, lines: int) -> int:
        return size_class(-(-lines // 2) * spectra_bytes(self.grid, self.outputs), self.use)

    def make(self, nodes: list[Node]) -> Iterator[tuple[Node, np.ndarray]]:
        """Yield even or odd lines with their spectra, the last line of zeros if one lacks."""
        grid, modes = self.grid, self.decomposition.modes
        for node in nodes:
            kernels = [
                modes[line % self.rank, line // self.rank] for line in range(node[0], self.lines, 2)
            ]
            kernels += [np.zeros_like(modes[0, 0])] * (-(-self.lines // 2) - len(kernels))
            # One by one: in between, transforms take twice as much as their results.
            given = grid.length, self.aperture, self.scale.sigma, self.outputs.places
            ringing = self.scale.kernels.ringing
            spectra = [kernel_spectra(one[None], *given, ringing=ringing) for one in kernels]
            yield node, np.concatenate(spectra)

    def scratch(self, rec: Recording, planes: int) -> Scratch:
        """Declare what one block needs on the device."""
        pairs = -(-planes * self.rank // 2)
        return Scratch(rec, self.scale.name, self.grid, planes, pairs)

    def scratch_bytes(self, planes: int) -> int:
        """Return the device memory that `scratch` takes."""
        return Scratch.nbytes(self.grid, planes, -(-planes * self.rank // 2))

    def release(self) -> None:
        """Give the device's memory back."""
        super().release()
        self.twiddle.destroy()
        self.maps.destroy()

    def record(
        self,
        rec: Recording,
        block: tuple[int, int],
        needed: int,
        scratch: Scratch,
        rates: Rates,
    ) -> None:
        """Add one block to the planes of the CFA sites: see `Convolve.record`."""
        grid = self.grid
        cells = np.array([self._across - 1, self._down - 1])
        step = cells / (np.array(grid.block) * grid.blocks)
        first = (np.array(block) * grid.block + 0.5) * step
        node = first.astype(int)
        lines = needed * self.rank
        pairs = -(-lines // 2)
        self.modes.record(
            rec,
            groups=(-(-grid.block[1] // 2), pairs, 1),
            params={"first": first - node, "step": step, "node": node, "lines": lines},
            twiddle=self.twiddle,
            planes=scratch.planes,
            maps=self.maps,
            spectra=scratch.spectra,
        )
        even = self.nodes[0, 0]
        odd = self.nodes.get((1, 0), even)
        self.record_inverse(
            rec,
            block,
            scratch,
            rates,
            columns={"first_s": 0.0, "step_s": 0.0, "planes": pairs, "mirrored": (0, 0)},
            kernels=(even, odd, even, odd),
        )
