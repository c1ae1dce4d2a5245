#!/usr/bin/env python
"""Every lens of the library before a picture, with its certificate: docs/gallery.md.

Each lens is resized so that the corners of one sensor, 640 x 480 pixels of 4 um, stand at 98 % of
its image circle: all of its field is seen. Pictures and figures are kept entry by entry; the page
is written of all that are there.

    python tools/gallery.py [NAME ...]
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from rich.progress import track

import gpusim as gs
from gpusim.camera import Camera
from gpusim.formats.lens_file import load_prescription
from gpusim.gpu import default_device
from gpusim.lens.prescription import Prescription
from gpusim.lens.projection import ANGULAR, RECTILINEAR
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order
from gpusim.scene import make_scene
from gpusim.scene.scene import Scene

HERE = Path(__file__).resolve().parent
DOCS = HERE.parent / "docs"
FOLDER, PAGE = DOCS / "gallery", DOCS / "gallery.md"
ROWS, COLS, PITCH_UM = 480, 640, 4.0
FILL = 0.98  # of the image circle: where the sensor's corners stand
TOLERANCE, PROBES = 3e-3, 64
WIDE_DEG = 75.0  # lenses that see farther have scenes laid out by angles
SHOWN_PX = 480  # width of the pictures
IMPORTED = {"laikin-100": "lenses/laikin-100.zmx"}
NEAR_M = 0.6  # of the AR/VR target in the Ansys paper


@dataclass(frozen=True)
class Entry:
    """A lens, and the scene that it is shown with."""

    lens: str
    scene: str
    object_m: float = math.inf

    @property
    def name(self) -> str:
        """The name of its picture."""
        return self.lens if math.isinf(self.object_m) else f"{self.lens}-near"


ENTRIES = (
    Entry("compact-6mm", "demo"),
    Entry("cooke-triplet", "colorchecker"),
    Entry("double-gauss", "e-sfr"),
    Entry("fisheye", "checkerboard"),
    Entry("phone", "siemens-star"),
    Entry("telephoto", "slanted-edge"),
    Entry("tessar", "dots"),
    Entry("wide", "checkerboard"),
    Entry("laikin-100", "checkerboard"),
    Entry("double-gauss", "colorchecker", NEAR_M),
)


def lens_of(entry: Entry) -> Prescription:
    """Return a lens whose image circle the sensor fills."""
    lens = load_prescription(HERE / IMPORTED[entry.lens] if entry.lens in IMPORTED else entry.lens)
    lens = lens.resized(0.5e-3 * math.hypot(ROWS, COLS) * PITCH_UM / FILL / circle_mm(lens))
    if math.isinf(entry.object_m):
        return lens
    near = {"object_distance_mm": 1e3 * entry.object_m, "focus": "paraxial"}
    return lens.model_copy(update=near)


def circle_mm(lens: Prescription) -> float:
    """Return the radius of the image circle at 550 nm."""
    system, middle = build(lens), np.zeros(1)
    edge = sample_rays(
        system, system.index(np.array([550.0])), np.radians(lens.max_field_deg), middle, middle
    )
    return float(edge.chief_y_mm[0])


def camera_of(entry: Entry) -> Camera:
    """Return the lens before the sensor."""
    sensor = gs.Sensor.load("imx477").roi(ROWS, COLS)
    sensor = sensor.model_copy(update={"pixel_pitch_um": PITCH_UM})
    return gs.Camera(lens_of(entry), sensor, entry.name)


def scene_of(entry: Entry, lens: Prescription) -> Scene:
    """Return the scene, laid out as a lens of this field sees it."""
    plane = ANGULAR if lens.max_field_deg > WIDE_DEG else RECTILINEAR
    return make_scene(entry.scene, projection=plane.name)


def rendered(entry: Entry) -> dict[str, object]:
    """Render an entry, keep its picture, and return what is known of it."""
    camera = camera_of(entry)
    lens, started = camera.lens, time.perf_counter()
    light = gs.expose(camera, scene_of(entry, lens), TOLERANCE, probes=PROBES)
    seconds = time.perf_counter() - started
    picture = light.capture().develop()
    height = round(SHOWN_PX * picture.height / picture.width)
    FOLDER.mkdir(exist_ok=True)
    shown = picture.resize((SHOWN_PX, height), Image.Resampling.LANCZOS)
    shown.save(FOLDER / f"{entry.name}.jpg", quality=85, optimize=True)
    found, order = light.certificate, first_order(lens)
    return {
        "name": entry.name,
        "lens": lens.title,
        "scene": entry.scene,
        "f_number": order.f_number,
        "field_deg": 2 * lens.max_field_deg,
        "efl_mm": order.efl_mm,
        "object_m": None if math.isinf(entry.object_m) else entry.object_m,
        "engine_rms": found.engine_rms,
        "bank_rms": found.bank_rms,
        "window": found.window,
        "total_rms": found.total_rms,
        "total_worst": found.total_worst,
        "met": found.met,
        "anew": [note for note in light.notes if note.startswith("planned for")],
        "seconds": seconds,
        "adapter": default_device().report()["adapter"],
    }


def page(records: list[dict]) -> str:
    """Return the entries as a page of Markdown."""
    met = sum(one["met"] for one in records)
    adapters = ", ".join(sorted({one["adapter"] for one in records}))
    out = [
        "# Gallery",
        "",
        "Written by `tools/gallery.py`. Each lens of the library, one from a Zemax file and one "
        f"with the object at {NEAR_M:g} m before the same sensor, {COLS} x {ROWS} pixels of "
        f"{PITCH_UM:g} um, whose corners stand at {FILL:.0%} of the image circle. Certificates "
        f"are of {PROBES} probes for a tolerance of {TOLERANCE:g}: {met} of {len(records)} are "
        f"met. Seconds are those of the light, lens, plan and certificate included, on {adapters}.",
        "",
        "| lens | f/ | field, deg | engine | bank | window | total | s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one in records:
        total = f"{one['total_rms']:.1e}" + ("" if one["met"] else " **not met**")
        parts = (f"{one[name]:.1e}" for name in ("engine_rms", "bank_rms", "window"))
        row = [f"[{one['name']}](#{one['name']})", f"{one['f_number']:.3g}"]
        row += [f"{one['field_deg']:.3g}", *parts, total, f"{one['seconds']:.0f}"]
        out.append(f"| {' | '.join(row)} |")
    for one in records:
        near = "" if one["object_m"] is None else f", the object at {one['object_m']:g} m"
        out += [
            "",
            f"## {one['name']}",
            "",
            f"![{one['name']}: {one['scene']}](gallery/{one['name']}.jpg)",
            "",
            f"{one['lens']}, resized to {one['efl_mm']:.3g} mm; {one['scene']}{near}.",
        ]
        out += [f"{note[0].upper()}{note[1:]}." for note in one["anew"]]
    return "\n".join(out) + "\n"


def main() -> int:
    """Render what is asked for and write the page; return 1 where a certificate is not met."""
    parse = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    names = [entry.name for entry in ENTRIES]
    parse.add_argument("names", nargs="*", metavar="NAME", help=", ".join(names))
    asked = parse.parse_args().names
    if unknown := set(asked) - set(names):
        parse.error(f"{', '.join(unknown)}: none of {', '.join(names)}")
    kept = DOCS / "gallery.json"
    done = {one["name"]: one for one in json.loads(kept.read_text())} if kept.exists() else {}
    chosen = [entry for entry in ENTRIES if not asked or entry.name in asked]
    for entry in track(chosen, "render"):
        done[entry.name] = rendered(entry)
        records = [done[name] for name in names if name in done]
        kept.write_text(json.dumps(records, indent=1) + "\n")
        PAGE.write_text(page(records), encoding="utf-8")
    return int(not all(one["met"] for one in done.values()))


if __name__ == "__main__":
    sys.exit(main())
