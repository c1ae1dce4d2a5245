"""Render every chart, and pictures that are given, before the demonstration camera: one sheet.

    python tools/contact_sheet.py --out docs/scenes.jpg Desk.exr StillLife.exr cube.exr

Prints the certificate of each. Exit code 1 where one is not met.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

import gpusim as gs
from gpusim.scene.charts import CHARTS
from gpusim.scene.make import make_scene

CAMERA = "demo"
TOLERANCE, PROBES = 3e-3, 64
TILE, LINE, GAP, ACROSS = (360, 270), 26, 12, 5  # px, and tiles in a row
PAPER, INK = (250, 250, 250), (30, 34, 40)


def main() -> int:
    """Make the sheet."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pictures", nargs="*", help="files of scenes beside the charts")
    parser.add_argument("--out", type=Path, required=True, help="the sheet: .jpg or .png")
    parser.add_argument(
        "--parts", type=Path, help="keep each picture here; what is there is not rendered again"
    )
    given = parser.parse_args()
    camera, tiles, all_met = gs.Camera.load(CAMERA), [], True
    for name in (*CHARTS, *given.pictures):
        part = None if given.parts is None else given.parts / f"{Path(name).name}.png"
        if part is not None and part.exists():
            tiles.append((Path(name).name, Image.open(part)))
            print(f"{Path(name).name:24} from {part}", flush=True)
            continue
        started = time.perf_counter()
        light = gs.expose(
            camera, make_scene(name, frame=camera.frame), TOLERANCE, probes=PROBES, best_effort=True
        )
        picture = light.capture().develop()
        found = light.certificate
        print(
            f"{Path(name).name:24} {time.perf_counter() - started:6.1f} s, "
            f"total RMS {found.total_rms:.1e}, worst {found.total_worst:.1e}, "
            f"{'met' if found.met else 'NOT MET'}",
            flush=True,
        )
        all_met &= found.met
        if part is not None:
            given.parts.mkdir(parents=True, exist_ok=True)
            picture.save(part)
        tiles.append((Path(name).name, picture))
        light.release()
    _sheet(tiles).save(given.out, quality=88)
    return 0 if all_met else 1


def _sheet(tiles: list[tuple[str, Image.Image]]) -> Image.Image:
    rows = math.ceil(len(tiles) / ACROSS)
    wide, high = TILE[0] + GAP, TILE[1] + LINE + GAP
    sheet = Image.new("RGB", (ACROSS * wide + GAP, rows * high + GAP), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(16)
    for number, (name, picture) in enumerate(tiles):
        x, y = GAP + number % ACROSS * wide, GAP + number // ACROSS * high
        picture.thumbnail(TILE, Image.Resampling.BOX)
        sheet.paste(picture, (x, y))
        pen.text((x, y + TILE[1] + 3), name, fill=INK, font=font)
    return sheet


if __name__ == "__main__":
    sys.exit(main())
