"""What the PDP may know: one frozen set of readings, each with its age, or `NOT_COLLECTED`.

Readings are made by the PEP at one instant. Cheap ones come first; once one is a fault, what would have come after is
marked `NOT_COLLECTED`, and a primitive that needs it does not hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from capabilities.chain import Chain, Refusal
from policies import canonical

if TYPE_CHECKING:
    from capabilities.errors import Fault
    from capabilities.scope import Tier


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
class TrustReading:
    """Trust in the weakest edge of the chain, in permille, as `policies.trust` makes it of signed statements."""

    score_permille: int


@dataclass(frozen=True, slots=True)
class Contribution:
    """One thing that raises the index: what (kind), between which link and object, when, how near, how fast."""

    kind: str
    index_milli: int
    link: str
    object: str
    at_ms: int
    clearance_um: int
    speed_um_s: int


@dataclass(frozen=True, slots=True)
class ImpactReading:
    """The runtime physical impact of a request, computed from the live world.

    Attributes:
        tier: ceil of the certified index.
        index_milli: the index in thousandths, 0 to 4000.
        violations: named violations ("person", "joint_limit", "workspace", "zone", "self"); any one denies whatever is
            authorised.
        contributions: ranked, highest index first.
        lower_tier_speed: highest value of the speed parameter (its own unit) at which the tier falls below `tier`, or
            None when none does.
        perception: "fresh", "stale" or "missing".
        perception_age_ms: age of the frame that was used, or None.
        scene_digest, model_digest, engine: what it was computed on and with.
    """

    tier: Tier
    index_milli: int
    violations: tuple[str, ...]
    contributions: tuple[Contribution, ...]
    lower_tier_speed: int | None
    perception: str
    perception_age_ms: int | None
    scene_digest: str
    model_digest: str
    engine: str


@dataclass(frozen=True, slots=True)
class ImpactFault:
    """Physics that could not be computed or must not be believed. A fault is no tier, and no approval overrides it.

    Attributes:
        reason: a `policies.reasons.Reason` code, e.g. "PERCEPTION_INVALID", "PHYSICS_FAULT", "ENGINES_DISAGREE",
            "NOT_FINITE".
        detail: for the record and the holder.
    """

    reason: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Evidence:
    """All readings for one request, taken at one instant.

    Attributes:
        at: the instant, seconds since the epoch.
        at_ms: the same instant on the PEP's monotonic clock.
        chain: the verified chain (steps 1 to 9), or the fault that verification found.
        proof: True after a valid proof of possession by the leaf's key that was never seen before, or the fault.
        request_fault: what the compiled scope and Biscuit's own authorizer (steps 11 and 12) say against the request,
            or None.
        robot_fault: the robot's own parameter limit that the request breaks, or None.
        tool: the tool's identity.
        trust: of the chain.
        impact: of the request; `NOT_COLLECTED` for an operation that has no physical dependency.
    """

    at: float
    at_ms: int
    chain: Chain | Fault | NotCollected = NOT_COLLECTED
    proof: bool | Fault | NotCollected = NOT_COLLECTED
    request_fault: Refusal | Fault | NotCollected | None = NOT_COLLECTED
    robot_fault: Refusal | NotCollected | None = NOT_COLLECTED
    tool: ToolReading | NotCollected = NOT_COLLECTED
    trust: TrustReading | NotCollected = NOT_COLLECTED
    impact: ImpactReading | ImpactFault | NotCollected = NOT_COLLECTED

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of all readings, for the record.

        A verified chain stands in it by the digest of its canonical bytes, which fixes sponsor, hops and scope,
        together with what verification added: the root key, the epoch and the age of the revocation view.
        """
        chain: object = self.chain
        if isinstance(chain, Chain):
            chain = ("verified", chain.token_id, chain.digest, chain.root_key_id, chain.epoch, chain.view_age_ms)
        return canonical.digest(
            "evidence",
            {
                "at": self.at,
                "at_ms": self.at_ms,
                "chain": chain,
                "proof": self.proof,
                "request_fault": self.request_fault,
                "robot_fault": self.robot_fault,
                "tool": self.tool,
                "trust": self.trust,
                "impact": self.impact,
            },
        )
