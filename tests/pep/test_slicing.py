"""Salami slicing with real physics: a sweep that needs a person, cut into steps that would not."""

import asyncio
from dataclasses import replace

import pytest
from pep.world.sequence import WINDOW_MS
from pep.world.world import tool_position
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.pit.scenes import FRONT, ROBOT
from tests.pep.test_retreat import Cell, Standing

from pep.pit import Person, Region, Sphere, adult_at_distance

REST = (-1.62, 1.25, -1.2, -1.57, 0.0)
STEPS = 12
HASTE = {"speed_rad_s": 1.05, "acceleration_rad_s2": 1.4}


class Moving(Cell):
    """The arm stands where the last permitted move led; what is permitted is known."""

    def __post_init__(self):
        super().__post_init__()
        self.arm = Standing(base(-0.6))

    def seen(self, *people):
        """A fresh view, with the acts that were done still remembered."""
        sequence = self.gate._robot.sequence
        self.at(self.arm.q, *people)
        self.physics._state = self.arm
        self.gate._robot = replace(self.gate._robot, sequence=sequence)
        return self

    def goes(self, angle, agent, **changes):
        arguments = {"q_rad": [round(q, 6) for q in base(angle)], **{**HASTE, **changes}}
        call = self.call(self.agent(name=agent), "move_joint", arguments)
        decision = asyncio.run(self.gate.run(call, self.effect)).decision
        if decision.effect is Effect.PERMIT:
            self.arm.q = tuple(arguments["q_rad"])
        return decision


def base(angle):
    return (angle, *REST)


@pytest.fixture
def cell(tmp_path, monkeypatch):
    monkeypatch.setattr("pep.gate.gate.PHYSICS_TIMEOUT_S", 60.0)
    cell = Moving(tmp_path)
    yield cell
    cell.gate.close()
    cell.journal.close()


SOMEBODY = adult_at_distance(1.1, bearing_rad=FRONT)


def test_the_sweep_needs_a_person_and_a_single_step_does_not(cell):
    cell.seen(SOMEBODY)
    assert cell.goes(0.6, "robotic").reason is Reason.TIER_NEEDS_APPROVAL
    step = cell.goes(-0.5, "robotic")
    assert (step.effect, step.tier) == (Effect.PERMIT, 2)


@pytest.mark.parametrize("agents", [("robotic",), ("robotic", "vision")])
def test_the_same_sweep_in_steps_needs_that_person_too(cell, agents):
    cell.seen(SOMEBODY)
    decisions = []
    for number in range(STEPS):
        decisions.append(cell.goes(-0.5 + 0.1 * number, agents[number % len(agents)]))
        if decisions[-1].effect is not Effect.PERMIT:
            break
    last = decisions[-1]
    assert (last.effect, last.reason, last.primitive) == (Effect.DEFER, Reason.SEQUENCE_NEEDS_APPROVAL, "TEA-6")
    assert 1 < len(decisions) < STEPS
    assert cell.arm.q[0] < 0.3
    # No faster than what may be swept at once, it may go on; and it may go back.
    assert cell.goes(-0.6, "robotic").effect is Effect.PERMIT


def test_steps_with_time_between_them_are_steps(cell):
    cell.seen(SOMEBODY)
    for number in range(3):
        assert cell.goes(-0.5 + 0.1 * number, "robotic").effect is Effect.PERMIT
        cell.clock.advance(WINDOW_MS + 1)
        cell.seen(SOMEBODY)
    assert len(cell.sent) == 3


def test_slow_steps_are_no_more_than_a_slow_sweep(cell):
    cell.seen()
    for number in range(STEPS):
        assert cell.goes(-0.5 + 0.1 * number, "robotic", speed_rad_s=0.25).effect is Effect.PERMIT
    assert cell.arm.q[0] == pytest.approx(0.6)


def test_what_lies_behind_the_arm_is_done(cell):
    """A person reaches for the arm's earlier place: the arm may go on, away from there.

    It goes as if it had begun where it is.
    """
    cell.seen()
    assert cell.goes(-0.2, "robotic", speed_rad_s=0.25).effect is Effect.PERMIT
    hand = Person("bob", ((Region.HAND, Sphere(tool_position(ROBOT, base(-0.42)), 0.02)),))
    cell.seen(hand)
    away = cell.goes(0.2, "robotic", speed_rad_s=0.25)
    assert (away.effect, away.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)
    back = cell.goes(-0.6, "robotic", speed_rad_s=0.25)
    assert (back.effect, back.reason) == (Effect.DENY, Reason.PHYSICS_VIOLATION)
