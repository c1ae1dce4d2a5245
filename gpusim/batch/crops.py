"""Pieces of a frame, of raw, truth and labels alike: at places that are given, or drawn by seed."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.random import Philox
from pydantic import Field, model_validator

from gpusim.config.model import Strict
from gpusim.errors import UserError

Side = Annotated[int, Field(ge=1)]


class Crops(Strict):
    """Where the pieces of a frame lie: exactly one of ``at`` and ``count``.

    Attributes
    ----------
    rows, cols : int
        Size of each.
    at : list of (x, y), optional
        Their upper left pixels, counted from that of the frame.
    count : int, optional
        How many are drawn, evenly over the frame's lit pixels: by the sweep's ``random_seed`` and
        the frame's number.
    step : int
        Drawn places are multiples of it both ways, from the first lit pixel on: with the period of
        the filter array (2 for Bayer) all crops begin with the same colour.

    Examples
    --------
    >>> from gpusim.batch.crops import Crops
    >>> Crops(rows=16, cols=16, at=[(0, 0), (8, 16)]).a_frame
    2
    """

    rows: Side
    cols: Side
    at: tuple[tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]], ...] | None = Field(
        default=None, min_length=1
    )
    count: Side | None = None
    step: Side = 2

    @model_validator(mode="after")
    def _one(self) -> Crops:
        if (self.at is None) == (self.count is None):
            raise ValueError("exactly one of at, count")
        return self

    @property
    def a_frame(self) -> int:
        """How many there are of a frame."""
        return self.count or len(self.at or ())

    def places(
        self, lit: tuple[int, int, int, int], shape: tuple[int, int], seed: int, number: int
    ) -> np.ndarray:
        """Return the upper left pixels of a frame's crops.

        Parameters
        ----------
        lit : (row, col, rows, cols)
            Where the frame's lit pixels lie in it.
        shape : (rows, cols)
            Size of the frame.
        seed, number : int
            The sweep's, and the frame's.

        Returns
        -------
        ndarray of int (n, 2)
            x, y.

        Raises
        ------
        UserError
            A crop does not lie in the frame.

        Examples
        --------
        >>> from gpusim.batch.crops import Crops
        >>> crops = Crops(rows=16, cols=16, count=3)
        >>> crops.places((0, 0, 48, 64), (48, 64), seed=1, number=0).shape
        (3, 2)
        """
        if self.at is not None:
            rows, cols = shape
            for x, y in self.at:
                if x + self.cols > cols or y + self.rows > rows:
                    raise UserError(
                        "a crop lies beyond the frame",
                        field="crops.at",
                        value=f"{x}, {y}",
                        allowed=f"{self.cols} x {self.rows} pixels within {cols} x {rows}",
                    )
            return np.array(self.at)
        row, col, rows, cols = lit
        room = cols - self.cols, rows - self.rows
        if min(room) < 0:
            raise UserError(
                "crops are larger than the frame",
                field="crops",
                value=f"{self.cols} x {self.rows}",
                allowed=f"{cols} x {rows} lit pixels, or fewer",
            )
        draw = np.random.Generator(Philox(key=[seed, number]))
        steps = [draw.integers(0, most // self.step, self.count, endpoint=True) for most in room]
        return self.step * np.stack(steps, axis=1) + np.array([col, row])

    def cut(self, plane: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the crops (n, rows, cols, ...) of a plane (rows, cols, ...)."""
        return np.stack([plane[y : y + self.rows, x : x + self.cols] for x, y in places])
