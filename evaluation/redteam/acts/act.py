"""Act of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import msgspec

if TYPE_CHECKING:
    from evaluation.redteam.attempts import Begun
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena
    from evaluation.redteam.parts import Came


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
    """True where it is done at the arena's admission point, or with the tools beside it."""

    by: str
    name: str = ""
    needs: str = ""
    harms: Literal["", "exfiltration", "availability", "authority"] = ""

    @property
    def at_desk(self) -> bool:
        """True where it is done at the arena's desk."""
        return getattr(self, "place", "") == "desk"

    @property
    def blinds(self) -> bool:
        """True where it takes the view of the cell from the watch over what follows."""
        return False

    def did(self, arena: BareArena | GuardedArena, begun: Begun) -> str:  # noqa: ARG002 - for acts that harm
        """Harm that it names and has truly done, or nothing.

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
