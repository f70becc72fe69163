"""Model of a decision: request, evidence, answer, as frozen values that every enforcement point shares.

The flow is one way: a Request and its Evidence go in, a Decision comes out (policies.decision.pdp). Nothing here reads
a clock, a file or a socket.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import msgspec
import rfc8785

from capabilities.values.arguments import kind_given, plain
from capabilities.values.units import Quantity
from policies.words.canonical import EXACT
from policies.words.errors import PolicyError, PolicyFault

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.arguments import Value
    from capabilities.values.scope import Tier
    from policies.evidence.evidence import Evidence
    from policies.words.reason_table import Reason

_QUICK: Final = msgspec.json.Encoder()


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


SEVERITY: Final[Mapping[Effect, int]] = MappingProxyType({Effect.PERMIT: 0, Effect.DEFER: 1, Effect.DENY: 2})
"""Rank of each effect by strictness."""


def _whole(value: Value) -> bool:
    """True for an integer that every reader keeps, and for a list of such."""
    numbers = value.value if type(value.value) is tuple else (value.value,)
    return all(type(each) is int and -EXACT <= each <= EXACT for each in numbers)


@dataclass(frozen=True, slots=True)
class Request:
    """One canonical request: the act to be done, each value in its one spelling.

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
    values: tuple[Value, ...]
    at: float

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Values that are quantities, in their order; of a robot's request that is all of them."""
        return tuple(value for value in self.values if type(value) is Quantity)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the act, as RFC 8785 JSON: audience, object, operation and values.

        The same for every retry.
        """
        # of names and of integers that every reader keeps, the quick encoder writes the RFC 8785 form
        usual = all(map(_whole, self.values))
        content: dict[str, Any] = {
            "audience": self.audience,
            "object": self.object,
            "operation": self.operation,
            "values": [[v.name, str(kind_given(v)), plain(v)] for v in self.values],
        }
        return hashlib.sha256(_QUICK.encode(content) if usual else rfc8785.dumps(content)).hexdigest()


class ObligationKind(StrEnum):
    """Kind of obligation: an act that makes a PERMIT count, or that follows a DENY.

    A policy may ask for any of them but `CONSUME` and `CLAMP`, which only a decision can know.
    """

    RECORD = "record"
    """Write the decision durably before the effect."""
    WATCH = "watch"
    """Keep watching while the effect lasts: its authority, the sensors' view, and the rest of the motion; else stop."""
    CONSUME = "consume approval"
    """Take the use of the approval that the decision names, durably, before the effect."""
    CLAMP = "clamp"
    """Let no value of the parameter through above the decided one.

    Never silent: a PEP that lowers a parameter has the lower request decided and tells the caller; a PERMIT names the
    value that it holds for.
    """
    NOTIFY = "notify"
    """Tell a person who answers for the cell."""
    REATTEST = "re-attest"
    """Have the holder attested again before its next act."""
    LOWER_TRUST = "lower trust"
    """Report the attempt, so that trust is lowered.

    Where chain and proof were verified, it is trust in the holder; else in the sender of the request. It is never
    trust in an agent that only an unverified token names.
    """


@dataclass(frozen=True, slots=True)
class Obligation:
    """One obligation of a decision.

    Attributes:
        kind: the kind of act.
        at_most: of a clamp, and of nothing else: the parameter, its unit and its highest value.

    Raises:
        PolicyError: for a clamp without a bound, and for a bound without a clamp.
    """

    kind: ObligationKind
    at_most: Quantity | None = None

    def __post_init__(self) -> None:
        if (self.kind is ObligationKind.CLAMP) is (self.at_most is None):
            raise PolicyError(PolicyFault.UNKNOWN_VALUE, "obligation", "a clamp and a bound come together")


@dataclass(frozen=True, slots=True)
class ApprovalUse:
    """One use of an approval: the ask, and the number of the use, from 1."""

    ask_id: str
    use: int


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of one primitive against a request.

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
        obligations: acts that make the PERMIT count, or that follow the DENY; sorted by kind.
        policy_digest: SHA-256 (hex) of the policy set.
        evidence: the evidence; None where it was not even of the right shape.
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
    evidence: Evidence | None = field(repr=False)
    lifetime_ms: int
    approval: ApprovalUse | None = None

    @property
    def evidence_digest(self) -> str:
        """SHA-256 (hex) of the evidence, or "".

        It is computed when it is asked for, which is when a record is made.
        """
        return "" if self.evidence is None else self.evidence.digest
