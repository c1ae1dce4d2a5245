"""Charts of waves: the spline through their samples has the amplitude that the file says."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gpusim.scene.make import make_scene
from gpusim.scene.patterns import Frame
from gpusim.scene.raster import PlacedRaster

BAR = 0.003  # of the amplitude: what renders may differ from MTF times aperture by
ROWS = 400  # of a sensor whose pixels are 1 um; all lengths below are pixels
HALF_PX = 8.0  # of a window in which a wave is fitted: 4 periods and more
STEP_PX = 1 / 16  # 8 phases of a sample, 2 of which are a pixel


def placed(folder: Path, pattern: str, frame: Frame, pitch: float = 0.0) -> PlacedRaster:
    """Return a pattern on the sensor, resampled where it is finer than a pitch."""
    file = folder / "chart.yaml"
    file.write_text(f"title: t\nunit: pixels\nbackground: 0.5\npattern: {{{pattern}}}\n")
    half = frame.rows / 2
    return make_scene(file, frame=frame).source.placed(half * frame.aspect, half, pitch)


def frame_of(rows: int, aspect: float = 4 / 3) -> Frame:
    return Frame(rows, aspect, half_height_um=rows / 2)


def fitted(raster: PlacedRaster, phase: Callable, place: tuple[float, float]) -> np.ndarray:
    """Return the mean, the wave in phase and the one a quarter off it in the spline at a place.

    Least squares under a Hann window, which keeps out the wave's images: they are two periods and
    more off in frequency.
    """
    line = np.arange(-HALF_PX, HALF_PX, STEP_PX) + STEP_PX / 2
    x, y = place[0] + line[None], place[1] + line[:, None]
    at = np.stack(np.broadcast_arrays((y - raster.y0_um), (x - raster.x0_um)))
    at = at / raster.pitch_um - 0.5
    first = np.floor(at.min(axis=(1, 2))).astype(int) - 2
    last = np.ceil(at.max(axis=(1, 2))).astype(int) + 3
    spline = raster.spline_in(*(range(*pair) for pair in zip(first, last, strict=True)))[0]
    seen = map_coordinates(spline, at - first[:, None, None], order=3, prefilter=False)
    turn = 2 * np.pi * phase(x, y)
    hann = np.cos(np.pi * line / (2 * HALF_PX)) ** 2
    weight = np.outer(hann, hann).ravel()
    terms = np.stack([np.ones(seen.size), np.cos(turn).ravel(), np.sin(turn).ravel()], axis=1)
    return np.linalg.lstsq(weight[:, None] * terms, weight * seen.ravel(), rcond=None)[0]


def along(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x * math.cos(math.radians(30)) + y * math.sin(math.radians(30))) / 2


def swept(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    # The integral of the frequency, which rises by 5 octaves, from 1 / 64, in 400 pixels.
    ratio = 5 * math.log(2) / 400
    return (np.exp(ratio * (x + 200)) - 1) / ratio / 64 + 0 * y


WAVES = {
    "straight": ("pattern: sinusoid, period: 2", lambda x, y: x / 2 + 0 * y, [(3.3, 1.2)]),
    "turned": ("pattern: sinusoid, period: 2, angle_deg: 30", along, [(3.3, 1.2)]),
    "longer": ("pattern: sinusoid, period: 3", lambda x, y: x / 3 + 0 * y, [(3.3, 1.2)]),
    "sweep": (
        "pattern: sweep, periods: [64, 2], width: 400",
        swept,
        [(191.0, 5.0), (120.0, -90.0), (0.0, 0.0)],
    ),
    "zone plate": (
        "pattern: zone-plate, radius: 200, period: 2",
        lambda x, y: (x**2 + y**2) / 800,
        [(180.0, 0.0), (0.0, -185.0), (130.0, 130.0), (60.0, 40.0)],
    ),
    "star": (
        "pattern: sine-star, cycles: 100, diameter: 360, inner_diameter: 64",
        lambda x, y: 100 * np.arctan2(y, x) / (2 * np.pi),
        [(44.0, 0.0), (0.0, 44.0), (-31.0, 31.0), (100.0, 90.0)],
    ),
}


@pytest.mark.parametrize("fills", [(0.05, 0.8), (0.0, 1.0)], ids=["16:1", "black"])
@pytest.mark.parametrize(("text", "phase", "places"), WAVES.values(), ids=WAVES)
def test_waves_have_the_amplitude_of_their_fills(tmp_path, text, phase, places, fills):
    raster = placed(tmp_path, f"{text}, fills: {list(fills)}", frame_of(ROWS))
    low, high = fills
    for place in places:
        mean, wave, quadrature = fitted(raster, phase, place)
        assert mean == pytest.approx((low + high) / 2, rel=BAR)
        assert [wave, quadrature] == pytest.approx(
            [(high - low) / 2, 0], abs=BAR * (high - low) / 2
        )


def test_waves_of_2_pixels_are_drawn_for_large_sensors(tmp_path):
    # A strip of it: the whole sensor has 55 million samples.
    raster = placed(
        tmp_path, "pattern: sinusoid, period: 2, angle_deg: 90, fills: [0, 1]", frame_of(3040, 0.02)
    )
    assert raster.pitch_um == pytest.approx(0.5)  # 4 samples a period
    found = fitted(raster, lambda x, y: y / 2 + 0 * x, (0.3, 700.0))
    assert found == pytest.approx([0.5, 0.5, 0.0], abs=BAR / 2)


def test_waves_that_are_resampled_keep_their_amplitude(tmp_path):
    # Three times as fine as the sim grid, two samples to a pixel.
    text = "pattern: sinusoid, period: 2, samples: 2400, fills: [0, 1]"
    raster = placed(tmp_path, text, frame_of(ROWS, 0.2), pitch=0.5)
    assert raster.integrals
    found = fitted(raster, lambda x, y: x / 2 + 0 * y, (3.3, 1.2))
    assert found == pytest.approx([0.5, 0.5, 0.0], abs=BAR / 2)
