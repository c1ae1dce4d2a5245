"""What a source point spreads: two ways to sum it agree, and one lens less another is that."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import FLAT, MOVED, RED, bank, monochrome, plane_bank, sensor

from gpusim.reference.exact_model import ExactCore
from gpusim.reference.fields import Grid, Heights
from gpusim.reference.point_spread import PointSpread
from gpusim.reference.wide import Wide
from gpusim.scene.chart import Chart, Rect
from gpusim.scene.highlights import Highlights
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.spectra import WAVELENGTHS_NM

SPECTRA = np.stack([FLAT, RED])
# Gaussians six samples wide, to 1e-5 of their middle within the window: halves of a halo's level.
SMOOTH = {"size": 64, "sigma_um": (3.0, 3.2, 3.4), "coma_um": 0.0, "lateral": (-0.02, 0.0, 0.015)}
# A cubic spline errs by 3 / 384 (h / sigma)^4 of a Gaussian's middle at most along each axis; here
# `at` by both axes, `wide` by these and by x and y of the way that it moved the samples.
SPLINES = 6 * 3 / 384 / 6**4


@pytest.mark.parametrize("plane", [False, True])
def test_smooth_psfs_by_one_product_are_those_line_by_line(plane: bool):
    lens = plane_bank(**SMOOTH, **MOVED) if plane else bank(**SMOOTH)
    given = (Grid if plane else Heights)(lens), SPECTRA, WAVELENGTHS_NM
    spread = PointSpread(lens, sensor(), *given)
    rng = np.random.default_rng(3)
    # Also within a field of the axis, whose neighbours lie beyond it.
    source = rng.uniform(-70, 70, (400, 2)) * rng.uniform(0, 1, (400, 1))
    t = 11 * rng.uniform(-1, 1, (400, 2)) / np.sqrt(2)
    excess = rng.uniform(0, 1, (400, 2))
    for channel in (0, 2):
        found = spread.wide(channel, excess, t, source)
        expected = spread.at(channel, excess, t, source)
        middle = spread.at(channel, excess, np.zeros((400, 2)), source)
        assert_close(found / middle, expected / middle, atol=SPLINES)


def raster(glint: float) -> PlacedRaster:
    """Return a ramp with a highlight near the middle."""
    ramp = np.linspace(0.5, 1.5, 128) * np.ones((2, 96, 128))
    highlights = Highlights(
        centre_um=np.array([[20.0, 12.0]]), excess=np.array([[glint, 0.0]]), size_um=1.55
    )
    return PlacedRaster(
        planes=ramp, pitch_um=1.55, x0_um=-99.2, y0_um=-74.4, highlights=highlights, note=""
    )


@pytest.mark.parametrize("scene", ["chart", "raster", "wide"])
def test_one_lens_less_another_is_what_the_first_brings_more(scene: str):
    """The difference of two sums, but for rounding; a highlight counts in each by itself."""
    first, other = bank(), bank(coma_um=1.0, sigma_um=(1.0, 1.05, 1.2))
    camera = monochrome()
    fields = Heights(first), Heights(other)
    pixels = np.array([[50, 70], [56, 77], [20, 30]])
    chart = Chart(("white", "red"), 0, (Rect(20.0, 11.0, 9.0, 6.0, 0.2, 1),))

    def seen(lens, own, less=None):
        given = lens, camera, SPECTRA, WAVELENGTHS_NM
        banks = {"fields": own, "less": less}
        if scene == "wide":
            return Wide(*given, **banks).at(chart, pixels)
        exact = ExactCore(*given, **banks)
        if scene == "chart":
            return exact.chart(chart, pixels)
        return exact.raster(raster(50.0), pixels)

    one, two = (seen(lens, own) for lens, own in zip((first, other), fields, strict=True))
    found = seen(first, fields[0], (other, fields[1]))
    assert np.abs(one - two).max() > 1e-4 * one.max()
    assert_close(found, one - two, atol=1e-12 * one.max())
