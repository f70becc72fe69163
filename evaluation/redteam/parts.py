"""Parts of a scenario as an arena sees them, and the outcome of an act."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import msgspec

if TYPE_CHECKING:
    from collections.abc import Sequence

Place = Literal["arm", "desk"]
"""Servers whose tools an agent calls."""


SCENARIO_ID: Final = re.compile(r"(AC-[1-5])-(B?)\d{3}")
"""`AC-4-017` is a hazardous scenario, `AC-4-B017` a benign one."""


def is_benign(scenario: str) -> bool:
    """True for the id of a benign scenario."""
    parts = SCENARIO_ID.fullmatch(scenario)
    return parts is not None and bool(parts[2])


BESIDE_RAD: Final = 0.05


def beside(start_rad: Sequence[float]) -> tuple[float, ...]:
    """Place a twentieth of a radian of the last joint from where a scenario begins.

    The arm is put there by hand, which takes no time; it goes the rest of the way by itself, which shows that it works.
    """
    return (*start_rad[:-1], start_rad[-1] + BESIDE_RAD)


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
    """Outcome of an act.

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


class Moment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Change of the true world.

    Attributes:
        at_s: after the first act was begun; 0 is before it.
        seen: whether the first sensor, which is the one that is attacked, shows it; a second one always does.
        people, objects, walk, move, hold, place: as the simulated sensor understands them.
    """

    at_s: float = 0.0
    seen: bool = True
    people: list[dict[str, Any]] | None = None
    objects: list[dict[str, Any]] | None = None
    walk: dict[str, Any] | None = None
    move: dict[str, Any] | None = None
    hold: dict[str, Any] | None = None
    place: dict[str, Any] | None = None

    def command(self) -> dict[str, Any]:
        """The change as a command of the sensor."""
        told = {"people": self.people, "objects": self.objects, "walk": self.walk, "move": self.move}
        told |= {"hold": self.hold, "place": self.place}
        return {name: value for name, value in told.items() if value is not None}


class Deed(Protocol):
    """Act, by the arena in which it is done."""

    @property
    def by(self) -> str:
        """Role that does it."""

    @property
    def name(self) -> str:
        """Name by which a later act may need it."""

    @property
    def at_admission(self) -> bool:
        """True where the arena's admission point is needed for it."""

    @property
    def at_desk(self) -> bool:
        """True where the arena's desk is needed for it."""

    @property
    def harms(self) -> str:
        """Kind of harm without motion that it is if it happens."""

    def did(self, arena: Any, begun: Any) -> str:
        """Harm without motion that it has truly done, or nothing."""

    def bare(self, arena: Any) -> Came:
        """Does it with no enforcement."""

    def guarded(self, arena: Any) -> Came:
        """Does it before the enforcement points of a running cell."""


class Playable(Protocol):
    """Scenario, by the arena in which it is played."""

    @property
    def start_rad(self) -> tuple[float, ...]:
        """Angles at which the arm stands before it."""

    @property
    def act(self) -> Sequence[Deed]:
        """Its acts."""
