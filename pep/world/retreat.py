"""Way out for an arm that was stopped: straight moves in joint space, each assessed from where it stands.

A proposal and no permit: to take it is to ask for a motion of its own, which is decided afresh. Clause [LSD-23].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.people.latch import Retreat, Turn
from capabilities.values.units import Quantity
from pep.base.operations import MOVE_JOINT
from policies.evidence.evidence import ImpactFault
from policies.evidence.model import Point, Request
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from policies.evidence.evidence import ImpactReading

SPEED_URAD_S: Final = 100_000
ACCELERATION_URAD_S2: Final = 500_000
"""Speed and acceleration of the way.

At 0.1 rad/s and 1.3 m of reach the tool has 0.13 m/s, about half of the 0.25 m/s that a retreat may have (PHY-6).
"""
STEPS_URAD: Final = (200_000, 100_000)
"""Turns of one joint that are tried, the farther first.

Ours: 0.1 rad at 0.5 m of reach are 50 mm.
"""
TURNING: Final = (1, 2, 0, 3)
"""Joints that are tried: those that carry the tool away.

Shoulder lift, elbow, base and first wrist do; the last two wrists only turn it.
"""
SAME_URAD: Final = 2_000
"""Smallest turn that counts as one: 2 mrad, the tolerance of a motion's start."""


def proposed(
    here_urad: Sequence[int],
    back_urad: Sequence[int] | None,
    assess: Callable[[Request], ImpactReading | ImpactFault],
    *,
    audience: str,
    at: float,
    new_id: Callable[[], str],
    late: Callable[[], bool],
) -> Retreat | str:
    """The way with the least tier, then the least index; or the code of why there is none.

    Of equal ones the way back is preferred, then the farther one.

    Args:
        here_urad: joint angles where the arm stands, six.
        back_urad: where the stopped motion began; None where that is not known.
        assess: the impact of a request from here, in the world as it is now.
        audience: canonical URL of the server.
        at: now, seconds since the epoch.
        new_id: an id of a request, which nobody else has.
        late: whether no further way is to be tried.
    """
    best: Retreat | None = None
    why = Reason.UNPROVEN
    for target in _ways(tuple(here_urad), back_urad):
        if late():
            break
        request = _request(target, audience=audience, at=at, request_id=new_id())
        if MOVE_JOINT.refuse(request) is not None:
            continue
        impact = assess(request)
        if isinstance(impact, ImpactFault):
            why = Reason(impact.reason)
            continue
        if impact.violations:
            why = Reason.PHYSICS_VIOLATION
            continue
        if best is None or (impact.tier, impact.index_milli) < (best.tier, best.index_milli):
            best = Retreat(_turns(here_urad, target), target, SPEED_URAD_S, impact.tier, impact.index_milli)
    return str(why) if best is None else best


def _ways(here: tuple[int, ...], back: Sequence[int] | None) -> Iterator[tuple[int, ...]]:
    """Targets to be tried, the preferred one first."""
    if back is not None and _turns(here, back):
        yield tuple(back)
    for step in STEPS_URAD:
        for joint in TURNING:
            for by in (-step, step):
                yield (*here[:joint], here[joint] + by, *here[joint + 1 :])


def _turns(here: Sequence[int], target: Sequence[int]) -> tuple[Turn, ...]:
    by = ((joint, there - now) for joint, (now, there) in enumerate(zip(here, target, strict=True)))
    return tuple(Turn(joint, turned) for joint, turned in by if abs(turned) > SAME_URAD)


def _request(target: Sequence[int], *, audience: str, at: float, request_id: str) -> Request:
    numbers = (*target, SPEED_URAD_S, ACCELERATION_URAD_S2)
    values = tuple(Quantity(p.name, p.unit, n) for p, n in zip(MOVE_JOINT.parameters, numbers, strict=True))
    return Request(request_id, frozenset({Point.ACTUATION}), audience, MOVE_JOINT.object, MOVE_JOINT.name, values, at)
