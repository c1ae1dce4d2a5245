"""Filter patterns of all kinds, from the scene to the raw frame, against the exact model."""

from __future__ import annotations

import numpy as np
import pytest
from harness import assert_close
from optics.made import StubCamera, bank, scene, sensor, shapes
from sampling import one_in

from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

LENS = bank(coma_um=0.6, falloff=0.1, halo=0.1)
PATTERNS = {
    "Bayer, blue first": ["BG", "GR"],
    "RCCB": ["RW", "WB"],
    "RGBW": ["WBWG", "BWGW", "WGWR", "GWRW"],
    "X-Trans": ["GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG"],
    "two rows": ["R", "G"],
    "six channels, 3 x 2": ["RG", "BC", "MY"],
    "seven channels, 4 x 4": ["RGBC", "MYWR", "GBCM", "YWRG"],
}


def of_pattern(pattern: list[str], rows: int = 32, cols: int = 44, **changes: object) -> Sensor:
    """Return a sensor whose channels are bells over the spectrum, all unlike."""
    names = sorted({*"".join(pattern)})
    bells = {
        name: 0.3 + 0.4 * np.exp(-(((WAVELENGTHS_NM - 430 - 40 * "BCGYRMW".index(name)) / 50) ** 2))
        for name in names
    }
    curves = QuantumEfficiency(
        wavelengths_nm=WAVELENGTHS_NM.tolist(),
        channels={name: bell.tolist() for name, bell in bells.items()},
    )
    cfa = ColourFilterArray(pattern=[list(row) for row in pattern])
    return sensor(rows, cols, cfa=cfa, quantum_efficiency=curves, **changes)


@pytest.mark.parametrize("name", one_in(2, PATTERNS))
def test_any_pattern_meets_the_certificate(name: str):
    """In the core of the PSFs and in their tails; a tile has the same bits."""
    camera = StubCamera(LENS, of_pattern(PATTERNS[name]))
    wanted = Accuracy(tolerance=1e-2, probes=12)
    renderer = Renderer(camera, scene(shapes()), wanted, force=("tail",), method="fft")
    try:
        assert [scale.name for scale in renderer.plan.scales] == ["core", "tail"]
        whole = renderer.capture(0.01, keep=("rate",))
        part = renderer.capture(0.01, tile=(7, 5, 20, 13), tile_px=9, keep=("rate",))
    finally:
        renderer.release()
    assert whole.certificate.met
    assert_close(part.rate, whole.rate[5:18, 7:27].copy(), atol=0)
    assert_close(part.raw, whole.raw[5:18, 7:27].copy(), atol=0)


def test_the_certificate_sees_a_wrong_pattern():
    """The control: the rates of one pattern are none of another's."""
    camera = StubCamera(LENS, of_pattern(PATTERNS["X-Trans"]))
    other = StubCamera(LENS, of_pattern(PATTERNS["X-Trans"][::-1]))
    found = []
    for one in (camera, other):
        renderer = Renderer(one, scene(shapes()), Accuracy(1e-2, 0), method="fft")
        try:
            found.append(renderer.capture(0.01, keep=("rate",)).rate)
        finally:
            renderer.release()
    assert np.abs(found[0] / found[1] - 1).max() > 0.1
