"""What is decided, about what, and the answer: frozen values that every enforcement point shares.

The flow is one way: a Request and its Evidence go in, a Decision comes out (policies.pdp). Nothing here reads a
clock, a file or a socket.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import rfc8785

if TYPE_CHECKING:
    from capabilities.scope import Tier
    from capabilities.units import Quantity
    from policies.reasons import Reason


class Point(StrEnum):
    """The five enforcement points of the paper."""

    OPERATOR = "e1"
    """Operator to orchestrator."""
    AGENT = "e2"
    """Agent to agent."""
    CONTEXT = "e3"
    """Context admission: retrieval, memory, scenario, perception."""
    TOOL = "e4"
    """Tool call (MCP)."""
    ACTUATION = "e5"
    """Pre-actuation (robot controller)."""


class Effect(StrEnum):
    """The three effects. Anything late, broken, forged or undecidable is DENY."""

    PERMIT = "PERMIT"
    DENY = "DENY"
    DEFER = "DEFER"


@dataclass(frozen=True, slots=True)
class Request:
    """One canonical request: what would be done, in integers.

    Attributes:
        request_id: unique, made by the PEP.
        points: the enforcement points that this one gate run stands for.
        audience: canonical URL of the server that received it.
        object: the thing acted on, e.g. "ur3e".
        operation: e.g. "move_joint".
        values: every parameter, in the operation's order.
        at: wall clock of arrival, seconds since the epoch.
    """

    request_id: str
    points: frozenset[Point]
    audience: str
    object: str
    operation: str
    values: tuple[Quantity, ...]
    at: float

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of what would be done: audience, object, operation and values; the same for every retry."""
        return hashlib.sha256(
            rfc8785.dumps(
                {
                    "audience": self.audience,
                    "object": self.object,
                    "operation": self.operation,
                    "values": [[v.name, str(v.unit), v.value] for v in self.values],
                }
            )
        ).hexdigest()


class ObligationKind(StrEnum):
    """What must be done for a PERMIT to count."""

    RECORD = "record"
    """Write the decision durably before the effect."""
    WATCH = "watch"
    """Keep watching while the effect lasts: its authority, what the sensors see, and what is left of it; else stop."""
    CONSUME = "consume approval"
    """Take the use of the approval that the decision names, durably, before the effect."""


@dataclass(frozen=True, slots=True)
class Obligation:
    """One obligation of a decision."""

    kind: ObligationKind


@dataclass(frozen=True, slots=True)
class ApprovalUse:
    """One use of what people approved: the ask, and the number of the use, from 1."""

    ask_id: str
    use: int


@dataclass(frozen=True, slots=True)
class Finding:
    """What one primitive says against a request.

    Attributes:
        primitive: id, e.g. "TEA-2".
        reason: the code.
        detail: parameter, value, unit, limit, who set it, nearest permitted ...: plain JSON values, safe for the
            holder.
    """

    primitive: str
    reason: Reason
    detail: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Decision:
    """The answer for one request.

    Attributes:
        request_id, request_digest: of the Request.
        effect: PERMIT, DENY or DEFER.
        reason: the leading reason; `PERMITTED` for a PERMIT.
        primitive: id of the primitive that led, or "" for a PERMIT.
        findings: every contributing finding, the leading one first.
        tier: the runtime tier, or None when no tier was computed (a fault is no tier).
        index: the physical impact index in thousandths, or None.
        obligations: what must be done for the PERMIT to count.
        policy_digest: SHA-256 (hex) of the policy set.
        evidence_digest: SHA-256 (hex) of the evidence.
        lifetime_ms: how long after the decision its effect may begin.
        approval: the use of an approval that this PERMIT rests on and must consume, or None.
    """

    request_id: str
    request_digest: str
    effect: Effect
    reason: Reason
    primitive: str
    findings: tuple[Finding, ...]
    tier: Tier | None
    index: int | None
    obligations: tuple[Obligation, ...]
    policy_digest: str
    evidence_digest: str
    lifetime_ms: int
    approval: ApprovalUse | None = None
