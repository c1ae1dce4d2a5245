"""What a tolerance study finds: yield, offenders, and how well it all agrees."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.tolerance.budget import step_of
from gpusim.tolerance.study import Study

WORST_SHARE = 0.05  # of the cameras lie below the one that is named


@dataclass(frozen=True)
class Found:
    """What a study found.

    Attributes
    ----------
    study : Study
    design_focus_mm : float
        Where the image plane of the unchanged camera is best.
    design : ndarray (9, 2)
        Its MTF50, cycles/px.
    focus_mm : ndarray (S,)
    mtf50 : ndarray (S, 9, 2)
        MTF50 of each sample, across upright and level edges.
    alone : ndarray (P, 2)
        Worst edge's MTF50 with each number alone one step less and more.
    agreement : dict
        Differentials against traced samples.
    seconds : float
    """

    study: Study
    design_focus_mm: float
    design: np.ndarray
    focus_mm: np.ndarray
    mtf50: np.ndarray
    alone: np.ndarray
    agreement: dict[str, Any]
    seconds: float

    @property
    def worst(self) -> np.ndarray:
        """MTF50 of each camera's worst edge, (S,)."""
        return self.mtf50.min(axis=(1, 2))

    @property
    def fifth(self) -> int:
        """The sample below which five in a hundred cameras lie."""
        order = np.argsort(self.worst, kind="stable")
        return int(order[math.floor(WORST_SHARE * (len(order) - 1) + 0.5)])

    @property
    def offenders(self) -> list[tuple[str, float]]:
        """Numbers and what the worst edge loses by each alone, at its worse side, most first."""
        lost = self.design.min() - self.alone.min(axis=1)
        order = np.argsort(-lost, kind="stable")
        return [(self.study.names[k], float(lost[k])) for k in order]


def run(study: Study) -> Found:
    """Do a study: differentials, samples, each number alone, and the traced samples."""
    started = time.perf_counter()
    shape = (1, len(study.waves), *study.shape)
    design_focus, design = study.evaluated(np.zeros(shape), "design's focus")
    focus, found = study.evaluated(study.modelled(study.draws), "samples")
    axes = study.budget.axes(study.lens)
    single = [{n: s * step_of(axis)} for n, axis in axes.items() for s in (-1, 1)]
    _, alone = study.evaluated(study.modelled(single), "each alone")
    return Found(
        study,
        float(design_focus[0]),
        design[0],
        focus,
        found,
        alone.min(axis=(1, 2)).reshape(-1, 2),
        _agreement(study, found),
        time.perf_counter() - started,
    )


def _agreement(study: Study, modelled: np.ndarray) -> dict[str, Any]:
    """Trace some samples and compare: MTF50, and the wavefront's RMS difference in waves."""
    numbers = list(study.budget.traced)
    if not numbers:
        return {"traced": 0}
    rows = []
    for k, number in enumerate(numbers):
        study.progress("traced", k, len(numbers))
        rows.append(study.change(f"traced-{number:06d}", study.draws[number]))
    study.progress("traced", len(numbers), len(numbers))
    traced = np.array([one for one, _ in rows])
    _, true = study.evaluated(traced, "traced focus")
    missed = traced - study.modelled([study.draws[number] for number in numbers])
    waves = []
    for k, wave in enumerate(study.waves):
        line = wave.lines[wave.reference]
        rest = missed[:, k, wave.reference] @ line.at_rays
        # Piston and tilt blur nothing.
        plane = np.stack(
            [
                np.ones_like(rest[0]),
                wave.samples.alpha[wave.reference],
                wave.samples.beta[wave.reference],
            ],
            axis=1,
        )
        rest = rest - (plane @ np.linalg.lstsq(plane, rest.T)[0]).T
        waves.append(np.sqrt(np.mean(rest**2, axis=1)) / line.wavelength_mm)
    apart = modelled[numbers] - true
    return {
        "traced": len(numbers),
        "mtf50_rms_cy_px": float(np.sqrt(np.mean(apart**2))),
        "mtf50_most_cy_px": float(np.abs(apart).max()),
        "worst_edge_most_cy_px": float(
            np.abs(modelled[numbers].min(axis=(1, 2)) - true.min(axis=(1, 2))).max()
        ),
        "wavefront_rms_waves": float(np.sqrt(np.mean(np.square(waves)))),
        "polynomials_rms_waves": float(
            max(one.max() for _, one in rows) / study.waves[0].lines[0].wavelength_mm
        ),
    }
