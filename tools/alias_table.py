#!/usr/bin/env python
"""Predicted and found errors of the sim grid: scenes x cameras x samples a pixel, as a page.

Each cell renders the middle of a camera on one sim grid, with PSF nodes and PSFs whole, so that
little else errs, and compares the mean signal with the exact model on the same bank at probe
pixels (`gpusim.certify`), as a certificate's engine part does. Predicted is what the planner's
`gpusim.plan.alias` says of the same grid.

What was found is kept as lines of JSON: a run that was cut off goes on where it was, and another
model is held against the same findings.

    python tools/alias_table.py --found FILE [--camera C ...] [--scene S ...] [--samples N ...]
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np

from gpusim.camera import Camera, load_camera
from gpusim.certify import ExactModel, Measure, Placed, certify
from gpusim.formats.lens_file import load_prescription
from gpusim.pareto.knobs import oversampled
from gpusim.plan import Accuracy
from gpusim.plan.choice import alias_of
from gpusim.plan.costs import LAVAPIPE
from gpusim.psf.field_bank import FieldBank
from gpusim.render import Renderer
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.raster import Raster
from gpusim.scene.scene import DEFAULT_WHITE_LUMINANCE_CD_M2, Scene
from gpusim.scene.spectra import WAVELENGTHS_NM, white_radiance
from gpusim.sensor.load import load_sensor

ROWS, COLS = 96, 128  # of the sensor: its middle
WHITE, BLACK = 0.80, 0.05
SAMPLES = (1, 2, 4, 8)
PROBES = 64
# Tolerance of the plan whose PSF nodes are taken: far below what the sim grid costs.
TOLERANCE = 1e-4
# Found errors below are those of the nodes and of float32.
FLOOR = 2e-4


def _flat(*levels: float) -> np.ndarray:
    white = white_radiance("D50", DEFAULT_WHITE_LUMINANCE_CD_M2)
    return np.array(levels)[:, None] * np.ones(WAVELENGTHS_NM.size) * white


def _chart(name: str, shapes: tuple[Rect, ...]) -> Scene:
    spectra = _flat(WHITE, BLACK)
    chart = Chart(("white", "black"), 0, shapes)
    return Scene(name, spectra, chart, "D50", spectra[0] / WHITE)


def edge(angle_deg: float) -> Scene:
    """Return a black square on white; lengths in half-heights of the frame."""
    square = Rect(0.013, -0.007, 0.4, 0.4, math.radians(angle_deg), 1)
    return _chart(f"edge of {angle_deg:g} deg", (square,))


def bars(cycles: float) -> Scene:
    """Return black bars as wide as the white between them, slanted by 3 degrees."""
    width = 2 / (cycles * ROWS)  # of a bar and a gap, half-heights
    angle = math.radians(3.0)
    count = int(0.8 / width)
    shapes = tuple(
        Rect(k * width * math.cos(angle), k * width * math.sin(angle), width / 4, 0.7, angle, 1)
        for k in range(-count, count + 1)
    )
    return _chart(f"bars of {cycles:g} cycles/px", shapes)


def _photograph(name: str, plane: np.ndarray) -> Scene:
    spectra = _flat(1.0)
    return Scene(name, spectra, Raster(plane[None].astype(np.float32)), "D50", spectra[0])


def waves(cycles: float) -> Scene:
    """Return a photograph of a sinusoid, a sample a pixel, slanted by as much as a grid allows."""
    row, col = np.indices((ROWS, COLS))
    turn = 2 * np.pi * cycles * (col + 0.1 * row)
    return _photograph(f"photograph, {cycles:.3g} cycles/px", 0.4 * (1 + 0.9 * np.cos(turn)))


def noise(fine: int) -> Scene:
    """Return a photograph of white noise, `fine` samples a pixel."""
    values = np.random.default_rng(7).uniform(BLACK, WHITE, (fine * ROWS, fine * COLS))
    return _photograph(f"white noise, {fine} a pixel", values)


def checks(side: int) -> Scene:
    """Return a photograph of a checkerboard, a sample a pixel."""
    row, col = np.indices((ROWS, COLS))
    return _photograph(
        f"checkerboard of {side} px", np.where((row // side + col // side) % 2, WHITE, BLACK)
    )


def scenes() -> dict[str, Scene]:
    """Return the scenes of the table by name."""
    made = [edge(angle) for angle in (2, 5, 45)]
    made += [bars(cycles) for cycles in (0.1, 0.25, 0.5)]
    made += [waves(1 / 4), waves(1 / 3), noise(1), checks(1), checks(2)]
    return {scene.name: scene for scene in made}


def cameras() -> dict[str, Camera]:
    """Return the middles of cameras by name."""
    found = {name: load_camera(name) for name in ("demo", "arvr", "machine-vision")}
    large = load_sensor("imx249-mono").model_copy(update={"pixel_pitch_um": 8.0})
    found["double Gauss f/2, 8 um"] = Camera(load_prescription("double-gauss"), large, "f/2")
    return {
        name: Camera(one.lens, one.sensor.roi(ROWS, COLS), one.title) for name, one in found.items()
    }


class Near:
    """A camera of which the light far from each chief ray is left out: it needs no sim grid."""

    def __init__(self, camera: Camera) -> None:
        self.sensor, self.lens = camera.sensor, camera.lens
        self.core = camera.bank().levels[0]

    def bank(self, *_: object, **__: object) -> FieldBank:
        """Return the core of the PSFs."""
        return self.core


def found_error(camera: Near, scene: Scene, samples: int) -> float:
    """Render on one sim grid, and return the engine's error as a certificate finds it."""
    asked = Accuracy(TOLERANCE, probes=0, best_effort=True)
    first = Renderer(camera, scene, asked, costs=LAVAPIPE, noise=False, method="fft")
    try:
        plan = oversampled(first, samples)
    finally:
        first.release()
    one = Renderer(camera, scene, asked, plan=plan, costs=LAVAPIPE, noise=False)
    try:
        rate = one.capture(1 / 60, keep=("rate",)).rate
        by = Measure(camera.sensor, 1 / 60, Accuracy(TOLERANCE, PROBES))
        exact = ExactModel(one.bank, camera.sensor, scene, one.placed)
        return certify(exact, Placed(rate, (0, 0, *rate.shape)), one.glare, by).engine_rms
    finally:
        one.release()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--found", type=Path, required=True)
    parser.add_argument("--camera", nargs="*", default=list(cameras()))
    parser.add_argument("--scene", nargs="*", default=list(scenes()))
    parser.add_argument("--samples", nargs="*", type=int, default=SAMPLES)
    given = parser.parse_args()
    lines = given.found.read_text().splitlines() if given.found.exists() else []
    known = {tuple(cell): error for *cell, error in map(json.loads, lines)}
    print("| camera | scene | samples a pixel | predicted | found | predicted / found |")
    print("|---|---|---|---|---|---|")
    for name in given.camera:
        near = Near(cameras()[name])
        for scene in given.scene:
            made = scenes()[scene]
            asked = Accuracy(TOLERANCE, probes=0)
            alias = alias_of(near.core, near.sensor, made, asked)
            for samples in given.samples:
                cell = name, scene, samples
                if cell not in known:
                    known[cell] = found_error(near, made, samples)
                    with given.found.open("a") as file:
                        file.write(json.dumps([*cell, known[cell]]) + "\n")
                predicted, found = alias.error(samples), known[cell]
                ratio = f"{predicted / found:.2f}" if found > FLOOR else "-"
                print(
                    f"| {name} | {scene} | {samples} | {predicted:.1e} | {found:.1e} | {ratio} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
