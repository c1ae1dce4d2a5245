"""Cases of sensor files that are wrong: each is to be refused with the field that is."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.sensor.load import PRESETS, load_sensor
from gpusim.sensor.sensor import Sensor
from gpusim.stress.table import REFUSED, Case

MAY_BE_NEGATIVE = ("reference_temperature_c",)


def preset() -> dict:
    """Return the fields of a preset's file."""
    return read_yaml(PRESETS / "imx477.yaml", "the sensor file")


def altered(**changes: object) -> Sensor:
    """Load a preset's file in which some fields, by dotted names, have other values."""
    data = preset()
    for path, value in changes.items():
        *above, last = path.split(".")
        place = data
        for key in above:
            place = place[key]
        place[last] = value
    return loaded(yaml.safe_dump(data))


def loaded(text: str) -> Sensor:
    """Load a sensor file of some content."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "sensor.yaml"
        file.write_text(text, encoding="utf-8")
        return load_sensor(file)


def wrong(field: str, value: object, **others: object) -> Callable[[], tuple]:
    """Return the case of one wrong value, of a sensor in which others are as given."""

    def case() -> tuple:
        altered(**{field: value}, **others)
        return "refused", "accepted", False

    return case


def every_number(value: float) -> Callable[[], tuple]:
    """Return the case of a value that no number of a sensor may have, in each field in turn."""

    def case() -> tuple:
        fields = [
            name
            for name, old in preset().items()
            if isinstance(old, int | float) and not (value == -1 and name in MAY_BE_NEGATIVE)
        ]
        accepted = []
        for name in fields:
            try:
                altered(**{name: value})
                accepted.append(name)
            except UserError as error:
                if error.field != name:
                    accepted.append(f"{name}: named {error.field}")
        return (
            f"each of {len(fields)} fields refused by its name",
            f"not refused: {', '.join(accepted) or 'none'}",
            False if accepted else REFUSED,
        )

    return case


def content(text: str) -> Callable[[], tuple]:
    """Return the case of a file that is no sensor."""

    def case() -> tuple:
        loaded(text)
        return "refused", "accepted", False

    return case


def mask_of(shape: tuple[int, ...], value: float = 1.0) -> Callable[[], tuple]:
    """Return the case of a mask in a file, for a sensor of 6 x 8 pixels."""

    def case() -> tuple:
        with TemporaryDirectory() as folder:
            np.save(Path(folder) / "gain.npy", np.full(shape, value, np.float32))
            altered(rows=6, cols=8, masks={"gain": f"{folder}/gain.npy"})
        return "refused", "accepted", False

    return case


def more_than_every_photon() -> tuple:
    """Take a quantum efficiency over 1: measured curves may have it, so it is warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        altered(quantum_efficiency=filters(G=[0.5, 1.02, 0.5]))
    said = "; ".join(str(one.message) for one in caught)
    right = all(word in said for word in ("of G", "1.02", "550 nm"))
    return "a warning that names G, 1.02 and 550 nm", said or "nothing", right


def filters(**curves: list[float]) -> dict:
    """Return quantum efficiencies at 400, 550 and 700 nm: one half where none is given."""
    channels = {name: curves.get(name, [0.5, 0.5, 0.5]) for name in "RGB"}
    return {"wavelengths_nm": [400, 550, 700], "channels": channels}


CASES: tuple[Case, ...] = (
    ("sensor file with NaN", every_number(float("nan")), None),
    ("sensor file with infinities", every_number(float("inf")), None),
    ("sensor file with negative numbers", every_number(-1), None),
    (
        "negative quantum efficiency",
        wrong("quantum_efficiency", filters(G=[0.5, -0.1, 0.5])),
        "channels.G.2",
    ),
    (
        "filter that passes nothing",
        wrong("quantum_efficiency", filters(B=[0.0, 0.0, 0.0])),
        "channels.B",
    ),
    ("quantum efficiency over 1", more_than_every_photon, None),
    ("full well of 0", wrong("full_well_e", 0), "full_well_e"),
    ("converter of 0 bits", wrong("bit_depth", 0), "bit_depth"),
    ("converter of 40 bits", wrong("bit_depth", 40), "bit_depth"),
    ("filter of no colour", wrong("cfa.pattern", [["R", "Q"], ["G", "B"]]), "'Q'"),
    ("filters in rows of unlike length", wrong("cfa.pattern", [["R", "G"], ["G"]]), "rectangle"),
    ("filter without a curve", wrong("cfa.pattern", [["R", "W"], ["G", "B"]]), "cfa.pattern"),
    ("mask of another size", mask_of((8, 6)), "6 x 8"),
    ("mask without a pixel", mask_of((0, 8)), "6 x 8"),
    ("mask of planes", mask_of((6, 8, 3)), "masks"),
    ("mask with NaN", mask_of((6, 8), float("nan")), "masks.gain"),
    ("mask with a negative", mask_of((6, 8), -0.5), "none negative"),
    ("sensor file without a field", content("name: a\nrows: 3\n"), "cols"),
    ("sensor file with another field", wrong("full_well", 3), "full_well_e is meant"),
    ("empty sensor file", content(""), "no fields"),
    ("sensor file that is a list", content("- 1\n- 2\n"), "no fields"),
)
