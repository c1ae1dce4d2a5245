"""Bursts: frames of one light, read one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from numbers import Integral, Real
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import held
from gpusim.library.frame import Frame, histogram_curves, spoken_s, truth_dn
from gpusim.library.notebook import abreast, facts, figure, picture
from gpusim.library.together import read_raws
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from gpusim.library.light import Light
    from gpusim.sensor.sensor import Sensor

MOST_SHOWN, SHOWN_PX = 4, 240  # frames of a burst in a notebook, and their longest side
# Frames in one recording: what submitting and fetching cost is shared, and memory stays small.
TOGETHER = 10


@dataclass(frozen=True, eq=False)
class Burst:
    """Frames of one light.

    Attributes
    ----------
    raw : ndarray (frames, rows, cols), uint16
    light : Light
    shots : tuple of Shot
        Exposure, seed and number of each frame.
    sensors : tuple of Sensor
        The sensor of each frame, at its gain.
    truth_dn : ndarray (frames, rows, cols), float32, or None
        The mean signal of each, where it was asked for.

    Examples
    --------
    >>> burst = light.burst(4, [1/240, 1/60], seed=7)
    >>> burst[1]
    Frame('small', 'colorchecker', 64 x 48 pixels, 1/60 s, ISO 100, 0.00% saturated)
    >>> len(burst), burst.exposure_s.round(4).tolist()
    (4, [0.0042, 0.0167, 0.0042, 0.0167])
    >>> [frame.shot.frame for frame in burst]
    [0, 1, 2, 3]
    """

    raw: np.ndarray
    light: Light
    shots: tuple[Shot, ...]
    sensors: tuple[Sensor, ...]
    truth_dn: np.ndarray | None = None

    def __repr__(self) -> str:
        count, rows, cols = self.raw.shape
        times = ", ".join(dict.fromkeys(spoken_s(one.exposure_s) for one in self.shots))
        return f"Burst({self.light.title!r}, {count} frames of {cols} x {rows} pixels, {times})"

    def __len__(self) -> int:
        return len(self.raw)

    def __getitem__(self, number: int) -> Frame:
        """Return one frame."""
        light = self.light.at(sensor=self.sensors[number])
        return Frame(self.raw[number], light, self.shots[number])

    def __iter__(self) -> Iterator[Frame]:
        return (self[number] for number in range(len(self)))

    def _repr_html_(self) -> str:
        """Return the first frame at each exposure and gain with its histogram, for notebooks."""
        first: dict[tuple[float, float], int] = {}
        for number, (shot, sensor) in enumerate(zip(self.shots, self.sensors, strict=True)):
            first.setdefault((shot.exposure_s, sensor.analogue_gain), number)
        cells = []
        for (exposure_s, gain), number in list(first.items())[:MOST_SHOWN]:
            frame = self[number]
            what = f"frame {number}", {"": spoken_s(exposure_s), "gain": f"{gain:g}"}
            shown = picture(frame.develop(), SHOWN_PX), facts(*what), histogram_curves(frame)
            cells.append(figure(*shown))
        told = {"": repr(self)[6:-1]}
        if len(first) > MOST_SHOWN:
            told["shown"] = f"{MOST_SHOWN} of {len(first)} settings"
        return figure(facts("Burst", told), abreast(*cells))

    @property
    def exposure_s(self) -> np.ndarray:
        """Exposure times, seconds: (frames,)."""
        return np.array([one.exposure_s for one in self.shots])


def taken(
    light: Light,
    count: int,
    exposure_s: float | Sequence[float] | None,
    iso: int | Sequence[int] | None,
    *,
    seed: int,
    temperature_c: float | None,
    truth: bool,
    progress: Callable[[str, int, int], None] | None,
) -> Burst:
    """Return a burst: see `Light.burst`."""
    if not isinstance(count, Integral) or count < 1:
        raise UserError("no frame was asked for", field="count", value=count, allowed="1 or more")
    for name, given in (("exposure_s", exposure_s), ("iso", iso)):
        if not all(one is None or isinstance(one, Real) for one in _several(given)):
            raise UserError("not numbers", field=name, value=given, allowed="numbers, in turns")
        if not _several(given):
            raise UserError("an empty list", field=name, allowed="one or several, or None")
    speeds = [light.at(iso=one) for one in _several(iso)]
    exposures = [
        speeds[0].white_exposure_s if one is None else float(one) for one in _several(exposure_s)
    ]
    # Gain changes once all exposures were taken: every pair comes.
    pairs = [(one, at) for at in speeds for one in exposures]
    raw = np.empty((count, *light.rect[2:]), np.uint16)
    means: dict[int, np.ndarray] = {}
    shots, sensors = [], []
    for number, (seconds, at) in enumerate(islice(cycle(pairs), count)):
        shots.append(Shot(seconds, seed, number, temperature_c))
        sensors.append(at.sensor)
        if truth and number < len(pairs):
            means[number] = truth_dn(at, shots[number])
    with held():
        for first in range(0, count, TOGETHER):
            chunk = slice(first, min(first + TOGETHER, count))
            for number, one in enumerate(read_raws(light, sensors[chunk], shots[chunk]), first):
                raw[number] = one
            if progress is not None:
                progress("burst", chunk.stop, count)
    clean = None
    if truth:
        clean = np.stack([means[number % len(pairs)] for number in range(count)])
    return Burst(raw, light, tuple(shots), tuple(sensors), clean)


def read_frames(shots: Sequence[tuple[Light, Shot]]) -> list[Frame]:
    """Return the frames of shots at one light, noise drawn: as one by one, but read together.

    Parameters
    ----------
    shots : sequence of (Light, Shot)
        As `Light.shot` returns them, of one light. `TOGETHER` of them take as little memory as a
        burst.
    """
    if not shots:
        return []
    lights, taken = zip(*shots, strict=True)
    with held():
        raws = read_raws(lights[0], [light.sensor for light in lights], taken)
    return [Frame(*one) for one in zip(raws, lights, taken, strict=True)]


def _several(value: object) -> list:
    """Return one value or several as a list."""
    return list(value) if isinstance(value, Sequence | np.ndarray) else [value]
