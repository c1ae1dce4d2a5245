"""RGB to spectra by name: shares of nodes make up each colour, tables are their authors'."""

import numpy as np
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene import make_scene
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, lab, rgb_to_xyz
from gpusim.scene.exr import write_exr
from gpusim.scene.spectra import rgb_nodes, xyz
from gpusim.scene.upsampling import TABLES, node_shares

NODES = ["jakob_2019", "smits_1999"]


@pytest.mark.parametrize("table", NODES)
def test_at_most_three_nodes_make_up_each_colour(table: str):
    nodes = rgb_nodes(table)[0]
    rng = np.random.default_rng(1)
    planes = rng.uniform(0, 3, (3, 40, 50)).astype(np.float32)
    planes[:, 0, 0] = 0
    planes[:, 1, : len(nodes)] = 2.5 * nodes.T
    shares = node_shares(planes, nodes)
    assert shares.min() >= 0
    assert (shares > 0).sum(axis=0).max() <= 3
    assert_close(
        np.einsum("nrc,nk->krc", shares.astype(float), nodes), planes.astype(float), atol=1e-6
    )
    # A node is itself alone.
    assert_close(shares[:, 1, : len(nodes)], 2.5 * np.eye(len(nodes)), atol=1e-6)
    # Between two colours that are near there is no step.
    line = np.linspace(0, 1, 2001)
    path = np.stack([line, 1 - line, np.full(2001, 0.3)])[:, None]
    assert np.abs(np.diff(node_shares(path, nodes), axis=2)).max() < 5e-3


def test_smits_is_smits():
    """His own rule (1999, section 3): white, then the secondary, then the primary."""
    nodes = rgb_nodes("smits_1999")[0]
    rgb = np.array([0.2, 0.9, 0.5])
    shares = node_shares(rgb[:, None, None], nodes)[:, 0, 0]
    found = {tuple(node.astype(int)): share for node, share in zip(nodes, shares, strict=True)}
    expected = {(1, 1, 1): 0.2, (0, 1, 1): 0.5 - 0.2, (0, 1, 0): 0.9 - 0.5}
    for node, share in found.items():
        assert share == pytest.approx(expected.get(node, 0.0), abs=1e-6)


@pytest.mark.parametrize("table", NODES)
def test_the_tables_are_colour_sciences(table: str):
    colour = pytest.importorskip("colour", reason="has both methods")
    nm = np.arange(400.0, 701.0, 5.0)
    nodes, spectra = rgb_nodes(table, nm)
    shape = colour.SpectralShape(360, 780, 5)
    bars = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    daylight = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    chosen = range(len(nodes)) if table == "smits_1999" else (0, 7, 18)  # each takes half a second
    for number in chosen:
        if table == "smits_1999":
            sd = colour.recovery.RGB_to_sd_Smits1999(nodes[number])
            theirs = np.interp(nm, sd.wavelengths, sd.values)
        else:
            wanted = rgb_to_xyz(REC709_CHROMATICITIES) @ nodes[number]
            sd = colour.recovery.XYZ_to_sd_Jakob2019(wanted, bars, daylight)
            theirs = np.interp(nm, sd.wavelengths, sd.values)
        assert_close(spectra[number], theirs, atol=1e-5)  # six digits


@pytest.mark.parametrize(("name", "most"), [(None, 1.5), ("jakob-2019", 1.5), ("smits-1999", 25.0)])
def test_the_round_trip_is_told(tmp_path, name: str | None, most: float):
    rgb = np.random.default_rng(3).uniform(0, 1, (20, 30, 3)).astype(np.float32)
    write_exr(tmp_path / "a.exr", {"RGB": rgb}, 100.0)
    scene = make_scene(tmp_path / "a.exr", upsampling=name)
    space = rgb_to_xyz(REC709_CHROMATICITIES)
    planes = scene.source.planes.reshape(len(scene.spectra), -1).T.astype(float)
    found = lab(planes @ xyz(scene.spectra) / 100, space.sum(axis=1))
    off = np.linalg.norm(found - lab(rgb.reshape(-1, 3) @ space.T, space.sum(axis=1)), axis=1)
    (told,) = [note for note in scene.notes if "dE*ab" in note]
    assert f"{off.mean():.2f} in the mean, {off.max():.2f} at most" in told
    assert 0 < off.max() < most
    assert scene.white_luminance_cd_m2 == pytest.approx(100, rel=5e-3)


def test_lab_is_the_cies():
    colour = pytest.importorskip("colour", reason="has CIE Lab")
    white = np.array([0.9505, 1.0, 1.089])
    some = np.random.default_rng(2).uniform(0, 1, (50, 3)) ** 4 * white
    xy = white[:2] / white.sum()
    assert_close(lab(some, white), colour.XYZ_to_Lab(some, xy), atol=1e-9)


def test_another_name_is_refused(tmp_path):
    write_exr(tmp_path / "a.exr", {"RGB": np.ones((2, 2, 3), np.float32)}, 100.0)
    with pytest.raises(UserError, match="no such way") as caught:
        make_scene(tmp_path / "a.exr", upsampling="meng-2015")
    assert caught.value.allowed == ", ".join(TABLES)
