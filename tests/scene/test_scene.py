"""Scenes by name and from files: spectra, absolute scale, and what is refused."""

import numpy as np
import OpenEXR
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene import Chart, Raster, make_scene
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.scene.exr import write_exr
from gpusim.scene.spectra import WAVELENGTHS_NM, luminance_cd_m2, xyz


@pytest.fixture
def photograph(tmp_path):
    """Return a function that writes a picture to an EXR and returns its path."""

    def write(rgb: np.ndarray, luminance: float | None = None):
        path = tmp_path / "photo.exr"
        write_exr(path, {"RGB": np.asarray(rgb, np.float32)}, luminance)
        return path

    return write


@pytest.mark.parametrize("name", ["demo", "colorchecker", "slanted-edge", "dots", "grey"])
def test_charts_come_by_name(name):
    scene = make_scene(name)
    assert scene.name == name
    assert isinstance(scene.source, Chart)
    assert scene.spectra.shape == (len(scene.source.materials), 61)
    assert scene.illuminant == "D50"
    assert scene.white_luminance_cd_m2 == pytest.approx(300, rel=1e-13)


def test_rgb_becomes_spectra_of_the_same_xyz(photograph):
    colour = pytest.importorskip("colour", reason="for the observer beyond 400-700 nm")
    rng = np.random.default_rng(6)
    rgb = np.concatenate([np.eye(3), np.ones((1, 3)), rng.uniform(0, 1, (20, 3))])
    scene = make_scene(photograph(rgb[None]), luminance_cd_m2=250.0)
    assert isinstance(scene.source, Raster)
    coefficients = scene.source.planes[:, 0].T.astype(np.float64)
    ours = xyz(coefficients @ scene.spectra) / 250.0
    reference = rgb @ rgb_to_xyz(REC709_CHROMATICITIES).T
    # Mallett and Yuksel's spectra meet Rec.709 over 380-780 nm. Cut to 400-700 nm, XYZ change by at
    # most the tails of the observer under D65; the scale to luminance by as much as Y does. On top,
    # 1e-3: their own optimisation stops there, and the sum of the 5 nm samples.
    full = colour.SpectralShape(380, 780, 5)
    bars = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(full).values
    power = colour.SDS_ILLUMINANTS["D65"].copy().align(full).values
    outside = (full.wavelengths < 400) | (full.wavelengths > 700)
    tails = power[outside] @ bars[outside] / (power @ bars[:, 1])
    assert tails.max() < 0.01
    assert_close(ours, reference, atol=tails + tails[1] + 1e-3)


def test_luminance_of_a_photograph(photograph):
    rgb = np.ones((2, 2, 3))
    silent = make_scene(photograph(rgb))
    assert silent.white_luminance_cd_m2 == pytest.approx(300, rel=1e-4)
    assert "300 cd/m^2" in silent.notes[-2]
    stated = make_scene(photograph(rgb, 80.0))
    assert stated.white_luminance_cd_m2 == pytest.approx(80, rel=1e-4)
    assert len(stated.notes) == 1 and "dE*ab" in stated.notes[0]
    asked = make_scene(photograph(rgb, 80.0), luminance_cd_m2=7.0)
    # The basis reflectances add up to 1 within 1e-5 only.
    assert asked.white_luminance_cd_m2 == pytest.approx(7, rel=1e-4)
    assert asked.notes == stated.notes


def test_white_of_a_photograph_is_that_of_its_primaries(tmp_path):
    chromaticities = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": chromaticities,
    }
    path = tmp_path / "aces.exr"
    OpenEXR.File(header, {"RGB": np.ones((2, 2, 3), np.float32)}).write(str(path))
    scene = make_scene(path, luminance_cd_m2=100.0)
    x, y = (xyz(scene.white) / xyz(scene.white).sum())[:2]
    # Tails beyond 400-700 nm: see above, 1e-3 in x and y.
    assert (x, y) == pytest.approx((0.32168, 0.33767), abs=1e-3)
    at_a_pixel = np.tensordot(scene.source.planes[:, 0, 0], scene.spectra, axes=1)
    assert_close(at_a_pixel, scene.white.copy(), rtol=1e-6)


def test_spectra_are_physical(photograph):
    scene = make_scene(photograph(np.ones((1, 1, 3))))
    assert scene.spectra.shape == (3, WAVELENGTHS_NM.size)
    assert scene.spectra.min() > 0
    assert luminance_cd_m2(scene.spectra[1]) > luminance_cd_m2(scene.spectra[0])


def test_an_unknown_scene_lists_the_charts():
    with pytest.raises(UserError, match="unknown scene") as caught:
        make_scene("siemens-planet")
    assert caught.value.value == "siemens-planet"
    assert "demo, colorchecker, slanted-edge, " in caught.value.allowed
    assert ".exr" in caught.value.allowed


def test_a_missing_file_is_not_an_unknown_chart(tmp_path):
    with pytest.raises(UserError, match="no such scene file") as caught:
        make_scene(tmp_path / "none.EXR")
    assert caught.value.file == tmp_path / "none.EXR"


@pytest.mark.parametrize("luminance", [0.0, -1.0, np.nan, np.inf])
def test_an_impossible_luminance_is_refused(luminance):
    with pytest.raises(UserError, match="luminance"):
        make_scene("grey", luminance_cd_m2=luminance)


def test_an_unknown_illuminant_is_refused():
    with pytest.raises(UserError, match="illuminant"):
        make_scene("grey", illuminant="moonlight")
