"""The stiff and extreme cases: all hold or are declined clearly, and the table can fail."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from gpusim import stress
from gpusim.cli import stress as command
from gpusim.errors import UserError
from gpusim.stress import CASES, made
from gpusim.stress.table import FAILED, HELD, REFUSED, Row, judged


def test_every_case_has_a_name_of_its_own():
    names = [case[0] for case in CASES]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", [case[0] for case in CASES])
def test_a_case_holds_or_is_refused(name: str):
    (row,) = stress.run((name,))
    assert row.verdict in (HELD, REFUSED), row
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


def test_one_failure_is_the_exit_code(monkeypatch: pytest.MonkeyPatch, tmp_path, capsys):
    rows = [Row("a case", "1", "1", HELD), Row("another", "2", "3", FAILED)]
    monkeypatch.setattr(command, "run_cases", lambda progress: rows)
    monkeypatch.setattr(
        command, "default_device", lambda: SimpleNamespace(report=lambda: {"adapter": "a GPU"})
    )
    assert command.run(True, tmp_path) == 1
    facts = json.loads(capsys.readouterr().out)
    assert facts["failed"] == 1 and facts["adapter"] == "a GPU"
    assert json.loads((tmp_path / "stress.json").read_text()) == facts
    rows.pop()
    assert command.run(False, None) == 0
    shown = capsys.readouterr().out
    assert "a case" in shown and HELD in shown and "1 of 1 as expected" in shown
