"""PSFs to look at: which places, which way round, and where their colours land."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from optics.made import StubCamera, bank, monochrome, scene, sensor

from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.psf.local import HEIGHTS, local_psfs
from gpusim.render import Capture, Renderer


def centroid(light: np.ndarray, side_um: float) -> np.ndarray:
    n = len(light)
    at = (np.arange(n) - n // 2) * side_um / n
    return np.array([light.sum(axis=0) @ at, light.sum(axis=1) @ at]) / light.sum()


def test_coma_points_away_from_the_axis():
    lens, chip = bank(coma_um=3.0), sensor(64, 96)
    found = local_psfs(lens, chip, scene())
    assert found.turned
    assert 1 < len(found.places_um) <= HEIGHTS
    assert found.places_um[0, 0] == 0
    corner_um = np.hypot(64, 96) / 2 * chip.pixel_pitch_um
    height = lens.real_height_um[:, lens.reference]
    assert found.places_um[-1, 0] == height[np.abs(height - corner_um).argmin()]
    last = centroid(found.light[-1].sum(axis=-1), found.side_um)
    psf = lens.psf[np.abs(height - corner_um).argmin(), lens.reference]
    direct = centroid(psf, len(psf) * lens.pitch_um)
    assert last[0] == pytest.approx(direct[0], abs=0.15 * abs(direct[0]) + 0.05)
    assert last[1] == pytest.approx(0, abs=1e-3)


def test_lateral_colour_parts_the_colours():
    lens = bank(coma_um=0.0)
    shift = np.linspace(2.0, -2.0, len(lens.wavelengths_nm))  # blue lands farther out
    real = lens.real_height_um + shift * (np.arange(len(lens.field_deg)) > 0)[:, None]
    found = local_psfs(replace(lens, real_height_um=real), sensor(64, 96), scene())
    red, green, blue = (
        centroid(one, found.side_um)[0] for one in np.moveaxis(found.light[-1], -1, 0)
    )
    assert blue > green > red


def test_one_colour_is_one_picture():
    found = local_psfs(bank(), monochrome(64, 96), scene())
    assert found.light.ndim == 3
    assert 0 < found.light[0].sum() <= 1 + 1e-5


def test_a_capture_makes_them_where_they_are_asked_for(monkeypatch):
    made = []
    monkeypatch.setattr(
        sys.modules[Capture.__module__], "local_psfs", lambda *given: made.append(given) or "these"
    )
    camera = StubCamera(bank(), sensor(64, 96))
    renderer = Renderer(camera, scene(), Accuracy(1e-2, 0), costs=LAVAPIPE, noise=False)
    found = renderer.capture(0.01)
    assert not made
    assert found.psfs == found.psfs == "these"
    assert made == [(renderer.core, camera.sensor, renderer.scene)]
    renderer.release()
