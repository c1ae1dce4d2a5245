"""The rows of the sensor's effects: each names what is there, and the documentation is theirs."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
from harness import shader_names

from gpusim.gpu.wgsl import load
from gpusim.sensor.effects import CCD, CMOS, EFFECTS, switches
from gpusim.sensor.load import load_sensor, presets
from gpusim.sensor.sensor import Sensor

PROJECT = Path(__file__).resolve().parents[2]


def test_every_effect_has_one_name_a_shader_and_fields_of_a_sensor():
    assert len({effect.name for effect in EFFECTS}) == len(EFFECTS)
    for effect in EFFECTS:
        assert f"sensor/{effect.stage}" in shader_names()
        assert {field.partition(".")[0] for field in effect.fields} <= set(Sensor.model_fields)


def test_one_order_is_that_of_both_kinds():
    for order in (CMOS, CCD):
        assert list(order) == [effect for effect in EFFECTS if effect in order]
    assert {effect.name for effect in set(CCD) - set(CMOS)} == {
        "smear",
        "bloom",
        "parallel cti",
        "serial cti",
    }


@pytest.mark.parametrize("stage", ["exposure", "noise"])
def test_the_switches_of_a_shader_are_its_own(stage: str):
    """All booleans that the shader lets one override, but what a table or a half is for."""
    found = set(re.findall(r"override (\w+): bool", load(f"sensor/{stage}").text))
    named = {*switches(stage), *switches(stage, read_out=True)}
    assert named == found - {"SHOT", "READ_TABLE"}


@pytest.mark.parametrize("name", presets())
def test_an_effect_says_why_it_runs_or_not(name: str):
    sensor = load_sensor(name)
    for effect in EFFECTS:
        has = effect.has(sensor)
        assert isinstance(has, bool)
        assert effect.reason(sensor, has, noise=True)
        assert effect.work is None or not has or effect.work(sensor)[1] > 0
        if effect.random:
            assert effect.reason(sensor, False, noise=False) == "noise is switched off"


def test_the_table_of_the_documentation_is_that_of_the_code():
    tool = runpy.run_path(str(PROJECT / "tools" / "effects_table.py"))
    page = tool["PAGE"].read_text(encoding="utf-8")
    assert tool["with_table"](page) == page, "run tools/effects_table.py"
    assert tool["with_table"](page.replace("| adc |", "| dac |")) == page
