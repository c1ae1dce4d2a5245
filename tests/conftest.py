"""One device for the session, named in the header; a wrong or missing adapter fails the tests."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from unittest import mock

import pytest
from threadpoolctl import threadpool_limits

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.gpu import Device, default_device
from gpusim.lens.prescription import Prescription
from gpusim.plan.costs import LAVAPIPE

LONGEST = (
    "tests/validate/test_kodak.py::test_rendered_edges_hold_their_bars[far]",
    "tests/validate/test_ansys.py::test_rendered_edges_hold_their_bars",
)
BEGUN = time.monotonic()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--begin-within",
        type=float,
        default=math.inf,
        metavar="SECONDS",
        help="leave out, and say so, tests that would begin later than this",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what begins too late, so that a slow machine ends in time and says what it left out."""
    within = item.config.getoption("--begin-within")
    if time.monotonic() - BEGUN > within:
        pytest.skip(f"left out: {within:.0f} s have passed")


def pytest_report_header() -> str:
    try:
        report = default_device().report()
    except UserError as error:
        return f"adapter: none ({error.problem})"
    return (
        f"adapter: {report['adapter']}, {report['driver']}, {report['backend']}, "
        f"wgpu {report['wgpu']}"
    )


@pytest.fixture(scope="session", autouse=True)
def expected_adapter() -> None:
    """Fail every test where GPUSIM_EXPECT_ADAPTER names another adapter than the one in use.

    A suite that silently ran elsewhere proves nothing about the adapter that was meant.
    """
    expected = os.environ.get("GPUSIM_EXPECT_ADAPTER")
    if expected:
        found = str(default_device().report()["adapter"])
        assert expected.lower() in found.lower(), f"{expected!r} was expected, this is {found!r}"


@pytest.fixture(scope="session", autouse=True)
def same_plans() -> Iterator[None]:
    """Make every plan from one table of rates, so that no test depends on the machine's speed."""
    with mock.patch("gpusim.render.renderer.adapter_costs", lambda device, **more: LAVAPIPE):
        yield


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> Iterator[None]:
    """Keep OpenBLAS to one thread.

    The matrices of tests are small, and threads without work spin: beside another process a plan
    takes 2 s of the processor with one thread and 9 s with two.
    """
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def device() -> Device:
    """Return the device of this process; without an adapter the test fails."""
    return default_device()


@pytest.fixture(scope="session")
def double_gauss() -> Prescription:
    return load_prescription("double-gauss")


@pytest.fixture(scope="session")
def demo_lens(double_gauss: Prescription) -> Prescription:
    """Return the lens of the camera `demo`."""
    return double_gauss.scaled(8.3).stopped(2.8).limited(14.3)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest: at the end one process would wait ten minutes for the other.

    Two processes begin with the first test and with the middle one.
    """
    for place, name in zip((0, len(items) // 2), LONGEST, strict=True):
        number = next((n for n, item in enumerate(items) if item.nodeid == name), None)
        if number is not None:
            items.insert(place, items.pop(number))
