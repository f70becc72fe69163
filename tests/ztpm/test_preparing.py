"""Progress of long work: on a terminal in one line, elsewhere now and then."""

import io
import threading
import time
from types import SimpleNamespace

import pytest
from pep.pit.assessment import readiness
from pep.pit.assessment.readiness import Progress, compile_telling
from ztpm.cli.demo import _Shown as Shown
from ztpm.preparing import EACH_S, WIPED, Preparing, waiting


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_elsewhere_than_on_a_terminal_a_line_comes_every_few_seconds():
    stream, times = io.StringIO(), iter([0.0, 1.0, EACH_S - 0.1, EACH_S, EACH_S + 1])
    shown = Preparing(stream, clock=lambda: next(times))
    for number in range(5):
        shown.tell(number)
    shown.over()
    assert stream.getvalue() == "0\n3\n"


def test_a_silent_wait_is_told_once_in_a_few_seconds():
    stream, now = io.StringIO(), [0.0]
    shown = Preparing(stream, clock=lambda: now[0])
    for now[0] in (0.0, EACH_S - 0.1, EACH_S, EACH_S + 1, 2 * EACH_S - 0.1):
        shown.wait(now[0])
    shown.over()  # of one wait: the next goes on where it ended
    now[0] = 2 * EACH_S
    shown.wait(now[0])
    assert stream.getvalue() == f"{EACH_S}\n{2 * EACH_S}\n"


def test_those_who_tell_something_are_shown_before_those_who_only_wait():
    stream, now = io.StringIO(), [0.0]
    shown = Preparing(stream, clock=lambda: now[0])
    shown.tell("3 of 15")
    for now[0] in (1.0, EACH_S - 0.1):
        shown.tell(f"4 of 15, {now[0]} s")
    now[0] = EACH_S
    shown.wait("a minute")
    assert stream.getvalue() == f"3 of 15\n4 of 15, {EACH_S - 0.1} s\n"
    now[0] = 2 * EACH_S
    shown.wait("a minute")
    assert stream.getvalue().endswith("a minute\n")


def test_a_block_that_takes_long_is_told_of_until_its_end():
    began, stream, before = time.monotonic(), io.StringIO(), threading.active_count()
    shown = Preparing(stream, clock=lambda: 100 * (time.monotonic() - began))
    with waiting("it", shown, at_once=True) as end:
        while stream.getvalue().count("\n") < 3:
            assert time.monotonic() - began < 60
        end()
        told = stream.getvalue()
        assert {line.partition(",")[0] for line in told.splitlines()} == {"it"}
        assert threading.active_count() == before
    assert stream.getvalue() == told


def test_what_a_child_says_stays_on_the_line_of_the_running_step():
    """Its parent's own words are shown only when it has said nothing for long."""
    texts, now = [], [0.0]
    shown = Shown(SimpleNamespace(console=SimpleNamespace(is_terminal=True), update=texts.append))
    shown._clock = lambda: now[0]
    shown.wait("starting")
    for now[0] in (10.0, 10.2, 11.0):
        shown.tell(f"3 of 15, {now[0]} s")
        shown.wait("starting")
    now[0] = 11.0 + EACH_S
    shown.wait("starting")
    shown.over()
    words = ("3 of 15, 10.0 s", "3 of 15, 10.2 s", "3 of 15, 11.0 s", "starting")
    assert texts == [*(f"They start: {word}" for word in words), "They start"]


def test_on_a_terminal_one_line_changes_and_is_free_afterwards():
    stream = Terminal()
    shown = Preparing(stream, clock=lambda: 0.0)
    shown.tell("one")
    shown.tell("two")
    shown.over()
    shown.over()
    assert stream.getvalue() == f"{WIPED}one{WIPED}two{WIPED}"


def test_progress_is_one_line_for_people():
    assert str(Progress(7, 15, 40.4)) == "compiling the physics kernel: 7 of 15 functions, 40 s"


def test_a_compilation_tells_how_far_it_is_until_it_is_over(monkeypatch):
    told, seconds = [], iter(range(100))
    monkeypatch.setattr(readiness, "TOLD_EACH_S", 0.001)

    def compiled():
        while len(told) < 3:
            pass

    monkeypatch.setattr(readiness, "compile_all", compiled)
    compile_telling(told.append, clock=lambda: float(next(seconds)))
    count = len(told)
    assert [each.seconds for each in told] == [float(each + 1) for each in range(count)]
    assert {each.functions for each in told} == {len(readiness.ENTRIES)}
    assert len(readiness.ENTRIES) > 10


def test_a_compilation_that_fails_says_so_and_tells_nothing_more(monkeypatch):
    def broken():
        raise RuntimeError

    monkeypatch.setattr(readiness, "compile_all", broken)
    with pytest.raises(RuntimeError):
        compile_telling(lambda progress: None)
