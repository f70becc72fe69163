"""Digital outputs: exactly the decided one is sent, once, and is done only when the robot shows it."""

import asyncio

import pytest
from pep.base.errors import ActuationRefusedError, PepFault, RobotError
from pep.base.operations import SET_DIGITAL_OUTPUT
from pep.base.request_digest import digest_of
from pep.request.permit import Permit
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs
from pep.rtde.robot.digital_outputs import DigitalOutputs
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, ManualClock


class Io:
    def __init__(self, *, takes=True, shows=True):
        self.takes, self.shows, self.sent, self.output_bits = takes, shows, [], 0

    def switch(self, command):
        self.sent.append(command)
        if self.shows:
            self.output_bits = self.output_bits & ~command.mask | command.levels
        return self.takes

    def next(self):
        return self


def switched(io, pin=2, value=True, *, permitted=(2, 1), stopped_ms=None, times=1):
    clock = ManualClock()
    permit = Permit(
        request_id="r",
        digest=digest_of(SET_DIGITAL_OUTPUT, permitted, audience=AUDIENCE),
        since_ms=clock.mono,
        deadline_ms=clock.mono + 50,
        clock=clock,
        standing=lambda: None,
    )
    outputs = DigitalOutputs(io.switch, io, audience=AUDIENCE, stopped_ms=lambda: stopped_ms)
    try:
        for _ in range(times):
            asyncio.run(outputs.set(pin, value, permit))
    finally:
        outputs.close()


def test_it_is_sent_and_seen():
    io = Io()
    switched(io)
    assert io.sent == [SetDigitalOutputs(Bank.STANDARD, 0b100, 0b100)]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"pin": 3}, Reason.NOT_WHAT_WAS_DECIDED),
        ({"value": False}, Reason.NOT_WHAT_WAS_DECIDED),
        ({"permitted": (2, 0)}, Reason.NOT_WHAT_WAS_DECIDED),
        ({"stopped_ms": 10**9}, Reason.VERDICT_EXPIRED),
    ],
)
def test_nothing_else_is_sent(options, reason):
    io = Io()
    with pytest.raises(ActuationRefusedError) as raised:
        switched(io, **options)
    assert raised.value.reason is reason
    assert io.sent == []


def test_not_twice():
    io = Io()
    with pytest.raises(ActuationRefusedError):
        switched(io, times=2)
    assert io.sent == [SetDigitalOutputs(Bank.STANDARD, 0b100, 0b100)]


def test_a_controller_that_does_not_take_it():
    with pytest.raises(ActuationRefusedError) as raised:
        switched(Io(takes=False))
    assert raised.value.reason is Reason.EFFECT_FAILED


def test_an_output_that_the_robot_does_not_show_is_not_told_as_set():
    with pytest.raises(RobotError) as raised:
        switched(Io(shows=False))
    assert raised.value.code is PepFault.OUTPUT_UNCONFIRMED
