"""What the page replays: one light, its read-out at every exposure and gain, its development.

Nothing of the camera is written twice: the page knows buffers, shaders and uniforms alone. What a
setting changes are uniforms, so that each comes with its own, as the host packed them.
"""

from __future__ import annotations

import base64
import hashlib
import json
import tempfile
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.gpu import Recording, default_device
from gpusim.gpu.exported import Exported, exported
from gpusim.isp.pipeline import record_whole
from gpusim.isp.settings import Settings
from gpusim.isp.source import read_source
from gpusim.library.light import Light
from gpusim.sensor.readout import Shot

STEPS = range(-15, 10)  # thirds of a stop about the exposure of the scene's white
FILES = ("index.html", "replay.js", "page.js")
BAYER = {"R", "G", "B"}


class _Store:
    """Programs and data, each kept once."""

    def __init__(self) -> None:
        self.data: list[str] = []
        self.programs: list[dict[str, Any]] = []
        self.shaders: dict[str, str] = {}
        self._places: dict[str, int] = {}

    def keep(self, values: np.ndarray | bytes) -> int:
        """Return the number of some data."""
        raw = values if isinstance(values, bytes) else np.ascontiguousarray(values).tobytes()
        return self._once(raw, self.data, lambda: base64.b64encode(raw).decode("ascii"))

    def program(self, found: Exported) -> int:
        """Return the number of a recording without its uniforms."""
        places = [self.keep(values) for values in found.data]
        steps = [
            step | {"data": places[step["data"]]} if step["do"] == "write" else step
            for step in found.steps
        ]
        made = {
            "buffers": found.buffers,
            "steps": steps,
            "frames": found.members.get("frame", []),
        }
        self.shaders |= found.shaders
        return self._once(json.dumps(made).encode(), self.programs, lambda: made)

    def _once(self, content: bytes, among: list, make: Any) -> int:
        key = f"{id(among)} {hashlib.sha256(content).hexdigest()}"
        if key not in self._places:
            self._places[key] = len(among)
            among.append(make())
        return self._places[key]


def bundle(light: Light, seed: int = 0) -> dict[str, Any]:
    """Return what the page needs, in JSON types.

    Parameters
    ----------
    light : Light
    seed : int
        Seed of the noise: a raw of the page is that of `Light.capture` with it.

    Raises
    ------
    UserError
        A CCD; a sensor that DNG cannot describe; more pixels than are developed at once.
    """
    store = _Store()
    speeds: list[int | None] = [step.iso for step in light.sensor.analogue_gains if step.iso]
    speeds = speeds or [None]
    exposures = [light.white_exposure_s * 2 ** (step / 3) for step in STEPS]
    states = [
        [
            [
                _state(store, light.at(iso=speed), exposure_s, seed, noise)
                for exposure_s in exposures
            ]
            for speed in speeds
        ]
        for noise in (False, True)
    ]
    certificate = light.certificate
    return {
        "title": light.title,
        "scene": light.scene,
        "tolerance": light.tolerance,
        "certified": None if certificate is None else certificate.total_rms,
        "rows": light.rect[2],
        "cols": light.rect[3],
        "most": light.sensor.raw_max_dn,
        "exposures_s": exposures,
        "isos": speeds,
        "states": states,
        "develop": _development(store, light),
        "programs": store.programs,
        "shaders": store.shaders,
        "data": store.data,
    }


def _state(
    store: _Store, light: Light, exposure_s: float, seed: int, noise: bool
) -> dict[str, int]:
    """Return the program of a read-out, and its uniforms."""
    rec, _ = light.recording(Shot(exposure_s, seed, 0), noise)
    found = exported(rec)
    return {"program": store.program(found), "params": store.keep(found.params)}


def _development(store: _Store, light: Light) -> dict[str, Any]:
    """Return the development of a raw: as shot, no stops brighter."""
    frame = light.capture()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "raw.dng"
        frame.write_raw(path, 0.0)
        source = read_source(path)
    row, col, rows, cols = frame.areas.active
    source = replace(source, codes=frame.raw[row : row + rows, col : col + cols])
    # As the preview: Malvar, He and Cutler's interpolation is a tenth of the work of the other.
    bayer = len(source.pattern) == 2 and set("".join(source.pattern)) == BAYER
    rec = Recording(default_device())
    whole = record_whole(rec, source, Settings(demosaic="malvar" if bayer else None))
    found = exported(rec)
    codes = next(step for step in found.steps if step["do"] == "write")
    found.steps.remove(codes)  # the page writes those of its own raw
    return {
        "program": store.program(found),
        "params": store.keep(found.params),
        "codes": codes["buffer"],
        "rows_of": store.keep((whole.rows + row).astype("<u4")),
        "cols_of": store.keep((whole.cols + col).astype("<u4")),
        "top": whole.top,
        "left": whole.left,
        "rows": rows,
        "cols": cols,
    }


def write_page(light: Light, folder: Path, seed: int = 0) -> None:
    """Write the page of a light into a folder: see `bundle`."""
    made = json.dumps(bundle(light, seed), allow_nan=False)
    (folder / "bundle.js").write_text(f"const BUNDLE = {made};\n", encoding="utf-8")
    for name in FILES:
        text = (resources.files("gpusim.web") / "page" / name).read_text(encoding="utf-8")
        (folder / name).write_text(text, encoding="utf-8")
