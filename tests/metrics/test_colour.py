"""Colours: charts found in any turn, a known matrix recovered, differences by their formula."""

from __future__ import annotations

import numpy as np
import pytest
from metrics.colour_charts import SIZE, chart

from gpusim.errors import UserError
from gpusim.metrics.colour import compared, measure_colour
from gpusim.metrics.picture import Plane
from gpusim.scene.spectra import colorchecker, illuminant, xyz

# From Rec.709 to XYZ with D65 (IEC 61966-2-1), and a camera's own channels.
SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
CAMERA = np.array([[0.7, 0.2, 0.1], [0.25, 0.9, -0.1], [0.05, -0.2, 1.3]])
OPEN = (-np.inf, np.inf)


def true_xyz(light="D65"):
    power = illuminant(light)
    return xyz(np.stack(list(colorchecker().values())) * power) / xyz(power)[1]


def planes(picture, sites=None):
    return {name: Plane(picture[..., at], sites, OPEN) for at, name in enumerate("RGB")}


@pytest.mark.parametrize("turn", [-12.0, 0.0, 5.0, 88.0, 180.0, 265.0])
def test_the_chart_is_found_and_its_matrix_recovered(turn):
    rgb = true_xyz() @ np.linalg.inv(CAMERA).T
    found = measure_colour(planes(chart(rgb, turn)))
    # Patches are even, so that any part of them has their colour, and the colours are those of a
    # matrix: nothing is left but rounding.
    assert found.matrix == pytest.approx(CAMERA, abs=1e-6)
    assert found.fitted.delta_e["2000"].max() < 1e-4
    assert found.names[0] == "dark skin"


def test_an_srgb_picture_has_its_own_colours():
    rgb = 0.37 * true_xyz() @ np.linalg.inv(SRGB).T  # any exposure
    found = measure_colour(planes(chart(rgb)))
    # Four digits of the matrix, and D65 from 400 to 700 nm, whose white lies 3e-4 of xy from that
    # of Rec.709: the adaptation between the two moves greys by 0.4.
    assert np.abs(found.as_is.xy - true_xyz()[:, :2] / true_xyz().sum(1)[:, None]).max() < 1e-3
    assert found.as_is.delta_e["2000"].max() < 0.5
    assert found.white_xy == pytest.approx([0.3127, 0.3290], abs=3e-3)


def test_differences_are_those_of_their_formula():
    own = true_xyz() * (1.0, 1.0, 0.9)
    found = measure_colour(planes(chart(own @ np.linalg.inv(SRGB).T)))
    white = xyz(illuminant("D65"))
    white = white / white[1]

    def lab(values):
        ratio = values / white
        root = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio * (29 / 6) ** 2 / 3 + 4 / 29)
        fx, fy, fz = root.T
        return np.stack([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)], 1)

    theirs = np.linalg.norm(lab(found.as_is.xyz) - lab(found.chart_xyz), axis=1)
    assert found.as_is.delta_e["76"] == pytest.approx(theirs, rel=1e-6)
    assert found.as_is.delta_e["76"].mean() > 3
    # What a matrix undoes is undone.
    assert found.fitted.delta_e["76"].max() < 1e-3


# Lab of a pair and Delta E 2000: G. Sharma, W. Wu, E. N. Dalal, Color Res. Appl. 30 (2005), table
# 1, pairs 1, 7, 10, 17, 20, 25 and 34.
SHARMA = (
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
    ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0010), 7.1792),
    ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
    ((50.0, 2.5, 0.0), (58.0, 24.0, 15.0), 19.4535),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
)


def xyz_of(lab, white):
    """Return XYZ of CIELAB (CIE 15:2018, annex D)."""
    fy = (lab[0] + 16) / 116
    f = np.array([fy + lab[1] / 500, fy, fy - lab[2] / 200])
    return white * np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))


def test_differences_of_1994_and_2000_are_those_that_are_published():
    white = xyz(illuminant("D65"))
    white = white / white[1]
    chart, own = (np.array([xyz_of(pair[at], white) for pair in SHARMA]) for at in (0, 1))
    found = compared(own, chart, white)
    # Four digits after the point are published.
    assert found.delta_e["2000"] == pytest.approx([pair[2] for pair in SHARMA], abs=6e-5)
    first, second = (np.array([pair[at] for pair in SHARMA]) for at in (0, 1))
    apart = second - first
    chroma, other = (np.hypot(*each[:, 1:].T) for each in (first, second))
    # CIE 116:1995: k_L = 1, K_1 = 0.045, K_2 = 0.015, weighed by the chart's chroma.
    hue2 = (apart[:, 1:] ** 2).sum(axis=1) - (other - chroma) ** 2
    by_equation = np.sqrt(
        apart[:, 0] ** 2
        + ((other - chroma) / (1 + 0.045 * chroma)) ** 2
        + hue2 / (1 + 0.015 * chroma) ** 2
    )
    assert found.delta_e["94"] == pytest.approx(by_equation, abs=1e-6)


def test_another_light_is_another_chart():
    rgb = true_xyz("A") @ np.linalg.inv(CAMERA).T
    assert measure_colour(planes(chart(rgb)), "A").fitted.delta_e["2000"].max() < 1e-4
    assert measure_colour(planes(chart(rgb)), "D65").fitted.delta_e["2000"].mean() > 0.3


def test_a_filter_arrays_photosites_are_measured_where_they_lie():
    rgb = true_xyz() @ np.linalg.inv(CAMERA).T
    picture = chart(rgb)
    letters = np.array([["R", "G"], ["G", "B"]])
    rows, cols = np.indices(picture.shape[:2])
    mosaic = np.zeros(picture.shape[:2])
    for at, name in enumerate("RGB"):
        own = letters[rows % 2, cols % 2] == name
        mosaic[own] = picture[..., at][own]
    found = measure_colour({name: Plane(mosaic, letters == name, OPEN) for name in "RGB"})
    assert found.as_is is None
    assert found.matrix == pytest.approx(CAMERA, abs=1e-6)


def test_noise_moves_the_matrix_by_little():
    rgb = true_xyz() @ np.linalg.inv(CAMERA).T
    noise = 0.01 * np.random.default_rng(2).normal(size=(SIZE[1], SIZE[0], 3))
    found = measure_colour(planes(chart(rgb) + noise))
    # 200 pixels a patch: 7e-4 of white, on 24 patches.
    assert found.matrix == pytest.approx(CAMERA, abs=0.02)
    assert found.patches.noise.mean() == pytest.approx(0.01, rel=0.05)


def test_corners_that_are_given_are_taken():
    rgb = true_xyz() @ np.linalg.inv(CAMERA).T
    picture = chart(rgb, turn_deg=0.0, tilt=0.0)
    x = SIZE[0] / 2 + 36 * np.array([-2.5, 2.5, 2.5, -2.5])
    y = SIZE[1] / 2 + 36 * np.array([-1.5, -1.5, 1.5, 1.5])
    found = measure_colour(planes(picture), corners=np.stack([x, y], 1))
    assert found.matrix == pytest.approx(CAMERA, abs=1e-6)


def test_pictures_without_a_chart_are_refused():
    with pytest.raises(UserError, match="not found"):
        measure_colour(planes(np.full((90, 90, 3), 0.5)))
    with pytest.raises(UserError, match="no red, green"):
        measure_colour({"Y": Plane(np.zeros((90, 90)), None, OPEN)})
