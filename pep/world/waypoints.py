"""Path of a request that lists its waypoints, by kind, as physics has it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.values.units import ListOf, Unit, si
from pep.base.operations import JOINTS
from pep.pit import BlendedPath, JointLeg, LineLeg

if TYPE_CHECKING:
    from pep.pit.base.motion import Joints
    from policies.evidence.model import Request


def through_waypoints(request: Request, here: Joints) -> BlendedPath | None:
    """Path of a `move_waypoints` from joint angles; None where its lists do not fit each other.

    Args:
        request: with one list for each parameter, in the operation's order.
        here: joint angles where the arm stands, rad.
    """
    lists = [_si(value) for value in request.values]
    *parts, blends, kinds = lists
    joints, lines = (
        list(zip(*part, strict=False)) for part in (parts[: JOINTS + 2], parts[JOINTS + 2 :])
    )  # angles or pose, speed, acceleration
    lengths = {len(each) for each in parts[: JOINTS + 2]}, {len(each) for each in parts[JOINTS + 2 :]}
    asked = sum(kind != 0 for kind in kinds)
    if lengths != ({len(kinds) - asked}, {asked}) or len(blends) != len(kinds) or not kinds:
        return None
    legs: list[JointLeg | LineLeg] = []
    one, other = iter(joints), iter(lines)
    for kind, blend in zip(kinds, blends, strict=True):
        *target, speed, acceleration = next(other if kind else one)
        made = LineLeg if kind else JointLeg
        legs.append(made(tuple(target), speed, acceleration, blend))
    return BlendedPath(here, tuple(legs))


def _si(value: object) -> tuple[float, ...]:
    kind, members = getattr(value, "kind", None), getattr(value, "value", ())
    if not (isinstance(kind, ListOf) and isinstance(kind.element, Unit) and isinstance(members, tuple)):
        return ()
    return tuple(si(member, kind.element) for member in members)
