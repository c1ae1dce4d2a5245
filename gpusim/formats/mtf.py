"""The MTF-only lens: a table of contrast against frequency, field and colour, and no PSF.

The simpler lens model of the Kodak simulator (Short, Williams and Jones, "Image capture simulation
using an accurate and realistic lens model", SPIE 3650, 1999, section 2.1): rotationally symmetric
at every field, so without coma, astigmatism or lateral colour; the fall-off of the light is given
apart. From each MTF(f) this module makes the PSF whose transform is real and symmetric,

    h(r) = 2 pi integral MTF(f) J_0(2 pi f r) f df    (Hankel transform; Goodman, section 2.1.5)

and so a bank like any other: the same convolution, planner and certificate serve it. The table is a
YAML file; gpusim/data/mtf holds one as an example:

    title: A lens by its MTF
    source: measured at ...
    efl_mm: 8.0
    f_number: 2.8
    working_f_number: 2.8            # 1 / (2 sin theta') on the axis: sets the level of the light
    transmission: 0.9                # or one number for each wavelength
    wavelengths_nm: [450, 550, 650]  # or colour bands: [[400, 490], [510, 570], [590, 700]]
    mtf:
      frequencies_cy_mm: [0, 50, 100, 200, 400, 600]
      fields:
        - height_mm: 0               # distortion-free image height; the last is the image circle
          relative_illumination: 1   # or one number for each wavelength
          distortion_percent: 0      # real over ideal height, less 1; none where left out
          values:                    # one row for each wavelength or band, one row for all
            - [1, 0.95, 0.90, 0.78, 0.5, 0.3]
            - ...

Between its frequencies the table is interpolated by monotone cubics (PCHIP, Fritsch and Carlson
1980): no overshoot, and no contrast that the table does not have. Beyond the last it goes on as a
straight line with the slope of the last interval until it meets zero; where that slope does not
fall, the table must be longer. Between fields PSFs are cubic (``places.py``), and so are MTFs;
between wavelengths linear. Inside a colour band they are constant, and beyond the first and last
wavelength too.

An MTF that ends abruptly has a PSF that rings and dips below zero, as that of a sharpened image
does. It is kept: cutting it would change the MTF. (An MTF alone does not say what the phase was: a
lens with spurious resolution has a negative transform, which this model shows as positive.)

The PSF is cut to the circle of the bank's window and made to hold all the light, so the MTF is that
of the table but for the share of the light that the window misses: ``outside_energy``, below 1 %
with the window of 256 samples or the larger one that is taken where it must be.
"""

from __future__ import annotations

from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.errors import UserError
from gpusim.formats.assemble import Stated, make_bank, per_wavelength
from gpusim.psf.bank import Bank
from gpusim.psf.lines import STRAIGHT
from gpusim.psf.sampling import PITCH_UM, REFERENCE_NM, SIZE

# Samples in a period of the finest detail: splines of degree 3 on the bank's grid interpolate it to
# 1e-2 at the very end of the band, where little contrast is left, and to 1e-3 at two thirds of it.
SAMPLES_PER_PERIOD = 2.5
SIZES = (SIZE, 2 * SIZE)
GOOD_OUTSIDE = 0.01
MOST_OUTSIDE = 0.05
LARGEST_CONTRAST = 1.05  # a little above 1 is the noise of a measurement, or sharpening
HIGHEST = 5.0  # cycles/um: cut-off 2 NA / lambda at NA 1 in air and 400 nm
NODES = 8  # Gauss-Legendre nodes in a quarter of a period of the Bessel function


class MtfField(Strict):
    """One field of the table: see the module."""

    height_mm: float = Field(ge=0)
    relative_illumination: float | tuple[float, ...]
    distortion_percent: float = Field(0.0, gt=-90, lt=90)
    values: tuple[tuple[float, ...], ...] = Field(min_length=1)


class MtfTable(Strict):
    """The table."""

    frequencies_cy_mm: tuple[float, ...] = Field(min_length=3)
    fields: tuple[MtfField, ...] = Field(min_length=2)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        frequency = np.array(self.frequencies_cy_mm)
        if frequency[0] != 0 or not (np.diff(frequency) > 0).all():
            raise ValueError("frequencies_cy_mm must rise from 0")
        heights = np.array([field.height_mm for field in self.fields])
        if heights[0] != 0 or not (np.diff(heights) > 0).all():
            raise ValueError("height_mm must rise from 0, field after field")
        for number, field in enumerate(self.fields, start=1):
            for row in field.values:
                where = f"field {number}: "
                if len(row) != len(frequency):
                    raise ValueError(f"{where}{len(row)} values for {len(frequency)} frequencies")
                if abs(row[0] - 1) > 1e-6:
                    raise ValueError(f"{where}the MTF at frequency 0 is 1, not {row[0]:g}")
                if min(row) < 0 or max(row) > LARGEST_CONTRAST:
                    raise ValueError(
                        f"{where}an MTF lies from 0 to {LARGEST_CONTRAST:g}, not at "
                        f"{min(row) if min(row) < 0 else max(row):g}"
                    )
                if row[-1] > 0 and row[-1] >= row[-2]:
                    raise ValueError(
                        f"{where}the MTF ends at {row[-1]:g} without falling: give it at higher "
                        "frequencies, until it falls or is 0"
                    )
        if self.fields[0].distortion_percent != 0:
            raise ValueError("field 1: there is no distortion on the axis")
        return self


class MtfFile(Stated):
    """Fields of the YAML file: see the module."""

    wavelengths_nm: tuple[float | tuple[float, float], ...] = Field(min_length=1)
    mtf: MtfTable

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if not (np.diff(self.samples_nm()) > 0).all() or self.samples_nm()[0] <= 0:
            raise ValueError(
                "wavelengths_nm must rise; between two bands there is a gap, over which one passes "
                "into the other"
            )
        for number, field in enumerate(self.mtf.fields, start=1):
            if len(field.values) not in (1, len(self.wavelengths_nm)):
                raise ValueError(
                    f"field {number}: {len(field.values)} rows of values for "
                    f"{len(self.wavelengths_nm)} wavelengths or bands"
                )
        return self

    def samples_nm(self) -> np.ndarray:
        """Return the bank's wavelengths: a band has two, its ends."""
        return np.concatenate([np.atleast_1d(entry) for entry in self.wavelengths_nm]).astype(float)

    def rows(self) -> np.ndarray:
        """Return which wavelength or band each of the bank's wavelengths belongs to."""
        return np.concatenate(
            [np.full(np.size(entry), place) for place, entry in enumerate(self.wavelengths_nm)]
        )


class Curve:
    """An MTF against frequency, cycles/um: the table, and what lies between and beyond.

    Parameters
    ----------
    frequency : ndarray (K,)
        Cycles/um, rising from 0.
    contrast : ndarray (K,)
    """

    def __init__(self, frequency: np.ndarray, contrast: np.ndarray) -> None:
        from scipy.interpolate import PchipInterpolator

        # Trailing zeros but the first say only where it ends.
        last = int(np.flatnonzero(contrast)[-1])
        keep = min(last + 2, len(contrast))
        self.inside = PchipInterpolator(frequency[:keep], contrast[:keep])
        self.known = float(frequency[keep - 1])
        self.level = float(contrast[keep - 1])
        self.slope = float(np.diff(contrast)[keep - 2] / np.diff(frequency)[keep - 2])
        self.end = self.known - (self.level / self.slope if self.level > 0 else 0.0)

    def __call__(self, frequency: np.ndarray) -> np.ndarray:
        """Return the contrast at frequencies >= 0, cycles/um."""
        f = np.asarray(frequency, float)
        line = np.maximum(self.level + self.slope * (f - self.known), 0.0)
        beyond = np.where(f < self.end, line, 0.0) if self.level > 0 else np.zeros(f.shape)
        return np.where(f <= self.known, self.inside(np.minimum(f, self.known)), beyond)


def round_psfs(curves: list[Curve], pitch_um: float, size: int) -> np.ndarray:
    """Return the PSFs of MTFs, centred on a grid.

    Parameters
    ----------
    curves : list of Curve
    pitch_um : float
    size : int
        n, even.

    Returns
    -------
    ndarray (len(curves), n, n)
        Share of the light in a sample, 0 outside the circle. The sum is the light in the circle:
        on an unbounded grid it would be 1, as the MTF ends below the sampling frequency.
    """
    from scipy.interpolate import CubicSpline
    from scipy.special import j0

    # An eighth of a sample: the spline errs by (2 pi / 20)^4 / 384 of the finest detail, 2.5e-5.
    radius = np.arange(4 * size + 2) * pitch_um / 8
    ends = np.array([curve.end for curve in curves])
    known = np.concatenate([curve.inside.x for curve in curves])
    steps = np.arange(0, ends.max(), 1 / (4 * radius[-1]))
    edges = np.unique(np.concatenate([known, ends, steps]))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    half = np.diff(edges) / 2
    f = (edges[:-1] + half + nodes[:, None] * half).ravel()
    df = (weights[:, None] * half).ravel()
    kernel = j0(2 * np.pi * np.outer(radius, f)) * (2 * np.pi * f * df)
    density = kernel @ np.stack([curve(f) for curve in curves], axis=1)
    distance = np.hypot(*(np.indices((size, size)) - size // 2)) * pitch_um
    inside = distance < size // 2 * pitch_um
    psfs = np.zeros((len(curves), size, size))
    psfs[:, inside] = pitch_um**2 * CubicSpline(radius, density)(distance[inside]).T
    return psfs


def read_mtf(data: dict[str, object], file: Path) -> Bank:
    """Make the bank of a table of the MTF.

    Raises
    ------
    UserError
        Where the table is not whole, is no MTF, or spreads light beyond any window.
    """
    stated = checked(MtfFile, data, file)
    table = stated.mtf
    frequency = 1e-3 * np.array(table.frequencies_cy_mm)
    count = len(stated.wavelengths_nm)
    rows = stated.rows()
    curves = [
        Curve(frequency, np.array(field.values[min(row, len(field.values) - 1)]))
        for field in table.fields
        for row in range(count)
    ]
    highest = _highest(curves, frequency, file)
    pitch_um = min(PITCH_UM, 1 / (SAMPLES_PER_PERIOD * highest))
    psfs, outside = _windowed(curves, pitch_um, count, file)
    shape, size = (len(table.fields), count), psfs.shape[-1]
    wavelengths = stated.samples_nm()
    ideal_um = 1e3 * np.array([field.height_mm for field in table.fields])
    distortion = np.array([field.distortion_percent for field in table.fields]) / 100
    illumination = [
        per_wavelength(
            field.relative_illumination, count, file, f"mtf.fields.{number}.relative_illumination"
        )
        for number, field in enumerate(table.fields, start=1)
    ]
    transmission = per_wavelength(stated.transmission, count, file, "transmission")
    return make_bank(
        stated.model_copy(update={"transmission": tuple(transmission[rows])}),
        wavelengths_nm=wavelengths,
        # No lateral colour: any wavelength would do.
        reference_nm=float(wavelengths[np.abs(wavelengths - REFERENCE_NM).argmin()]),
        ideal_height_um=ideal_um,
        real_height_um=np.repeat((ideal_um * (1 + distortion))[:, None], len(wavelengths), axis=1),
        psf=psfs.reshape(*shape, size, size)[:, rows],
        pitch_um=pitch_um,
        relative_illumination=np.stack(illumination)[:, rows],
        outside_energy=outside.reshape(shape)[:, rows],
        spectral_degree=STRAIGHT,
        provenance={
            "lens_model": "MTF only: rotationally symmetric at each field, no coma, astigmatism, "
            "lateral colour or phase",
            "mtf": f"table up to {table.frequencies_cy_mm[-1]:g} cycles/mm, monotone cubics "
            f"between, a straight line to 0 at {1e3 * highest:.4g} cycles/mm beyond",
            "object": "not stated",
            "image_height": "distortion-free, as stated",
        },
        file=file,
    )


def _highest(curves: list[Curve], frequency: np.ndarray, file: Path) -> float:
    """Return the frequency at which the last of some MTFs ends, cycles/um."""
    highest = max(curve.end for curve in curves)
    if highest > HIGHEST:
        raise UserError(
            "the MTF goes on to frequencies that light does not resolve",
            file=file,
            field="mtf.fields.values",
            value=f"0 at {1e3 * highest:.4g} cycles/mm"
            + (", as the last interval falls" if highest > frequency[-1] else ""),
            allowed=f"0 at {1e3 * HIGHEST:g} cycles/mm or before: 2 / (400 nm)",
        )
    return highest


def _windowed(
    curves: list[Curve], pitch_um: float, count: int, file: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Return PSFs in the least window that holds them, and the share of light that it misses.

    ``count`` is how many MTFs each field has.
    """
    for size in SIZES:
        psfs = round_psfs(curves, pitch_um, size)
        outside = 1 - psfs.sum(axis=(1, 2))
        if np.abs(outside).max() <= GOOD_OUTSIDE:
            break
    worst = int(np.abs(outside).argmax())
    if abs(outside[worst]) > MOST_OUTSIDE:
        raise UserError(
            f"the MTF falls so fast from frequency 0 that {outside[worst]:.1%} of the light lie "
            f"more than {size * pitch_um / 2:.3g} um from the centre",
            file=file,
            field=f"mtf.fields.{worst // count + 1}.values",
            allowed=f"at most {MOST_OUTSIDE:.0%}: light that spreads evenly is veiling glare, a "
            "field of the sensor file",
        )
    return psfs, outside
