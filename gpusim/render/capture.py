"""What one frame is, with all that tells how it was made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.camera import Camera
from gpusim.certify import Certificate
from gpusim.isp.lens_tags import Optics
from gpusim.plan import Accuracy, Plan
from gpusim.plan.band import Band
from gpusim.plan.costs import Costs
from gpusim.plan.tiles import Rect
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.local import LocalPsfs, local_psfs
from gpusim.scene.scene import Scene
from gpusim.sensor.frame import Areas, areas_of
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from gpusim.render.lighting import Lighting
    from gpusim.render.reading import Reading
    from gpusim.render.renderer import Renderer


@dataclass(frozen=True)
class Capture:
    """One frame and how it was made.

    Attributes
    ----------
    raw : ndarray (rows, cols), uint16
        Digital numbers: of all that is read out, or of the rectangle that was asked for.
    rate, electrons : ndarray (rows, cols), float32, or None
        Electrons/s before the exposure, and electrons before the ADC, where they were kept.
    white_e : dict of str to float
        Mean electrons that the scene's white makes on the axis, by channel.
    transmission : ndarray (61,)
        Transmission of the lens, at WAVELENGTHS_NM.
    optics : Optics
        What files say of the lens.
    notes : tuple of str
        How the scene was read and placed.
    plan : Plan
    times_s : dict of str to float
        Seconds by stage, on the device's clock.
    wall_s : float
        From the recording of the first tile to the last byte of the raw; without preparation and
        certificate.
    prepare_s : dict of str to float
        Seconds spent before the first tile, which further frames of the same scene do not spend.
        Kernels that the memory does not hold all at once are made within the render: see
        ``times_s["kernels"]``.
    memory : dict of str to int
        Memory of the device, bytes: ``budget_bytes``, and ``peak_bytes`` that were held at most.
    work : dict of str to int
        How many ``tiles`` were rendered and ``blocks`` convolved, and of how many PSF nodes the
        kernels were made (``nodes``).
    rect : (int, int, int, int)
        First row and column, rows and columns of the raw, counted from the first lit pixel: the
        border of optical black has negative numbers.
    device : dict
        Adapter, driver and limits.
    certificate : Certificate or None
    camera, scene, seed, frame, exposure_s, accuracy
        What was asked for.
    temperature_c : float
        Temperature of the sensor.
    costs : Costs or None
        The rates that the plan was made from: with them it is made again.
    recipe : dict
        What makes its light again: see `gpusim.render.recipe`.
    band : Band
        The wavelengths that were rendered, and what no data describe.
    bank : FieldBank
        The PSFs that it was rendered with.
    """

    raw: np.ndarray
    rate: np.ndarray | None
    electrons: np.ndarray | None
    white_e: dict[str, float]
    transmission: np.ndarray
    optics: Optics
    notes: tuple[str, ...]
    plan: Plan
    times_s: dict[str, float]
    wall_s: float
    prepare_s: dict[str, float]
    memory: dict[str, int]
    work: dict[str, int]
    rect: Rect
    device: dict
    certificate: Certificate | None
    camera: Camera
    scene: Scene
    seed: int
    frame: int
    exposure_s: float
    accuracy: Accuracy
    temperature_c: float
    band: Band
    recipe: dict[str, Any]
    bank: FieldBank
    costs: Costs | None = None

    @property
    def areas(self) -> Areas:
        """Which pixels of the raw see light."""
        return areas_of(self.rect, self.camera.sensor.frame)

    @cached_property
    def psfs(self) -> LocalPsfs:
        """PSFs over the sensor, to look at."""
        return local_psfs(self.bank.levels[0], self.camera.sensor, self.scene)


def captured(
    renderer: Renderer,
    lighting: Lighting,
    reading: Reading,
    asked: Shot,
    *,
    rect: Rect,
    keep: tuple[str, ...],
    wall_s: float,
    nodes: int,
    certificate: Certificate | None,
) -> Capture:
    """Return what a renderer made of a rectangle.

    Parameters
    ----------
    renderer : Renderer
    lighting, reading : Lighting, Reading
        What brought the light, and what read it.
    asked : Shot
        With the seed that was asked for, of all frames.
    rect : (row, col, rows, cols)
        What was read.
    keep : tuple of str
        Any of "rate" and "electrons".
    wall_s : float
        Seconds of light and read-out.
    nodes : int
        PSF nodes that kernels were made for.
    certificate : Certificate or None
    """
    return Capture(
        costs=renderer.costs,
        recipe=renderer.recipe,
        band=renderer.band,
        raw=reading.on_rect("dn"),
        rate=reading.on_rect("rate") if "rate" in keep else None,
        electrons=reading.on_rect("electrons") if "electrons" in keep else None,
        white_e={name: asked.exposure_s * e for name, e in renderer.white_e_per_s.items()},
        transmission=renderer.transmission,
        optics=renderer.optics,
        notes=renderer.notes + tuple(lighting.notes),
        plan=renderer.plan,
        times_s=dict(lighting.times_s),
        wall_s=wall_s,
        prepare_s=dict(renderer.prepare_s),
        memory={"budget_bytes": renderer.memory_bytes, "peak_bytes": renderer.peak_bytes},
        work={**lighting.work, "nodes": nodes},
        rect=rect,
        device=renderer.device.report(),
        certificate=certificate,
        camera=renderer.camera,
        scene=renderer.scene,
        seed=asked.seed,
        frame=asked.frame,
        exposure_s=asked.exposure_s,
        accuracy=renderer.accuracy,
        temperature_c=asked.temperature_c,
        bank=renderer.bank,
    )
