"""A chart drawn for the eye."""

import numpy as np
import pytest
from harness import assert_close

from gpusim.scene import make_scene
from gpusim.scene.charts import load_chart
from gpusim.scene.exr import read_exr, write_exr
from gpusim.scene.preview import SUBSAMPLES, chart_rgb


@pytest.mark.parametrize("illuminant", ["D50", "A"])
def test_grey_is_grey_under_any_light(illuminant):
    rgb = chart_rgb(make_scene("grey", illuminant=illuminant), 30)
    assert rgb.shape == (30, 40, 3)
    # The adapted white is Rec.709's to rounding: float32.
    assert_close(rgb, np.full(rgb.shape, 0.18), rtol=1e-6)


def test_colorchecker_patches_have_their_published_colours():
    colour = pytest.importorskip("colour", reason="for published colours and dE2000")
    rows = 152
    rgb = chart_rgb(make_scene("colorchecker"), rows).astype(np.float64)
    chart = load_chart("colorchecker").source
    ours = [
        rgb[int((1 + p.cy) * rows / 2), int(rgb.shape[1] / 2 + p.cx * rows / 2)]
        for p in chart.primitives[1:]
    ]
    published = colour.CCS_COLOURCHECKERS["BabelColor Average"]
    d65 = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    target = colour.XYZ_to_Lab(
        colour.chromatic_adaptation(
            colour.xyY_to_XYZ(list(published.data.values())),
            colour.xy_to_XYZ(published.illuminant),
            colour.xy_to_XYZ(d65),
        ),
        d65,
    )
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    lab = colour.XYZ_to_Lab(np.array(ours) @ srgb.matrix_RGB_to_XYZ.T, d65)
    difference = colour.delta_E(target, lab, method="CIE 2000")
    # BabelColor's table was rounded to 1e-4 and is 5e-4 in x, y off its spectra (dark skin, in
    # test_spectra.py), about 0.5 dE at most; cyan is out of Rec.709 and clipped.
    cyan = list(published.data).index("cyan")
    assert np.delete(difference, cyan).max() < 1.0
    assert difference[cyan] < 5.0


def test_areas_are_averaged():
    rows = 300
    rgb = chart_rgb(make_scene("slanted-edge"), rows)
    laid = load_chart("slanted-edge")
    chart, (white, black) = laid.source, laid.reflectances(np.array([550.0]))[:, 0]
    cell = (2 / rows) ** 2
    area = sum(4 * p.half_w * p.half_h for p in chart.primitives)
    perimeter = sum(4 * (p.half_w + p.half_h) for p in chart.primitives)
    expected = white * rgb[..., 0].size + (black - white) * area / cell
    # Counting sub-samples misplaces a border by less than one of them; 36 sides at random.
    allowed = (white - black) * perimeter / (2 / rows) / SUBSAMPLES / np.sqrt(36)
    assert rgb[..., 1].sum(dtype=np.float64) == pytest.approx(expected, abs=allowed)
    # The layout is the same when turned by 180 degrees: nothing is shifted.
    assert_close(rgb, rgb[::-1, ::-1].copy(), atol=1e-6)
    between = (rgb[..., 1] > black + 0.05) & (rgb[..., 1] < white - 0.05)
    assert between.sum() > 0.5 * perimeter / (2 / rows)  # edges are not jagged


def test_an_exr_of_a_chart_is_the_same_chart(tmp_path):
    scene = make_scene("colorchecker", luminance_cd_m2=80.0)
    rgb = chart_rgb(scene, 60)
    write_exr(tmp_path / "a.exr", {"RGB": rgb}, scene.white_luminance_cd_m2)
    photograph = read_exr(tmp_path / "a.exr")
    assert_close(photograph.rgb, np.moveaxis(rgb, -1, 0).copy(), atol=0)
    assert photograph.white_luminance_cd_m2 == pytest.approx(80.0, rel=2.0**-23)
