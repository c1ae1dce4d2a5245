"""Crops, labels and measures of a sweep's frames; the same as an iterable for training."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from pyarrow import parquet
from typer.testing import CliRunner

import gpusim as gs
from gpusim.batch import dataset
from gpusim.batch.crops import Crops
from gpusim.batch.run import status, tasks_of
from gpusim.batch.sweep import Sweep
from gpusim.batch.table import write_table
from gpusim.batch.work import work
from gpusim.cli.app import app
from gpusim.errors import UserError
from gpusim.library.labels import labels_on_sensor
from gpusim.sensor.frame import areas_of

CAMERA = {
    "title": "small",
    "lens": {"mtf": "diffraction-limited"},
    "sensor": {"preset": "imx477", "rows": 32, "cols": 48},
}
FIELDS = {
    "camera": "small.yaml",
    "scenes": ["colorchecker"],
    "axes": {"seed": {"range": [0, 4]}, "exposure_s": [0.005, None]},
    "tolerance": 1e-2,
    "probes": 0,
    "crops": {"rows": 8, "cols": 12, "count": 3},
    "labels": {"class": "{scene}-class.npy"},
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(CAMERA))
    np.save(tmp_path / "colorchecker-class.npy", np.arange(6, dtype=np.uint8).reshape(2, 3))
    return tmp_path


def sweep_in(folder: Path, **changes: object) -> Sweep:
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump(FIELDS | changes, sort_keys=False))
    return Sweep.load(path)


def test_samples_are_the_crops_of_the_frames_that_a_batch_writes(folder: Path):
    sweep = sweep_in(folder, outputs=["npz", "crops", "labels"])
    for task in tasks_of(sweep, folder, 0.0):
        work(task)
    seen = labels_on_sensor(sweep.base, np.load(folder / "colorchecker-class.npy"))
    samples = list(sweep.dataset())
    assert len(samples) == len(sweep.dataset()) == 3 * 8
    for at, frame in enumerate(sweep.frames):
        files = [
            np.load(folder / f"{frame.name}{end}") for end in (".npz", ".crops.npz", ".labels.npz")
        ]
        whole, crops, labels = files
        np.testing.assert_array_equal(labels["class"], seen)
        for number in range(3):
            sample = samples[3 * at + number]
            x, y = crops["xy"][number]
            assert x % 2 == 0 and y % 2 == 0
            piece = slice(y, y + 8), slice(x, x + 12)
            np.testing.assert_array_equal(sample.raw, whole["raw"][piece])
            np.testing.assert_array_equal(sample.clean, crops["truth_dn"][number])
            np.testing.assert_array_equal(sample.labels["class"], seen[piece])
            np.testing.assert_array_equal(crops["class"][number], seen[piece])
            said = {"number": frame.number, "scene": "colorchecker", "x": x, "y": y}
            given = {name: v for name, v in frame.settings.items() if v is not None}
            assert sample.parameters == said | given
    # Frames have crops at places of their own.
    places = {tuple(np.load(one)["xy"].ravel()) for one in folder.glob("*.crops.npz")}
    assert len(places) == 8


def test_labels_lie_on_the_pixels_of_a_tile(folder: Path):
    sweep = sweep_in(folder, tile=[6, 4, 20, 10], outputs=["labels"], crops=None)
    work(tasks_of(sweep, folder, 0.0)[0])
    seen = labels_on_sensor(sweep.base, np.load(folder / "colorchecker-class.npy"))
    found = np.load(folder / "frame-000000.labels.npz")["class"]
    np.testing.assert_array_equal(found, seen[4:14, 6:26])


def test_shielded_pixels_have_no_label():
    sensor = gs.Sensor.load("imx477").roi(32, 48).model_dump()
    sensor = gs.Sensor(**sensor | {"optical_black": {"top": 4, "left": 6}})
    areas = areas_of(sensor.frame.read, sensor.frame)
    taken = SimpleNamespace(raw=np.zeros((36, 54)), areas=areas)
    found = dataset.in_frame({"class": np.full((32, 48), 7, np.uint8)}, taken)["class"]
    lit = np.zeros((36, 54), np.uint8)
    lit[4:, 6:] = 7
    np.testing.assert_array_equal(found, lit)


@pytest.mark.parametrize("shards, parts", [(1, 1), (3, 1), (2, 3)])
def test_shards_and_workers_share_the_samples_and_none_is_lost(folder, monkeypatch, shards, parts):
    sweep = sweep_in(folder, crops=None, labels={})
    monkeypatch.setattr(
        dataset, "rendered", lambda frames: ((one, SimpleNamespace()) for one in frames)
    )
    monkeypatch.setattr(dataset, "in_frame", lambda labels, taken: labels)
    monkeypatch.setattr(dataset, "samples_of", lambda frame, *_: [frame.number])
    found = []
    for shard in range(shards):
        data = sweep.dataset(shard=shard, shards=shards)
        own = []
        for part in range(parts):
            torch = SimpleNamespace(
                get_worker_info=lambda part=part: SimpleNamespace(id=part, num_workers=parts)
            )
            monkeypatch.setitem(sys.modules, "torch.utils.data", torch)
            own += list(data)
        assert len(own) == len(data)
        found += own
    assert found == list(range(8))


def test_no_thread_is_left_where_a_reader_stops(folder: Path):
    before = threading.active_count()
    for _ in sweep_in(folder).dataset(prefetch=1):
        break
    assert threading.active_count() == before


def test_what_fails_in_the_thread_is_the_readers(folder: Path):
    sweep = sweep_in(folder, axes={"frame": [0, 2**32]})
    for prefetch in (0, 2):
        found = iter(sweep.dataset(prefetch=prefetch))
        assert [next(found).parameters["frame"] for _ in range(3)] == [0, 0, 0]
        with pytest.raises(UserError, match="frame"):
            next(found)


@pytest.mark.parametrize(
    "changes, field",
    [
        ({"crops": {"rows": 40, "cols": 8, "count": 1}}, "crops"),
        ({"crops": {"rows": 8, "cols": 8, "at": [[0, 0], [42, 0]]}}, "crops.at"),
        ({"crops": {"rows": 8, "cols": 8}}, "crops"),
        ({"crops": None, "outputs": ["crops"]}, "outputs"),
        ({"labels": {}, "outputs": ["labels"]}, "outputs"),
        ({"labels": {"depth": "none/{scene}.npy"}}, "labels"),
        ({"labels": {"raw": "{scene}-class.npy"}}, "labels"),
        ({"metrics": ["mtf"]}, "metrics"),
        ({"metrics": ["sfr"], "outputs": ["npz"]}, "metrics"),
    ],
)
def test_mistakes_are_told_before_the_work(folder: Path, changes: dict, field: str):
    with pytest.raises(UserError) as told:
        sweep_in(folder, **changes)
    assert told.value.field == field


def test_there_are_no_other_shards(folder: Path):
    sweep = sweep_in(folder)
    for given in ({"shard": 2, "shards": 2}, {"shard": -1}, {"shards": 0}, {"prefetch": -1}):
        with pytest.raises(UserError):
            sweep.dataset(**given)


def test_drawn_places_reach_both_ends_and_follow_the_seed():
    crops = Crops(rows=8, cols=12, count=400, step=3)
    lit, shape = (2, 4, 32, 48), (40, 60)
    first = crops.places(lit, shape, 5, 7)
    assert first.min(axis=0).tolist() == [4, 2] and first.max(axis=0).tolist() == [40, 26]
    assert not ((first - [4, 2]) % 3).any()
    assert (crops.places(lit, shape, 5, 7) == first).all()
    assert (crops.places(lit, shape, 5, 8) != first).any()
    assert (crops.places(lit, shape, 6, 7) != first).any()


def test_measures_of_each_raw_stand_in_the_table(folder: Path):
    (folder / "small.yaml").write_text(
        yaml.safe_dump({**CAMERA, "sensor": {"preset": "imx477", "rows": 240, "cols": 320}})
    )
    fields = {
        **FIELDS,
        "scenes": ["slanted-edge"],
        "axes": {"exposure_s": [0.01]},
        "metrics": ["sfr", "colour"],
        "crops": None,
        "labels": {},
    }
    (folder / "sweep.yaml").write_text(yaml.safe_dump(fields))
    sweep = Sweep.load(folder / "sweep.yaml")
    work(tasks_of(sweep, folder, 0.0)[0])
    write_table(status(sweep, folder), folder / "frames.parquet")
    (row,) = parquet.read_table(folder / "frames.parquet").to_pylist()
    assert row["sfr.edges"] >= 2
    assert "ColorChecker" in row["colour.not_measured"]
    command = ["measure", "sfr", str(folder / "frame-000000.dng"), "--channel", "G"]
    told = json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)
    halves = [one["figures"]["mtf50"]["value"] for one in told["edges"]]
    assert row["sfr.mtf50_median_cy_px"] == pytest.approx(np.median(halves), rel=1e-6)
    assert row["sfr.mtf50_least_cy_px"] == pytest.approx(min(halves), rel=1e-6)


def test_the_public_name_is_this_data_set(folder: Path):
    assert isinstance(sweep_in(folder).dataset(), gs.Dataset)
