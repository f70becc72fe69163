"""Evidence of a decision: one frozen set of readings, each with its age, or `NOT_COLLECTED`.

Readings are made by the PEP at one instant. Cheap ones come first; once one is a fault, what would have come after is
marked `NOT_COLLECTED`, and a primitive that needs it does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Chain, Refusal
from policies.words import canonical

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.errors import Fault
    from capabilities.values.scope import Tier
    from policies.evidence.conduct_readings import BehaviourReading, SequenceReading
    from policies.evidence.content_readings import ContextReading, InstructionReading, MessageReading
    from policies.evidence.fact_reading import FactReading


class NotCollected(Enum):
    """The type of `NOT_COLLECTED`."""

    NOT_COLLECTED = "not collected"


NOT_COLLECTED: Final = NotCollected.NOT_COLLECTED


@dataclass(frozen=True, slots=True)
class ToolReading:
    """The called tool's identity.

    Attributes:
        name: of the tool.
        approved_digest: definition digest in the signed registry, or None when the tool is not registered.
        actual_digest: digest of the definition that the server serves now.
        base_tier: registered base tier, or None when not registered.
    """

    name: str
    approved_digest: str | None
    actual_digest: str
    base_tier: Tier | None


@dataclass(frozen=True, slots=True)
class EdgeReading:
    """Trust of one party in one other, in permille; it belongs to this edge and to no other."""

    delegator: str
    delegate: str
    score_permille: int


@dataclass(frozen=True, slots=True)
class TrustReading:
    """Trust along a chain, as `policies.conduct.trust` makes it of signed statements.

    Attributes:
        score_permille: of the chain: that of its weakest edge.
        edges: one for each hop, the sponsor's trust in the first holder first.
    """

    score_permille: int
    edges: tuple[EdgeReading, ...] = ()


@dataclass(frozen=True, slots=True)
class Contribution:
    """One contribution to the index: its kind, link and object, time, clearance and speed.

    `source` is who says that the object is there: a sensor, or "" for the signed cell file and the robot itself.
    """

    kind: str
    index_milli: int
    link: str
    object: str
    at_ms: int
    clearance_um: int
    speed_um_s: int
    source: str = ""


@dataclass(frozen=True, slots=True)
class ImpactReading:
    """The runtime physical impact of a request, computed from the live world.

    Attributes:
        tier: ceil of the certified index.
        index_milli: the index in thousandths, 0 to 4000.
        violations: named violations ("person", "fragile", "rigid", "joint_limit", "workspace", "zone", "self"); any one
            denies, and no authority lifts that.
        contributions: ranked, highest index first.
        lower_tier_speed: highest value of the speed parameter (its own unit) at which the tier falls below `tier`, or
            None when none does.
        tcp_speed_um_s: proven bound on the tool centre point's speed.
        contact_permille: highest ratio of a body region's relative contact speed to its limit speed (PFL) over all
            people that the motion could meet; 0 when there is nobody.
        start_urad: joint angles from which it was computed, six integers; empty when nothing was read.
        perception: "fresh", "stale" or "missing".
        perception_age_ms: age of the frame that was used, or None.
        scene_digest, model_digest, engine: those of the computation.
    """

    tier: Tier
    index_milli: int
    violations: tuple[str, ...]
    contributions: tuple[Contribution, ...]
    lower_tier_speed: int | None
    tcp_speed_um_s: int
    contact_permille: int
    start_urad: tuple[int, ...]
    perception: str
    perception_age_ms: int | None
    scene_digest: str
    model_digest: str
    engine: str


@dataclass(frozen=True, slots=True)
class DeclaredImpact:
    """Impact of an act that no physics computes, by the declared row of its operation.

    Attributes:
        tier: of these values: the row's base tier, or the highest to which one of them is raised.
        raised_by: names of the parameters and facts that raised it to that tier.
        facts: every fact of a sensor that the row depends on, as it was read.
    """

    tier: Tier
    raised_by: tuple[str, ...] = ()
    facts: tuple[FactReading, ...] = ()

    @property
    def contributors(self) -> frozenset[tuple[str, str]]:
        """Kind and name of each fact that raised the tier: `fact`, or `fact-unseen` for one that is not fresh."""
        raising = (fact for fact in self.facts if fact.fact in self.raised_by)
        return frozenset(("fact" if fact.state == "fresh" else "fact-unseen", fact.fact) for fact in raising)


@dataclass(frozen=True, slots=True)
class ImpactFault:
    """Fault of physics: the impact could not be computed, or must not be believed.

    A fault is no tier, and no approval overrides it.

    Attributes:
        reason: a `policies.words.reason_table.Reason` code, e.g. "PERCEPTION_INVALID", "PHYSICS_FAULT",
            "ENGINES_DISAGREE",
            "NOT_FINITE".
        detail: for the record and the holder.
    """

    reason: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class SensorReading:
    """One registered sensor's part in the view of the world.

    Attributes:
        sensor: its id; "" for frames that name no registered sensor.
        state: "fresh", "stale", "missing" or "invalid".
        fault: why its newest frame is not believed, a code; "" when it is.
        age_ms: of its newest believed frame, transit included, or None.
    """

    sensor: str
    state: str
    fault: str
    age_ms: int | None


@dataclass(frozen=True, slots=True)
class PerceptionReading:
    """Origin of the view of the world: every sensor that the cell names, in the order of their ids."""

    sensors: tuple[SensorReading, ...]


@dataclass(frozen=True, slots=True)
class RobotReading:
    """State of the robot as it reports it, and the PEP's knowledge of its hold on it.

    Attributes:
        robot_mode, safety_mode: as the controller numbers them (7 is running; 1 normal, 2 reduced).
        remote_control: whether the controller takes commands from remote; None when it does not say.
        exclusive: whether the program that runs is this PEP's own, and no other client commands the arm.
        payload_g: the payload that the controller reckons with.
        expected_payload_g: tool and held object by the committed state; None when the held mass is unknown.
        frames_match: whether tool centre point and base frame are those of the model.
    """

    robot_mode: int
    safety_mode: int
    remote_control: bool | None
    exclusive: bool
    payload_g: int
    expected_payload_g: int | None
    frames_match: bool


@dataclass(frozen=True, slots=True)
class ApprovalReading:
    """Answer of people to an earlier deferral of this very request by this very agent.

    Every vote in it was verified with its approver's registered key over the ask that it binds.

    Attributes:
        ask_id: of the ask.
        state: "open", "granted", "denied", "withdrawn", "used" or "expired" (granted, and over).
        reasons: the deferral reasons that it resolves.
        tier, index_milli: as they were shown.
        contributors: (kind, object) of everything that contributed as it was shown.
        start_urad: joint angles as they were shown, six integers, or none.
        model_digest, policy_digest: as they were shown.
        approvers: the different people who approved, sorted.
        sponsor: of the chain that asked.
        opening_id: the opening that it rests on, or "".
        sees_clear: every approver attested to seeing the cell clear.
        uses_left: how often it may still be used.
        use: number of its next use, from 1.
        not_after: seconds since the epoch; the earliest of all votes.
        age_ms: since the nonce of the identity provider's newest word about it was sent.
    """

    ask_id: str
    state: str
    reasons: frozenset[str]
    tier: Tier
    index_milli: int
    contributors: frozenset[tuple[str, str]]
    start_urad: tuple[int, ...]
    model_digest: str
    policy_digest: str
    approvers: tuple[str, ...]
    sponsor: str
    opening_id: str
    sees_clear: bool
    uses_left: int
    use: int
    not_after: int
    age_ms: int


@dataclass(frozen=True, slots=True)
class OpeningReading:
    """A person's prior leave to ask for a safety-critical act of this agent, verified and in force.

    Attributes:
        opening_id, opener: the opening's id, and the person who signed it.
        uses_left: how many acts may still rest on it.
        not_after: seconds since the epoch.
        age_ms: since the nonce of the identity provider's newest word about it was sent.
    """

    opening_id: str
    opener: str
    uses_left: int
    not_after: int
    age_ms: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """All readings for one request, taken at one instant.

    Attributes:
        at: the instant, seconds since the epoch.
        at_ms: the same instant on the PEP's monotonic clock.
        chain: the verified chain (steps 1 to 9), or the fault that verification found.
        proof: True after a valid proof of possession by the leaf's key that was never seen before, or the fault.
        request_fault: the refusal of the request by the compiled scope or Biscuit's own authorizer (steps 11 and 12),
            or None.
        robot_fault: the robot's own parameter limit that the request breaks, or None.
        tool: the tool's identity.
        trust: of the chain.
        impact: of the request; `NOT_COLLECTED` for a robot's operation that has no physical dependency.
        perception: where the view of the world comes from; like `impact`.
        robot: its readiness; like `impact`.
        approval: people's answer to this request, or None when nobody was asked.
        opening: the prior leave that a safety-critical act needs, or None when there is none.
        instruction: of an operator (e1, e2).
        message: of another agent (e2).
        context: the items that would enter a context (e3), or the origins of the arguments of a call (e4).
        sequence: the sequence that the command stands in; like `impact`.
        behaviour: of the holder.
    """

    at: float
    at_ms: int
    chain: Chain | Fault | NotCollected = NOT_COLLECTED
    proof: bool | Fault | NotCollected = NOT_COLLECTED
    request_fault: Refusal | Fault | NotCollected | None = NOT_COLLECTED
    robot_fault: Refusal | NotCollected | None = NOT_COLLECTED
    tool: ToolReading | NotCollected = NOT_COLLECTED
    trust: TrustReading | NotCollected = NOT_COLLECTED
    impact: ImpactReading | DeclaredImpact | ImpactFault | NotCollected = NOT_COLLECTED
    perception: PerceptionReading | NotCollected = NOT_COLLECTED
    robot: RobotReading | NotCollected = NOT_COLLECTED
    approval: ApprovalReading | NotCollected | None = NOT_COLLECTED
    opening: OpeningReading | NotCollected | None = NOT_COLLECTED
    instruction: InstructionReading | NotCollected = NOT_COLLECTED
    message: MessageReading | NotCollected = NOT_COLLECTED
    context: ContextReading | NotCollected = NOT_COLLECTED
    sequence: SequenceReading | NotCollected = NOT_COLLECTED
    behaviour: BehaviourReading | NotCollected = NOT_COLLECTED

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of all readings, for the record.

        A verified chain stands in it by the digest of its canonical bytes, which fixes sponsor, hops and scope,
        together with the additions of verification: the root key, the epoch and the age of the revocation view.
        """
        return self.digest_of({name: canonical.plain(getattr(self, name)) for name in READINGS if name != "chain"})

    def digest_of(self, readings: Mapping[str, object]) -> str:
        """The same digest, given the plain readings by name; that of the chain is not looked at."""
        chain: object = self.chain
        if isinstance(chain, Chain):
            chain = ("verified", chain.token_id, chain.digest, chain.root_key_id, chain.epoch, chain.view_age_ms)
        own = canonical.plain(chain)
        pairs = [[name, own if name == "chain" else readings[name]] for name in READINGS]
        return canonical.plain_digest("evidence", {"map": pairs})


READINGS: Final = tuple(sorted(field.name for field in fields(Evidence)))
"""Names of the readings in the order of their digest."""


def prior_leave(evidence: Evidence) -> OpeningReading | None:
    """Opening that is in force for the request, or None.

    It permits nothing: it only lets tier 4 be asked for.
    """
    opening = evidence.opening
    if not isinstance(opening, OpeningReading):
        return None
    return opening if opening.uses_left >= 1 and evidence.at <= opening.not_after else None
