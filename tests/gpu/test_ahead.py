"""Kernels are compiled on further cores too, whatever becomes of the devices that do it."""

import threading
import time
from contextlib import contextmanager

import pytest
from adding import TEXT, recorded

from gpusim.gpu import Compiled, Device, ShaderError, ahead, run
from gpusim.gpu.device import Device as Opened


@pytest.fixture
def opened(monkeypatch) -> list[Device]:
    """Let two further devices compile as soon as a kernel is compiled; return those."""
    found, another = [], Opened.another

    @contextmanager
    def noted(self: Device):
        with another(self) as device:
            found.append(device)
            yield device

    compile_one = run.compile_one

    def unhurried(device: Device, command) -> float:
        if threading.current_thread() is threading.main_thread():
            time.sleep(0.1)  # so that the others come to do something
        return compile_one(device, command)

    monkeypatch.setattr(Opened, "another", noted)
    monkeypatch.setattr(run, "compile_one", unhurried)
    monkeypatch.setattr(run, "LONG_S", 0.0)
    monkeypatch.setattr(ahead.os, "cpu_count", lambda: 3)
    return found


@pytest.fixture(autouse=True)
def _as_it_was(device: Device):
    yield
    device.shares_code = True


def test_further_devices_take_some_and_the_caller_has_all(device: Device, opened: list[Device]):
    names = [f"ahead/{n}" for n in range(7)]
    before = len(device.compiled)
    assert recorded(device, names).run()["found"] == len(names)
    own = [one.path for one in list(device.compiled.values())[before:]]
    assert sorted(own) == names
    others = [one.path for further in opened for one in further.compiled.values()]
    assert others
    assert set(others) < set(names)
    assert len(set(others)) == len(others)  # each of them once


def test_one_kernel_opens_no_device(device: Device, opened: list[Device]):
    recorded(device, ["ahead/alone"]).run()
    assert not opened


def test_a_further_device_that_fails_leaves_all_to_the_caller(device: Device, monkeypatch, opened):
    def lost(self):
        raise RuntimeError("device lost")

    monkeypatch.setattr(Opened, "another", lost)
    names = [f"ahead/left {n}" for n in range(5)]
    assert recorded(device, names).run()["found"] == len(names)


def test_a_shader_that_does_not_compile_is_told_by_the_caller(device: Device, opened):
    names = [f"ahead/wrong {n}" for n in range(5)]
    rec = recorded(device, names, TEXT.replace("+=", "+= true +"))
    with pytest.raises(ShaderError, match="does not compile"):
        rec.run()


@pytest.mark.parametrize(("spent_s", "asked"), [(60.0, True), (0.0, False)])
def test_a_driver_that_keeps_no_code_is_asked_for_it_once(
    device: Device, monkeypatch, opened: list[Device], spent_s: float, asked: bool
):
    class Taking(ahead.Ahead):
        """Threads that take all there is at once, and say that it took so long."""

        def _work(self) -> None:
            for command in ahead.popped(self._left.pop):
                self._taken.append(command)
                kernel = command.kernel
                self._compiled[kernel.key] = Compiled(kernel.path, kernel.overrides, spent_s)

    monkeypatch.setattr(run, "Ahead", Taking)
    names = [f"ahead/{asked} {n}" for n in range(9)]
    assert recorded(device, names[:5]).run()["found"] == 5
    assert device.shares_code is asked
    # Written down as what it took where it was compiled.
    assert [one.wall_s for one in device.compiled.values()].count(spent_s) == 4
