"""What a command follows (TEA-6): where the last act left the arm, and acts that undo each other."""

from dataclasses import replace

import pytest

from capabilities.units import Quantity
from pep.operations import GRIPPER_MOVE, MOVE_JOINT, SPEED_JOINT
from pep.sequence import WINDOW_MS, Sequence
from policies import NOT_COLLECTED, ImpactFault, Point, Request
from tests.policies import world


class Clock:
    now_ms = 0

    def monotonic_ms(self):
        return self.now_ms


def move(*target_urad, operation=MOVE_JOINT):
    numbers = (*target_urad, *(0 for _ in operation.parameters))
    values = tuple(Quantity(p.name, p.unit, n) for p, n in zip(operation.parameters, numbers, strict=False))
    return Request("r", frozenset({Point.TOOL}), "https://a/", operation.object, operation.name, values, 0.0)


A, B, HOME = move(0, 0, 0), move(900_000, 0, 0), (0,) * 6


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def sequence(clock):
    return Sequence(clock)


def reading(sequence, request=A, start=HOME, agent="robotic", **given):
    impact = given.pop("impact", replace(world.asked()[1].impact, start_urad=start))
    robot = given.pop("robot", world.asked()[1].robot)
    return sequence.reading(request, agent=agent, impact=impact, robot=robot, unfinished=False)


def done(sequence, request, *, arrived=True, agent="robotic"):
    sequence.begins(request, agent=agent)
    sequence.ended(request, arrived=arrived)


def test_nothing_was_done_yet(sequence):
    found = reading(sequence)
    assert (found.unfinished, found.drift_urad, found.alternations, found.acts) == (False, 0, 0, 0)
    assert (found.tier, found.index_milli, found.held_known) == (1, 1_000, True)


def test_an_arm_that_is_where_it_was_left_has_not_drifted(sequence):
    done(sequence, B)
    assert reading(sequence, start=(900_000, 0, 0, 0, 0, 0)).drift_urad == 0
    assert reading(sequence, start=(900_000, -1, 0, 0, 0, 0)).drift_urad == 1
    assert reading(sequence, start=HOME).drift_urad == 900_000


def test_another_agents_act_moved_the_arm_all_the_same(sequence):
    done(sequence, B, agent="vision")
    found = reading(sequence)
    assert (found.drift_urad, found.acts) == (900_000, 0)


@pytest.mark.parametrize("operation", [MOVE_JOINT, SPEED_JOINT])
def test_nobody_knows_where_an_arm_stands_that_did_not_arrive(sequence, operation):
    done(sequence, B)
    done(sequence, move(1, operation=operation), arrived=operation is SPEED_JOINT)
    assert reading(sequence).drift_urad == 0


def test_while_it_is_under_way_its_end_is_not_known(sequence):
    done(sequence, B)
    sequence.begins(A, agent="robotic")
    assert reading(sequence).drift_urad == 0


def test_the_gripper_moves_no_arm(sequence):
    done(sequence, B)
    done(sequence, move(50_000, operation=GRIPPER_MOVE))
    assert reading(sequence).drift_urad == 900_000


def test_who_looked_asks_from_there(sequence):
    done(sequence, B)
    sequence.looked()
    assert reading(sequence).drift_urad == 0


def test_there_and_back_and_there_again(sequence):
    for n, request in enumerate((A, B, A, B)):
        assert reading(sequence, request).alternations == max(0, n - 1)
        done(sequence, request)
    assert reading(sequence, A).alternations == 3
    assert reading(sequence, move(450_000)).alternations == 2


def test_nearly_back_is_back_and_standing_still_is_no_alternation(sequence):
    done(sequence, A)
    done(sequence, B)
    assert reading(sequence, move(45_000)).alternations == 1
    assert reading(sequence, move(45_001)).alternations == 0
    still = Sequence(Clock())
    for _ in range(3):
        done(still, A)
    assert reading(still, A).alternations == 0


def test_acts_count_within_the_window_for_their_agent_and_operation(sequence, clock):
    done(sequence, A)
    done(sequence, B)
    assert reading(sequence, A, agent="vision").alternations == 0
    done(sequence, move(1, operation=GRIPPER_MOVE))
    assert reading(sequence, A).alternations == 1
    clock.now_ms = WINDOW_MS
    assert reading(sequence, A).acts == 3
    clock.now_ms = WINDOW_MS + 1
    assert (reading(sequence, A).acts, reading(sequence, A).alternations) == (0, 0)


def test_what_could_not_be_computed_is_not_known(sequence):
    found = reading(sequence, impact=ImpactFault("PHYSICS_FAULT"))
    assert (found.tier, found.index_milli) == (None, None)
    assert not reading(sequence, robot=NOT_COLLECTED).held_known
    unknown = replace(world.asked()[1].robot, expected_payload_g=None)
    assert not reading(sequence, robot=unknown).held_known
