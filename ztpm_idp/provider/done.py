"""Result of a command, and the use of the proof that came with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from capabilities.proof.proof import Proof
    from ztpm_idp.domain.events import Event
    from ztpm_idp.store import ProofUse


@dataclass(frozen=True, slots=True)
class Done:
    """Result of a command, durable.

    Attributes:
        events: in order; empty when it had been done before.
        epoch: the revocation epoch after it.
        token: text of the token that was made, if any. Never kept anywhere.
        known: of the revocation of a token or a hop: such a one was made here.
    """

    events: tuple[Event, ...]
    epoch: int
    token: str | None
    known: bool = False

    def __repr__(self) -> str:
        return f"Done(epoch={self.epoch}, events={len(self.events)})"


@dataclass(slots=True)
class OneUse:
    """The one use of a proof that came with a request.

    Attributes:
        proof: valid for exactly this request; of what is no proof of possession, how it is used.
        spent: True once that is durable.
    """

    proof: Proof | ProofUse
    spent: bool = False
