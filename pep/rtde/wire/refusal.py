"""Refusal by the readers of a client's input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.words.reason_codes import Reason


@dataclass(frozen=True, slots=True)
class InputRefusal:
    """Refusal of a client's input.

    Attributes:
        reason: the code.
        place: the parameter, variable or place in a text, for the record. No text of the client.
        command: the command id of the input, when it has one that exists. A refused command that would have stopped the
            arm is followed by a stop of the refuser's own: a malformed stop is still a stop.
    """

    reason: Reason
    place: str
    command: int | None = None
