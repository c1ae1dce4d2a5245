"""The light on a camera's photosites: made once by the optics, read as often as asked.

`gpusim.library.expose` makes it, `Light.capture` and `Light.burst` read it. Nothing of the optics
is done again for another exposure, gain, temperature or seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import Recording, Resident, default_device
from gpusim.library.burst import taken
from gpusim.library.frame import Frame
from gpusim.library.held import Held
from gpusim.library.shot import checked
from gpusim.library.store import read_light, save_light
from gpusim.plan.stages import sensor_runs
from gpusim.plan.tiles import Rect, aligned, tiles_of
from gpusim.render.reading import Reader, Reading, lit_for, reading_of
from gpusim.sensor.optical import optical_differences
from gpusim.sensor.planes import planes_of
from gpusim.sensor.readout import Shot, SiteLight, record_readout

if TYPE_CHECKING:
    from pathlib import Path

    from gpusim.certify import Certificate
    from gpusim.isp.lens_tags import Optics
    from gpusim.library.burst import Burst
    from gpusim.sensor.sensor import Sensor

# Without an exposure of its own a capture brings the scene's white to this share of saturation:
# ISO 12232 leaves half a stop above a white diffuser for highlights.
WHITE_SHARE = 2**-0.5


@dataclass(frozen=True, eq=False)
class Light:
    """What arrives at the photosites of a camera before a scene.

    Attributes
    ----------
    title : str
        The camera's.
    scene : str
        The scene's name.
    sensor : Sensor
        What reads it.
    rect : (row, col, rows, cols)
        The pixels that a frame of it has, counted from the first lit one.
    area : (row, col, rows, cols)
        The pixels that ``rates`` hold: whole periods of the filter pattern.
    rates : ndarray (S, rows / period, cols / period), float32
        Electrons/s of the photosites, a plane for each site of the filter pattern.
    glare : ndarray (sites,), float32
        Veiling glare of each site, electrons/s.
    white_e_per_s : dict of str to float
        Mean electrons/s that the scene's white makes on the axis, by channel.
    transmission : ndarray (61,)
        Transmission of the lens from 400 to 700 nm in steps of 5 nm.
    optics : Optics
        What files say of the lens.
    tolerance : str
        For which it was made, in words.
    recipe : dict
        What makes it again: see `gpusim.render.recipe`.
    notes : tuple of str
        How the scene was read and placed.
    certificate : Certificate or None
        How far the mean signal is from the exact one, at the exposure of `white_exposure_s`.

    Examples
    --------
    >>> import gpusim as gs
    >>> small = gs.Camera.load("mtf-only")
    >>> small = gs.Camera(small.lens, small.sensor.roi(48, 64), "small")
    >>> light = gs.expose(small, gs.Scene.load("colorchecker"), 1e-2, probes=0)
    >>> light.rates.shape  # of each site of the filter pattern, 2 x 2, its photosites
    (4, 24, 32)
    """

    title: str
    scene: str
    sensor: Sensor
    rect: Rect
    area: Rect
    rates: np.ndarray
    glare: np.ndarray
    white_e_per_s: dict[str, float]
    transmission: np.ndarray
    optics: Optics
    tolerance: str
    recipe: dict[str, Any]
    notes: tuple[str, ...] = ()
    certificate: Certificate | None = None
    _held: Held = field(default_factory=Held, init=False, repr=False)  # on the device

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: all but what lies on a device."""
        return {**self.__dict__, "_held": Held()}

    def __repr__(self) -> str:
        rows, cols = self.rect[2:]
        certified = ""
        if self.certificate is not None:
            verdict = "met" if self.certificate.met else "not met"
            certified = f", total RMS {self.certificate.total_rms:.1e} ({verdict})"
        return f"Light({self.title!r}, {self.scene!r}, {cols} x {rows} pixels{certified})"

    def _repr_html_(self) -> str:
        """Return the picture that the white exposure takes, for notebooks."""
        return self.capture()._repr_html_()

    @property
    def white_exposure_s(self) -> float:
        """Exposure that brings the scene's white on the axis to 71 % of saturation, seconds."""
        brightest = max(self.white_e_per_s.values())
        return WHITE_SHARE * self.sensor.saturation_e / brightest if brightest > 0 else 1.0

    def at(
        self,
        *,
        iso: int | None = None,
        gain: float | None = None,
        sensor: Sensor | None = None,
    ) -> Self:
        """Return the same light before a sensor that reads it differently.

        Parameters
        ----------
        iso, gain : int, float, optional
            A step of the sensor's analogue gain, by its ISO speed or by itself.
        sensor : Sensor, optional
            Another sensor with the same pixels, filters and quantum efficiency.

        Raises
        ------
        UserError
            No such step, both at once, or a sensor whose pixels see other light.
        """
        chosen = self.sensor if sensor is None else sensor
        if differing := optical_differences(chosen, self.sensor):
            raise UserError(
                "the light was made for other pixels",
                field=f"sensor.{differing[0]}",
                value=getattr(chosen, differing[0]),
                allowed="a sensor with the same pixels, filters and quantum efficiency: expose "
                "the camera with this one anew",
            )
        if iso is not None and gain is not None:
            raise UserError("both name the gain", field="iso", value=iso, allowed="iso or gain")
        if iso is not None:
            chosen = chosen.at_iso(iso)
        if gain is not None:
            chosen = chosen.at_gain(gain)
        if chosen is self.sensor:
            return self
        other = replace(self, sensor=chosen)
        object.__setattr__(other, "_held", self._held)  # the same light lies on the device
        return other

    def capture(
        self,
        exposure_s: float | None = None,
        *,
        iso: int | None = None,
        gain: float | None = None,
        seed: int = 0,
        frame: int = 0,
        temperature_c: float | None = None,
        noise: bool = True,
    ) -> Frame:
        """Read the light with the sensor alone: one frame.

        Parameters
        ----------
        exposure_s : float, optional
            Seconds; by default `white_exposure_s`.
        iso, gain : int, float, optional
            A step of the sensor's analogue gain.
        seed : int
            0 to 2^64 - 1. The same seed, frame, exposure and gain give the same raw as
            ``gpusim render``.
        frame : int
            0 to 2^32 - 1. Frames of one seed have independent noise.
        temperature_c : float, optional
            The sensor's, degrees Celsius; by default its reference temperature.
        noise : bool
            Whether to draw noise and fixed patterns; else the frame is the mean signal.

        Raises
        ------
        UserError
            A value out of range.

        Examples
        --------
        >>> light.capture(1/60, seed=7)
        Frame('small', 'colorchecker', 64 x 48 pixels, 1/60 s, ISO 100, 0.00% saturated)
        >>> light.burst(20, [1/240, 1/60], seed=7)
        Burst('small', 20 frames of 64 x 48 pixels, 1/240 s, 1/60 s)
        """
        seen = self.at(iso=iso, gain=gain)
        shot = seen.shot(exposure_s, seed, frame, temperature_c)
        raw = seen.read({"dn": np.uint16}, shot, noise)["dn"]
        return Frame(raw, seen, shot, noise)

    def shot(
        self,
        exposure_s: float | None = None,
        seed: int = 0,
        frame: int = 0,
        temperature_c: float | None = None,
    ) -> Shot:
        """Return what `capture` reads of the light at its gain.

        Parameters
        ----------
        exposure_s, seed, frame, temperature_c
            As of `capture`.

        Raises
        ------
        UserError
            A value out of range.
        """
        seconds = self.white_exposure_s if exposure_s is None else exposure_s
        shot = Shot(seconds, seed, frame, temperature_c)
        checked(shot, self.sensor)
        return shot

    def burst(
        self,
        count: int,
        exposure_s: float | Sequence[float] | None = None,
        *,
        iso: int | Sequence[int] | None = None,
        seed: int = 0,
        temperature_c: float | None = None,
        truth: bool = False,
        progress: Callable[[str, int, int], None] | None = None,
    ) -> Burst:
        """Read the light several times: frames counted on, each with noise of its own.

        Parameters
        ----------
        count : int
            Frames, 1 or more.
        exposure_s : float or sequence of float, optional
            Seconds; several are taken in turns: a bracket.
        iso : int or sequence of int, optional
            ISO speeds, in turns as well.
        seed : int
            Frame k is frame number k of this seed.
        temperature_c : float, optional
            The sensor's, degrees Celsius.
        truth : bool
            Whether to keep the mean signal of each exposure, in DN, without noise and rounding.
        progress : callable, optional
            Called with (what, done, total).

        Raises
        ------
        UserError
            No frame, or a value out of range.

        Examples
        --------
        >>> burst = light.burst(4, [1/240, 1/60], seed=7, truth=True)
        >>> burst.raw.shape, burst.truth_dn.shape
        ((4, 48, 64), (4, 48, 64))
        """
        return taken(
            self,
            count,
            exposure_s,
            iso,
            seed=seed,
            temperature_c=temperature_c,
            truth=truth,
            progress=progress,
        )

    def read(self, names: dict[str, type], shot: Shot, noise: bool = True) -> dict[str, np.ndarray]:
        """Return planes of one frame: ``dn``, ``electrons``, ``rate`` (electrons/s), ``mean``.

        Parameters
        ----------
        names : dict of str to type
            The planes, and of which numbers they are.
        shot : Shot
        noise : bool

        Returns
        -------
        dict of str to ndarray (rows, cols)

        Raises
        ------
        UserError
            A value of the shot is out of range.
        """
        reading = self.reading(names, shot, noise)
        return {name: reading.on_rect(name) for name in names}

    def reader(self, sensor: Sensor, runs: Callable[[str], bool]) -> Reader:
        """Return what reads the light out on the device: a sensor, and which of its stages run."""
        device = default_device()
        glare = self._held.glare(self.glare)
        return Reader(device, sensor, runs, glare, device.pool.budget, Recording.run)

    def on_device(self, whole: Rect) -> Resident:
        """Return the light of a rectangle of whole periods, on the device."""
        return self._held.rates(self.rates, self.area, whole, planes_of(self.sensor).period)

    def reading(self, names: dict[str, type], shot: Shot, noise: bool = True) -> Reading:
        """Return a frame as the certificate takes it: see `read`."""
        shot = checked(shot, self.sensor)
        runs = sensor_runs(self.sensor, noise)
        reader = self.reader(self.sensor, runs)
        reading = reading_of(reader, self.rect, names, None, shot)
        planes = planes_of(self.sensor)
        for tile in tiles_of(reading.rect, planes.period, reader.memory_bytes, None, planes.layers):
            whole = aligned(lit_for(tile, self.sensor, runs), planes.period)
            reading.take(tile, self.on_device(whole), whole)
        reading.finish()
        return reading

    def recording(self, shot: Shot, noise: bool = True) -> tuple[Recording, str]:
        """Return the read-out of one frame as a recording, and under which label its raw comes.

        All of it is read at once, however much memory that takes.

        Raises
        ------
        UserError
            A CCD, whose read-out is no one recording; a value of the shot is out of range.
        """
        if self.sensor.is_ccd:
            raise UserError(
                "charge of a CCD moves by columns and rows in turns: that is no one recording",
                field="sensor",
                value=self.sensor.name,
                allowed="a CMOS sensor",
            )
        runs, period = sensor_runs(self.sensor, noise), planes_of(self.sensor).period
        whole = aligned(lit_for(self.rect, self.sensor, runs), period)
        rec = Recording(default_device())
        light = SiteLight(self.on_device(whole), self._held.glare(self.glare), whole)
        kept = checked(shot, self.sensor)
        outputs = record_readout(rec, light, self.sensor, self.rect, shot=kept, runs=runs)
        return rec, rec.download(outputs["dn"])

    def release(self) -> None:
        """Give the device's memory back; what needs it again brings it there again."""
        self._held.release()

    def save(self, path: str | Path) -> None:
        """Write the light to a file, to be read again by `Light.load`: see `gpusim.library.store`.

        Raises
        ------
        UserError
            The file cannot be written.

        Examples
        --------
        >>> light.save("light.npz")
        """
        save_light(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Light:
        """Return a light that was saved.

        Raises
        ------
        UserError
            No such file, or not a light.

        Examples
        --------
        >>> import gpusim as gs
        >>> light.save("light.npz")
        >>> again = gs.Light.load("light.npz")
        >>> bool((again.capture(1/60, seed=7).raw == light.capture(1/60, seed=7).raw).all())
        True
        """
        return cls(**read_light(path))
