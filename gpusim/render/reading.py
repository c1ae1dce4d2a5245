"""One frame on its way from the light at the photosites to digital numbers on the host.

It needs the light alone, whoever brings it: a render tile by tile (`gpusim.render.lighting`), or a
light that is kept (`gpusim.render.light`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from gpusim.certify import MeanSignal, Placed
from gpusim.gpu import Array, Device, Recording, Resident, Result
from gpusim.plan.tiles import STRIP_SHARE, Rect, strips
from gpusim.sensor.ccd import ReadOut, needed, record_tile, taking
from gpusim.sensor.frame import overlap
from gpusim.sensor.readout import (
    Shot,
    SiteLight,
    record_charge,
    record_read,
    record_readout,
    rects_of,
)
from gpusim.sensor.sensor import Sensor


@dataclass(frozen=True)
class Reader:
    """What reads light out: a sensor, on a device.

    Attributes
    ----------
    device : Device
    sensor : Sensor
    runs : callable
        Whether a stage of the sensor runs, by its name in the plan.
    glare : Resident (sites,), f32
        Veiling glare of each site of the filter pattern, electrons/s.
    memory_bytes : int
        Budget of device memory: it decides how many rows are read at once.
    run : callable
        Runs a recording: whoever pays for the frame counts its seconds.
    """

    device: Device
    sensor: Sensor
    runs: Callable[[str], bool]
    glare: Resident
    memory_bytes: int
    run: Callable[[Recording], Result]


class Reading(Protocol):
    """One frame in the making."""

    rect: Rect  # the pixels whose light it takes, tile by tile

    def take(self, tile: Rect, rates: Resident, whole: Rect) -> None:
        """Take the light (S, rows, cols) of a rectangle of whole periods that lights a tile."""

    def finish(self) -> None:
        """Do what needs the light of all tiles."""

    def on_rect(self, name: str) -> np.ndarray:
        """Return a plane, of the rectangle that was asked for."""

    def mean_signal(self) -> MeanSignal:
        """Return the light and the mean electrons that the certificate compares."""


def reading_of(
    reader: Reader, rect: Rect, names: dict[str, type], folder: Path | None, shot: Shot
) -> Reading:
    """Return a frame of a sensor that is to be made.

    Parameters
    ----------
    reader : Reader
    rect : (row, col, rows, cols)
        What is wanted of all that is read out.
    names : dict of str to type
        The planes that are wanted, and of which numbers: ``dn``, ``electrons``, ``mean``, ``rate``.
    folder : path, optional
        Where the planes are kept as files; without it in memory.
    shot : Shot
    """
    kind = CcdReading if reader.sensor.is_ccd else CmosReading
    return kind(reader, rect, names, folder, shot)


def read_together(
    readers: Sequence[Reader], shots: Sequence[Shot], rect: Rect, rates: Resident, whole: Rect
) -> list[np.ndarray]:
    """Return the raws (rows, cols) of several frames of one light, in one recording.

    Submitting, waiting and fetching cost some milliseconds each, however many frames there are. The
    mean charge is the same for all frames of an exposure: it comes once, and is half of the work.

    Parameters
    ----------
    readers : sequence of Reader
        One for each frame, of CMOS sensors, on one device.
    shots : sequence of Shot
    rect, whole : (row, col, rows, cols)
        What is read, and the rectangle of whole periods that the light is of.
    rates : Resident (S, rows, cols), f32
    """
    rec, labels = Recording(readers[0].device), []
    collecting: list[Sensor] = []  # those of which each collects other charge
    means: dict[tuple[int, float, float | None], Array] = {}
    for number, (reader, shot) in enumerate(zip(readers, shots, strict=True)):
        sensor, runs = reader.sensor, reader.runs
        alike = (n for n, one in enumerate(collecting) if one.collects_as(sensor))
        if (kind := next(alike, len(collecting))) == len(collecting):
            collecting.append(sensor)
        exposure = kind, shot.exposure_s, shot.temperature_c
        with rec.labelled(f"frame {number} "):
            if exposure not in means:
                light = SiteLight(rates, reader.glare, whole)
                means[exposure] = record_charge(rec, light, sensor, rect, shot=shot, runs=runs)[1]
            read = record_read(rec, means[exposure], sensor, rect, shot=shot, runs=runs)
            labels.append(rec.download(read["dn"], np.uint16))
    result = readers[0].run(rec)
    return [result[label] for label in labels]


def taken_for(rect: Rect, sensor: Sensor, runs: Callable[[str], bool]) -> Rect:
    """Return the pixels whose light is taken for a rectangle: of a CCD, whole columns."""
    return needed(rect, sensor, runs) if sensor.is_ccd else rect


def lit_for(rect: Rect, sensor: Sensor, runs: Callable[[str], bool]) -> Rect:
    """Return the lit pixels that a rectangle needs; of one without any, the pixel next to it.

    So that there always are planes of the sites, of which the border then takes nothing.
    """
    _, rect = rects_of(rect, sensor, runs)
    sides = []
    for first, count, size in zip(rect[:2], rect[2:], sensor.frame.lit[2:], strict=True):
        begin = min(max(first, 0), size - 1)
        sides.append((begin, max(min(first + count, size) - begin, 1)))
    (row, rows), (col, cols) = sides
    return row, col, rows, cols


class CmosReading:
    """A frame whose pixels are read where they stand: strip by strip of each tile."""

    def __init__(
        self,
        reader: Reader,
        rect: Rect,
        names: dict[str, type],
        folder: Path | None,
        shot: Shot,
    ) -> None:
        self.reader, self.rect, self.shot = reader, rect, shot
        self.planes = {
            name: _on_host(name, self._area(name, rect)[2:], dtype, folder)
            for name, dtype in names.items()
        }

    def take(self, tile: Rect, rates: Resident, whole: Rect) -> None:
        """Take the light on a tile to digital numbers, strip by strip."""
        for strip in strips(tile, self.reader.memory_bytes):
            self._strip(strip, rates, whole)

    def finish(self) -> None:
        """Nothing is left to do: each strip went all the way."""

    def _strip(self, strip: Rect, rates: Resident, whole: Rect) -> None:
        """Take a strip of rows from the planes of the sites to digital numbers, and to the host."""
        rec = Recording(self.reader.device)
        outputs = self._outputs(rec, strip, rates, whole)
        # Without noise the electrons are their own mean: one buffer, which comes once.
        for array in {outputs[name].label: outputs[name] for name in self.planes}.values():
            rec.download(array)
        result = self.reader.run(rec)
        for name, plane in self.planes.items():
            part = _part(plane, self._area(name, self.rect), self._area(name, strip))
            part[...] = result[outputs[name].label]

    def _area(self, name: str, rect: Rect) -> Rect:
        """Return what a plane holds of a rectangle: also the pixels around it that it needs."""
        collecting, around = rects_of(rect, self.reader.sensor, self.reader.runs)
        return {"rate": around, "mean": collecting}.get(name, rect)

    def on_rect(self, name: str) -> np.ndarray:
        """Return a plane, of the rectangle alone."""
        return _part(self.planes[name], self._area(name, self.rect), self.rect)

    def mean_signal(self) -> MeanSignal:
        """Return the light and the mean electrons that the certificate compares."""
        placed = [Placed(self.planes[n], self._area(n, self.rect)) for n in ("rate", "mean")]
        return MeanSignal(*placed)

    def _outputs(
        self, rec: Recording, strip: Rect, rates: Resident, whole: Rect
    ) -> dict[str, Array]:
        """Record what becomes of a strip."""
        light = SiteLight(rates, self.reader.glare, whole)
        how = {"shot": self.shot, "runs": self.reader.runs}
        return record_readout(rec, light, self.reader.sensor, strip, **how)


class CcdReading(CmosReading):
    """One frame of a CCD: the tiles bring the light, then charge goes by columns and by rows."""

    def __init__(
        self,
        reader: Reader,
        rect: Rect,
        names: dict[str, type],
        folder: Path | None,
        shot: Shot,
    ) -> None:
        light = {"light": np.float32}
        if "rate" in names and reader.runs("crosstalk"):
            light["rate"] = np.float32
        # Beside what is wanted of the same name.
        within = None if folder is None else folder / "light"
        if within is not None:
            within.mkdir(exist_ok=True)
        super().__init__(reader, taken_for(rect, reader.sensor, reader.runs), light, within, shot)
        self.folder = folder
        self.charge = self._charge("charge")
        self.wanted = rect
        self.found = {
            name: _on_host(name, rect[2:], dtype, folder)
            for name, dtype in names.items()
            if name != "mean"  # made when it is asked for
        }

    def finish(self) -> None:
        """Read the light of all tiles out."""
        read_out = self._read_out(self.reader.run)
        read_out.columns(self.planes["light"], self.rect, self.charge)
        drawn = {name: plane for name, plane in self.found.items() if name != "rate"}
        read_out.rows(self.charge, self.rect[1], self.wanted, drawn)
        if "rate" in self.found:  # none in the overscan
            seen = overlap(self.wanted, self.rect)
            self.found["rate"][...] = 0
            _part(self.found["rate"], self.wanted, seen)[...] = _part(*self._light, seen)

    @property
    def _light(self) -> Placed:
        """The rate of the pixels."""
        name = "rate" if "rate" in self.planes else "light"
        return Placed(self.planes[name], self._area(name, self.rect))

    def _area(self, name: str, rect: Rect) -> Rect:
        return taking(rect, self.reader.sensor, self.reader.runs) if name == "rate" else rect

    def _charge(self, name: str) -> np.ndarray:
        """Return room for the charge of whole columns."""
        size = self.reader.sensor.frame.read[2], self.rect[3]
        return _on_host(name, size, np.float32, self.folder)

    def _read_out(
        self, run: Callable[[Recording], Result], without: Collection[str] = ()
    ) -> ReadOut:
        reader = self.reader
        return ReadOut(
            reader.device,
            reader.sensor,
            self.shot,
            lambda name: name not in without and reader.runs(name),
            reader.memory_bytes // STRIP_SHARE,
            run,
        )

    def on_rect(self, name: str) -> np.ndarray:
        """Return a plane, of the rectangle alone."""
        return self.found[name]

    def mean_signal(self) -> MeanSignal:
        """Return light, mean charge of whole columns, and mean electrons that arrive.

        The light goes through the read-out once more, and no noise is drawn.
        """
        read = self.reader.sensor.frame.read
        columns = read[0], self.rect[1], read[2], self.rect[3]
        charge = self._charge("mean_charge")
        self._read_out(Recording.run, ("noise",)).columns(self.planes["light"], self.rect, charge)
        # Whole rows: the serial register is as long as the frame itself found it.
        seen = overlap(self.wanted, self.rect)
        rows = seen[0], self.rect[1], seen[2], self.rect[3]
        mean = _on_host("mean", rows[2:], np.float32, self.folder)
        # What comes once the charge has arrived.
        later = ("noise", "electrical crosstalk", "defects")
        self._read_out(Recording.run, later).rows(charge, rows[1], rows, {"electrons": mean})
        return MeanSignal(self._light, Placed(mean, rows), Placed(charge, columns))

    def _outputs(
        self, rec: Recording, strip: Rect, rates: Resident, whole: Rect
    ) -> dict[str, Array]:
        reader = self.reader
        light = SiteLight(rates, reader.glare, whole)
        return record_tile(rec, light, reader.sensor, strip, reader.runs)


def _on_host(name: str, shape: tuple[int, int], dtype: type, folder: Path | None) -> np.ndarray:
    """Return an array in memory, or in a file of a folder."""
    if folder is None:
        return np.empty(shape, dtype)
    file = folder / f"{name}.npy"
    array = np.lib.format.open_memmap(file, mode="w+", dtype=dtype, shape=shape)
    if hasattr(os, "posix_fallocate"):  # a full disk is told here, and kills nothing later
        with file.open("r+b") as opened:
            os.posix_fallocate(opened.fileno(), 0, file.stat().st_size)
    return array


def _part(plane: np.ndarray, area: Rect, rect: Rect) -> np.ndarray:
    """Return the part of a plane, which is that of an area, on a rectangle of it."""
    row, col = rect[0] - area[0], rect[1] - area[1]
    return plane[row : row + rect[2], col : col + rect[3]]
