"""Certificates of validations: renderers that certify their first frame, and what is told of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from gpusim.camera import Camera
from gpusim.certify import Certificate
from gpusim.library.expose import lit
from gpusim.library.light import Light
from gpusim.plan import Accuracy
from gpusim.render import Capture, Renderer
from gpusim.render.anew import Certified as WithCertificate
from gpusim.render.anew import planned_anew
from gpusim.render.checks import rectangle
from gpusim.scene.scene import Scene
from gpusim.validate.bars import Bar

CERTIFICATE_BAR = 1.0  # error over what is allowed


@dataclass(frozen=True)
class Certified:
    """The certificate of a render, and for which tolerance that was planned."""

    certificate: Certificate
    tolerance: float

    @property
    def share(self) -> float:
        """Error over what is allowed, the worse of RMS and of the worst probe (ten times it)."""
        one = self.certificate
        return max(one.total_rms, one.total_worst / 10) / self.tolerance


def certificate_bar(certificates: Mapping[str, Certified]) -> Bar:
    """Return the bar of the certificates: total error over the tolerance."""
    name = f"certificates of {len(certificates)} renders, total"
    shares = [one.share for one in certificates.values()]
    return Bar.largest(name, shares, CERTIFICATE_BAR, "of what is allowed")


def certificate_numbers(certificates: Mapping[str, Certified]) -> dict[str, Any]:
    """Return what the certificates say."""
    names = ("total_rms", "total_worst", "met", "probes")
    return {
        render: {name: getattr(one.certificate, name) for name in names}
        | {"tolerance": one.tolerance}
        for render, one in certificates.items()
    }


Rect = tuple[int, int, int, int]  # x, y, width, height


def certified_tiles(
    camera: Camera, scene: Scene, accuracy: Accuracy, exposure_s: float, tiles: Sequence[Rect]
) -> list[Capture]:
    """Return the mean light of rectangles, ``rate`` kept; the first has the certificate.

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
    try:
        return [capture, *(taken(renderer, tile) for tile in others)]
    finally:
        renderer.release()


def certified_lights(
    camera: Camera, scene: Scene, accuracy: Accuracy, tiles: Sequence[Rect]
) -> list[Light]:
    """Return the light of rectangles; the first has the certificate.

    Parameters
    ----------
    camera : Camera
    scene : Scene
    accuracy : Accuracy
    tiles : sequence of (x, y, width, height)
    """
    first, *others = (rectangle(tile, camera.sensor) for tile in tiles)
    renderer, light = certified(
        accuracy,
        lambda asked: Renderer(camera, scene, asked),
        lambda renderer: lit(renderer, first),
    )
    try:
        return [light, *(lit(renderer, one) for one in others)]
    finally:
        renderer.release()


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
