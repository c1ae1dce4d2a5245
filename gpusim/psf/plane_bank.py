"""The bank of a lens without an axis, whose elements may be decentred and tilted.

It spans both directions of the field. The chain renders with it as with that of a lens with an axis
(``bank.py``): PSFs are bicubic between the fields of the grid, as they lie, and nothing is turned.
x and y are those of the prescription; on the sensor x points right and y down.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gpusim.psf.field_bank import FieldBank
from gpusim.psf.lines import CUBIC
from gpusim.psf.places import FieldGrid
from gpusim.psf.plane_map import PlaneMap
from gpusim.psf.store import Table
from gpusim.psf.variables import PLANE


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaneBank(FieldBank):
    """PSFs and chief rays of a lens over its field: Y by X fields, L wavelengths, n x n samples.

    A field (x, y) in degrees lies hypot(x, y) off the axis of the lens, in the direction of
    (x, y): that holds beyond 90 deg too. In the corners of the grid, a quarter beyond the lens's
    largest field and more, is what the last field in the same direction shows that rays pass.

    Light lands within a circle about the chief ray of field (0, 0), the largest that the fields
    fill; beyond it the image is black.

    Attributes
    ----------
    field_x_deg, field_y_deg : ndarray, shapes (X,) and (Y,)
        Rising; each holds 0.
    chief_x_um, chief_y_um : ndarray, shape (Y, X, L)
    psf : ndarray of float32, shape (Y, X, L, n, n)
        Rows y, columns x.
    relative_illumination : ndarray, shape (Y, X, L)
        What an even scene sends through the lens about a field, per area of its image, over that
        of field (0, 0): see ``gpusim.lens.entering``.
    projected_solid_angle_sr, transmission : ndarray, shape (L,)
        At field (0, 0), and on the axis.
    chief : ndarray, shape (Y, X, L, 2), or None
        Along x and y.
    ray_x_deg, ray_y_deg, ray_x_um, ray_y_um : ndarray, shape (M,)
        Chief rays of the map from field to image; the first is that of field (0, 0), the last
        lie on the rim of the field.

    The others are those of every bank: see ``gpusim.psf.field_bank.FieldBank``.
    """

    field_x_deg: np.ndarray
    field_y_deg: np.ndarray
    chief_x_um: np.ndarray
    chief_y_um: np.ndarray
    ray_x_deg: np.ndarray
    ray_y_deg: np.ndarray
    ray_x_um: np.ndarray
    ray_y_um: np.ndarray
    spectral_degree: int = field(default=CUBIC, init=False)  # its files do not say it

    table: ClassVar[Table] = PLANE

    @property
    def middle(self) -> tuple[int, int]:
        """Row and column of the field on the axis."""
        return int(np.abs(self.field_y_deg).argmin()), int(np.abs(self.field_x_deg).argmin())

    @property
    def landing_um(self) -> np.ndarray:
        """Where chief rays land (Y, X, L, 2)."""
        return np.stack([self.chief_x_um, self.chief_y_um], axis=-1)

    def at(self, number: int) -> tuple[int, ...]:
        """Return row and column of a field, counted row after row."""
        return divmod(number, len(self.field_x_deg))

    @property
    def centre_um(self) -> tuple[float, float]:
        """x, y of the image circle's centre: the chief ray of field (0, 0)."""
        return float(self.ray_x_um[0]), float(self.ray_y_um[0])

    @property
    def image_circle_um(self) -> float:
        """Radius of the largest circle about ``centre_um`` that the fields fill."""
        field = np.hypot(self.ray_x_deg, self.ray_y_deg)
        rim = field >= field.max() * (1 - 1e-9)
        x, y = self.centre_um
        return float(np.hypot(self.ray_x_um[rim] - x, self.ray_y_um[rim] - y).min())

    @property
    def rectilinear_circle_um(self) -> float:
        """The same: the map's rays end where the ideal plane does."""
        return self.image_circle_um

    @property
    def probes(self) -> tuple[int, ...]:
        """Fields that stand for all: the axis, the ends of the axes and, half-way, the corners."""
        across = len(self.field_x_deg)
        x0, y0 = (int(np.flatnonzero(a == 0)[0]) for a in (self.field_x_deg, self.field_y_deg))
        x1, y1 = across - 1, len(self.field_y_deg) - 1
        ends = [(x0, y0), (0, y0), (x1, y0), (x0, 0), (x0, y1)]
        half_x, half_y = ((a // 2, (a + b + 1) // 2) for a, b in ((x0, x1), (y0, y1)))
        half = [(x, y) for y in half_y for x in half_x]
        return tuple(y * across + x for x, y in ends + half)

    def places(self, reach_um: float) -> tuple[tuple[int, ...], FieldGrid]:
        """Return the fields as far as image points up to `reach_um` from the middle need them.

        And a PSF's half width farther, as light from there still reaches them.
        """
        turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        reach_um += self.psf.shape[-1] / 2 * self.pitch_um
        rim = self.field_deg(reach_um * np.cos(turn), reach_um * np.sin(turn))
        x, y = (
            np.arange(
                # Two on either side of a point are of the nearest four.
                max(int(np.searchsorted(axis, angle.min(), "right")) - 2, 0),
                min(int(np.searchsorted(axis, angle.max())) + 2, len(axis)),
            )
            for axis, angle in zip((self.field_x_deg, self.field_y_deg), rim, strict=True)
        )
        numbers = (y[:, None] * len(self.field_x_deg) + x).ravel()
        grid = FieldGrid(self.field_x_deg[x], self.field_y_deg[y], self.field_deg)
        return tuple(int(number) for number in numbers), grid

    @functools.cached_property
    def plane_map(self) -> PlaneMap:
        """The map from the real to the ideal plane at the reference wavelength.

        Raises
        ------
        UserError
            Where the chief rays do not tell the map, or it folds over.
        """
        return PlaneMap(
            np.stack([self.ray_x_deg, self.ray_y_deg], axis=1),
            np.stack([self.ray_x_um, self.ray_y_um], axis=1),
            lambda theta: 1e3 * self.principal_distance_mm * self.projection.height(theta),
            self.centre_um,
            self.image_circle_um,
        )

    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle.

        Beyond the circle they are those of the nearest point of its rim.
        """
        return self.plane_map.ideal_points(x_um, y_um)

    def field_deg(self, x_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the field angles x and y of real image points; beyond the circle its rim's."""
        u, v, _ = self.plane_map.ideal_points(x_um, y_um)
        height = np.hypot(u, v)
        theta = self.projection.angle(height / (1e3 * self.principal_distance_mm))
        scale = np.degrees(theta) / np.maximum(height, 1e-9)
        return u * scale, v * scale

    def illumination_at(self, x_um: np.ndarray, y_um: np.ndarray) -> np.ndarray:
        """Return the relative illumination at real image points, by wavelength first."""
        grid = FieldGrid(self.field_x_deg, self.field_y_deg, self.field_deg)
        table = self.relative_illumination.reshape(-1, len(self.wavelengths_nm))
        numbers, weights = grid.blended(x_um, y_um)
        # One after the other, because maps are large.
        light = sum(
            weights[..., one, None] * table[numbers[..., one]] for one in range(weights.shape[-1])
        )
        return np.moveaxis(light, -1, 0)
