"""The calibration: what it measures, and when it is taken from the cache."""

from __future__ import annotations

import json
import resource
from pathlib import Path

import numpy as np
import pytest
from command_line import gpusim

from gpusim.calibrate import optics_rates, rates, timing
from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.plan.blocks import TRANSFORMS
from gpusim.plan.costs import LAVAPIPE, UNITS, Costs, content_of


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "gpusim" / "costs"


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Costs]:
    """Put a table in the place of the measurement, each time another one; return those given."""
    given: list[Costs] = []

    def measure(device: Device, progress: object) -> Costs:
        ns = dict.fromkeys(UNITS, 1.0 + len(given))
        given.append(Costs("a test", ns, dict.fromkeys(TRANSFORMS, 1.0)))
        return given[-1]

    monkeypatch.setattr(rates, "measure", measure)
    return given


def test_every_rate_is_measured_and_none_is_nothing(device: Device, monkeypatch):
    monkeypatch.setattr(timing, "RUNS", 1)
    monkeypatch.setattr(rates, "TURNS", 1)
    before, steps = device.pool.in_use, []
    costs = rates.measure(device, lambda done, total: steps.append((done, total)))
    assert costs.ns.keys() == UNITS.keys() and costs.lengths.keys() == set(TRANSFORMS)
    # Two of the three rates of the FFT of columns may drown in each other; not both, and no other.
    in_columns = ("fft columns", "products", "inverse columns")
    assert all(rate > 0 for name, rate in costs.ns.items() if name not in in_columns)
    assert min(costs.ns.values()) >= 0 and costs.ns["fft columns"] + costs.ns["products"] > 0
    assert all(0.1 < slower < 10 for slower in costs.lengths.values())
    assert device.report()["adapter"] in costs.source
    assert steps[0][0] == 0 and steps[-1][0] == steps[-1][1]
    assert device.pool.in_use == before


@pytest.mark.parametrize(("kind", "slower"), [("CPU", LAVAPIPE.lengths[512]), ("DiscreteGPU", 2.0)])
def test_long_transforms_are_timed_where_their_kernels_compile_fast(
    device: Device, monkeypatch, kind: str, slower: float
):
    units = Costs("", dict.fromkeys(UNITS, 1.0), dict.fromkeys(TRANSFORMS, 1.0))
    asked = set()

    def convolved(device: Device, length: int, channels: int, planes: int) -> dict[str, float]:
        asked.add(length)
        alike = units.transforms(optics_rates._grid(length, 2), channels, np.array([planes]))
        return {
            stage: (1.0 if length == 256 else 2.0) * seconds for stage, seconds in alike.items()
        }

    monkeypatch.setattr(optics_rates, "_convolved", convolved)
    monkeypatch.setattr(Device, "report", lambda self: {"type": kind})
    found = optics_rates.transform_rates(device)
    # The FFT of columns' three rates are held to the numbers that each moves: 3.4 % of the sum.
    assert found[512] == pytest.approx(slower, rel=0.04)
    assert asked == ({256} if kind == "CPU" else set(TRANSFORMS))


def test_rates_are_measured_once(device: Device, cache: Path, measured: list[Costs]):
    assert rates.cached_costs(device) is None
    first = rates.adapter_costs(device)
    assert rates.adapter_costs(device) == first == rates.cached_costs(device)
    assert len(measured) == 1 and len(list(cache.iterdir())) == 1
    again = rates.adapter_costs(device, again=True)
    assert len(measured) == 2 and again != first
    assert rates.cached_costs(device) == again


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[]", "null", json.dumps({"source": "x", "ns": {}, "lengths": {}}), "\x00"],
)
def test_a_spoilt_file_is_measured_again(device: Device, cache, measured, text: str):
    rates.adapter_costs(device)
    (file,) = cache.iterdir()
    file.write_text(text)
    assert rates.cached_costs(device) is None
    rates.adapter_costs(device)
    assert len(measured) == 2 and rates.cached_costs(device) == measured[1]


@pytest.mark.parametrize("rate", ["NaN", "-1.0", "Infinity", "true_", "1e999"])
@pytest.mark.parametrize("where", ["ns", "lengths"])
def test_a_rate_that_is_none_is_refused(device: Device, cache: Path, measured, rate, where):
    rates.adapter_costs(device)
    (file,) = cache.iterdir()
    before, name, after = file.read_text().partition(f'"{where}"')
    file.write_text(before + name + after.replace("1.0", rate, 1))
    assert rates.cached_costs(device) is None


def test_a_disk_that_takes_no_more_keeps_nothing_half(device: Device, cache: Path, measured):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))  # bytes; the rates have some 1000
    try:
        assert rates.adapter_costs(device) == measured[0]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(cache.iterdir()) == []


def test_rates_survive_a_report(tmp_path: Path):
    file = tmp_path / "report.json"
    file.write_text(json.dumps({"costs": content_of(LAVAPIPE)}))
    assert rates.planned_costs(file) == LAVAPIPE


@pytest.mark.parametrize("text", ["{}", "[]", '{"costs": 3}', '{"costs": {"ns": {}}}', "{"])
def test_a_report_without_rates_is_refused(tmp_path: Path, text: str):
    (tmp_path / "report.json").write_text(text)
    with pytest.raises(UserError) as caught:
        rates.planned_costs(tmp_path / "report.json")
    assert caught.value.file == tmp_path / "report.json"


def test_other_shaders_or_another_driver_have_rates_of_their_own(
    device: Device, cache: Path, measured, monkeypatch
):
    rates.adapter_costs(device)
    monkeypatch.setattr(rates, "shaders_sha256", lambda: "others")
    assert rates.cached_costs(device) is None
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache.parents[1]))
    assert rates.cached_costs(device) is not None
    report = device.report() | {"driver": "a newer one"}
    monkeypatch.setattr(Device, "report", lambda self: report)
    assert rates.cached_costs(device) is None


def test_without_a_cache_to_write_it_is_measured_each_time(device: Device, measured, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    for count in (1, 2):
        assert rates.adapter_costs(device).ns["fft rows"] == count


def test_devices_shows_the_rates_and_measures_them_again(cache: Path, measured: list[Costs]):
    ran = gpusim("devices")
    assert ran.code == 0 and "not measured yet" in ran.out and not measured
    ran = gpusim("devices", "--calibrate")
    assert ran.code == 0 and len(measured) == 1
    for name in (*UNITS, "by length"):
        assert name in ran.out
    assert gpusim("devices").out == ran.out and len(measured) == 1


def test_the_tables_lengths_are_the_planners():
    assert LAVAPIPE.lengths.keys() == set(TRANSFORMS)
