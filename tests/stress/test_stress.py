"""The stiff and extreme cases: all hold or are declined clearly, and the table can fail."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from sampling import one_in

from gpusim import stress
from gpusim.cli import stress as command
from gpusim.errors import UserError
from gpusim.optics.angular import AngularResponse
from gpusim.sensor.adc_model import Linearity
from gpusim.stress import CASES, data_sheet, levels, made, noise, readout, sensor_files
from gpusim.stress.table import FAILED, HELD, LIMIT, REFUSED, Engine, Row, judged

# What physics allows and the engine declines: none joins them unseen.
LIMITS = {
    "distortion beyond fold-over",
    "principal point off centre",
    "tolerance of 1e-9",
    "tolerance of 1e-6 sigma",
    "tolerance below float32's rounding",
    "tolerance below the alias",
    "border wider than allowed",
    "merged codes beyond 16 bits",
}


def test_every_case_has_a_name_of_its_own():
    names = [case[0] for case in CASES]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", one_in(4, [case[0] for case in CASES]))
def test_a_case_holds_or_is_refused(name: str):
    (row,) = stress.run((name,))
    assert row.verdict in ((LIMIT,) if name in LIMITS else (HELD, REFUSED)), row
    assert row.expected and row.got


def declined() -> tuple:
    raise UserError("no such thing", field="where", value=3, allowed="less")


@pytest.mark.parametrize(
    ("case", "refusal", "verdict"),
    [
        (lambda: ("1", "1", True), None, HELD),
        (lambda: ("1", "2", False), None, FAILED),
        (lambda: ("1", "2", False), "where", FAILED),
        (lambda: ("no", "no", REFUSED), None, REFUSED),
        (declined, "where", REFUSED),
        (declined, "elsewhere", FAILED),
        (declined, None, FAILED),
        (declined, Engine("where"), LIMIT),
        (declined, Engine("elsewhere"), FAILED),
        (lambda: ("no", "no", REFUSED), Engine("no"), LIMIT),
        (lambda: ("1", "1", True), Engine("where"), HELD),
        (lambda: 1 / 0, None, FAILED),
    ],
)
def test_a_verdict_is_earned(case, refusal: str | None, verdict: str):
    assert judged("case", case, refusal).verdict == verdict


def test_a_planted_error_fails_a_case(monkeypatch: pytest.MonkeyPatch):
    right = made.rate_of
    name = "bank with one wavelength"
    monkeypatch.setattr(made, "rate_of", lambda *given, **more: 1.01 * right(*given, **more))
    (row,) = stress.run((name,))
    assert row.verdict == FAILED and "off" in row.got


def test_a_planted_error_fails_the_cases_of_the_angles(monkeypatch: pytest.MonkeyPatch):
    right = AngularResponse.qe
    monkeypatch.setattr(AngularResponse, "qe", lambda self, number: right(self, 0))
    (row,) = stress.run(("QE by angle, pixel blind to one side",))
    assert row.verdict == FAILED and "off" in row.got


def test_planted_errors_fail_the_cases_of_the_sensor(monkeypatch: pytest.MonkeyPatch):
    counts, convert, loaded = noise.noise_of, levels.record_adc, sensor_files.loaded

    def fails(name: str, module, function: str, plant) -> None:
        with monkeypatch.context() as planted:
            planted.setattr(module, function, plant)
            (row,) = stress.run((name,))
        assert row.verdict == FAILED, row

    def shifted(chosen, factor: float):
        return lambda mean, **more: counts(np.where(chosen(mean), factor, 1) * mean, **more)

    between, ladder = "Poisson between its two methods", "Poisson at means of 1e-3 to 9.9e6"
    fails(between, noise, "noise_of", shifted(lambda mean: mean < 10, 1.01))
    fails(ladder, noise, "noise_of", shifted(lambda mean: mean > 1e6, 1.0001))
    fails(ladder, noise, "noise_of", lambda mean, **more: counts(mean, **more) - 0.5)
    even = "Poisson at a mean of 9e6"  # counts beyond 2^24, halved
    fails(even, noise, "noise_of", lambda mean, **more: 2 * (counts(mean, **more) // 2))
    fails("full well of 1e7 electrons", noise, "noise_of", lambda mean: counts(mean, 9.99e6))

    def steeper(rec, charge, sensor):
        gain = 1.00002 * sensor.system_gain_dn_per_e
        return convert(rec, charge, sensor.model_copy(update={"system_gain_dn_per_e": gain}))

    fails("converter of 16 bits", levels, "record_adc", steeper)
    one_field_accepted = "sensor file with NaN"
    fails(
        one_field_accepted,
        sensor_files,
        "loaded",
        lambda text: loaded(text.replace("fill_factor: .nan", "fill_factor: 1.0")),
    )


def test_planted_errors_fail_the_cases_of_the_read_out(monkeypatch: pytest.MonkeyPatch):
    convert, merged, whole = readout.record_adc, readout.record_merge, readout.captured

    def changed(record, **changes):
        """Record a stage by the figures of another sensor."""

        def plant(rec, *arrays_and_sensor, **more):
            *arrays, sensor = arrays_and_sensor
            return record(rec, *arrays, sensor.unchecked(**changes), **more)

        return plant

    def moved(sensor, exposure_s=0.01, noise=False, **more):
        """Let tiles move the border's noise by a column."""
        raw = whole(sensor, exposure_s, noise, **more)
        return np.roll(raw, 1, axis=1) if more else raw

    bent = Linearity(electrons=[0, 1e5], read_e=[0, 9.99e4])
    other = readout.DUAL.model_copy(update={"black_level_dn": 201.0})
    for name, function, plant in (
        ("response of 4000 points", "record_adc", changed(convert, linearity=bent)),
        ("column offsets beyond the codes", "record_adc", changed(convert, column_offset=None)),
        ("two reads, 16 to 1", "record_merge", changed(merged, dual_gain=other)),
        ("charge beyond both reads", "record_merge", changed(merged, dual_gain=other)),
        ("one lit pixel in a wide border", "captured", moved),
    ):
        with monkeypatch.context() as planted:
            planted.setattr(readout, function, plant)
            (row,) = stress.run(tuple(case[0] for case in CASES if case[0].startswith(name)))
        assert row.verdict == FAILED, row


def test_a_planted_error_fails_the_data_sheets(monkeypatch: pytest.MonkeyPatch):
    rows = data_sheet.loop.rows

    def of_another(found, sensor):
        gain = 1.03 * sensor.system_gain_dn_per_e
        return rows(found, sensor.model_copy(update={"system_gain_dn_per_e": gain}))

    monkeypatch.setattr(data_sheet.loop, "rows", of_another)
    (row,) = stress.run(("data sheet of a sensor of 100 electrons",))
    assert row.verdict == FAILED and "sigma off" in row.got


def test_one_failure_is_the_exit_code(monkeypatch: pytest.MonkeyPatch, tmp_path, capsys):
    rows = [
        Row("a case", "1", "1", HELD),
        Row("a bound", "it holds", "no", LIMIT),
        Row("another", "2", "3", FAILED),
    ]
    monkeypatch.setattr(command, "run_cases", lambda progress: rows)
    monkeypatch.setattr(
        command, "default_device", lambda: SimpleNamespace(report=lambda: {"adapter": "a GPU"})
    )
    assert command.run(True, tmp_path) == 1
    facts = json.loads(capsys.readouterr().out)
    assert facts["failed"] == facts["limits"] == 1 and facts["adapter"] == "a GPU"
    assert json.loads((tmp_path / "stress.json").read_text()) == facts
    rows.pop()
    assert command.run(False, None) == 0
    shown = capsys.readouterr().out
    assert "a case" in shown and HELD in shown and "1 of 2 as expected" in shown
    assert "1 declined that physics allows" in shown
