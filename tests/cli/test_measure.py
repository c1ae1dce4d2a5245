"""``gpusim measure noise``: data sheets of frames, the loop on sensors, and refusals."""

from __future__ import annotations

import csv
import json

import pytest
import yaml
from command_line import assert_refused, gpusim
from metrics.made import write

from gpusim.sensor.load import PRESETS, load_sensor

SMALL = ("--side", "64")


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Return a folder of frames of a small monochrome sensor, its page, and what was printed."""
    at = tmp_path_factory.mktemp("noise")
    sensor = yaml.safe_load((PRESETS / "imx477.yaml").read_text())
    sensor |= {"name": "small", "rows": 80, "cols": 96, "cfa": {"pattern": [["G"]]}}
    curves = sensor["quantum_efficiency"]
    curves["channels"] = {"G": curves["channels"]["G"]}
    del sensor["sources"]
    (at / "small.yaml").write_text(yaml.safe_dump(sensor))
    ran = gpusim(
        "measure", "noise", "--sensor", at / "small.yaml", *SMALL, "--out", at / "page",
        "--keep", at / "frames",
    )  # fmt: skip
    return at, ran


def test_the_loop_prints_a_verdict_for_each_parameter(kept):
    _, ran = kept
    assert ran.code == 0, ran.out + ran.err
    assert ran.err == ""
    for word in ("sigma_d", "mu_I (mean)", "mu_e.sat", "DSNU", "PRNU", "eta at 530 nm", "k = 3"):
        assert word in ran.out
    assert "OUTSIDE" not in ran.out


def test_the_page_is_written(kept):
    at, _ = kept
    assert sorted(file.name for file in (at / "page").iterdir()) == [
        "noise.csv", "noise.html", "noise.json", "noise.png",
    ]  # fmt: skip
    facts = json.loads((at / "page" / "noise.json").read_text())
    assert facts["outside"] == 0
    assert {row["parameter"] for row in facts["verdicts"]} >= {"K", "sigma_d", "DSNU"}
    title, *levels = csv.reader((at / "page" / "noise.csv").open())
    transfer = facts["channels"][0]["transfer"]
    first = dict(zip(title, levels[0], strict=True))
    assert float(first["mean_dn"]) == pytest.approx(transfer["mean"][0], rel=1e-8)
    assert float(first["u_variance_dn2"]) ** 2 == pytest.approx(
        transfer["variance_u2"][0], rel=1e-7
    )
    assert len(levels) == sum(len(one["transfer"]["mean"]) for one in facts["channels"])
    page = (at / "page" / "noise.html").read_text()
    for word in ("Overall system gain", "recovered within", "data:image/svg+xml"):
        assert word in page
    assert "nan" not in page.lower().replace("nanometre", "").split("data:image")[0]
    assert (at / "page" / "noise.png").read_bytes().startswith(b"\x89PNG")


def test_kept_frames_give_the_same_data_sheet(kept):
    at, _ = kept
    ran = gpusim("measure", "noise", at / "frames", "--json")
    assert ran.code == 0, ran.err
    again = json.loads(ran.out)
    facts = json.loads((at / "page" / "noise.json").read_text())
    assert again["camera"] == "small"
    assert again["channels"] == facts["channels"]
    assert again["all_pixels"] == facts["all_pixels"]
    assert "verdicts" not in again


def test_frames_that_lack_what_the_standard_asks_for_are_measured_as_far_as_they_go(tmp_path):
    """Pairs at one exposure time, without stacks: the page says what is not there."""
    lights = [(0.01, 0.0, 2), *((0.01, 400.0 * k, 2) for k in range(1, 24))]
    ran = gpusim("measure", "noise", write(tmp_path / "cam", lights), "--out", tmp_path / "page")
    assert ran.code == 0, ran.err
    for word in (
        "note: exposure times in the dark: 1",
        "23 levels of light",
        "DSNU and PRNU are not measured",
    ):
        assert word in ran.out
    assert "mu_I" not in ran.out and "DSNU.row" not in ran.out
    page = (tmp_path / "page" / "noise.html").read_text()
    assert "no dark level has more than two frames" in page


def test_a_parameter_that_is_not_recovered_gives_exit_code_1(kept, monkeypatch):
    """The file says another gain than the frames have."""
    at, _ = kept
    from gpusim.metrics import loop

    rows = loop.rows
    monkeypatch.setattr(
        loop,
        "rows",
        lambda found, sensor: rows(found, sensor.model_copy(update={"system_gain_dn_per_e": 0.45})),
    )
    ran = gpusim("measure", "noise", "--sensor", at / "small.yaml", *SMALL)
    assert ran.code == 1
    assert "OUTSIDE" in ran.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("nothing to measure", "--sensor")),
        ((".", "--sensor", "imx477"), ("two things",)),
        ((".", "--keep", "x"), ("--keep",)),
        (("nowhere",), ("frames.csv",)),
        (("--sensor", "nosuch"), ("nosuch", "imx477")),
    ],
)
def test_bad_arguments_are_refused(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(gpusim("measure", "noise", *arguments), *words)
    assert list(tmp_path.iterdir()) == []


def test_the_sensor_file_of_what_was_measured_is_written(kept, tmp_path):
    at, _ = kept
    ran = gpusim("measure", "noise", at / "frames", "--sensor-out", tmp_path / "mine.yaml")
    assert ran.code == 0, ran.err
    assert str(tmp_path / "mine.yaml") in ran.out
    mine, true = load_sensor(tmp_path / "mine.yaml"), load_sensor(at / "small.yaml")
    # 64 x 64 pixels and pairs of frames: K to 0.3 %, noise to 2 %.
    assert mine.system_gain_dn_per_e == pytest.approx(true.system_gain_dn_per_e, rel=0.02)
    assert mine.temporal_dark_noise_e == pytest.approx(true.temporal_dark_noise_e, rel=0.1)
    assert mine.bit_depth == true.bit_depth
    assert (mine.rows, mine.cols) == (64, 64)
    assert mine.pixel_pitch_um == true.pixel_pitch_um


def test_a_simulated_sensor_has_its_file(tmp_path):
    ran = gpusim("measure", "noise", "--sensor", "imx477", "--sensor-out", tmp_path / "a.yaml")
    assert_refused(ran, "--sensor-out", "only with frames on disk")
