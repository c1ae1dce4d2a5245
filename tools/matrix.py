#!/usr/bin/env python
"""Is any certificate wrong? Lenses x pitches x scenes x tolerances, judged by brute force.

Each cell renders one tile off the axis with a certificate and compares its mean signal with
`gpusim.reference.lens_truth`, which shares no bank of PSFs with the render. Verdicts: ``met``,
``not met`` (the certificate says so itself), ``refused`` (beforehand, with the reason), ``WRONG``
(certified, and the judge finds otherwise).

Cells are kept as lines of JSON, so that a run that was cut off goes on where it was; ``--table``
writes them as a page.

    python tools/matrix.py [--lens NAME ...] [--pitch UM ...] [--scene NAME ...] [--tolerance T ...]
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.prescription import Prescription
from gpusim.lens.projection import ANGULAR, RECTILINEAR, Projection
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order
from gpusim.plan import Accuracy
from gpusim.reference.lens_truth import Judge
from gpusim.reference.lens_view import View, view
from gpusim.render import capture as render
from gpusim.scene.chart import Chart, Disc, Rect
from gpusim.scene.scene import DEFAULT_WHITE_LUMINANCE_CD_M2, Scene
from gpusim.scene.spectra import WAVELENGTHS_NM, white_radiance
from gpusim.sensor.load import load_sensor

HERE = Path(__file__).resolve().parent
CELLS = HERE.parent / "docs/matrix.jsonl"
LIBRARY = (
    "compact-6mm",
    "cooke-triplet",
    "double-gauss",
    "fisheye",
    "phone",
    "telephoto",
    "tessar",
    "wide",
)
TWO_STOPS = 2.0  # factor of the f-number
FISHEYE_DEG = 75.0  # lenses that see farther have scenes that do
# PLACE: share of the sensor's half-diagonal. The sensor's corner lies at FILL of the image circle.
PLACE, FILL = 0.85, 0.97
ASPECT = (0.8, 0.6)  # 4:3, over the diagonal
COMMON_UM = 20.0  # a multiple of every pitch: the same points are pixels' middles at each
PROBES_UM = ((0, 0), (20, -20), (-20, 20), (20, 20), (-20, -20))
TILE_PX = 64
# Wavelengths of the judge, evenly spaced: more are traced while what those between them hide may be
# more than half of the tolerance. The last are all of the scene's.
LINES = (13, 31, 61)
CERTIFICATE = 64  # probes of the certificate
WHITE, GREY, BLACK = 0.80, 0.18, 0.05
EDGE_RAD = math.radians(5.0)
# An RMS over five probes exceeds twice that over all in one case of a thousand: chi^2 with 5
# degrees of freedom is 20.5 there, sqrt(20.5 / 5) = 2.02.
CHANCE = 2.0


def lenses() -> dict[str, Prescription]:
    """Return every lens of the matrix by name."""
    found = {}
    for name in LIBRARY:
        lens = load_prescription(name)
        number = first_order(lens).f_number
        found[f"{name} f/{number:.3g}"] = lens
        found[f"{name} f/{TWO_STOPS * number:.3g}"] = lens.stopped(TWO_STOPS * number)
    # Published for f of about 1 mm: ten times that is a lens for sensors that there are.
    found["laikin-100 f/4"] = load_prescription(HERE / "lenses/laikin-100.zmx").resized(10.0)
    found["laikin-120 f/2.8"] = load_prescription(HERE / "lenses/laikin-120.yaml").resized(5.0)
    triplet = load_prescription("cooke-triplet")
    found["cooke-triplet decentred"] = triplet.with_element_moved(3, 4, (0.05, 0.03))
    return found


@dataclass(frozen=True)
class Spot:
    """Where on a lens's image the tile lies, for all pitches and scenes."""

    lens: Prescription
    views: dict[tuple[int, int], View] = field(default_factory=dict)

    @cached_property
    def system(self):
        """The lens, ready to be traced."""
        return build(self.lens)

    @property
    def projection(self) -> Projection:
        """How scenes lie before the lens."""
        return ANGULAR if self.lens.max_field_deg > FISHEYE_DEG else RECTILINEAR

    @cached_property
    def circle_um(self) -> float:
        """Radius of the image circle at 550 nm."""
        index, middle = self.system.index(np.array([550.0])), np.zeros(1)
        edge = np.radians(self.lens.max_field_deg)
        radii = []
        for azimuth in (0.0, np.pi / 2, np.pi, -np.pi / 2):
            there = sample_rays(self.system, index, edge, middle, middle, azimuth=azimuth)
            radii.append(math.hypot(there.chief_x_mm[0], there.chief_y_mm[0]))
        return 1e3 * min(radii)

    @cached_property
    def middle_um(self) -> tuple[float, float]:
        """The tile's middle, x right and y down."""
        along = PLACE * FILL * self.circle_um
        return tuple(COMMON_UM * round(along * part / COMMON_UM) for part in ASPECT)

    def sides(self, pitch_um: float) -> tuple[int, int]:
        """Return columns and rows of the sensor: odd, so that its middle is a pixel's."""
        return tuple(2 * int(FILL * self.circle_um * part / pitch_um) - 1 for part in ASPECT)

    def view(self, number: int, lines: int = LINES[0]) -> View:
        """Return what the image sees at a probe, at so many wavelengths."""
        if (number, lines) not in self.views:
            point = tuple(a + b for a, b in zip(self.middle_um, PROBES_UM[number], strict=True))
            seen = view(self.system, point, np.linspace(400, 700, lines))
            self.views[number, lines] = seen
        return self.views[number, lines]

    def to_ideal(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ideal plane's point of the tile's middle, and its change per um (2, 2)."""
        frame = replace(self.view(0).frame, flat=self.projection is RECTILINEAR)
        zero = np.array(frame.ideal(np.zeros(1), np.zeros(1))[:2])[:, 0]
        columns = [
            np.array(frame.ideal(*(frame.per_um @ way)[:, None])[:2])[:, 0] - zero
            for way in np.eye(2)
        ]
        return zero, np.stack(columns, axis=1)


def edge(spot: Spot, pitch_um: float) -> tuple[int, tuple[Rect, ...]]:
    """Return a black square on white whose left edge passes by the tile's middle, slanted."""
    zero, per_um = spot.to_ideal()
    half = 2 * TILE_PX * pitch_um * np.linalg.norm(per_um, 2)
    off = half + 0.3 * pitch_um * np.linalg.norm(per_um, 2)
    cx, cy = zero + off * np.array([math.cos(EDGE_RAD), math.sin(EDGE_RAD)])
    return 0, (Rect(float(cx), float(cy), half, half, EDGE_RAD, 2),)


def texture(spot: Spot, pitch_um: float) -> tuple[int, tuple[Disc, ...]]:
    """Return black discs of 3 to 6 pixels on white, in disorder, over the tile and around it."""
    zero, per_um = spot.to_ideal()
    draw = np.random.default_rng(15)
    reach = TILE_PX // 2 + max(16, int(60 / pitch_um))  # pixels from the tile's middle
    least = np.linalg.svd(per_um, compute_uv=False)[-1]
    shapes, spacing = [], 8.0
    for row in np.arange(-reach, reach + 1, spacing):
        for col in np.arange(-reach, reach + 1, spacing):
            radius = draw.uniform(1.5, 3.0)
            shift = draw.uniform(-1, 1, 2) * (spacing / 2 - 0.2 - radius)
            place = zero + per_um @ ((np.array([col, row]) + shift) * pitch_um)
            shapes.append(Disc(*map(float, place), float(radius * pitch_um * least), 2))
    return 0, tuple(shapes)


def grey(spot: Spot, pitch_um: float) -> tuple[int, tuple[()]]:
    """Return an even grey."""
    return 1, ()


SCENES = {"edge": edge, "texture": texture, "grey": grey}


def scene_of(spot: Spot, name: str, pitch_um: float, rows: int) -> Scene:
    """Return a scene in the units of charts, half-heights of the sensor."""
    background, shapes = SCENES[name](spot, pitch_um)
    chart = Chart(("white", "grey", "black"), background, shapes)
    white = white_radiance("D50", DEFAULT_WHITE_LUMINANCE_CD_M2)
    spectra = np.multiply.outer([WHITE, GREY, BLACK], white)
    placed = chart.placed(2 / (rows * pitch_um))
    return Scene(name, spectra, placed, "D50", white, projection=spot.projection)


def camera_of(spot: Spot, pitch_um: float) -> Camera:
    """Return the lens in front of a sensor of that pitch, without veiling glare."""
    cols, rows = spot.sides(pitch_um)
    sensor = load_sensor("imx249-mono").model_copy(
        update={
            "rows": rows,
            "cols": cols,
            "pixel_pitch_um": pitch_um,
            "veiling_glare": 0.0,
        }
    )
    return Camera(spot.lens, sensor, f"{spot.lens.title}, {pitch_um:g} um")


def predicted(plan) -> float:
    """Return what the plan expects: the root of the sum of its stages' squares."""
    parts = [stage.predicted_error or 0.0 for stage in plan.stages if stage.runs]
    return float(getattr(plan, "predicted_error", None) or np.sqrt(np.sum(np.square(parts))))


def cell(spot: Spot, pitch_um: float, scene_name: str, tolerance: float, judged: int) -> dict:
    """Render one cell and judge it."""
    camera = camera_of(spot, pitch_um)
    sensor = camera.sensor
    scene = scene_of(spot, scene_name, pitch_um, sensor.rows)
    middle = [
        round(at / pitch_um + (side - 1) / 2)
        for at, side in zip(spot.middle_um, (sensor.cols, sensor.rows), strict=True)
    ]
    tile = (middle[0] - TILE_PX // 2, middle[1] - TILE_PX // 2, TILE_PX, TILE_PX)
    started = time.perf_counter()
    try:
        capture = render(
            camera,
            scene,
            exposure_s=0.01,
            accuracy=Accuracy(tolerance, CERTIFICATE),
            tile=tile,
            keep=("rate",),
            noise=False,
        )
    except UserError as error:
        return {"verdict": "refused", "reason": error.problem}
    certificate = capture.certificate
    out = {
        "predicted": predicted(capture.plan),
        **{
            name: getattr(certificate, name)
            for name in ("engine_rms", "bank_rms", "sensor_rms", "window", "total_rms", "met")
        },
        "render_s": round(time.perf_counter() - started, 2),
    }
    out["verdict"] = "met" if out["met"] else "not met"
    if judged:
        started = time.perf_counter()
        judge = Judge(spot.system, sensor, scene, WAVELENGTHS_NM)
        errors, bounds, traced = [], [], []
        for number, offset in enumerate(PROBES_UM[:judged]):
            col, row = (at + round(off / pitch_um) for at, off in zip(middle, offset, strict=True))
            for lines in LINES:
                truth = judge.pixel(spot.view(number, lines), row, col)
                if truth.colours <= 0.5 * tolerance * truth.rate:
                    break
            found = float(capture.rate[row - tile[1], col - tile[0]])
            errors.append(found / truth.rate - 1)
            bounds.append((truth.bound + truth.colours) / truth.rate)
            traced.append(lines)
        rms = float(np.sqrt(np.mean(np.square(errors))))
        out |= {
            "errors": errors,
            "judge_rms": rms,
            "judge_lines": traced,
            "judge_bound": float(np.sqrt(np.mean(np.square(bounds)))),
            "beyond": max(float(spot.view(n).beyond.max()) for n in range(judged)),
            "judge_s": round(time.perf_counter() - started, 2),
        }
        if out["met"] and rms - out["judge_bound"] > CHANCE * tolerance:
            out["verdict"] = "WRONG"
    return out


def read(path: Path) -> dict[tuple, dict]:
    """Return the cells that are there already, the last of each."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {key(one): one for one in map(json.loads, lines)}


def key(one: dict) -> tuple:
    """Return what names a cell."""
    return one["lens"], one["pitch_um"], one["scene"], one["tolerance"]


def foretold(cells: list[dict]) -> list[str]:
    """Return a line on how the plans' predictions compare with the certificates' totals."""
    ratios = [one["predicted"] / one["total_rms"] for one in cells if one.get("total_rms")]
    if not ratios:
        return []
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    near = sum(1 / 3 <= ratio <= 3 for ratio in ratios)
    return [
        f"Predicted over total: median {middle:.2g}, one in ten below {low:.2g}, one in ten above "
        f"{high:.2g}; within a factor of 3 in {near} of {len(ratios)} cells.",
        "",
    ]


def table(cells: list[dict]) -> str:
    """Return the cells as a page of Markdown."""
    counts = Counter(one["verdict"] for one in cells)
    out = [
        "# Certificates against the judge",
        "",
        "Written by `tools/matrix.py`: each row is one tile of 64 x 64 pixels at "
        f"{PLACE * FILL:.0%} of the image circle, rendered with a certificate and compared with "
        "PSFs traced anew at the pixel itself (`gpusim/reference/lens_truth.py`).",
        "",
        ", ".join(f"{counts[name]} {name}" for name in sorted(counts)) + ". The judge's figure is "
        "the RMS over up to five pixels; a certificate is wrong where that exceeds twice the "
        "tolerance by more than the judge's own bound. What is predicted is the RMS over the "
        "whole sensor, of which the tile is one place: errors between PSF nodes are largest "
        "half-way, and on the tile they may be several times less, or somewhat more. The last "
        "column is the commit that a row was made with.",
        "",
        *foretold(cells),
        "| lens | pitch, um | scene | tolerance | predicted | engine | bank | window | total "
        "| judge | verdict | code |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]

    def number(one: dict, name: str) -> str:
        return f"{one[name]:.1e}" if one.get(name) is not None else ""

    for one in sorted(cells, key=key):
        figures = ("predicted", "engine_rms", "bank_rms", "window", "total_rms", "judge_rms")
        verdict = one["verdict"] + (f": {one['reason']}" if "reason" in one else "")
        row = [one["lens"], f"{one['pitch_um']:g}", one["scene"], f"{one['tolerance']:g}"]
        row += [*(number(one, name) for name in figures), verdict, one.get("code", "")]
        out.append(f"| {' | '.join(row)} |")
    return "\n".join(out) + "\n"


def main() -> int:
    """Run what is asked for; return 1 where a certificate was found wrong."""
    parse = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parse.add_argument("--lens", nargs="*", help="names, or parts of them; all by default")
    parse.add_argument("--pitch", nargs="*", type=float, default=[10.0, 4.0, 1.0])
    parse.add_argument("--scene", nargs="*", default=list(SCENES), choices=list(SCENES))
    parse.add_argument("--tolerance", nargs="*", type=float, default=[1e-2, 1e-3])
    parse.add_argument("--judge", type=int, default=len(PROBES_UM), help="pixels a cell; 0: none")
    parse.add_argument("--cells", type=Path, default=CELLS, help="kept results")
    parse.add_argument("--again", action="store_true", help="do cells that are there once more")
    parse.add_argument("--table", type=Path, help="write this page, and run nothing")
    asked = parse.parse_args()
    done = read(asked.cells)
    if asked.table:
        asked.table.write_text(table(list(done.values())), encoding="utf-8")
        return int(any(one["verdict"] == "WRONG" for one in done.values()))
    named = {
        name: lens
        for name, lens in lenses().items()
        if not asked.lens or any(part in name for part in asked.lens)
    }
    wanted = [
        (name, pitch, scene, tolerance)
        for name in named
        for pitch in asked.pitch
        for scene in asked.scene
        for tolerance in asked.tolerance
        if asked.again or (name, pitch, scene, tolerance) not in done
    ]
    asks = ["git", "-C", str(HERE), "describe", "--always", "--dirty"]
    code = subprocess.run(asks, capture_output=True, text=True, check=False).stdout.strip()
    wrong, spot, of = 0, None, None
    for number, (name, pitch, scene, tolerance) in enumerate(wanted, start=1):
        if of != name:
            spot, of = Spot(named[name]), name
        # BLAS's own threads wait by spinning: beside other work the judge's fits took 20 times as
        # long by them.
        with threadpool_limits(1):
            found = cell(spot, pitch, scene, tolerance, asked.judge)
        line = {
            "lens": name,
            "pitch_um": pitch,
            "scene": scene,
            "tolerance": tolerance,
            **found,
            "code": code,
        }
        with asked.cells.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        wrong += found["verdict"] == "WRONG"
        figures = " ".join(
            f"{what} {found[what]:.1e}" for what in ("total_rms", "judge_rms") if what in found
        )
        print(
            f"{number}/{len(wanted)} {name}, {pitch:g} um, {scene}, {tolerance:g}: "
            f"{found['verdict']} {found.get('reason', figures)}",
            flush=True,
        )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
