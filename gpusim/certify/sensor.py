"""The sensor's part of the certificate: from the light of a render to mean electrons, in float64.

At the probes of the engine's part, the mean electrons of the frame are compared with those that a
chain of float64 twins makes of the same light: the render's own rates, so that no error of the
optics is counted twice. They include mosaic, veiling glare, aperture and scan motion, which are
part of the optics' kernels or of its planes: the engine's part judges these.

- Sensors that read each pixel: border, optical cross-talk, response (PRNU, mask), exposure, dark
  current, dead and hot pixels. It is the very mean that the frame's shot noise was drawn from.
- CCDs: also smear, full well or blooming, and both transfers. There the noise is drawn on the way;
  what is judged is the mean signal, which the same shaders carry once more without noise. The
  serial transfer has a reference of its own, from the charge that the columns gave, since a row's
  history is the history of whole columns. The two differences are added.

What follows the noise (electrical cross-talk, offsets, stuck pixels, converter) is not covered.

The engine's error at the electrons is no larger than at the rates, where it is measured: what a
pixel has after cross-talk, smear and transfer is a sum of light around it with shares that are not
negative, so that its relative error is a mean of theirs, weighted with their light, and no larger
than the largest of them. Response and exposure scale signal and error alike, and dark current adds
to the signal alone. Traps and blooming are not linear, but pass on of a change of the charge no
more than there is of it.

Blooming halves an excess to whole electrons, for it is made for charge that was drawn: where the
excess of a mean comes within a rounding of an even number, the two chains may send one electron to
different ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpusim.certify.budget import Measure, Placed, Share
from gpusim.reference.bloom import bloom
from gpusim.reference.crosstalk import crosstalk_at
from gpusim.reference.cti import cti
from gpusim.reference.defects import defects
from gpusim.reference.exposure import dark_current, exposed
from gpusim.reference.smear import smear
from gpusim.reference.traps import traps
from gpusim.sensor.defects import defects_of
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.sensor import Sensor

# -log of the share of a charge packet, 1e-10, that may lie beyond the history that is looked at.
LEFT_OUT = 23.0


@dataclass(frozen=True)
class MeanSignal:
    """What the shaders made of a frame's mean signal.

    Attributes
    ----------
    rate : Placed
        Electrons/s, before cross-talk, of all pixels that the frame takes light from.
    mean : Placed
        Mean electrons.
    charge : Placed, optional
        CCDs only: mean electrons of whole columns, before the serial transfer.
    """

    rate: Placed
    mean: Placed
    charge: Placed | None = None


def sensor_share(
    by: Measure, made: MeanSignal, pixels: np.ndarray, *, temperature_c: float, noise: bool
) -> tuple[Share, str]:
    """Compare the mean electrons of some pixels with their float64 references.

    Parameters
    ----------
    by : Measure
    made : MeanSignal
        What the shaders made.
    pixels : ndarray (P, 2) of int
        Row and column of lit pixels.
    temperature_c : float
        The sensor's, in the frame.
    noise : bool
        Whether the frame has noise and fixed patterns; else it is clipped at the full well.

    Returns
    -------
    share : Share
    note : str
        What was compared.
    """
    sensor, (row, col) = by.sensor, pixels.T
    light = _Light(sensor, made.rate, by.exposure_s, temperature_c, noise)
    if made.charge is None:
        steps = [(light.mean(row, col), made.mean.at(row, col))]
    else:
        charge = made.charge
        steps = [
            (_columns(light, row, col), charge.at(row, col)),
            (_arrived(sensor, charge, row, col), made.mean.at(row, col)),
        ]
    error = _error(sensor, steps, by.accuracy.unit)
    share = Share(float(np.sqrt(np.mean(error**2))), float(error.max()), len(error))
    return share, (
        f"sensor: {', '.join(_covered(sensor, noise))} of the mean signal in float64 from the "
        f"render's own light, at {len(error)} probes; aperture and mosaic are in the engine's part"
    )


def _error(sensor: Sensor, steps: list[tuple[np.ndarray, np.ndarray]], unit: str) -> np.ndarray:
    """Return the differences of all steps (truth, found) together, in the tolerance's unit."""
    truth = steps[-1][0]
    if unit == "relative":
        off = sum(np.abs(found - true) for true, found in steps)
        return np.where(truth > 0, off / np.where(truth > 0, truth, 1.0), off > 0)
    well_e = sensor.full_well_e  # beyond it nothing is in any frame
    off = sum(np.abs(np.minimum(found, well_e) - np.minimum(true, well_e)) for true, found in steps)
    noise_e = np.sqrt(np.clip(truth, 0, well_e) + sensor.temporal_dark_noise_e**2)
    return np.where(noise_e > 0, off / np.where(noise_e > 0, noise_e, 1.0), 0.0)


def _covered(sensor: Sensor, noise: bool) -> list[str]:
    """Return what of the sensor was judged, in words."""
    has = sensor.effects if noise else frozenset()
    parts = {
        "border": sensor.optical_black is not None,
        "optical cross-talk": sensor.crosstalk is not None and sensor.crosstalk.optical is not None,
        "response of pixels": not has.isdisjoint({"prnu", "prnu lines", "gain mask"}),
        "exposure and dark current": True,
        "dead and hot pixels": "defects" in has,
        "smear": sensor.smear is not None,
        "blooming": sensor.bloom,
        "parallel transfer": sensor.parallel_cti is not None,
        "serial transfer": sensor.serial_cti is not None,
    }
    return [name for name, there in parts.items() if there]


@dataclass(frozen=True)
class _Light:
    """The light on a sensor, and the mean electrons that pixels make of it.

    The sensor's file says which effects there are, not the plan.
    """

    sensor: Sensor
    rate: Placed
    exposure_s: float
    temperature_c: float
    noise: bool

    def seen(self, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Return the electrons/s of pixels as the optics made them: none on the optical black."""
        lit = self.sensor.frame.lit
        inside = (row >= 0) & (row < lit[2]) & (col >= 0) & (col < lit[3])
        return np.where(inside, self.rate.at(row, col), 0.0)

    def spread(self, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Return the electrons/s that reach pixels, with the light of others."""
        sensor = self.sensor
        kernels = sensor.crosstalk and sensor.crosstalk.optical
        if kernels is None:
            return self.seen(row, col)
        frame = sensor.frame.pixels
        return crosstalk_at(
            row, col, self.seen, pattern=sensor.cfa.pattern, between=kernels.between, frame=frame
        )

    def mean(self, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Return the mean electrons of pixels, as far as each is by itself."""
        mean = self.exposed(self.spread(row, col), row, col)
        return mean if self.noise else np.minimum(mean, self.sensor.full_well_e)

    def exposed(self, light: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Return the mean electrons of pixels that so much light reaches, not clipped."""
        sensor = self.sensor
        dark_e_per_s = dark_current(
            sensor.dark_current_e_per_s,
            self.temperature_c,
            sensor.reference_temperature_c,
            sensor.doubling_temperature_c,
        )
        if not self.noise:
            return self.exposure_s * (np.maximum(light, 0) + dark_e_per_s)
        top, left = sensor.frame.on_chip(
            (0, 0, 0, 0)
        )  # of the first lit pixel, in all that is read
        lines = sensor.lines or LineNoise()
        mean = exposed(
            light,
            row + top + sensor.first_row,
            col + left + sensor.first_col,
            self.exposure_s,
            prnu=sensor.prnu_percent / 100,
            prnu_row=lines.prnu_row_percent / 100,
            prnu_column=lines.prnu_column_percent / 100,
            dark_current_e_per_s=dark_e_per_s,
            dcnu=sensor.dcnu_percent / 100,
            serial_number=sensor.serial_number,
            mask=self._mask(row, col),
        )
        return mean if sensor.defects is None else self._changed(mean, row, col, dark_e_per_s)

    def _mask(self, row: np.ndarray, col: np.ndarray) -> np.ndarray | float:
        """Return the multiplicative mask of pixels, 1 beside it."""
        masks = self.sensor.masks
        if masks is None or masks.gain is None:
            return 1.0
        plane, (first_row, first_col, rows, cols) = masks.plane("gain"), masks.area
        y, x = row + self.sensor.first_row - first_row, col + self.sensor.first_col - first_col
        inside = (y >= 0) & (y < rows) & (x >= 0) & (x < cols)
        own = plane[np.clip(y, 0, rows - 1), np.clip(x, 0, cols - 1)]
        return np.where(inside, own.astype(np.float64), 1.0)

    def _changed(
        self, mean: np.ndarray, row: np.ndarray, col: np.ndarray, dark_e_per_s: float
    ) -> np.ndarray:
        """Return the mean electrons (...) with those of the dead and hot pixels among them."""
        sensor, listed = self.sensor, defects_of(self.sensor)
        warmer = dark_current(
            1.0, self.temperature_c, sensor.reference_temperature_c, sensor.doubling_temperature_c
        )
        where = np.broadcast_arrays(row + sensor.first_row, col + sensor.first_col)
        at, keep, add = [], [], []
        for number, place in enumerate(
            zip(*(axis.ravel().tolist() for axis in where), strict=True)
        ):
            kind, value = listed.get(place, ("", 0.0))
            if kind in ("dead", "hot"):
                at.append((0, number))
                keep.append(float(kind == "hot"))
                e_per_s = dark_e_per_s if kind == "dead" else warmer * value
                add.append(self.exposure_s * e_per_s)
        return defects(mean.reshape(1, -1), at, np.array(keep), np.array(add)).reshape(mean.shape)


def _columns(light: _Light, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the mean charge of pixels (P,) of a CCD once their columns were shifted out."""
    sensor = light.sensor
    first, _, rows, _ = sensor.frame.pixels
    cols, line = np.unique(col, return_inverse=True)
    every_row = np.arange(first, first + rows)[:, None]
    spread = light.spread(every_row, cols)
    mean = light.exposed(spread, every_row, cols)
    limit_e = math.inf if sensor.bloom else sensor.full_well_e
    if sensor.smear is None:
        mean = np.minimum(mean, limit_e)
    else:
        kind = sensor.smear.kind
        if kind == "frame_transfer" and sensor.smear.cleared_by_shift:
            kind = "cleared"
        weight_s = sensor.smear.row_s * (sensor.smear.leak or 1.0)
        mean = smear(spread, mean, kind, weight_s, limit_e)
    if sensor.bloom:
        mean, _ = bloom(mean, sensor.full_well_e)
    return _transferred(mean, line, row - first, sensor, serial=False)


def _arrived(sensor: Sensor, charge: Placed, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return the mean electrons of pixels (P,) of a CCD that arrive of the charge in their rows."""
    rows, line = np.unique(row, return_inverse=True)
    first, cols = charge.rect[1], charge.rect[3]
    held = charge.at(rows, np.arange(first, first + cols)[:, None])
    return _transferred(held, line, col - first, sensor, serial=True)


def _transferred(
    charge: np.ndarray, line: np.ndarray, packet: np.ndarray, sensor: Sensor, *, serial: bool
) -> np.ndarray:
    """Return what arrives (P,) of packets of the lines of a charge (packets, lines).

    ``serial``: by the transfer along rows, else by that along columns.
    """
    # So many elements hold photosites, and as many packets as there are in a whole line; `before`
    # lie between the first of them and the read-out.
    if serial:
        model, before, elements = sensor.serial_cti, sensor.first_col, sensor.frame.pixels[3]
    else:
        model, before, elements = sensor.parallel_cti, sensor.first_row, sensor.frame.pixels[2]
    if model is None:
        return charge[packet, line]
    if model.traps:
        arrived, _ = traps(
            charge,
            [(one.density, one.release_transfers) for one in model.traps],
            well_fill_power=model.well_fill_power,
            well_e=model.well_e or sensor.full_well_e,
            notch_e=model.notch_e,
            groups=min(model.groups, before + elements),
            before=before,
            overscan=len(charge) - elements,
        )
        return arrived[packet, line]
    # Only so many packets before each one matter; before the first one of the line there are none.
    reach = min(_history(model.inefficiency, before + len(charge)), len(charge) - 1)
    behind = np.arange(-reach, 1)[:, None] + packet
    known = np.where(behind >= 0, charge[np.maximum(behind, 0), line], 0.0)
    return cti(known, model.inefficiency, before + packet - reach)[-1]


def _history(inefficiency: float, transfers: int) -> int:
    """Return the packets ahead of which a packet takes all but the share exp(-LEFT_OUT).

    What reaches a packet comes from d before it with the binomial law of N transfers, each of which
    leaves the fraction e behind. Bernstein's inequality (1924), with a variance below N e:
    P(d >= N e + t) <= exp(-t^2 / (2 (N e + t / 3))).
    """
    mean, third = transfers * inefficiency, LEFT_OUT / 3
    return math.ceil(mean + third + math.sqrt(third**2 + 2 * LEFT_OUT * mean))
