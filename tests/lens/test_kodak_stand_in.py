"""The stand-in for the lens of Short, Williams & Jones 1999 has its kind of lateral colour."""

from pathlib import Path

import numpy as np

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build
from gpusim.scene.spectra import WAVELENGTHS_NM, white_radiance
from gpusim.sensor.load import load_sensor

LENS = Path(__file__).parents[2] / "gpusim" / "data" / "validate" / "kodak-stand-in.yaml"
EFL_MM, PITCH_UM, PLACE_PX = 6.6, 7.8, 254.9
LINES_NM = np.arange(400.0, 701.0, 20.0)


def test_the_lens_has_the_papers_kind_of_lateral_colour():
    system = build(load_prescription(LENS).scaled(EFL_MM))
    field = np.arctan(PLACE_PX * PITCH_UM * 1e-3 / EFL_MM)
    middle = np.zeros(1)
    found = sample_rays(system, system.index(LINES_NM), field, middle, middle)
    height_px = np.hypot(found.chief_x_mm, found.chief_y_mm) * 1e3 / PITCH_UM
    efficiency = load_sensor("kodak-vga").quantum_efficiency
    photons = np.interp(LINES_NM, WAVELENGTHS_NM, white_radiance("D50", 1000.0)) * LINES_NM
    at = {
        band: np.average(
            height_px,
            weights=photons
            * np.interp(LINES_NM, efficiency.wavelengths_nm, efficiency.channels[band]),
        )
        for band in "RGB"
    }
    # Table 1 of the paper, at 254.9 pixels: -0.392 and +0.700.
    assert -0.5 < at["R"] - at["G"] < -0.3
    assert 0.6 < at["B"] - at["G"] < 0.85
