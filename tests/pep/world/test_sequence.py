"""Sequence before a command (TEA-6): the place of the last act, and acts that undo each other."""

from dataclasses import replace

import pytest
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity
from pep.base.operations import GRIPPER_MOVE, MOVE_JOINT, MOVE_PATH, SPEED_JOINT
from pep.base.ports import Together
from pep.world.motion_history import act_of
from pep.world.sequence import WINDOW_MS, Sequence
from tests.policies import world

from policies import NOT_COLLECTED, ImpactFault, Point, Request


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


READY = world.asked()[1].robot


def standing(start):
    return replace(world.asked()[1].impact, start_urad=start)


def reading(sequence, request=A, start=HOME, agent="robotic", *, impact=None, robot=READY, together=None):
    impact = impact or standing(start)
    return sequence.reading(request, agent=agent, impact=impact, robot=robot, unfinished=False, together=together)


def done(sequence, request, *, arrived=True, agent="robotic", start=HOME):
    sequence.begins(request, agent=agent, impact=standing(start))
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
    sequence.begins(A, agent="robotic", impact=standing(HOME))
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


def test_acts_count_within_the_window(sequence, clock):
    done(sequence, A)
    done(sequence, B)
    other = reading(sequence, A, agent="vision")
    assert (other.alternations, other.acts) == (1, 0)  # the arm is shaken, whoever takes turns
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
    unknown = replace(READY, expected_payload_g=None)
    assert not reading(sequence, robot=unknown).held_known


# -- paths


def path(*firsts):
    points = [(first, 0, 0, 0, 0, 0) for first in firsts]
    points += [points[-1]] * (4 - len(points))
    return move(*(q for point in points for q in point), operation=MOVE_PATH)


def test_after_a_path_the_arm_stands_at_its_last_waypoint(sequence):
    done(sequence, B)
    done(sequence, path(100_000, 400_000, 250_000))
    assert reading(sequence, start=(250_000, 0, 0, 0, 0, 0)).drift_urad == 0
    assert reading(sequence, start=HOME).drift_urad == 250_000
    done(sequence, path(100_000), arrived=False)
    assert reading(sequence, start=HOME).drift_urad == 0


def test_shaking_inside_one_path_and_over_several_operations_counts(sequence):
    assert reading(sequence, path(0, 900_000, 0, 900_000)).alternations == 2
    assert reading(sequence, path(0, 900_000, 900_000, 900_000)).alternations == 0
    done(sequence, A)
    done(sequence, path(900_000), agent="vision")
    assert reading(sequence, A).alternations == 1
    assert reading(sequence, path(0, 900_000, 0)).alternations == 3


# -- small steps that make a large one


def at(first, second=0):
    return (first, second, 0, 0, 0, 0)


def step(first, second=0, speed=1_000_000):
    request = move(first, second)
    return replace(
        request,
        values=(
            *request.values[:6],
            replace(request.values[6], value=speed),
            replace(request.values[7], value=1_400_000),
        ),
    )


def sliced(sequence, *firsts, agents=("robotic",), speed=1_000_000):
    """Steps from one to the next, by agents in turn."""
    for number, (here, there) in enumerate(zip(firsts, firsts[1:], strict=False)):
        done(sequence, step(there, speed=speed), start=at(here), agent=agents[number % len(agents)])


def whole(sequence, request, start):
    return sequence.joined(request, impact=standing(start))


@pytest.mark.parametrize("agents", [("robotic",), ("robotic", "vision", "planner")])
def test_slices_are_taken_together_whoever_cuts(sequence, clock, agents):
    sliced(sequence, 0, 100_000, 200_000, 300_000, agents=agents)
    found = whole(sequence, step(400_000), at(300_000))
    assert (found.start_urad, found.acts) == (HOME, 3)
    assert [v.value for v in found.request.values] == [400_000, 0, 0, 0, 0, 0, 1_000_000, 1_400_000]
    clock.now_ms = WINDOW_MS + 1
    assert whole(sequence, step(400_000), at(300_000)) is None


def test_a_slice_that_was_stopped_or_a_look_in_between_changes_nothing(sequence):
    sliced(sequence, 0, 100_000)
    done(sequence, step(200_000), start=at(100_000), arrived=False)
    sequence.looked()
    assert whole(sequence, step(300_000), at(140_000)).start_urad == HOME


def test_what_goes_elsewhere_is_no_part_of_the_way(sequence):
    sliced(sequence, 0, 100_000, 200_000)
    assert whole(sequence, step(100_000), at(200_000)) is None  # back
    assert whole(sequence, step(200_000, 100_000), at(200_000)) is None  # aside
    assert whole(sequence, step(300_000, 9_000), at(200_000)).start_urad == at(0, -18_000)  # nearly straight on
    assert whole(sequence, step(200_000), at(200_000)) is None  # nowhere
    assert whole(sequence, move(50_000, operation=GRIPPER_MOVE), at(200_000)) is None
    assert whole(sequence, step(300_000), ()) is None


@pytest.mark.parametrize(("second", "together"), [(46_000, True), (47_000, False)])
def test_a_way_is_straight_to_a_tenth_of_its_length(sequence, second, together):
    sliced(sequence, 0, 200_000)
    assert (whole(sequence, step(300_000, second), at(200_000)) is not None) is together


def test_to_and_fro_is_no_straight_way(sequence):
    sliced(sequence, 0, 200_000, 100_000)
    assert whole(sequence, step(300_000), at(100_000)) is None


def test_where_a_path_went_in_between_is_a_part_of_its_way(sequence):
    for waypoints, together in (((50_000, 100_000), True), ((900_000, 100_000), False)):
        done(sequence, timed(path(*waypoints)), start=HOME)
        assert (whole(sequence, step(200_000), at(100_000)) is not None) is together


def test_what_moves_no_arm_is_passed_over(sequence):
    sliced(sequence, 0, 100_000)
    done(sequence, move(50_000, operation=GRIPPER_MOVE), start=at(100_000))
    assert whole(sequence, step(200_000), at(100_000)).start_urad == HOME


def test_what_was_crept_along_before_is_no_run_up(sequence):
    sliced(sequence, 0, 100_000, speed=100_000)
    assert whole(sequence, step(200_000), at(100_000)) is None
    assert whole(sequence, step(200_000, speed=200_000), at(100_000)).acts == 1


def timed(request, speed=1_000_000):
    """The path at this speed."""
    return replace(request, values=(*request.values[:24], replace(request.values[24], value=speed), request.values[25]))


def stream(first):
    """A joint speed for a tenth of a second."""
    asked = move(first, operation=SPEED_JOINT)
    return replace(
        asked,
        values=(*asked.values[:6], replace(asked.values[6], value=2_000_000), replace(asked.values[7], value=100)),
    )


def test_paths_and_streams_are_parts_of_a_way(sequence):
    done(sequence, timed(path(100_000, 200_000)), start=HOME)
    assert whole(sequence, step(300_000), at(200_000)).start_urad == HOME
    found = whole(sequence, stream(1_000_000), at(200_000))
    assert (found.start_urad, found.request.values[0].value) == (HOME, 300_000)
    assert act_of(stream(1_000_000), agent="", at_ms=0, start_urad=at(200_000)).points == (at(300_000),)


def test_a_stream_backwards_is_as_fast_as_one_forwards(sequence):
    done(sequence, stream(-1_000_000), start=at(300_000))
    assert whole(sequence, step(100_000), at(200_000)).start_urad == at(300_000)


def test_the_whole_counts_when_it_is_higher_and_a_fault_of_it_is_no_tier(sequence):
    for together, tier, index_milli in (
        (None, 1, 1_000),
        (Together(2_700), 3, 2_700),
        (Together(2_000), 2, 2_000),
        (Together(2_001), 3, 2_001),
        (Together(0), 1, 1_000),
        (ImpactFault("PHYSICS_FAULT"), None, None),
    ):
        found = reading(sequence, together=together)
        assert (found.tier, found.index_milli) == (tier, index_milli)
    higher = replace(standing(HOME), tier=Tier.CONSEQUENTIAL)
    assert reading(sequence, impact=higher, together=Together(1_000)).tier == 2, "for another reason than its index"
