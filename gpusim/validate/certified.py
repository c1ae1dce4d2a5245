"""Certificates of validations: renderers that certify their first frame, and what is told of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from gpusim.camera import Camera
from gpusim.certify import Certificate, Judged, Share
from gpusim.certify.budget import WORST_TO_RMS
from gpusim.library.expose import lit
from gpusim.library.light import Light
from gpusim.pareto.knobs import oversampled
from gpusim.plan import Accuracy
from gpusim.plan.tiles import enclosing
from gpusim.render import Capture, Renderer
from gpusim.render.anew import Certified as WithCertificate
from gpusim.render.anew import planned_anew
from gpusim.render.checks import rectangle
from gpusim.scene.scene import Scene
from gpusim.validate.bars import Bar
from gpusim.validate.report import Rows, Section

CERTIFICATE_BAR = 1.0  # error over what is allowed


@dataclass(frozen=True)
class Certified:
    """The certificate of a render, and for which tolerance that was planned.

    Where rectangles of its frame were rendered, ``rectangles`` holds the total RMS of each.
    """

    certificate: Certificate
    tolerance: float
    rectangles: tuple[float, ...] = ()

    @property
    def share(self) -> float:
        """Error over what is allowed, the worse of RMS and of the worst probe (ten times it)."""
        one = self.certificate
        return max(one.total_rms, one.total_worst / WORST_TO_RMS) / self.tolerance


def certificate_bar(certificates: Mapping[str, Certified], name: str = "") -> Bar:
    """Return the bar of the certificates: total error over the tolerance, RMS and worst probe."""
    name = name or f"certificates of {len(certificates)} renders, total"
    shares = [one.share for one in certificates.values()]
    return Bar.largest(name, shares, CERTIFICATE_BAR, "of what is allowed")


def certificates_of(made: Mapping[str, WithCertificate], tolerance: float) -> dict[str, Certified]:
    """Return the certificates of frames or lights that were planned for a tolerance."""
    return {name: Certified(one.certificate, tolerance) for name, one in made.items()}


def pooled(made: Sequence[WithCertificate], tolerance: float) -> Certified:
    """Return the certificate of rectangles of one frame: of all their probes together.

    So it is for a whole frame, whose tolerance is about its RMS and its worst probe.
    """
    own = [one.certificate for one in made]
    probes = sum(one.probes for one in own)
    rms = math.sqrt(sum(one.probes * one.total_rms**2 for one in own) / probes)
    worst = max(one.total_worst for one in own)
    met = rms <= tolerance and worst <= WORST_TO_RMS * tolerance
    whole = replace(own[0], probes=probes, total_rms=rms, total_worst=worst, met=met)
    return Certified(whole, tolerance, tuple(one.total_rms for one in own))


def certificate_numbers(certificates: Mapping[str, Certified]) -> dict[str, Any]:
    """Return what the certificates say."""
    names = ("total_rms", "total_worst", "met", "probes")
    return {
        render: {name: getattr(one.certificate, name) for name in names}
        | {"tolerance": one.tolerance, "rms_of_rectangles": list(one.rectangles)}
        for render, one in certificates.items()
    }


def certificate_section(
    certificates: Mapping[str, Certified], without: Mapping[str, str] | None = None
) -> Section:
    """Return the section that says of each render what its certificate found.

    Parameters
    ----------
    certificates : dict of str to Certified
    without : dict of str to str, optional
        Renders that have none, and why.
    """
    text = (
        "The error of the mean signal over the signal, of engine, bank, sensor and window together,"
        f" at probe pixels: RMS within the tolerance, the worst within {WORST_TO_RMS:g} times it. "
        "Where rectangles of one frame were rendered, probes lie in each, and count together; they "
        "share the plan, the bank and the bank's part, for which the lens is traced anew in the "
        "first one; so do renders that differ in the sensor alone."
    )
    body = [
        [name, f"{one.tolerance:g}", f"{one.certificate.total_rms:.1e}",
         f"{one.certificate.total_worst:.1e}", str(one.certificate.probes),
         ", ".join(f"{rms:.1e}" for rms in one.rectangles)]
        for name, one in certificates.items()
    ]  # fmt: skip
    body += [[name, f"none: {why}", "", "", "", ""] for name, why in (without or {}).items()]
    head = (
        "render",
        "tolerance",
        "total, RMS",
        "total, worst probe",
        "probes",
        "RMS of rectangles",
    )
    return Section("Certificates of the renders", text, rows=Rows(head, body))


Rect = tuple[int, int, int, int]  # x, y, width, height


def certified_tiles(
    camera: Camera, scene: Scene, accuracy: Accuracy, exposure_s: float, tiles: Sequence[Rect]
) -> list[Capture]:
    """Return the mean light of rectangles, ``rate`` kept, each with a certificate.

    The lens is traced anew for the first alone; it should be where PSFs change most.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    exposure_s : float
    tiles : sequence of (x, y, width, height)
    """

    def made(asked: Accuracy) -> Renderer:
        return Renderer(camera, scene, asked, noise=False)

    def taken(renderer: Renderer, tile: Rect) -> Capture:
        return renderer.capture(exposure_s, tile=tile, keep=("rate",))

    first, *others = tiles
    renderer, capture = certified(accuracy, made, lambda renderer: taken(renderer, first))
    go_on(renderer, capture, accuracy.probes)
    try:
        return [capture, *(taken(renderer, tile) for tile in others)]
    finally:
        renderer.release()


def certified_lights(
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    tiles: Sequence[Rect],
    *,
    like: WithCertificate | None = None,
    samples: int | None = None,
) -> list[Light]:
    """Return the light of rectangles, each with a certificate.

    The lens is traced anew for the first alone; it should be where PSFs change most.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    tiles : sequence of (x, y, width, height)
    like : Light or Capture, optional
        Before the same lens and scene: its certificate's bank part stands, nothing is traced anew.
    samples : int, optional
        Samples a pixel, in place of the planner's.
    """
    first, *others = (rectangle(tile, camera.sensor) for tile in tiles)

    def made(asked: Accuracy) -> Renderer:
        renderer = Renderer(camera, scene, asked)
        if samples is not None:
            planned = renderer
            renderer = Renderer(camera, scene, asked, plan=oversampled(planned, samples))
            planned.release()
        renderer.judged = None if like is None else judged_as(like)
        renderer.hold_halo(enclosing([first, *others]), lambda what, done, total: None)
        return renderer

    renderer, light = certified(accuracy, made, lambda renderer: lit(renderer, first))
    go_on(renderer, light, accuracy.probes)
    try:
        return [light, *(lit(renderer, one) for one in others)]
    finally:
        renderer.release()


def go_on(renderer: Renderer, first: WithCertificate, probes: int | None) -> None:
    """Let a renderer certify further rectangles, at so many probes, with the bank's part of one.

    Eight probes take a second of one core; tracing the lens anew would take twelve.
    """
    renderer.judged = judged_as(first)
    renderer.accuracy = replace(renderer.accuracy, probes=probes)


def judged_as(one: WithCertificate) -> Judged:
    """Return the bank's part and the window's of a certificate."""
    found = one.certificate
    return Judged(Share(found.bank_rms, found.bank_worst, found.probes), found.window, ())


Taken = TypeVar("Taken", bound=WithCertificate)


def certified(
    accuracy: Accuracy,
    make: Callable[[Accuracy], Renderer],
    take: Callable[[Renderer], Taken],
) -> tuple[Renderer, Taken]:
    """Return a renderer and its first frame or light, planned anew while that misses the tolerance.

    The renderer's further frames have no certificate.

    Parameters
    ----------
    accuracy : Accuracy
    make : callable
        Makes the renderer for an accuracy.
    take : callable
        Takes the frame, or the light.
    """
    kept: Renderer | None = None

    def attempt(asked: Accuracy) -> Taken:
        nonlocal kept
        renderer = make(asked)
        try:
            found = take(renderer)
        except BaseException:
            renderer.release()
            raise
        if kept is not None:
            kept.release()
        kept = renderer
        return found

    first = planned_anew(accuracy, attempt)
    assert kept is not None
    kept.accuracy = replace(kept.accuracy, probes=0)
    return kept, first
