"""How the readers of what a client says answer when they do not take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.words.reason_codes import Reason


@dataclass(frozen=True, slots=True)
class InputRefusal:
    """What a client said is not taken.

    Attributes:
        reason: why.
        place: what it was about, for the record: a parameter, a variable, a place in a text. No text of the client.
        command: the command id that it came with, when it came with one that exists. Whoever refuses a command that
            would have stopped the arm stops it itself: a stop that is badly said is still a stop.
    """

    reason: Reason
    place: str
    command: int | None = None
