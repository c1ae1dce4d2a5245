"""Compiling is a phase of its own: before the work, once a kernel, told and written down."""

from adding import recorded
from rich.console import Console

from gpusim.cli import screen
from gpusim.gpu import Device, compiling


def test_kernels_are_compiled_once_and_written_down(device: Device):
    before = len(device.compiled)
    rec = recorded(device, ["compiling/a", "compiling/b", "compiling/a"])
    assert rec.run()["found"] == 3  # the dispatch that compiles adds nothing
    new = list(device.compiled.values())[before:]
    assert [one.path for one in new] == ["compiling/a", "compiling/b"]
    assert all(one.wall_s > 0 for one in new)
    assert rec.run()["found"] == 3
    assert len(device.compiled) == before + 2


def test_those_who_listen_hear_of_all_recordings_together(device: Device):
    told = []
    with compiling(lambda *step: told.append(step)):
        recorded(device, ["compiling/c", "compiling/d"]).run()
        recorded(device, ["compiling/c"]).run()  # nothing new: nothing is told
        recorded(device, ["compiling/e"]).run()
    recorded(device, ["compiling/f"]).run()
    assert told == [(0, 2), (1, 2), (2, 2), (2, 3), (3, 3)]


def test_the_screen_has_a_bar_for_it(device: Device, monkeypatch):
    shown = Console(force_terminal=True, width=80, record=True)
    monkeypatch.setattr(screen, "Console", lambda **more: shown)
    with screen.progress_bar():
        recorded(device, ["compiling/g"]).run()
        with shown.capture():
            pass
    assert "compile" in shown.export_text()
