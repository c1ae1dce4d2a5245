"""The read-out of a CCD on one screen: where charge is shifted, after `readout`'s light.

Towards row 0 and column 0, which are read first; what is read after the last of them is overscan.

0. of each tile: mosaic, border and optical crosstalk, as of any sensor
1. exposure, dead and hot pixels, as of any sensor
2. smear: what light makes in the packets of whole columns on their way, from rates not clipped
3. noise, its first half: shot noise of all that; full well, unless charge blooms
4. bloom: charge above the full well flows along the columns
5. cti or traps, parallel: along the columns
6. cti or traps, serial: along the rows
7. electrical crosstalk: between what is read one after the other
8. noise, its second half: what is added when the charge is read; stuck pixels
9. adc

Smear comes before the transfer's inefficiency, so that its trails point the right way in the
overscan; the overscan, which collects no light and no dark current, is smeared like all that passes
the lit rows, and holds the trails. Whole columns, and whole rows as far as the charge comes through
them, are needed for any pixel: they pass through the host between the two.

What lies beyond the frame is not known: of a region of a sensor (`Sensor.roi`) all rows are taken
for dark but those of the region, which charge is shifted through as far as the chip goes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gpusim.gpu import Array, Device, Recording, Result
from gpusim.sensor.adc import record_adc
from gpusim.sensor.bloom import record_bloom
from gpusim.sensor.border import record_border
from gpusim.sensor.crosstalk import grown, reach, record_crosstalk
from gpusim.sensor.cti import record_cti
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.defects import record_defects, record_stuck
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.frame import Rect
from gpusim.sensor.noise import record_noise
from gpusim.sensor.readout import Shot, SiteLight, record_light
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.smear import record_smear
from gpusim.sensor.traps import record_traps

BOUNDLESS_E = 1.6e7  # no full well: the most that the noise stage draws
# Buffers of a strip on its way: light and mean, each also framed, smeared, charge, bloomed,
# arrived, the levels of traps, what goes to the host and comes from there.
PLANES = 12


def needed(rect: Rect, sensor: Sensor, runs: Callable[[str], bool]) -> Rect:
    """Return the pixels whose light a rectangle needs: whole columns, and all to the left of them.

    Parameters
    ----------
    rect : (row, col, rows, cols)
        With a pixel that is no overscan.
    sensor : Sensor
    runs : callable
        Whether a stage runs, by its name in the plan.
    """
    row, first, rows, cols = sensor.frame.pixels
    around = _around(sensor, runs)
    begin = first if runs("serial cti") else max(rect[1] - around, first)
    end = min(rect[1] + rect[3] + around, first + cols)
    return row, begin, rows, end - begin


def _around(sensor: Sensor, runs: Callable[[str], bool]) -> int:
    """Return how many pixels around a rectangle its electrical crosstalk needs."""
    return reach(sensor.crosstalk.electrical, sensor.period) if runs("electrical crosstalk") else 0


def taking(rect: Rect, sensor: Sensor, runs: Callable[[str], bool]) -> Rect:
    """Return the pixels whose light a rectangle takes: with what optical cross-talk needs."""
    if not runs("crosstalk"):
        return rect
    return grown(rect, reach(sensor.crosstalk.optical, sensor.period), sensor.frame.pixels)


def record_tile(
    rec: Recording,
    taken: SiteLight,
    sensor: Sensor,
    rect: Rect,
    runs: Callable[[str], bool],
) -> dict[str, Array]:
    """Record the light that makes charge on a rectangle of pixels: see `readout.record_readout`.

    Returns
    -------
    dict of str to Array (rows, cols), f32
        ``rate`` of the pixels whose light the rectangle takes, and ``light`` of the rectangle,
        which is the rate with optical cross-talk: electrons/s.
    """
    around, frame = taking(rect, sensor, runs), sensor.frame.pixels
    light = rate = record_light(rec, taken, sensor, around, runs)
    if runs("crosstalk"):
        optical = sensor.crosstalk.optical
        light = record_crosstalk(rec, rate, optical, sensor, given=around, wanted=rect, frame=frame)
    return {"rate": rate, "light": light}


def record_columns(
    rec: Recording,
    rate: Array,
    sensor: Sensor,
    rect: Rect,
    *,
    shot: Shot,
    runs: Callable[[str], bool],
) -> Array:
    """Record the charge of whole columns, from the light to the serial register.

    Parameters
    ----------
    rec : Recording
    rate : Array (rows, cols), f32
        Electrons/s of the pixels.
    sensor : Sensor
    rect : (row, col, rows, cols)
        Where they lie: all rows of the pixels.
    shot : Shot
    runs : callable
        Whether a stage runs, by its name in the plan.

    Returns
    -------
    Array (all rows that are read, cols), f32
        Electrons.
    """
    frame = sensor.frame
    read = frame.read[0], rect[1], frame.read[2], rect[3]
    overscan = read[2] - rect[2]
    clipped = {} if runs("noise") or runs("bloom") else {"limit_e": sensor.full_well_e}
    at_once = {} if runs("smear") else clipped
    mean = record_exposure(
        rec,
        rate,
        sensor,
        shot.exposure_s,
        temperature_c=shot.temperature_c,
        origin=frame.on_chip(rect),
        runs=runs,
        **at_once,
    )
    if runs("defects"):
        warm = {"temperature_c": shot.temperature_c, "origin": frame.on_chip(rect)}
        record_defects(rec, mean, sensor, shot.exposure_s, **warm, **at_once)
    if overscan:
        rate = record_border(rec, rate, rect, read, label="framed rate")
        mean = record_border(rec, mean, rect, read, label="framed mean")
    if runs("smear"):
        mean = record_smear(rec, rate, mean, sensor.smear, **clipped)
    charge = mean
    if runs("noise"):
        charge = record_noise(
            rec,
            mean,
            sensor.unchecked(full_well_e=BOUNDLESS_E) if runs("bloom") else sensor,
            seed=shot.seed,
            frame=shot.frame,
            origin=frame.on_chip(read),
            label="charge",
            read_out=False,
            runs=runs,
        )
    if runs("bloom"):
        photosites = (rect[0] - read[0], rect[0] - read[0] + rect[2])
        charge, _ = record_bloom(rec, charge, sensor.full_well_e, photosites=photosites)
    if runs("parallel cti"):
        charge = _shifted(rec, charge, sensor.parallel_cti, sensor, overscan, serial=False)
    return charge


def record_rows(
    rec: Recording,
    charge: Array,
    sensor: Sensor,
    given: Rect,
    rect: Rect,
    *,
    shot: Shot,
    runs: Callable[[str], bool],
) -> dict[str, Array]:
    """Record the read-out of rows, from the serial register to digital numbers.

    Parameters
    ----------
    rec : Recording
    charge : Array (rows, pixels' cols), f32
        Electrons, where ``given`` begins.
    sensor : Sensor
    given : (row, col, rows, cols)
        What is shifted; with overscan where it is wider than ``charge``.
    rect : (row, col, rows, cols)
        What is wanted: the same, or with electrical cross-talk what has enough around it.
    shot : Shot
    runs : callable
        Whether a stage runs, by its name in the plan.

    Returns
    -------
    dict of str to Array
        ``electrons``, f32, and ``dn``, u32: each (rows, cols).
    """
    overscan = given[3] - charge.shape[1]
    if overscan:
        held = (*given[:2], *charge.shape)
        charge = record_border(rec, charge, held, given, label="framed charge")
    electrons, origin = charge, sensor.frame.on_chip(rect)
    if runs("serial cti"):
        # The register is as long as the sensor, however much of it a tile needs.
        beyond = charge.shape[1] - sensor.frame.pixels[3]
        electrons = _shifted(rec, charge, sensor.serial_cti, sensor, beyond, serial=True)
    if runs("electrical crosstalk"):
        kernels, frame = sensor.crosstalk.electrical, sensor.frame.read
        among = {"given": given, "wanted": rect, "frame": frame}
        electrons = record_crosstalk(rec, electrons, kernels, sensor, **among, label="coupled")
    if runs("noise"):
        electrons = record_noise(
            rec,
            electrons,
            sensor,
            seed=shot.seed,
            frame=shot.frame,
            temperature_c=shot.temperature_c,
            origin=origin,
            shot=False,
            runs=runs,
        )
    if runs("defects"):
        record_stuck(rec, electrons, sensor, origin=origin)
    dn = record_adc(rec, electrons, sensor, origin=origin, column_offset=runs("column fpn"))
    return {"electrons": electrons, "dn": dn}


def _shifted(
    rec: Recording, charge: Array, cti: Cti, sensor: Sensor, overscan: int, *, serial: bool
) -> Array:
    """Record one direction of the transfer, by the model that the sensor's file gives."""
    where = {"serial": serial, "before": sensor.first_col if serial else sensor.first_row}
    where["label"] = "serial" if serial else "parallel"
    if cti.inefficiency is not None:
        return record_cti(rec, charge, cti.inefficiency, **where)
    well_e = sensor.full_well_e
    return record_traps(rec, charge, cti, well_e=well_e, overscan=overscan, **where)[0]


@dataclass(frozen=True)
class ReadOut:
    """The read-out of a rectangle whose light is on the host.

    Attributes
    ----------
    device : Device
    sensor : Sensor
    shot : Shot
    runs : callable
        Whether a stage runs, by its name in the plan.
    strip_bytes : int
        Device memory that a strip of columns or rows may take.
    run : callable
        Runs a recording.
    """

    device: Device
    sensor: Sensor
    shot: Shot
    runs: Callable[[str], bool]
    strip_bytes: int
    run: Callable[[Recording], Result]

    def columns(self, light: np.ndarray, rect: Rect, charge: np.ndarray) -> None:
        """Shift the charge of whole columns out of the pixels.

        Parameters
        ----------
        light : ndarray (rows, cols), float32
            Electrons/s of `needed` pixels.
        rect : (row, col, rows, cols)
            Where they lie.
        charge : ndarray (all rows that are read, cols), float32
            What becomes of them.
        """
        row, col, rows, cols = rect
        for begin, end in self._strips(cols, len(charge)):
            rec = Recording(self.device)
            rate = rec.buffer("rate", (rows, end - begin), "f4")
            rec.upload(rate, np.ascontiguousarray(light[:, begin:end]))
            part = row, col + begin, rows, end - begin
            arrived = record_columns(rec, rate, self.sensor, part, shot=self.shot, runs=self.runs)
            label = rec.download(arrived)
            charge[:, begin:end] = self.run(rec)[label]

    def rows(
        self, charge: np.ndarray, first_col: int, rect: Rect, planes: dict[str, np.ndarray]
    ) -> None:
        """Read a rectangle.

        Parameters
        ----------
        charge : ndarray (all rows that are read, cols), float32
        first_col : int
            First column of the charge.
        rect : (row, col, rows, cols)
            What is wanted.
        planes : dict of str to ndarray (rows, cols)
            "dn" or "electrons" of the rectangle.
        """
        row, col, rows, cols = rect
        read, around = self.sensor.frame.read, _around(self.sensor, self.runs)
        width = min(col + cols + around, read[1] + read[3]) - first_col
        for begin, end in self._strips(rows, width):
            top = max(row + begin - around, read[0])
            bottom = min(row + end + around, read[0] + read[2])
            rec = Recording(self.device)
            held = charge[top - read[0] : bottom - read[0]]
            buffer = rec.buffer("charge in", held.shape, "f4")
            rec.upload(buffer, np.ascontiguousarray(held))
            given = top, first_col, bottom - top, width
            part = (row + begin, col, end - begin, cols) if around else given
            how = {"shot": self.shot, "runs": self.runs}
            found = record_rows(rec, buffer, self.sensor, given, part, **how)
            labels = {name: rec.download(found[name]) for name in planes}
            result, left = self.run(rec), col - part[1]
            for name, plane in planes.items():
                plane[begin:end] = result[labels[name]][:, left : left + cols]

    def _strips(self, count: int, length: int) -> Iterator[tuple[int, int]]:
        """Cut lines of some length into strips that fit the memory."""
        step = max(self.strip_bytes // (PLANES * 4 * length), 1)
        return ((begin, min(begin + step, count)) for begin in range(0, count, step))
