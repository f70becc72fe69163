"""Act of a scenario, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, Literal

import msgspec

if TYPE_CHECKING:
    from evaluation.redteam.attempts import Begun
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena


class Effect(StrEnum):
    """Effect of an act."""

    DONE = "done"
    DENIED = "denied"
    DEFERRED = "deferred"
    """A person was asked, and was silent or absent."""
    STOPPED = "stopped"
    """It was begun, and ended by the watch or a stop."""
    OMITTED = "omitted"
    """The act that it needs did not get through."""


@dataclass(frozen=True, slots=True)
class Came:
    """What came of an act.

    Attributes:
        effect: of the act.
        point: enforcement point that decided, "e1" to "e5"; empty with no enforcement.
        reason: code of the refusal, or of the outcome.
        asked: people were asked on the way.
    """

    effect: Effect
    point: str = ""
    reason: str = ""
    asked: bool = False


class Act(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do"):
    """One act that is forced.

    Attributes:
        by: role of the agent (`orchestrator`, `robotic`, `vision`, `config`), or `stranger`.
        name: by which a later act may need it.
        needs: name of an earlier act; this one is done where that one got through, and left out otherwise.
        harms: harm without motion that it is if it happens: `exfiltration`, `availability` or `authority`; empty
            otherwise.
    """

    point: ClassVar[str]
    """Enforcement point at which it is decided, where nothing earlier decides."""
    at_admission: ClassVar[bool] = False
    """Whether it is done at the arena's admission point or with the tools beside it."""

    by: str
    name: str = ""
    needs: str = ""
    harms: Literal["", "exfiltration", "availability", "authority"] = ""

    def did(self, arena: BareArena | GuardedArena, begun: Begun) -> str:  # noqa: ARG002 - for acts that harm
        """What this act has truly brought about that is the harm which it names, or nothing.

        Args:
            arena: where the scenario was played; it is asked what happened there, never what a gate said.
            begun: times of the act.
        """
        return ""

    def bare(self, arena: BareArena) -> Came:
        """Does it with no enforcement."""
        raise NotImplementedError

    def guarded(self, arena: GuardedArena) -> Came:
        """Does it before the enforcement points of a running cell."""
        raise NotImplementedError
