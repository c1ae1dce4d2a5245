"""Pictures for knobs and a view: a draft at once, and at rest the one that ``render`` makes.

| what is turned | what a draft does again |
|---|---|
| exposure, ISO, temperature, noise, effects of the read-out, ev | read-out, development |
| focus shift | PSFs at the new focus, convolution |
| another part of the sensor | convolution |
| lens, f-number, focal length, focus distance | trace of few rays, plan, convolution |
| scene, light, sensor | plan, convolution |
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gpusim.camera import Camera
from gpusim.lens.prescription import Prescription
from gpusim.library.frame import Frame
from gpusim.library.light import Light
from gpusim.library.session import Session
from gpusim.plan.deadline import predicted_error
from gpusim.plan.stages import Plan
from gpusim.preview.draft import Draft, DraftLens, binned, step_for
from gpusim.preview.picture import Developer, mosaic
from gpusim.preview.state import Knobs, View
from gpusim.scene.scene import Scene
from gpusim.sensor.optical import OPTICAL

DRAFT, REFINED = "draft", "refined"
SPARE_PX = 64  # more photosites at the sensor's end than any binned pattern has


class Stale(Exception):  # noqa: N818 - nothing went wrong
    """What is being made is not asked for any more."""


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture, and what is known of it.

    Attributes
    ----------
    kind : str
        ``draft`` or ``refined``.
    knobs : Knobs
    rect : (x, y, width, height)
        The camera's photosites that it shows.
    rgb : ndarray (rows, cols, 3), uint8
        Developed.
    frame : Frame
        The raw behind it; a draft's has fewer, larger pixels.
    step : int
        Photosites each way to one of its pixels.
    plan : Plan
    redone : tuple of str
        What was done for it: ``lens``, ``plan``, ``PSFs``, ``light``, ``read-out``.
    times_s : dict of str to float
        Seconds of each.
    """

    kind: str
    knobs: Knobs
    rect: tuple[int, int, int, int]
    rgb: np.ndarray
    frame: Frame
    step: int
    plan: Plan
    redone: tuple[str, ...]
    times_s: dict[str, float]

    @property
    def predicted_error(self) -> float:
        """RMS error that the plan predicts, relative to the signal."""
        return predicted_error(self.plan)

    def photosites(self) -> np.ndarray:
        """Return the raw in the colours of its filters: see `mosaic`."""
        return mosaic(self.frame)


class Engine:
    """Makes pictures for knobs and views, and keeps what the next ones may use."""

    def __init__(self) -> None:
        self._draft_key: tuple | None = None
        self._draft: Draft | None = None
        self._lens_key: object = None
        self._lens: DraftLens | None = None
        self._light_key: tuple | None = None
        self._light: tuple[Light, tuple[int, int, int, int]] | None = None
        self._session: Session | None = None
        self._session_key: tuple | None = None
        self._developers = {DRAFT: Developer(), REFINED: Developer()}

    def draft(self, knobs: Knobs, view: View) -> Shown:
        """Return a draft of what is seen.

        Raises
        ------
        UserError
            The camera or the scene cannot be had so.
        """
        clock = _Clock()
        camera, scene = knobs.made_camera(), knobs.made_scene()
        sensor = camera.sensor
        seen = view.seen(sensor.rows, sensor.cols, _period(camera))
        step = step_for(seen[2] * seen[3])
        made = self._made_draft(knobs, camera, scene, step, clock)
        shift_um = knobs.focus_shift_um or 0.0
        key = knobs.f_number, shift_um
        if self._light is None or self._light_key != key or not _covers(self._light[1], seen):
            if self._lens is not None and made.bank is not self._lens.at(shift_um):
                made.refocus(self._lens.at(shift_um))
                clock.did("PSFs")
            self._light = made.light(seen)
            self._light_key = key
            clock.did("light")
        light, rect = self._light
        light = light.at(sensor=binned(sensor, step))
        frame = self._read(light, knobs)
        clock.did("read-out")
        rgb = self._developers[DRAFT].develop(frame, knobs.ev)
        clock.did("development")
        plan = made.renderer.plan
        return Shown(DRAFT, knobs, rect, rgb, frame, step, plan, clock.done, clock.times_s)

    def _made_draft(
        self, knobs: Knobs, camera: Camera, scene: Scene, step: int, clock: _Clock
    ) -> Draft:
        """Return the draft's chain, kept until lens, scene, pixels or step change."""
        self._trace(replace(knobs, focus_shift_um=None), scene, clock)
        # Focus and stop change PSFs alone; where light lands they leave as it is.
        lasting = replace(knobs, focus_shift_um=None, f_number=None)
        optical = tuple(str(getattr(camera.sensor, name)) for name in OPTICAL)
        key = (lasting.optics, optical, step)
        if self._draft is None or self._draft_key != key:
            self._drop_draft()
            self._draft = Draft(camera, scene, step, self._lens)
            self._draft_key = key
            clock.did("plan")
        return self._draft

    def _trace(self, in_focus: Knobs, scene: Scene, clock: _Clock) -> None:
        """Trace the lens for drafts, if it is another one than before and can be traced."""
        key = in_focus.lens_key, tuple(scene.wavelengths_nm[[0, -1]])
        if self._lens_key == key:
            return
        if self._lens is not None:
            self._lens.release()
            self._lens = None
        lens = in_focus.made_camera().lens
        if isinstance(lens, Prescription) and lens.is_centred:
            self._lens = DraftLens(lens, scene.wavelengths_nm)
            clock.did("lens")
        self._lens_key = key

    def _read(self, light: Light, knobs: Knobs) -> Frame:
        return light.capture(
            knobs.exposure_s,
            seed=knobs.seed,
            temperature_c=knobs.temperature_c,
            noise=knobs.noise,
        )

    def refine(
        self,
        knobs: Knobs,
        view: View,
        stale: Callable[[], bool],
        progress: Callable[[str, int, int], None] | None = None,
        probes: int = 0,
    ) -> Shown:
        """Return what is seen as ``render`` makes it, to the knobs' tolerance.

        Parameters
        ----------
        knobs, view
        stale : callable
            Asked often; once it says yes, `Stale` is raised.
        progress : callable, optional
            Called with (what, done, total).
        probes : int
            Pixels of a certificate; 0: none.

        Raises
        ------
        Stale
        UserError
            The tolerance cannot be met, or a value is one that the camera cannot have.
        """

        def step(what: str, done: int, total: int) -> None:
            if stale():
                raise Stale
            if progress is not None:
                progress(what, done, total)

        clock = _Clock()
        camera, scene = knobs.made_camera(), knobs.made_scene()
        seen = view.seen(camera.sensor.rows, camera.sensor.cols, _period(camera))
        key = knobs.optics
        if self._session is None or self._session_key != key:
            self._drop_session()
            self._session = Session(camera, scene, knobs.tolerance, probes=probes, progress=step)
            self._session_key = key
        session = self._session
        session.progress = step
        session.change(sensor=camera.sensor, tolerance=knobs.tolerance, probes=probes, tile=seen)
        session.change(
            exposure_s=knobs.exposure_s,
            temperature_c=knobs.temperature_c,
            seed=knobs.seed,
            noise=knobs.noise,
        )
        frame = session.frame()
        clock.times_s["light" if "light" in session.redone else "read-out"] = clock.passed()
        rgb = self._developers[REFINED].develop(frame, knobs.ev)
        clock.did("development")
        return Shown(
            REFINED, knobs, seen, rgb, frame, 1, session.plan, session.redone, clock.times_s
        )

    def psf(self, knobs: Knobs, x: float, y: float) -> tuple[np.ndarray, float]:
        """Return the draft's PSF (n, n) in the middle of the spectrum nearest to a photosite.

        Turned as it lies on the sensor is left to the eye: row sagittal, column tangential, along
        the radius. The pitch of its samples, um, comes with it.
        """
        draft, sensor = self._draft, knobs.bare.made_camera().sensor
        if draft is None:
            return np.zeros((2, 2)), 1.0
        bank = draft.renderer.core
        height = sensor.pixel_pitch_um * float(np.hypot(x - sensor.cols / 2, y - sensor.rows / 2))
        heights = bank.real_height_um[:, bank.reference]
        field = int(np.argmin(np.abs(heights - height)))
        return bank.psf[field, bank.reference], bank.pitch_um

    def release(self) -> None:
        """Give the device's memory back."""
        self._drop_draft()
        self._drop_session()
        if self._lens is not None:
            self._lens.release()
            self._lens = None

    def _drop_draft(self) -> None:
        if self._light is not None:
            self._light[0].release()
        self._light = self._light_key = None
        if self._draft is not None:
            self._draft.release()
            self._draft = None

    def _drop_session(self) -> None:
        if self._session is not None:
            self._session.release()
            self._session = None


def _covers(rect: tuple[int, int, int, int], seen: tuple[int, int, int, int]) -> bool:
    """Return whether a rectangle holds another, but for what binning leaves over at the rim."""
    return all(
        low <= first and first + size <= low + wide + SPARE_PX
        for low, wide, first, size in zip(rect[:2], rect[2:], seen[:2], seen[2:], strict=True)
    )


def _period(camera: Camera) -> int:
    return int(np.lcm(*camera.sensor.period))


class _Clock:
    """What was done, and how long each part took."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.times_s: dict[str, float] = {}

    @property
    def done(self) -> tuple[str, ...]:
        return tuple(self.times_s)

    def passed(self) -> float:
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        return passed

    def did(self, what: str) -> None:
        self.times_s[what] = self.passed()
