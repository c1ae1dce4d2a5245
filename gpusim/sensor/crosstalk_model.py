"""The cross-talk of a sensor: which share of a pixel's signal is found in the pixels around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import RootModel, field_validator, model_validator

from gpusim.config.model import Fixed, Strict, wrong

MAX_SIDE = 7  # of a kernel, pixels
ANY = "*"  # stands for every channel
ROUNDING = 1e-9  # by which shares given as decimal fractions may exceed 1

Kernel = tuple[tuple[float, ...], ...]
Pattern = Sequence[Sequence[str]]


class Kernels(RootModel[dict[str, Kernel]]):
    """Kernels by the channels between which they hold: ``"R>G"``, ``"R>*"``, ``"*>G"``, ``"*"``.

    A kernel has odd sides up to `MAX_SIDE`; its middle is the pixel itself, its first row lies
    above. Its numbers are the shares of the signal of a pixel of the first channel that are found
    at those of its neighbours that are of the second. Where several keys fit a pair, the most
    definite one counts, the first channel before the second. Where none fits, unlike channels share
    nothing, and pixels of one channel keep what they have.
    """

    model_config = {"frozen": True}

    @field_validator("root")
    @classmethod
    def _kernels(cls, kernels: Mapping[str, Kernel]) -> dict[str, Kernel]:
        if not kernels:
            raise wrong("there is no kernel", 'kernels by pair of channels: {"*": [[...]]}')
        for pair, kernel in kernels.items():
            sides = {len(row) for row in kernel}
            if len(sides) != 1:
                raise wrong(f"the kernel {pair} is no rectangle", "rows of equal length")
            for side in (len(kernel), *sides):
                if side % 2 == 0 or side > MAX_SIDE:
                    raise wrong(
                        f"the kernel {pair} has {len(kernel)} x {sides.pop()} numbers",
                        f"odd sides up to {MAX_SIDE}: a pixel in the middle",
                    )
            if not all(share >= 0 and np.isfinite(share) for row in kernel for share in row):
                raise wrong(f"the kernel {pair} has a negative share", "0 to 1")
            if pair != ANY and (pair.count(">") != 1 or "" in pair.split(">")):
                raise wrong(f"{pair!r} names no pair of channels", 'such as "R>G", "R>*", or "*"')
            giver, _, taker = pair.partition(">")
            if ANY not in pair and giver != taker and kernel[len(kernel) // 2][len(kernel[0]) // 2]:
                raise wrong(
                    f"the kernel {pair} has a share in its middle, where the pixel itself is",
                    "0 there between unlike channels",
                )
        return Fixed(kernels)

    @property
    def side(self) -> int:
        """Rows and columns of the smallest square that holds every kernel."""
        return max(max(len(kernel), len(kernel[0])) for kernel in self.root.values())

    def between(self, giver: str, taker: str) -> np.ndarray:
        """Return the kernel (side, side) from one channel to another."""
        square = np.zeros((self.side, self.side))
        square[self.side // 2, self.side // 2] = giver == taker
        for pair in (f"{giver}>{taker}", f"{giver}>{ANY}", f"{ANY}>{taker}", f"{ANY}>{ANY}", ANY):
            if pair in self.root:
                kernel = np.array(self.root[pair])
                rows, cols = ((self.side - n) // 2 for n in kernel.shape)
                square = np.pad(kernel, ((rows, rows), (cols, cols)))
                break
        return square

    def shares(self, pattern: Pattern) -> np.ndarray:
        """Return what the sites of a filter pattern take from the pixels around them.

        Returns
        -------
        ndarray (py, px, side, side)
            The share that a pixel of a site takes of the signal of the pixel at [dy, dx] from it,
            counted from ``-(side // 2)``.
        """
        py, px = len(pattern), len(pattern[0])
        half = self.side // 2
        names = {name for row in pattern for name in row}
        pairs = {(a, b): self.between(a, b) for a in names for b in names}
        taken = np.empty((py, px, self.side, self.side))
        for row, col, i, j in np.ndindex(taken.shape):
            giver = pattern[(row + i - half) % py][(col + j - half) % px]
            taken[row, col, i, j] = pairs[giver, pattern[row][col]][2 * half - i, 2 * half - j]
        return taken

    def check(self, field: str, pattern: Pattern) -> None:
        """Refuse kernels of other channels, and those that make signal.

        Raises
        ------
        PydanticCustomError
            A key names a channel that the pattern has not, or a pixel gives more than it has.
        """
        names = {name for row in pattern for name in row}
        for pair in self.root:
            if unknown := set(pair.split(">")) - names - {ANY}:
                raise wrong(
                    f"the filter pattern has no channel {', '.join(sorted(unknown))}",
                    ", ".join(sorted(names)),
                    field=field,
                    value=pair,
                )
        given = np.zeros((len(pattern), len(pattern[0])))
        taken = self.shares(pattern)
        half = self.side // 2
        for row, col, i, j in np.ndindex(taken.shape):
            giver = (row + i - half) % len(pattern), (col + j - half) % len(pattern[0])
            given[giver] += taken[row, col, i, j]
        if given.max() > 1 + ROUNDING:
            row, col = np.unravel_index(np.argmax(given), given.shape)
            raise wrong(
                f"a pixel of {pattern[row][col]} gives more signal than it has",
                "kernels that sum to 1 or less",
                field=field,
                value=f"{given.max():g} times",
            )


class Crosstalk(Strict):
    """Light and charge that reach other pixels than their own.

    Attributes
    ----------
    optical : Kernels, optional
        Spread of light and of diffusing charge: on the mean signal, before the shot noise.
    electrical : Kernels, optional
        Spread of collected charge, such as inter-pixel capacitance. It acts on electrons with their
        shot noise, which it correlates (Moore, Ninkov and Forrest 2004).
    """

    optical: Kernels | None = None
    electrical: Kernels | None = None

    @model_validator(mode="after")
    def _some(self) -> Crosstalk:
        if self.optical is None and self.electrical is None:
            raise wrong("the cross-talk has no kernels", "optical or electrical; or leave it out")
        return self
