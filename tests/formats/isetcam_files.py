"""Sensors of ISETCam as MATLAB and JSON hold them, made up, and what they are in our terms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from changes import changed
from scipy.io import savemat

from gpusim.formats import isetcam_sensor as isetcam
from gpusim.sensor.sensor import Sensor

WAVE = [400.0, 500.0, 600.0, 700.0]
STRUCT = {
    "name": "made up",
    "type": "sensor",
    "rows": 480,
    "cols": 640,
    "analogGain": 0.5,
    "analogOffset": 0.02,
    "sigmaGainFPN": 1.2,
    "sigmaOffsetFPN": 0.0006,
    "quantization": {"bits": 12, "method": "linear"},
    "integrationTime": 0.01,
    "cfa": {"pattern": [[1, 2], [2, 3]]},
    "spectrum": {"wave": WAVE},
    "color": {
        "filterSpectra": [[0.1, 0.2, 0.6], [0.1, 0.7, 0.5], [0.8, 0.2, 0.1], [0.6, 0.1, 0.0]],
        "filterNames": ["r", "g", "b"],
        "irFilter": [1.0, 1.0, 1.0, 0.5],
    },
    "pixel": {
        "width": 2.0e-6,
        "height": 2.0e-6,
        "pdWidth": 1.6e-6,
        "pdHeight": 1.5e-6,
        "conversionGain": 1e-4,
        "voltageSwing": 0.8,
        "readNoise": 0.0004,
        "darkVoltage": 0.002,
        "spectralQE": [0.9, 0.9, 0.8, 0.8],
    },
}


def written(folder: Path, *changes: tuple[tuple[str, ...], object], kind: str = ".json") -> Path:
    """Write the struct with some values replaced: see `changed`."""
    data = changed(STRUCT, *changes)
    file = folder / f"sensor{kind}"
    if kind == ".json":
        file.write_text(json.dumps({"sensor": data}))
    else:
        data["color"]["filterNames"] = np.array(["r", "g", "b"], object)
        savemat(file, {"sensor": data})
    return file


def read(file: Path) -> Sensor:
    return isetcam.read_isetcam(file).sensor({})


def check(sensor: Sensor) -> None:
    """Compare with what the equations give by hand."""
    assert (sensor.name, sensor.rows, sensor.cols) == ("made up", 480, 640)
    assert (sensor.pixel_pitch_um, sensor.bit_depth) == (2.0, 12)
    # An electron is 0.1 mV at the pixel, 0.2 mV behind a gain of 1/0.5; a DN is 0.8 V / 4096.
    assert sensor.system_gain_dn_per_e == pytest.approx(1.024)
    # 20 mV of offset are 40 mV behind the gain.
    assert sensor.black_level_dn == pytest.approx(204.8)
    assert sensor.full_well_e == pytest.approx(8000)
    assert sensor.temporal_dark_noise_e == pytest.approx(4)
    assert sensor.dark_current_e_per_s == pytest.approx(20)
    assert sensor.dsnu_e == pytest.approx(6)
    assert sensor.prnu_percent == 1.2
    assert sensor.fill_factor == pytest.approx(0.6)
    assert sensor.cfa.pattern == (("R", "G"), ("G", "B"))
    curves = sensor.quantum_efficiency.channels
    assert sensor.quantum_efficiency.wavelengths_nm == tuple(WAVE)
    assert curves["R"] == pytest.approx([0.09, 0.09, 0.64, 0.24])
    assert curves["G"] == pytest.approx([0.18, 0.63, 0.16, 0.04])
    assert curves["B"] == pytest.approx([0.54, 0.45, 0.08, 0.0])
