"""Ports of the gate to the world, as protocols: time, feeds, stores, physics.

Shells implement them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capabilities.statements.conduct import AgentEntry
    from capabilities.statements.revocation import RevocationView
    from capabilities.values.scope import Tier
    from pep.base.tier_row import FactRow
    from policies.conduct.report import Edge
    from policies.evidence.evidence import ImpactFault, ImpactReading, NotCollected, PerceptionReading, RobotReading
    from policies.evidence.fact_reading import FactReading
    from policies.evidence.model import Request


class Clock(Protocol):
    """Two clocks, never mixed: the wall for times of others, the monotonic one for ages and durations."""

    def wall_s(self) -> float:
        """Seconds since the epoch."""
        ...

    def monotonic_ms(self) -> int:
        """Milliseconds of a clock that never goes back."""
        ...


class RevocationFeed(Protocol):
    """The newest verified revocation view."""

    def view(self) -> RevocationView:
        """The view, with its age taken now; a feed that has never been read has an infinite age."""
        ...


@dataclass(frozen=True, slots=True)
class RegisteredTool:
    """A tool as the signed registry knows it."""

    name: str
    definition_digest: str
    operation: str
    base_tier: Tier


@dataclass(frozen=True, slots=True)
class ConductWord:
    """Word of the identity provider on agents' conduct.

    Attributes:
        age_ms: since the nonce of its newest word was sent; endless when there was none.
        edges: trust in each edge that it named, in permille; the others have the prior.
        agents: the standing of each agent that it named; of the others it knows nothing bad.
    """

    age_ms: int
    edges: Mapping[Edge, int]
    agents: Mapping[str, AgentEntry]


class Registry(Protocol):
    """The newest verified registry snapshot for this PEP's audience, and the newest word on conduct."""

    def tool(self, name: str) -> RegisteredTool | None:
        """The registered tool, or None."""
        ...

    def trust_permille(self, agent: str) -> int | None:
        """The signed static trust of an agent, or None when nothing is stated."""
        ...

    def conduct(self) -> ConductWord:
        """The word on conduct, with its age taken now."""
        ...


@dataclass(frozen=True, slots=True)
class RegisteredSensor:
    """A sensor as the signed registry knows it.

    Attributes:
        sensor: its id.
        key: raw Ed25519 public key, 32 bytes.
        calibration: digest (hex) of the calibration that its frames must name.
        transit_ms: declared longest time from exposure to arrival.
    """

    sensor: str
    key: bytes
    calibration: str
    transit_ms: int


class Sensors(Protocol):
    """The sensors of this PEP's audience, from the newest verified registry snapshot."""

    def sensors(self) -> Mapping[str, RegisteredSensor]:
        """By id; empty while no snapshot has been verified."""
        ...


class Facts(Protocol):
    """Numbers that registered sensors state."""

    def readings(self, rows: Sequence[FactRow]) -> tuple[FactReading, ...]:
        """Reading of each row's fact, in one look, now. Never raises and never waits."""
        ...


class Approvers(Protocol):
    """People who may answer, from the newest verified registry snapshot."""

    def approvers(self) -> Mapping[bytes, str]:
        """Person by raw public key, of which a person may have several; empty while no snapshot has been verified."""
        ...

    def passkeys(self) -> Mapping[bytes, str]:
        """Person by raw public key of a passkey, which makes votes by passkey and nothing else."""
        ...


class ReplayStore(Protocol):
    """Proof ids seen. Storing is the check: one call, atomic."""

    def first_use(self, jti: str, *, key: bytes, expires_ms: int) -> bool:
        """True exactly once for each (key, jti) until `expires_ms` (monotonic). A store that cannot answer raises."""
        ...


class Journal(Protocol):
    """The PEP's durable record. When `append` returns, the record survives a power cut."""

    def append(self, kind: str, body: dict[str, object]) -> str:
        """The record's hash (hex). Raises when it cannot be made durable."""
        ...

    def note(self, kind: str, body: dict[str, object]) -> str:
        """Hash (hex) of a record that nothing waits for. It survives a power cut once `settle` or `append` returns."""
        ...

    def settle(self) -> None:
        """Every note survives a power cut. Raises when it cannot be made durable."""
        ...


@dataclass(frozen=True, slots=True)
class RemainingVerdict:
    """Judgement of the rest of a motion in the world as it was seen.

    Attributes:
        holds: whether its index is proven to be at most the authorised one.
        index_milli: proven upper bound of its index in thousandths, or None when none can be told.
        cause: kind and object of what leads, for the record.
        fault: reason why it could not be judged, a `policies.words.reason_table.Reason` code; "" when it was.
        age_ms: age of the view it was judged on, transit included, or None when there was no view.
        shown: what that view shows, old or new (`pep.perception.sensor_frames.Seen.content`); None when there was
            no view.
        pace: the highest fraction of the commanded speed at which it is proven, counting the time to slow down to it;
            None when there is none, and when it was not asked for.
    """

    holds: bool
    index_milli: int | None
    cause: str
    fault: str
    age_ms: int | None
    shown: object = None
    pace: float | None = None


class RemainingImpact(Protocol):
    """Port for the physical impact of the rest of a running motion."""

    def left(
        self,
        request: Request,
        state_q_rad: Sequence[float],
        *,
        authorised_milli: int,
        touch: frozenset[str],
        running: float | None,
        oldest_ms: int | None,
    ) -> RemainingVerdict:
        """One look at the frames, one judgement. Never raises.

        Args:
            request: that was permitted and is being done.
            state_q_rad: measured joint angles, six.
            authorised_milli: index of the verdict, in thousandths.
            touch: objects that the token grants to be touched.
            running: highest fraction of the commanded speed that the arm can have now; None when nothing can slow it
                down, which is full speed.
            oldest_ms: frames that are older are left out; None for no such limit.
        """
        ...


class MotionSlot(Protocol):
    """One motion at a time. Taking the slot is the check: one call, atomic."""

    def reserve(self, request_id: str) -> bool:
        """True when nothing moves and the slot is now this request's."""
        ...

    def joins(self, request: Request, *, agent: str) -> bool:
        """True where the request, of that agent, only prolongs the stream that holds the slot.

        The slot is not taken then.
        """
        ...

    def release(self, request_id: str) -> None:
        """The slot is free again, if it was this request's."""
        ...


class Readiness(Protocol):
    """Port for the robot's word on its readiness, and for the PEP's own hold on it."""

    def reading(self) -> RobotReading:
        """State now. Never raises and never waits: an unknown value reads as unknown."""
        ...


@dataclass(frozen=True, slots=True)
class Assessed:
    """One look at the world: the impact, and the origin of the view it was computed on."""

    impact: ImpactReading | ImpactFault
    perception: PerceptionReading | NotCollected


@dataclass(frozen=True, slots=True)
class Together:
    """Judgement of several acts taken as one.

    It holds a proven upper bound of the index of the rest, in thousandths.
    """

    index_milli: int


class Pictures(Protocol):
    """The picture of an assessed motion, as people are shown it."""

    def shown(self, request_id: str) -> str | None:
        """Text of the picture of what was assessed for that request; None for an act without motion.

        Raises:
            StatementError: there is none, so people must not be asked.
        """
        ...


class Physics(Protocol):
    """The runtime physical impact of a request in the world as it is now."""

    def assess(self, request: Request, *, touch: frozenset[str]) -> Assessed:
        """One look at perception and robot state, one assessment. Never raises; a time-out is a fault.

        Args:
            request: the request to be judged.
            touch: objects that the authority behind it lets the arm touch on purpose; the cell has its own say.
        """
        ...

    def remember(self, request: Request) -> None:
        """Keeps the motion of a request that nothing has assessed, from where the arm is now. Never raises.

        For `unsafe_observe` alone: what was denied before physics begins somewhere, and leads somewhere, too.

        Args:
            request: the request whose motion is kept unassessed.
        """
        ...

    def together(
        self, request: Request, *, start_urad: tuple[int, ...], touch: frozenset[str]
    ) -> Together | ImpactFault:
        """Judges the rest of a straight move from `start_urad`, as seen from the arm's position now. Never raises.

        Args:
            request: a `move_joint`. It is asked about, never sent.
            start_urad: six joint angles, microradian, in line with the arm's and the target.
            touch: as for `assess`.
        """
        ...
