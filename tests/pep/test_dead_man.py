"""ur_rtde's motion outlives its client: the controller is told that we are there, and to end the program when we are not."""

import threading

import pytest
from pep.base.errors import RobotError
from pep.base.operations import SPEED_JOINT, digest_of
from pep.base.stop_model import FASTEST_RAD_S, KICK_S, STOP_DELAY_S, dead_man_s
from pep.request.permit import Permit
from pep.rtde.motion.dead_man import DeadMan
from pep.rtde.motion.permitted_control import PermittedControl
from tests.pep.kit import AUDIENCE, ManualClock

A = 6.0
EXPECTS = ("setWatchdog", (1 / dead_man_s(A),))
QD = [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]


class Raw:
    """Remembers what reached it."""

    def __init__(self, **answers):
        self.calls, self.answers = [], answers

    def __getattr__(self, name):
        def call(*arguments):
            self.calls.append((name, arguments))
            answer = self.answers.get(name, True)
            if isinstance(answer, Exception):
                raise answer
            return answer

        return call

    def said(self, name):
        return [said for said, _ in self.calls if said == name]


def guarded(raw):
    return PermittedControl(
        raw, audience=AUDIENCE, clock=ManualClock(), raise_refusals=True, stop_deceleration_rad_s2=A
    )  # fmt: skip


def until(what):
    for _ in range(1_000):
        if what():
            return
        threading.Event().wait(0.01)
    raise AssertionError


def test_it_is_more_patient_than_the_longest_stop():
    assert dead_man_s(A) >= KICK_S + STOP_DELAY_S + FASTEST_RAD_S / A


def test_the_controller_hears_us_until_the_end():
    raw = Raw()
    dead_man = DeadMan(guarded(raw))
    until(lambda: len(raw.said("kickWatchdog")) >= 3)
    dead_man.close()
    said = len(raw.calls)
    threading.Event().wait(3 * KICK_S)
    assert (raw.calls[0], len(raw.calls)) == (EXPECTS, said)


def test_a_controller_that_does_not_watch_is_not_used():
    with pytest.raises(RobotError):
        DeadMan(guarded(Raw(setWatchdog=False)))


def test_a_kick_that_fails_is_not_the_last():
    raw = Raw(kickWatchdog=RuntimeError())
    dead_man = DeadMan(guarded(raw))
    until(lambda: len(raw.said("kickWatchdog")) >= 2)
    dead_man.close()


def test_nothing_is_said_to_a_program_that_does_not_run():
    raw = Raw(isProgramRunning=False)
    control = guarded(raw)
    control.kick()
    assert not raw.said("kickWatchdog")


def test_a_kick_never_comes_between_and_never_waits():
    entered, leave = threading.Event(), threading.Event()

    class Slow(Raw):
        def setPayload(self, *_):  # noqa: N802
            entered.set()
            leave.wait(5)
            return True

    raw = Slow()
    control = guarded(raw)
    busy = threading.Thread(target=control.carries, args=(1.0, (0.0, 0.0, 0.0)))
    busy.start()
    assert entered.wait(5)
    control.kick()
    assert raw.calls == []
    leave.set()
    busy.join()
    control.kick()
    assert raw.said("kickWatchdog")


def test_a_stream_keeps_a_watchdog_of_its_own_and_gives_ours_back():
    raw, clock = Raw(), ManualClock()
    control = PermittedControl(raw, audience=AUDIENCE, clock=clock, raise_refusals=True, stop_deceleration_rad_s2=A)
    control.expect()
    digest = digest_of(SPEED_JOINT, (*QD, 1.5, 0.5), audience=AUDIENCE)
    granted = Permit(
        request_id="r", digest=digest, since_ms=clock.mono, deadline_ms=clock.mono + 50, clock=clock,
        standing=lambda: None,
    )  # fmt: skip
    assert control.speedJ(QD, 1.5, 0.5, permit=granted)
    control.kick()
    assert not raw.said("kickWatchdog"), "it would clear the stream's command"
    control.end_speed()
    assert raw.calls[-1] == EXPECTS
