"""Limits of what a force or a hand leads, taken from the grant."""

import json
from pathlib import Path

import pytest
from capabilities.values.scope import Grant, Limit, OneOf, Range
from pep.base.operations import FORCE_MODE, FREEDRIVE
from capabilities.values.scope_json import scope_from_json
from pep.rtde.command.stream_bounds import StreamBounds
from pep.rtde.judge.led_requests import forced, handed
from policies.words.reason_table import Reason
from pep.rtde.command.led_limits import HELD, ends_of, lowered, most_of

from pep.rtde.command import command_values as v

DOCS = Path(__file__).parents[4] / "docs"
ZERO = (0.0,) * 6
Z_ALONE = (False, False, True, False, False, False)
PUBLIC = v.ForceMode(ZERO, Z_ALONE, (0.0, 0.0, -10.0, 0.0, 0.0, 0.0), 2, (2.0, 2.0, 1.5, 1.0, 1.0, 1.0))
pytestmark = pytest.mark.clause("LSD-19")


def grant(operation, **bounds):
    limits = (Limit(each.parameter, bounds.get(each.parameter.name, each.bound)) for each in operation.limits)
    return Grant(operation.object, operation.name, tuple(limits))


def test_limits_that_nothing_reaches_become_those_of_the_grant_and_that_is_told():
    command, what = lowered(PUBLIC, grant(FORCE_MODE, vz=Range(0, 10_000)))
    assert command.limits == (0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
    assert (command.selection, command.wrench_n_nm) == (PUBLIC.selection, PUBLIC.wrench_n_nm)
    assert what.startswith("vz=10000 um_s, ")


def test_without_a_grant_they_become_the_robots():
    assert lowered(PUBLIC, None)[0].limits[2] == 0.25


def test_what_is_inside_already_is_not_touched():
    inside = v.ForceMode(ZERO, Z_ALONE, PUBLIC.wrench_n_nm, 2, (0.01, 0.002, 0.005, 0.1, 0.0, 0.1))
    assert lowered(inside, grant(FORCE_MODE, vz=Range(0, 10_000))) == (inside, "")


def test_a_force_that_does_nothing_becomes_none():
    pushed = v.ForceMode(ZERO, Z_ALONE, (3.0, 0.0, -10.0, 0.0, 0.0, 0.4), 2, (*HELD[:2], 0.005, *HELD[3:]))
    command, what = lowered(pushed, None)
    assert command.wrench_n_nm == PUBLIC.wrench_n_nm
    assert what == "x without force, rz without force"


def test_its_numbers_are_on_the_grid_of_its_request():
    odd = v.ForceMode(ZERO, Z_ALONE, (0.0, 0.0, -9.99999, 0.0, 0.0, 0.0), 2, (0.01, 0.01, 0.00123456, 0.1, 0.1, 0.1))
    command, _ = lowered(odd, None)
    assert (command.wrench_n_nm[2], command.limits[2]) == (-10.0, 0.001235)


@pytest.mark.clause("LSD-18")
@pytest.mark.parametrize(
    ("bound", "most"),
    [
        (Range(100, 5_000), 5.0),
        (Range(100, 900_000), 300.0),
        (OneOf(frozenset({200, 7_000, 900_000})), 7.0),
        (OneOf(frozenset({900_000})), 0.1),
    ],
)
def test_what_a_command_leaves_open_is_the_most_that_is_granted(bound, most):
    assert ends_of(FREEDRIVE, grant(FREEDRIVE, duration=bound), count=2)[0] == most
    assert most_of(FORCE_MODE.limits[-2], grant(FORCE_MODE, duration=bound)) == most


def test_the_scope_of_the_page_lends_what_public_programs_ask_for():
    scope = scope_from_json(json.loads((DOCS / "examples" / "force.scope.json").read_text()))
    found = scope.find("ur3e", "force_mode")
    command, _ = lowered(PUBLIC, found)
    numbers = forced(command, found)
    bounds = StreamBounds(FORCE_MODE, found)
    assert numbers[-2:] == (20.0, 0.06)
    assert bounds.outside(numbers) is None
    assert bounds.outside((*numbers[:8], -20.001, *numbers[9:])) is Reason.LIMIT_EXCEEDED_BY_REQUEST
    hand = scope.find("ur3e", "freedrive")
    assert StreamBounds(FREEDRIVE, hand).outside(handed(v.TeachMode(), hand)) is None
