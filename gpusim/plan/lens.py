"""What a plan says of a lens: where its image ends, its distortion and its lateral colour."""

from __future__ import annotations

from collections.abc import Collection

from gpusim.optics.chief_ray import ChiefRayMap, black_share
from gpusim.plan.stage import PlanStage
from gpusim.plan.stages import RIM
from gpusim.psf.field_bank import FieldBank
from gpusim.sensor.sensor import Sensor

LATERAL = "lateral"  # the stage of lateral colour


def describe_lens(
    bank: FieldBank, sensor: Sensor, chief_ray: ChiefRayMap, force: Collection[str]
) -> tuple[PlanStage, ...]:
    """Describe where the image ends, and what this lens may not need."""
    distorts, moves = chief_ray.distortion, bank.lateral_um > 0
    forced = {name: ", forced" * (name in force) for name in ("distortion", LATERAL)}
    return (
        _rim(bank, sensor),
        PlanStage(
            "distortion",
            distorts,
            "where each sample lies on the ideal plane, by splines to "
            f"{chief_ray.error_um:.0e} um" + forced["distortion"]
            if distorts
            else "the lens has none: the ideal and the real image are one",
        ),
        PlanStage(
            LATERAL,
            moves or LATERAL in force,
            f"colours lie up to {bank.lateral_um:.3g} um apart, folded into the kernels"
            if moves
            else "the lens has none: no colour is moved" + forced[LATERAL],
        ),
    )


def _rim(bank: FieldBank, sensor: Sensor) -> PlanStage:
    """Describe where the image ends, and what of the sensor lies beyond."""
    whole, flat = (
        black_share(sensor, bank.centre_um, radius)
        for radius in (bank.image_circle_um, bank.rectilinear_circle_um)
    )
    if whole == flat == 0:
        return PlanStage(RIM, False, "the image circle covers the sensor")
    words = []
    if whole > 0:
        words.append(
            f"the sensor reaches beyond the image circle: {whole:.2%} of its pixels are black"
        )
    if flat > whole:
        words.append(
            f"the scene is flat and ends {bank.projection.end_deg:g} deg off the axis, before "
            f"the image circle: {flat:.2%} of the pixels are black (--projection angular)"
        )
    return PlanStage(RIM, True, "; ".join(words))
