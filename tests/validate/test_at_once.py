"""Parts of a report run in processes of their own: what they give, tell, and how they end."""

import os
import time
from functools import partial
from multiprocessing import active_children, get_context

import psutil
import pytest

from gpusim.errors import UserError
from gpusim.validate.at_once import at_once, crew

LONG_S = 60.0  # of a part that is ended before


def slowly(number, progress):
    progress("slow", 0, 1)
    time.sleep(0.2 * (3 - number))  # the first ends last
    progress("slow", 1, 1)
    return number, os.getpid()


def waits(progress):
    time.sleep(LONG_S)


def waits_as(file, progress):
    file.write_text(str(os.getpid()))
    time.sleep(LONG_S)


def told_as(file, progress):
    file.touch()
    return "told"


def fails(progress):
    raise UserError("the light is out", field="light", value=3, allowed="4")


def test_parts_give_their_results_in_order_from_other_processes():
    told = []
    found = at_once([partial(slowly, n) for n in range(3)], lambda *one: told.append(one))
    assert [number for number, _ in found] == [0, 1, 2]
    assert os.getpid() not in {process for _, process in found}
    assert sorted(told) == [("slow", 0, 1)] * 3 + [("slow", 1, 1)] * 3


def test_parts_begin_while_the_one_who_hands_them_over_goes_on(tmp_path):
    file = tmp_path / "process"
    with crew(lambda *one: None) as workers:
        begun = [workers.begin(partial(told_as, file))]
        by = time.perf_counter() + LONG_S / 2
        while not file.exists() and time.perf_counter() < by:
            time.sleep(0.1)
        assert file.exists()
        begun.append(workers.begin(partial(slowly, 1)))
        (first,), (second,) = (workers.results([one]) for one in begun)
    assert (first, second[0]) == ("told", 1)
    assert not active_children()


def test_the_mistake_of_one_part_ends_all_and_is_told_whole():
    begin = time.perf_counter()
    with pytest.raises(UserError) as caught:
        at_once([fails, waits], lambda *one: None)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == ("light", 3, "4")
    assert time.perf_counter() - begin < LONG_S / 2
    assert not active_children()


def test_parts_end_when_what_started_them_is_killed(tmp_path):
    file = tmp_path / "process"
    killed = get_context("spawn").Process(target=at_once, args=([partial(waits_as, file)], print))
    killed.start()
    by = time.perf_counter() + LONG_S / 2
    while not (file.exists() and file.read_text()) and time.perf_counter() < by:
        time.sleep(0.1)
    killed.kill()
    killed.join()
    number = int(file.read_text())
    while psutil.pid_exists(number) and time.perf_counter() < by:
        time.sleep(0.1)
    assert not psutil.pid_exists(number)


def test_an_interrupt_ends_the_parts():
    begin = time.perf_counter()

    def stop(what, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        at_once([partial(slowly, 0), waits], stop)
    assert time.perf_counter() - begin < LONG_S / 2
    assert not active_children()
