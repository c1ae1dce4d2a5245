"""Which wavelengths a render covers: as far as scene, lens and sensor are known and see light.

Nothing is left out silently. What nobody has data for is named with its share of the electrons, by
estimate. What data show to be next to nothing, behind an infra-red cut for instance, is left out
to a small share of the tolerance, which the certificate adds to its total.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gpusim.known import Known
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.stage import PlanStage
from gpusim.plan.stages import Plan
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import ALL_NM, LONGEST_NM, SHORTEST_NM, STEP_NM, grid_nm, seen_by_eye
from gpusim.sensor.sensor import Sensor

# How much of a signal may be left out at both ends together: share of the tolerance.
DROPPED_SHARE = 0.01
# Silicon's band gap is 1.12 eV: where a sensor's data end, nothing is expected beyond it.
BAND_GAP_NM = 1100.0


@dataclass(frozen=True)
class Unknown:
    """Light that no data describe.

    Attributes
    ----------
    first_nm, last_nm : float
        Where it lies.
    lacking : tuple of str
        What has no data there.
    share : float
        Share of all electrons that the scene's white makes, in the channel that has most of them
        there. It is an estimate, by what is known at the ends.
    channel : str
        Empty of a sensor with one channel.
    """

    first_nm: float
    last_nm: float
    lacking: tuple[str, ...]
    share: float
    channel: str

    @property
    def text(self) -> str:
        """Name it."""
        side, end = (
            ("below", self.last_nm) if self.first_nm == SHORTEST_NM else ("beyond", self.first_nm)
        )
        whose = f"of {self.channel}'s electrons" if self.channel else "of the electrons"
        return (
            f"about {100 * self.share:.2g} % {whose} lie {side} {end:g} nm, for which there are no "
            f"data on {' and '.join(self.lacking)}: they are not rendered"
        )


@dataclass(frozen=True, eq=False)
class Band:
    """The wavelengths of a render.

    Attributes
    ----------
    wavelengths_nm : ndarray (K,)
    unknown : tuple of Unknown
        What is missing, as far as the tolerance would see it.
    dropped : float
        Share of the electrons, of any material in any channel at most, that data show at other
        wavelengths and that is left out.
    """

    wavelengths_nm: np.ndarray
    unknown: tuple[Unknown, ...] = ()
    dropped: float = 0.0

    @property
    def stages(self) -> tuple[PlanStage, ...]:
        """Describe it, and what is missing."""
        first, last = self.wavelengths_nm[[0, -1]]
        text = f"{first:g} to {last:g} nm, as far as scene, lens and sensor are known and see light"
        missing = (PlanStage("no data", False, one.text) for one in self.unknown)
        return PlanStage("wavelengths", True, text, self.dropped or None), *missing


def band_of(lens: object, sensor: Sensor, scene: Scene, accuracy: Accuracy) -> Band:
    """Return the wavelengths to render a scene at: 400 to 700 nm, and beyond where there is light.

    Parameters
    ----------
    lens : Prescription, ReadyLens, or anything else
        One that does not say how far it is `known` is used at the scene's own wavelengths.
    sensor, scene, accuracy
    """
    of_lens = getattr(lens, "known", None)
    if of_lens is None:
        return Band(scene.wavelengths_nm)
    known = (*scene.known, *of_lens, *sensor.known)
    whole = grid_nm(max(one.first_nm for one in known), min(one.last_nm for one in known))
    tolerance = _relative(sensor, accuracy)
    kept, dropped = _lit(_electrons(sensor, scene.on(whole)), whole, DROPPED_SHARE * tolerance)
    unknown = (one for one in _unknown(sensor, scene, whole, of_lens) if one.share > tolerance)
    return Band(whole[kept], tuple(unknown), dropped)


def _relative(sensor: Sensor, accuracy: Accuracy) -> float:
    """Return the tolerance relative to a full well's signal, the strictest of one in sigmas."""
    full = sensor.full_well_e
    signal = full, sensor.temporal_dark_noise_e, full
    return replace(accuracy, best_effort=True).relative(*signal).tolerance


def _electrons(sensor: Sensor, scene: Scene) -> np.ndarray:
    """Return electrons per nm (M, C, K) of each spectrum in each channel, to a common factor."""
    qe = np.stack(list(sensor.qe_at(scene.wavelengths_nm).values()))
    return scene.spectra[:, None] * qe * scene.wavelengths_nm


def _lit(electrons: np.ndarray, wavelengths_nm: np.ndarray, allowed: float) -> tuple[slice, float]:
    """Return which samples to keep, those that the eye sees at least, and what the rest has."""
    steps = (electrons[..., 1:] + electrons[..., :-1]) / 2
    light = steps.sum(axis=-1, keepdims=True)
    share = np.divide(steps, light, out=np.zeros_like(steps), where=light > 0)
    eye = seen_by_eye(wavelengths_nm)
    below = np.cumsum(share, axis=-1).max(axis=(0, 1))  # what is lost with the first steps
    beyond = np.cumsum(share[..., ::-1], axis=-1).max(axis=(0, 1))
    first = min(int(np.searchsorted(below, allowed / 2, "right")), eye.start)
    last = min(int(np.searchsorted(beyond, allowed / 2, "right")), share.shape[-1] + 1 - eye.stop)
    lost = [one[count - 1] for one, count in ((below, first), (beyond, last)) if count]
    return slice(first, len(wavelengths_nm) - last), float(sum(lost))


def _unknown(
    sensor: Sensor, scene: Scene, whole: np.ndarray, of_lens: tuple[Known, ...]
) -> Iterable[Unknown]:
    """Yield what lies below and beyond the wavelengths for which there are data.

    Beyond its data each thing goes on as at their end. But no lens passes what lies below its
    glasses' data, and no sensor sees beyond silicon's band gap, unless theirs reach there.
    """
    known, held = (*scene.known, *of_lens, *sensor.known), scene.on(ALL_NM)
    end_nm = max(BAND_GAP_NM, *(one.last_nm for one in sensor.known))
    start_nm = min(whole[0], max((one.first_nm for one in of_lens), default=SHORTEST_NM))
    passed = (start_nm <= ALL_NM) & (end_nm >= ALL_NM)
    light = held.white * np.stack(list(sensor.qe_at(ALL_NM).values())) * passed * ALL_NM
    total = np.maximum(light.sum(axis=-1), np.finfo(float).tiny)
    for first, last in ((SHORTEST_NM, whole[0]), (whole[-1], LONGEST_NM)):
        there = (first <= ALL_NM) & (last >= ALL_NM)
        # A sample at the end of the band counts for half of its step on either side.
        inner = last if first == SHORTEST_NM else first
        weight = np.where(inner == ALL_NM, 0.5, 1.0) * there
        share = (light * weight).sum(axis=-1) / total
        lacking = (
            one.what
            for one in known
            if (first == SHORTEST_NM and one.first_nm > last - STEP_NM)
            or (last == LONGEST_NM and one.last_nm < first + STEP_NM)
        )
        if last > first:
            most = int(share.argmax())
            channel = sensor.channels[most] if len(sensor.channels) > 1 else ""
            named = tuple(dict.fromkeys(lacking))
            yield Unknown(float(first), float(last), named, float(share[most]), channel)


def with_band(plan: Plan, band: Band) -> Plan:
    """Return a plan that says which wavelengths it is for."""
    return replace(plan, stages=(*band.stages, *plan.stages))
