"""Veiling glare: spots of known darkness, filter arrays, a rendered chart, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim

import gpusim as gs
from gpusim.errors import UserError
from gpusim.metrics.glare import measure_glare
from gpusim.metrics.picture import Plane

OPEN = (-np.inf, np.inf)


def spots(index=0.03, noise=0.0, rows=240, cols=320, places=((80, 70), (240, 170)), radius=24.0):
    """Return a field of 1000, falling off, with spots of a share of it, rims one pixel soft."""
    y, x = np.mgrid[:rows, :cols].astype(float)
    field = 1000 * (1 - 0.1 * ((x / cols - 0.5) ** 2 + (y / rows - 0.5) ** 2))
    for cx, cy in places:
        inside = np.clip(radius + 0.5 - np.hypot(x - cx, y - cy), 0, 1)
        field *= 1 - inside * (1 - index)
    return field + noise * np.random.default_rng(1).normal(size=field.shape)


def test_the_index_is_the_spots_share_of_the_field_around_it():
    found = measure_glare(Plane(spots(), None, OPEN), "Y")
    assert len(found) == 2
    for spot, place in zip(found, ((80, 70), (240, 170)), strict=True):
        assert spot.place_px == pytest.approx((place[0] + 0.5, place[1] + 0.5), abs=0.2)
        # The field falls by 1 % from a spot to the ring about it at most.
        assert spot.index.value == pytest.approx(0.03, rel=0.01)


def test_noise_is_in_the_uncertainty():
    errors = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        values = spots() + 30 * rng.normal(size=(240, 320))
        found = measure_glare(Plane(values, None, OPEN), "Y")[0]
        errors.append((found.index.value - 0.03) / found.index.u)
    # 40 draws: their spread is known to 11 %; the field's fall adds a constant.
    assert np.std(errors) == pytest.approx(1, abs=0.35)


def test_a_filter_array_is_read_where_the_channel_lies():
    values = spots(0.05)
    rows, cols = np.indices(values.shape)
    values[(rows % 2 != 0) | (cols % 2 != 1)] = 777.0
    sites = np.array([[False, True], [False, False]])
    found = measure_glare(Plane(values, sites, OPEN), "R")
    assert [one.index.value for one in found] == pytest.approx([0.05, 0.05], rel=0.02)


def test_pictures_without_a_spot_are_refused():
    for values in (np.ones((100, 100)), spots(places=((0, 0),)), spots(radius=2.0)):
        with pytest.raises(UserError, match="No black spot"):
            measure_glare(Plane(values, None, OPEN), "Y")


def test_a_sensors_veiling_glare_is_found_in_a_render():
    """The glare is a share of the mean signal; what PSFs scatter into a spot comes on top."""
    camera = gs.Camera.load("mtf-only")
    sensor = camera.sensor.roi(240, 320)
    index = {}
    for share in (0.0, 0.04):
        made = gs.Camera(camera.lens, sensor.model_copy(update={"veiling_glare": share}), "it")
        light = gs.expose(made, gs.Scene.load("glare-spots"), 1e-2, probes=0)
        frame = light.capture(0.01, noise=False)
        spot = measure_glare(Plane(frame.electrons, None, OPEN), "Y")[2]
        index[share] = spot.index.value
        mean = float(frame.electrons.mean()) / spot.field.value
    # a = g m / (1 + g m) with the mean m of the field: what is added is a share of all light.
    added = 0.04 * mean
    assert index[0.04] - index[0.0] == pytest.approx(added, rel=0.08)


def test_the_command_writes_its_files(tmp_path):
    np.save(tmp_path / "spots.npy", spots(0.03, noise=1.0))
    out = tmp_path / "out"
    ran = gpusim("measure", "glare", tmp_path / "spots.npy", "--out", out)
    assert ran.code == 0, ran.err
    facts = json.loads((out / "glare.json").read_text())
    assert facts["channels"][0]["spots"][0]["index_percent"] == pytest.approx(3, rel=0.02)
    assert {one.name for one in out.iterdir()} == {
        f"glare.{end}" for end in ("json", "csv", "html", "png")
    }
    np.save(tmp_path / "flat.npy", np.ones((90, 90)))
    assert_refused(
        gpusim("measure", "glare", tmp_path / "flat.npy"), "No black spot", "glare-spots"
    )
