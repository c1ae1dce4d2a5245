"""A light in a file: arrays and a text of JSON in one .npz, which holds no code."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.certify import Certificate, Probe
from gpusim.config.arrays import read_npz
from gpusim.config.mistakes import checked
from gpusim.config.text import json_of
from gpusim.disk import whole
from gpusim.errors import UserError
from gpusim.isp.lens_tags import Optics
from gpusim.library.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.library.light import Light

KIND = "gpusim light 2"
SUFFIX = ".npz"
OF_OPTICS = ("real_um", "ideal_um", "light", "lines_nm", "shift_um")


def save_light(light: Light, path: str | Path) -> None:
    """Write a light to a file, which appears whole or not at all: see `Light.save`."""
    path = Path(path)
    if path.suffix.lower() != SUFFIX:
        raise UserError("no such kind of file for a light", file=path, allowed=SUFFIX)
    optics = light.optics
    facts = {
        "kind": KIND,
        "recipe": light.recipe,
        "title": light.title,
        "scene": light.scene,
        "sensor": light.sensor.model_dump(mode="json"),
        "rect": light.rect,
        "area": light.area,
        "white_e_per_s": light.white_e_per_s,
        "lens": [optics.name, optics.focal_length_mm, optics.f_number],
        "tolerance": light.tolerance,
        "notes": light.notes,
        "certificate": None if light.certificate is None else asdict(light.certificate),
    }
    try:
        with whole(path) as part, part.open("wb") as file:
            np.savez(
                file,
                facts=np.frombuffer(json.dumps(facts).encode(), np.uint8),
                rates=light.rates,
                glare=light.glare,
                transmission=light.transmission,
                real_um=optics.real_um,
                ideal_um=optics.ideal_um,
                light=optics.light,
                lines_nm=optics.lines_nm,
                shift_um=optics.shift_um,
            )
    except OSError as error:
        raise UserError(f"the light cannot be written: {error.strerror}", file=path) from error


def read_light(path: str | Path) -> dict[str, Any]:
    """Return the fields of a light from a file: see `Light.load`."""
    path = Path(path)
    allowed = "a file that Light.save wrote"
    if not os.path.isfile(path):
        raise UserError("no such light", file=path, allowed=allowed)
    try:
        arrays = read_npz(path)
        facts: Any = json_of(arrays["facts"].tobytes(), path, "the light's account")
        if facts["kind"] != KIND:
            raise ValueError(f"its kind is {facts['kind']}")
        certificate = facts["certificate"]
        if certificate is not None:
            certificate |= {
                "points": tuple(Probe(**one) for one in certificate["points"]),
                "notes": tuple(certificate["notes"]),
                "worst_position": tuple(certificate["worst_position"]),
            }
        rect, area = (tuple(int(one) for one in facts[name]) for name in ("rect", "area"))
        return dict(
            title=facts["title"],
            scene=facts["scene"],
            sensor=checked(Sensor, facts["sensor"], path),
            rect=rect,
            area=area,
            rates=arrays["rates"],
            glare=arrays["glare"],
            white_e_per_s=facts["white_e_per_s"],
            transmission=arrays["transmission"],
            optics=Optics(*facts["lens"], *(arrays[name] for name in OF_OPTICS)),
            tolerance=facts["tolerance"],
            recipe=facts["recipe"],
            notes=tuple(facts["notes"]),
            certificate=None if certificate is None else Certificate(**certificate),
        )
    except UserError:
        raise
    except Exception as error:  # whatever a broken archive makes of NumPy and zipfile
        raise UserError(f"not a light: {error}", file=path, allowed=allowed) from error
