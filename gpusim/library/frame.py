"""Frames: what the sensor made of a light, one or many."""

from __future__ import annotations

import base64
import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from html import escape
from itertools import cycle, islice
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from gpusim.errors import UserError
from gpusim.gpu import held
from gpusim.isp.develop import develop
from gpusim.isp.dng import has_dng, write_dng
from gpusim.isp.files import image_of, write_picture
from gpusim.isp.histogram import channel_values
from gpusim.isp.levels import iso_speed, saturation_dn
from gpusim.library.recipe import write_sidecar
from gpusim.library.together import read_raws
from gpusim.scene.exr import write_exr
from gpusim.sensor.frame import Areas, areas_of
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from gpusim.certify import Certificate
    from gpusim.library.light import Light
    from gpusim.sensor.sensor import Sensor

SHOWN_PX = 960  # longest side of a frame's picture in a notebook
HISTOGRAM_BINS = 96
# Frames in one recording: what submitting and fetching cost is shared, and memory stays small.
TOGETHER = 10


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    Attributes
    ----------
    raw : ndarray (rows, cols), uint16
        Digital numbers.
    light : Light
        What was read, and the sensor that read it.
    shot : Shot
        Exposure (s), seed, frame number and temperature.
    noise : bool
        Whether noise and fixed patterns were drawn.
    """

    raw: np.ndarray
    light: Light
    shot: Shot
    noise: bool = True

    def __repr__(self) -> str:
        rows, cols = self.raw.shape
        return (
            f"Frame({self.light.title!r}, {self.light.scene!r}, {cols} x {rows} pixels, "
            f"{_seconds(self.exposure_s)}, ISO {self.iso}, {self.saturated.mean():.2%} saturated)"
        )

    @property
    def exposure_s(self) -> float:
        """Exposure time, seconds."""
        return self.shot.exposure_s

    @property
    def iso(self) -> int:
        """ISO speed: the sensor's, or the saturation-based one of ISO 12232."""
        return iso_speed(self.light.sensor)

    @property
    def certificate(self) -> Certificate | None:
        """How far the light is from the exact one: see `Light.certificate`."""
        return self.light.certificate

    @cached_property
    def electrons(self) -> np.ndarray:
        """Electrons before the converter, noise included: (rows, cols), float32."""
        return self.light.read({"electrons": np.float32}, self.shot, self.noise)["electrons"]

    @cached_property
    def truth_dn(self) -> np.ndarray:
        """Mean signal in DN, without noise, fixed patterns and rounding: (rows, cols), float32."""
        return truth_dn(self.light, self.shot)

    @property
    def saturated(self) -> np.ndarray:
        """Which pixels are saturated: (rows, cols), bool."""
        return self.raw >= saturation_dn(self.light.sensor)

    @property
    def areas(self) -> Areas:
        """Which pixels see light, and which are shielded from it."""
        return areas_of(self.light.rect, self.light.sensor.frame)

    def histogram(self, bins: int = 256) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the raw's histogram by colour.

        Parameters
        ----------
        bins : int

        Returns
        -------
        edges_dn : ndarray (bins + 1,)
        counts : dict of str to ndarray (bins,)
            Pixels of each filter colour that see light.
        """
        row, col, rows, cols = self.areas.active
        lit = self.raw[row : row + rows, col : col + cols]
        edges = np.linspace(0, self.light.sensor.raw_max_dn + 1, bins + 1)
        values = channel_values(lit, self.light.sensor, self.areas.lit[:2])
        return edges, {name: np.histogram(one, edges)[0] for name, one in values.items()}

    def develop(self, ev: float = 0.0) -> Image.Image:
        """Return the picture: white balance as shot, colour matrix, sRGB; see `gpusim develop`.

        Parameters
        ----------
        ev : float
            By how many stops it is shown brighter.
        """
        with tempfile.TemporaryDirectory() as folder:
            sensor = self.light.sensor.cut(*self.areas.lit[:2])
            path = Path(folder) / ("raw.dng" if has_dng(sensor) else "raw.tif")
            self.write_raw(path, ev)
            return image_of(develop(path).picture)

    def save(self, path: str | Path, ev: float = 0.0, *, taken: datetime | None = None) -> None:
        """Write the frame to a file, whose suffix says as what.

        ``.dng``, or ``.tif`` where DNG has no way: the raw, and beside it in a ``.json`` what makes
        it again (`gpusim render --from`). ``.png``, ``.jpg``: the developed
        picture, `ev` stops brighter. ``.exr``: electrons. ``.npz``: raw, electrons, truth_dn,
        saturated, and with what they were taken. `taken`: the time in a raw, by default now.

        Raises
        ------
        UserError
            Another suffix, or the file cannot be written.
        """
        path = Path(path)
        try:
            self._save(path, ev, taken)
        except OSError as error:
            raise UserError(
                f"the frame cannot be written: {error.strerror or error}",
                file=path,
                allowed="a file in a folder that is there",
            ) from error

    def _save(self, path: Path, ev: float, taken: datetime | None) -> None:
        suffix = path.suffix.lower()
        if suffix in (".dng", ".tif", ".tiff"):
            taken = taken or datetime.now(UTC)
            self.write_raw(path, ev, taken)
            write_sidecar(self, path, taken, ev=ev)
        elif suffix in (".png", ".jpg", ".jpeg"):
            write_picture(path, np.asarray(self.develop(ev)))
        elif suffix == ".exr":
            write_exr(path, {"Y": self.electrons}, units="e-")
        elif suffix == ".npz":
            np.savez(
                path,
                raw=self.raw,
                electrons=self.electrons,
                truth_dn=self.truth_dn,
                saturated=self.saturated,
                exposure_s=self.exposure_s,
                iso=self.iso,
                seed=self.shot.seed,
                frame=self.shot.frame,
            )
        else:
            raise UserError(
                "no such kind of file for a frame",
                file=path,
                value=suffix or "no suffix",
                allowed=".dng, .tif, .png, .jpg, .exr, .npz",
            )

    def write_raw(self, path: Path, ev: float, taken: datetime | None = None) -> None:
        """Write the raw as a DNG, or as a TIFF with its tags: see `save`."""
        light, areas = self.light, self.areas
        sensor = light.sensor.cut(*areas.lit[:2])
        if path.suffix.lower() == ".dng" and not has_dng(sensor):
            raise UserError(
                "DNG has no way to say what this filter array is",
                file=path,
                field="sensor.cfa",
                allowed=".tif: the same tags in a TIFF",
            )
        write_dng(
            path,
            self.raw,
            sensor,
            white_e={name: one * self.exposure_s for name, one in light.white_e_per_s.items()},
            exposure_s=self.exposure_s,
            transmission=light.transmission,
            active_area=areas.active,
            masked_areas=areas.masked,
            optics=light.optics,
            place=areas.lit[:2],
            temperature_c=self.shot.temperature_c,
            ev=ev,
            taken=taken,
        )

    def _repr_png_(self) -> bytes:
        """Return the developed picture for notebooks."""
        picture = self.develop()
        picture.thumbnail((SHOWN_PX, SHOWN_PX))
        with io.BytesIO() as file:
            picture.save(file, "PNG")
            return file.getvalue()

    def _repr_html_(self) -> str:
        """Return picture, histogram and certificate for notebooks."""
        shown = base64.b64encode(self._repr_png_()).decode("ascii")
        certificate = self.certificate
        verdict = "not certified"
        if certificate is not None:
            verdict = (
                f"total RMS {certificate.total_rms:.1e}, worst {certificate.total_worst:.1e}: "
                f"tolerance {self.light.tolerance} {'met' if certificate.met else 'not met'}"
            )
        return (
            f"<figure style='margin:0'><img src='data:image/png;base64,{shown}' "
            f"style='max-width:100%'><figcaption>{escape(repr(self)[6:-1])}<br>{escape(verdict)}"
            f"</figcaption>{self._histogram_svg()}</figure>"
        )

    def _histogram_svg(self) -> str:
        """Return the raw's histogram by colour, square-root counts."""
        _, counts = self.histogram(HISTOGRAM_BINS)
        top = max(float(np.sqrt(one.max())) for one in counts.values()) or 1.0
        colours = {"R": "#c0392b", "G": "#27864a", "B": "#2c62b4"}
        lines = "".join(
            f"<polyline fill='none' stroke='{colours.get(letter, '#777')}' points='"
            + " ".join(
                f"{k * 480 / HISTOGRAM_BINS:.1f},{78 - 76 * np.sqrt(n) / top:.1f}"
                for k, n in enumerate(one)
            )
            + "'/>"
            for letter, one in counts.items()
        )
        return f"<svg viewBox='0 0 480 80' style='width:100%;max-width:480px'>{lines}</svg>"


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
    """

    raw: np.ndarray
    light: Light
    shots: tuple[Shot, ...]
    sensors: tuple[Sensor, ...]
    truth_dn: np.ndarray | None = None

    def __repr__(self) -> str:
        count, rows, cols = self.raw.shape
        times = ", ".join(dict.fromkeys(_seconds(one.exposure_s) for one in self.shots))
        return f"Burst({self.light.title!r}, {count} frames of {cols} x {rows} pixels, {times})"

    def __len__(self) -> int:
        return len(self.raw)

    def __getitem__(self, number: int) -> Frame:
        """Return one frame."""
        light = self.light.at(sensor=self.sensors[number])
        return Frame(self.raw[number], light, self.shots[number])

    def __iter__(self) -> Iterator[Frame]:
        return (self[number] for number in range(len(self)))

    @property
    def exposure_s(self) -> np.ndarray:
        """Exposure times, seconds: (frames,)."""
        return np.array([one.exposure_s for one in self.shots])


def truth_dn(light: Light, shot: Shot) -> np.ndarray:
    """Return the mean signal in DN, without noise, fixed patterns and rounding: (rows, cols), f32.

    EMVA 1288's linear model, mu_y = mu_y.dark + K mu_e (release 3.1, equation 3), with the sensor's
    non-linearity, as far as the converter's codes go.
    """
    sensor = light.sensor
    electrons = light.read({"electrons": np.float32}, shot, False)["electrons"]
    if sensor.linearity is not None:
        electrons = sensor.linearity.read(electrons)
    signal = np.float32(sensor.system_gain_dn_per_e) * electrons
    rows, cols = sensor.period
    black = np.asarray(sensor.site_black_dn, np.float32).reshape(rows, cols)
    first = light.rect[0] % rows, light.rect[1] % cols
    black = np.roll(black, (-first[0], -first[1]), (0, 1))
    times = [-(-size // period) for size, period in zip(signal.shape, (rows, cols), strict=True)]
    black = np.tile(black, times)[: signal.shape[0], : signal.shape[1]]
    return np.clip(signal + black, 0, sensor.raw_max_dn).astype(np.float32)


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


def _seconds(exposure_s: float) -> str:
    """Return an exposure time as photographers write it."""
    if exposure_s >= 0.3:
        return f"{exposure_s:.3g} s"
    return f"1/{1 / exposure_s:.4g} s"
