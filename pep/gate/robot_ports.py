"""Ports of a gate that commands a robot; a gate before other tools has none of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from capabilities.values.chain import Chain

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import MotionSlot, Physics
    from pep.request.call import Call
    from pep.world.sequence import Sequence
    from policies.evidence.evidence import Evidence


class Pictured(Protocol):
    """The maker of pictures of decided motions ([CON-9])."""

    def __call__(self, request_id: str, record: str, *, moves: bool) -> None:
        """Told of a decision.

        Args:
            request_id: of the request.
            record: hash of the decision's record.
            moves: whether its effect follows.
        """
        ...


def unpictured(request_id: str, record: str, *, moves: bool) -> None:
    """The `Pictured` of a gate of which nobody makes pictures."""


@dataclass(frozen=True, slots=True)
class RobotPorts:
    """Ports of one robot.

    Attributes:
        slot: one motion at a time.
        sequence: its recent acts.
        physics: runtime impact.
        latched: id of the latch in force; None while there is none.
        pictured: told of each decision on record; returns at once.
    """

    slot: MotionSlot
    sequence: Sequence
    physics: Physics
    latched: Callable[[], str | None] = lambda: None
    pictured: Pictured = unpictured


def robot_of(call: Call, ports: RobotPorts | None) -> RobotPorts | None:
    """Ports of the robot that the call commands; None for an operation without one.

    Raises:
        ValueError: the operation is a robot's, and here is none.
    """
    if call.operation.robot is None:
        return None
    if ports is None or call.readiness is None:
        raise ValueError("an operation of a robot, and no robot")
    return ports


def takes_slot(call: Call, evidence: Evidence, slot: MotionSlot) -> bool:
    """True where the slot is this request's, or the request prolongs the same agent's running stream."""
    chain = evidence.chain
    return slot.reserve(call.request.request_id) or (
        isinstance(chain, Chain) and slot.joins(call.request, agent=chain.leaf.agent)
    )
