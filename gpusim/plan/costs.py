"""The cost model: seconds of each stage from counts of its work, at an adapter's rates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gpusim.optics.grid import SimGrid
from gpusim.plan.blocks import TRANSFORMS

# Unit of work of each rate: what the planner counts and gpusim.calibrate measures.
UNITS = {
    "kernels": "sample of a PSF that is made for a node, on the host",
    "spectra": "sample of such a PSF's spectrum, on the host and to the device",
    "paint": "sample of the sim grid",
    "edges": "sample and primitive, where a tile sees its edge",
    "warp": "sample and plane",
    "fft rows": "complex sample of a transform, and log2 of its length",
    "modes": "complex sample of a transform, and log2 of its length",
    "fft columns": "complex sample of a transform",
    "products": "complex product with a kernel, in the FFT of columns",
    "inverse columns": "complex sample of the inverse transform, in the FFT of columns",
    "inverse fft": "complex sample of a transform, and log2 of its length",
    "direct": "multiply-add of a source sample and a tap",
    "tables": "sample of a table of highlights, and wavelength, on the host",
    "point sources": "highlight and pixel in its reach",
    "mosaic": "pixel",
    "border": "pixel",
    "crosstalk": "pixel, and pixel around it that gives to it",
    "exposure": "pixel",
    "noise": "pixel",
    "smear": "pixel",
    "bloom": "pixel",
    "cti": "pixel",
    "traps": "pixel and group of transfers that it makes",
    "adc": "pixel",
    "merge": "pixel",
    "dispatch": "dispatch, recorded and submitted",
}


@dataclass(frozen=True)
class Costs:
    """What work costs on an adapter.

    Attributes
    ----------
    source : str
        Whose rates these are, for the report.
    ns : mapping of str to float
        Nanoseconds for each unit of work: see UNITS.
    lengths : mapping of int to float
        By transform length: what the FFTs cost relative to transforms of 256.
    """

    source: str
    ns: Mapping[str, float]
    lengths: Mapping[int, float]

    def seconds(self, stage: str, work: float) -> float:
        """Return the time of so many units of work."""
        return 1e-9 * self.ns[stage] * work

    def transforms(
        self, grid: SimGrid, outputs: int, planes: np.ndarray, rank: int | None = None
    ) -> dict[str, float]:
        """Return the time of each pass of the FFTs; with modes in place of the FFT of rows.

        Parameters
        ----------
        grid : SimGrid
        outputs : int
            Channels, or sites, in a node's kernels.
        planes : ndarray of int
            Planes that each block needs; a block that needs none is left out.
        rank : int, optional
            Modes; without it, PSF nodes around each block.
        """
        if rank is None:
            # Left and right node share a line, upper and lower have a transform each.
            first, lines, transforms, products = "fft rows", int(np.sum(planes)), 2, 4
        else:
            first, lines = "modes", int(np.sum(-(-planes * rank // 2)))
            transforms, products = 1, min(2, rank * int(np.max(planes, initial=0)))
        blocks = np.count_nonzero(planes)
        length, window, pairs = grid.length, grid.window, -(-grid.sites // 2)
        samples = length**2 // 2  # the other half are their mirrors
        columns = self.seconds("fft columns", transforms * lines * samples)
        columns += self.seconds("products", products * outputs * lines * samples)
        columns += self.seconds("inverse columns", blocks * pairs * samples / grid.stride)
        seconds = {
            first: self.seconds(first, lines * grid.block[1] * length * np.log2(length)),
            "fft columns": columns,
            "inverse fft": self.seconds(
                "inverse fft", blocks * pairs * window**2 * np.log2(window)
            ),
        }
        return {stage: self.lengths[length] * time for stage, time in seconds.items()}


# What gpusim.calibrate measured on lavapipe with 2 cores: for plans without a device.
LAVAPIPE = Costs(
    "table: lavapipe, 2 cores",
    {
        "kernels": 30.0,
        "spectra": 6.0,
        "paint": 2.4,
        "edges": 41.0,
        "warp": 6.0,
        "fft rows": 1.0,
        "modes": 1.2,
        "fft columns": 10.0,
        "products": 1.1,
        "inverse columns": 5.0,
        "inverse fft": 3.5,
        "direct": 0.07,
        "tables": 30.0,
        "point sources": 50.0,
        "mosaic": 3.0,
        "border": 3.0,
        "crosstalk": 0.42,
        "exposure": 3.8,
        "noise": 9.0,
        "smear": 4.0,
        "bloom": 4.2,
        "cti": 4.2,
        "traps": 18.0,
        "adc": 3.5,
        "merge": 3.7,
        "dispatch": 120e3,
    },
    {256: 1.0, 512: 1.1, 1024: 1.3},
)


def content_of(costs: Costs) -> dict[str, object]:
    """Return rates as a report or the cache holds them."""
    return {"source": costs.source, "ns": dict(costs.ns), "lengths": dict(costs.lengths)}


def costs_of(content: object) -> Costs:
    """Return the rates in what `content_of` made, its keys as texts or numbers.

    Raises
    ------
    ValueError
        It is no whole set, or a rate is none.
    """
    try:
        lengths = {str(length): factor for length, factor in content["lengths"].items()}
        costs = Costs(
            str(content["source"]),
            {name: float(content["ns"][name]) for name in UNITS},
            {length: float(lengths[str(length)]) for length in TRANSFORMS},
        )
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"no whole set of rates: {error}") from error
    for name, rate in costs.ns.items():
        if not 0 <= rate < np.inf:
            raise ValueError(f"no rate of {name}: {rate}")
    if not any(costs.ns.values()) or not all(0 < one < np.inf for one in costs.lengths.values()):
        raise ValueError("rates of nothing")
    return costs
