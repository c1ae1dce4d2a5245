"""Values that are read from files: checked however they are made, and nothing changes in them."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Iterator
from typing import get_args, get_origin

import pytest
from pydantic import BaseModel, model_validator

import gpusim as gs
from gpusim.camera import presets
from gpusim.config.model import Fixed, Strict
from gpusim.errors import UserError
from gpusim.formats.ready import ReadyLens
from gpusim.sensor.load import load_sensor
from gpusim.sensor.load import presets as sensors


def models(root: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Yield a model and those that its fields hold."""
    waiting, seen = [root], set()
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        if isinstance(one, type) and issubclass(one, BaseModel):
            seen.add(one)
            yield one
            waiting.extend(info.annotation for info in one.model_fields.values())
        else:
            waiting.extend(get_args(one))


def leaves(value: object) -> Iterator[object]:
    """Yield every part of a value that is not a model, a tuple or a fixed table itself."""
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from leaves(getattr(value, name))
    elif type(value) in (tuple, Fixed):
        for one in value.values() if isinstance(value, Fixed) else value:
            yield from leaves(one)
    else:
        yield value


@pytest.mark.parametrize("root", [gs.Sensor, gs.Lens, gs.Sweep, ReadyLens])
def test_no_field_of_a_public_value_holds_a_list(root: type[BaseModel]):
    found = []
    for model in models(root):
        for name, info in model.model_fields.items():
            waiting = [info.annotation]
            while waiting:
                one = waiting.pop()
                found += [(model.__name__, name)] * (get_origin(one) is list)
                waiting.extend(get_args(one))
    assert found == []


@pytest.mark.parametrize("name", sensors())
def test_a_sensor_holds_nothing_that_can_be_changed(name: str):
    sensor = load_sensor(name)
    assert {type(one) for one in leaves(sensor)} <= {str, int, float, bool, type(None)}
    with pytest.raises(TypeError, match="in place"):
        sensor.qe[sensor.channels[0]] = sensor.qe[sensor.channels[0]]


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.update(a=2),
        lambda table: table.clear(),
        lambda table: table.pop("a"),
        lambda table: table.popitem(),
        lambda table: table.setdefault("b", 2),
        lambda table: table.__setitem__("a", 2),
        lambda table: table.__delitem__("a"),
        lambda table: table.__ior__({"a": 2}),
    ],
)
def test_a_table_refuses_every_change_and_travels(change):
    table = Fixed(a=1)
    with pytest.raises(TypeError, match="in place"):
        change(table)
    assert table == {"a": 1} and json.dumps(table) == '{"a": 1}'
    for again in (pickle.loads(pickle.dumps(table)), copy.deepcopy(table)):
        assert again == table and type(again) is Fixed and hash(again) == hash(table)
    assert type(table | {"b": 2}) is dict


@pytest.mark.parametrize("name", presets())
def test_cameras_are_keys_by_what_they_hold(name: str):
    one, other = gs.Camera.load(name), gs.Camera.load(name)
    assert one.sensor is not other.sensor and {one.sensor: 1}[other.sensor] == 1
    assert hash(pickle.loads(pickle.dumps(one.sensor))) == hash(one.sensor)
    if not isinstance(one.lens, ReadyLens):  # its bank is its own
        assert {one: 1}[other] == 1
    changed = one.sensor.model_copy(update={"serial_number": one.sensor.serial_number + 1})
    assert changed not in {one.sensor}


@pytest.mark.parametrize(
    "update, field",
    [
        ({"bit_depth": 99}, "bit_depth"),
        ({"bit_dept": 12}, "bit_dept"),
        ({"black_level_dn": 1e6}, "black_level_dn"),  # beyond the converter's range
        ({"sources": {"none": "such"}}, "sources"),
    ],
)
def test_a_copy_is_checked_as_what_is_made_anew(update: dict, field: str):
    sensor = gs.Sensor.load("imx477")
    with pytest.raises(UserError) as error:
        sensor.model_copy(update=update)
    assert error.value.field == field
    with pytest.raises(UserError):
        gs.Lens.load("tessar").model_copy(update={"stop": 99})


def test_a_copy_keeps_what_was_not_changed():
    lens = gs.Lens.load("tessar").scaled(10.0)
    copied = lens.model_copy(update={"title": "other"})
    assert copied.history == lens.history and copied.file == lens.file
    assert all(a is b for a, b in zip(copied.surfaces, lens.surfaces, strict=True))
    sensor = gs.Sensor.load("imx477")
    fewer = sensor.model_copy(update={"filters": [], "rows": 10})
    assert fewer.filters == () and fewer.quantum_efficiency is sensor.quantum_efficiency
    assert fewer.model_fields_set == sensor.model_fields_set | {"filters", "rows"}


def test_a_copy_checks_no_part_that_was_made_already(monkeypatch: pytest.MonkeyPatch):
    """A map of the quantum efficiency by angle takes seconds where each copy would read it."""

    class Part(Strict):
        number: int
        checked: int = 0

        @model_validator(mode="after")
        def _count(self) -> Part:
            self.__dict__["checked"] += 1
            return self

    class Whole(Strict):
        part: Part
        name: str

    whole = Whole(part={"number": 1}, name="a")
    assert whole.model_copy(update={"name": "b"}).part.checked == 1
    assert Whole(part=whole.part, name="c").part is whole.part
