"""One picture of a running cell: each part's own words about itself now, and the gaps."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ztpm.status.decisions import Decided, OpenAsk


@dataclass(frozen=True, slots=True)
class Part:
    """A process.

    Attributes:
        name: for people.
        pid: None while there is none, between its death and its restart.
        answers: whether it does; None for one that is not asked.
        up_s: time since its start, seconds.
        restarts: number of restarts.
    """

    name: str
    pid: int | None
    answers: bool | None
    up_s: float
    restarts: int


@dataclass(frozen=True, slots=True)
class Known:
    """An agent of the signed registry, with its stated trust in permille."""

    agent: str
    trust_permille: int


@dataclass(frozen=True, slots=True)
class Told:
    """A step of a story that is told on the cell.

    Attributes:
        step: its id.
        words: one sentence; "" while it is played.
        decision, reason, tier: of its decisive call.
        ok: as told; None while it is played.
    """

    step: str
    words: str = ""
    decision: str = ""
    reason: str = ""
    tier: int | None = None
    ok: bool | None = None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State of a cell.

    Attributes:
        at_ms: wall clock, milliseconds since the epoch.
        data: its directory.
        issuer, audience: its two addresses.
        robot_host: where its gateway stands in the controller's place.
        parts: its processes.
        robot: "q_rad", "moving", "robot_mode" and "safety_mode", or "fault", and its "latch"; None when the gateway
            says nothing.
        perception: "perception", "age_ms", "people", "objects", "sensors", "seen"; None as above.
        view: "epoch" and "age_ms" of the revocation view; None as above.
        decisions: newest first.
        asks: open ones, oldest first.
        agents: with a stated trust; None when the registry is not to be had.
        incomplete: missing parts, as sentences.
        story: steps so far, newest last; None where none is told.
    """

    at_ms: int
    data: str
    issuer: str
    audience: str
    robot_host: str
    parts: tuple[Part, ...]
    robot: dict[str, Any] | None
    perception: dict[str, Any] | None
    view: dict[str, Any] | None
    decisions: tuple[Decided, ...]
    asks: tuple[OpenAsk, ...]
    agents: tuple[Known, ...] | None
    incomplete: tuple[str, ...]
    story: Sequence[Told] | None = None

    def as_json(self) -> dict[str, Any]:
        """The picture as plain JSON."""
        return asdict(self)
