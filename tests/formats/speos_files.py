"""Files of the Speos exporter as it writes them, made up."""

from __future__ import annotations

from pathlib import Path

import yaml
from changes import changed

MONO = {
    "Properties": {
        "Resolution": {"H": 640, "V": 480},
        "Pixel Size": {"H": 3.75, "V": 3.75},
        "Bits depth": 12,
    },
    "EMVA Data": {
        "IR & UV Filter": {"Filename": None, "Unit": "Percentage"},
        "Quantum Efficiency": {"Filename": "qe.spectrum", "Unit": "Percentage"},
        "Bayer Matrix": {"Type": None},
        "System Gain": 0.25,
        "Temporal Dark Noise": 6.0,
        "AST": 10.0,
        "DR": 60.0,
        "Dark Current": 3.0,
        "Spatial Non Uniformity": {"DSNU": 1.5, "PRNU": 0.8},
    },
}


def spectrum(file: Path, values: dict[float, float], count: int | None = None) -> None:
    lines = ["OPTIS - Spectrum file v1.0", "made up", str(len(values) if count is None else count)]
    lines += [f"{wavelength} {value}" for wavelength, value in values.items()]
    file.write_text("\n".join(lines) + "\n")


def written(folder: Path, *changes: tuple[tuple[str, ...], object]) -> Path:
    """Write the file with some values replaced: see `changed`."""
    file = folder / "camera.yaml"
    file.write_text(yaml.safe_dump(changed(MONO, *changes)))
    return file
