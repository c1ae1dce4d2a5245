"""What the preview saves: raw, picture, camera file, and the command that makes the raw."""

from __future__ import annotations

from pathlib import Path

import yaml
from PIL import Image

from gpusim.camera import PRESETS, changed_lens
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.isp.dng import has_dng
from gpusim.preview.engine import Shown
from gpusim.preview.state import Knobs
from gpusim.sensor.conversion import sensor_text

SENSOR_FILE = "sensor.yaml"  # beside the camera file, where effects are switched off


def camera_file(knobs: Knobs) -> str:
    """Return the text of a camera file with the knobs' lens and sensor."""
    path = Path(knobs.camera)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{knobs.camera}.yaml"
    data = dict(read_yaml(path, "the camera file"))
    for part, name in (("lens", "prescription"), ("sensor", "preset")):
        own = data[part]
        own = dict(own) if isinstance(own, dict) else {name: own}
        for key in ("prescription", "bank", "mtf", "preset"):
            # A file lies beside the camera's: the copy may lie anywhere.
            if Path(str(own.get(key, ""))).suffix:
                own[key] = str((path.parent / own[key]).resolve())
        data[part] = own
    data["lens"] = changed_lens(data["lens"], dict(knobs.lens_changes))
    if knobs.sensor is not None:
        data["sensor"] = {"preset": knobs.sensor}
    if knobs.off:
        data["sensor"] = {"preset": SENSOR_FILE}
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True)


def save(shown: Shown, folder: Path) -> list[Path]:
    """Write raw, picture, camera file and command line into a folder; return the files.

    Raises
    ------
    UserError
        The folder cannot be written to.
    """
    sensor = shown.frame.light.sensor.cut(*shown.frame.areas.lit[:2])
    raw = "raw.dng" if has_dng(sensor) else "raw.tif"
    tile = shown.rect if shown.step == 1 else None
    names = [raw, "picture.png", "camera.yaml", "command.txt"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shown.frame.write_raw(folder / raw, shown.knobs.ev)
        Image.fromarray(shown.rgb).save(folder / "picture.png")
        (folder / "camera.yaml").write_text(camera_file(shown.knobs), "utf-8")
        if shown.knobs.off:
            names.append(SENSOR_FILE)
            off = ", ".join(sorted(shown.knobs.off))
            text = sensor_text(shown.frame.light.sensor, f"Without {off}.")
            (folder / SENSOR_FILE).write_text(text, "utf-8")
        command = shown.knobs.command(tile, shown.frame.exposure_s)
        (folder / "command.txt").write_text(command + "\n", "utf-8")
    except OSError as error:
        raise UserError(
            f"the folder cannot be written: {error.strerror}", file=folder, field="--out"
        ) from error
    return [folder / name for name in names]
