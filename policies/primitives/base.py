"""Primitive: a check that looks at one case and answers `Holds`, `Fails` or `Defers`.

`Fails` says no, both where the evidence speaks against the request and where it is absent; `Defers` says that a person
may answer. A primitive judges the evidence as stated and computes nothing again: signatures, narrowing and physics were
settled when it was collected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, assert_never

from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from policies.evidence.evidence import NotCollected
from policies.evidence.model import Finding
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from capabilities.values.scope import Tier
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Request


@dataclass(frozen=True, slots=True)
class Case:
    """Case that a primitive judges.

    Attributes:
        request: the request to be decided.
        evidence: all readings, taken at one instant.
        physical: whether the operation has a physical dependency in this policy set.
        tier: the runtime tier, or None when it is not known (policies.evidence.tiers).
    """

    request: Request
    evidence: Evidence
    physical: bool
    tier: Tier | None


@dataclass(frozen=True, slots=True)
class Holds:
    """The condition holds; `because` is filled where a `not` turned findings round."""

    because: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class Fails:
    """The condition does not hold, or is not known to."""

    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class Defers:
    """A person may answer."""

    findings: tuple[Finding, ...] = ()


Verdict = Holds | Fails | Defers


class Primitive(Protocol):
    """One of the 25. A frozen dataclass whose fields are its parameters, each named in `policies.words.parameters`."""

    id: ClassVar[str]

    def judge(self, case: Case) -> Verdict:
        """The verdict on `case`."""
        ...


def found(primitive: str, reason: Reason, **detail: object) -> Finding:
    """A finding with the remedy of its reason."""
    return Finding(primitive, reason, {**detail, "remedy": REASONS[reason].remedy})


def fails(primitive: str, reason: Reason, **detail: object) -> Fails:
    """A refusal with one finding."""
    return Fails((found(primitive, reason, **detail),))


def missing(primitive: str, what: str) -> Fails:
    """Refusal because `what` was not collected: unknown never permits."""
    return fails(primitive, Reason.EVIDENCE_MISSING, evidence=what)


def fault_owners(fault: Fault) -> tuple[str, ...]:
    """The primitives that a fault of verification belongs to, the one that leads first.

    A revoked sponsor breaks the human root (AID-2); anything else that is revoked breaks a link (AID-3).
    """
    if fault.code is FaultCode.REVOKED:
        return ("AID-2",) if fault.detail.startswith("sponsor") else ("AID-3",)
    return REASONS[Reason(fault.code)].owners


def chain_fault(primitive: str, fault: Fault) -> Fails:
    """Refusal for a chain or proof that verification refused.

    The finding is the asking primitive's own where the fault is its own, else the leading owner's: the reason is the
    fault's for every primitive. The fault's detail stays out of it, since no caller is proven to be the holder yet.
    """
    owners = fault_owners(fault)
    owner = primitive if primitive in owners or not owners else owners[0]
    return fails(owner, Reason(fault.code), clause=fault.clause)


def verified_chain(primitive: str, case: Case) -> Chain | Fails:
    """The verified chain, or the refusal that stands for it."""
    match case.evidence.chain:
        case Chain() as chain:
            return chain
        case Fault() as fault:
            return chain_fault(primitive, fault)
        case NotCollected():
            return missing(primitive, "chain")
        case _:
            assert_never(case.evidence.chain)


def age_within(at: float, since: int, *, bound_s: int, skew_s: int) -> float | None:
    """The age in seconds, or None when it is out of bounds.

    Args:
        at: now, seconds since the epoch; NaN and infinities are never in bounds.
        since: when it happened, seconds since the epoch.
        bound_s: oldest age, included.
        skew_s: how far in the future, included.
    """
    age = at - since
    return age if -skew_s <= age <= bound_s else None
