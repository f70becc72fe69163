"""Acts of the arm as a way through joint space: each with its start, its target and its speed.

Small steps in one direction are one way that was cut up. `joined` puts them together again, so that none of them is
judged as smaller than the whole (docs/physics.md, PHY-25).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capabilities.values.units import Measure, Quantity, Unit
from pep.base.operation_row import Moves
from pep.base.operations import JOINTS, MOVE_JOINT, operation_of, targets_of
from pep.world.timed_request import end_urad

if TYPE_CHECKING:
    from collections.abc import Sequence

    from policies.evidence.model import Request

BESIDE_PERMILLE: Final = 100
"""Greatest distance of a point beside a straight way, as a part of its length. Ours."""
AS_FAST_PERMILLE: Final = 500
"""Least speed of an earlier act, as a part of a later one's, for both to be one way. Ours.

A slow approach is no run-up.
"""

Angles = tuple[int, ...]
"""Six joint angles in microradian."""


@dataclass(frozen=True, slots=True)
class Act:
    """An act of the arm or gripper, done or about to be done.

    Attributes:
        agent: agent of the act.
        operation: object and operation.
        values: of the request, in its own units.
        at_ms: monotonic time of the act.
        start_urad: joint angles at its beginning; () when they are not known or do not matter.
        points: its targets, waypoint by waypoint; () for an act that moves no arm.
        speed, acceleration: of the leading axis, urad/s and urad/s2; 0 for what moves no arm.
    """

    agent: str
    operation: tuple[str, str]
    values: tuple[tuple[str, Measure, int], ...]
    at_ms: int
    start_urad: Angles = ()
    points: tuple[Angles, ...] = ()
    speed: int = 0
    acceleration: int = 0


def act_of(request: Request, *, agent: str, at_ms: int, start_urad: Angles) -> Act:
    """The act that the request is, from that start."""
    operation = operation_of(request.object, request.operation)
    values = tuple((value.name, value.unit, value.value) for value in request.quantities)
    if operation is not None and operation.moves is Moves.ALONG_TRAJECTORY:
        # Where it leads; its way is no straight one, and is assessed as it is.
        ends = zip(MOVE_JOINT.parameters, end_urad(request), strict=False)
        values = (*((parameter.name, parameter.unit, angle) for parameter, angle in ends), *values)
        return Act(agent, (request.object, request.operation), values, at_ms)
    act = Act(agent, (request.object, request.operation), values, at_ms)
    numbers = tuple(value.value for value in request.quantities)
    if len(start_urad) != JOINTS:
        return act
    if operation is not None and operation.moves is Moves.AT_JOINT_SPEEDS:
        *speeds, acceleration, duration_ms = numbers
        end = tuple(q + qd * duration_ms // Unit.MILLISECOND.per_si for q, qd in zip(start_urad, speeds, strict=True))
        fastest = max((abs(qd) for qd in speeds), default=0)
        return replace(act, start_urad=start_urad, points=(end,), speed=fastest, acceleration=acceleration)
    points = targets_of(operation, numbers)
    if not points:
        return act
    return replace(act, start_urad=start_urad, points=points, speed=numbers[-2], acceleration=numbers[-1])


@dataclass(frozen=True, slots=True)
class Joined:
    """Several acts together as one straight move.

    Attributes:
        start_urad: its own beginning, in line with this act: as far behind the arm as the first of them began.
        request: a `move_joint` from there, to where the last one leads, at that one's speed and acceleration.
        acts: number of earlier acts among them.
    """

    start_urad: Angles
    request: Request
    acts: int


def joined(request: Request, now: Act, before: Sequence[Act]) -> Joined | None:
    """Longest straight way that ends with this act's first leg; None when no earlier act belongs to it.

    Args:
        request: the request.
        now: the act that it is.
        before: earlier acts in their order; those that move no arm are passed over.
    """
    if not now.points or now.points[0] == now.start_urad:
        return None
    moved = [act for act in before if act.points]
    end, found = now.points[0], None
    way: tuple[Angles, ...] = (now.start_urad,)
    for count, act in enumerate(reversed(moved), 1):
        if not act.speed * 1_000 >= now.speed * AS_FAST_PERMILLE:
            break
        # Where the arm stood, not where it was sent: an act may have been stopped on its way.
        way = (act.start_urad, *act.points[:-1], *way)
        if not _straight((*way, end)):
            break
        found = act.start_urad, count
    if found is None:
        return None
    start, acts = found
    # On the line of this leg, as far back as the way is long: the part behind is done, and only its length counts.
    here, leg = now.start_urad, max(abs(b - a) for a, b in zip(now.start_urad, end, strict=True))
    back = max(abs(b - a) for a, b in zip(start, here, strict=True))
    start = tuple(a - (b - a) * back // leg for a, b in zip(here, end, strict=True))
    values = (*end, now.speed, now.acceleration)
    made = tuple(Quantity(p.name, p.unit, v) for p, v in zip(MOVE_JOINT.parameters, values, strict=True))
    return Joined(start, replace(request, operation=MOVE_JOINT.name, values=made), acts)


def _straight(points: Sequence[Angles]) -> bool:
    """True where the points follow each other along one line, and none is far beside it."""
    first, last = points[0], points[-1]
    line = [b - a for a, b in zip(first, last, strict=True)]
    length2 = sum(each * each for each in line)
    if length2 == 0:
        return False
    longest = max(abs(each) for each in line)
    so_far = 0
    for point in points[1:]:
        off = [b - a for a, b in zip(first, point, strict=True)]
        along = sum(a * b for a, b in zip(off, line, strict=True))
        beside = max(abs(length2 * a - along * b) for a, b in zip(off, line, strict=True))
        if along < so_far or beside * 1_000 > longest * length2 * BESIDE_PERMILLE:
            return False
        so_far = along
    return True
