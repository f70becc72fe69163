"""Requests that let a force or a hand lead the arm, as the motions that they ask for."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from capabilities.values.units import Unit, si
from pep.base.operation_row import Moves
from pep.base.operations import operation_of
from pep.pit.assessment.led_motion import LedArm, LedTool

if TYPE_CHECKING:
    from pep.pit.assessment.led_motion import Led
    from policies.evidence.model import Request


def led_by(request: Request) -> Led | None:
    """Motion that a request lets a force or a hand lead; None for any other request."""
    operation, values = (
        operation_of(request.object, request.operation),
        [si(v.value, v.unit) for v in request.quantities],
    )
    match Moves.NOTHING if operation is None else operation.moves:
        case Moves.BY_FORCE:
            return LedTool(tuple(values[:6]), tuple(values[12:18]), values[19])
        case Moves.BY_HAND:
            return LedArm(values[6], values[7], values[9])
        case _:
            return None


def force_of(request: Request) -> float:
    """Force with which a request lets the tool press, N; 0 where it names none."""
    pressed = (si(v.value, v.unit) for v in request.quantities if v.unit is Unit.MILLINEWTON)
    return math.hypot(*pressed)
