"""Remedies: for a DENY or DEFER the changes that would lift it, and the reasons that no change lifts.

A suggestion that can be checked is checked: the changed case is decided by the same `decide`, and the suggestion states
the result. Nothing here permits anything: a changed case is a supposition (policies.explain.counterfactuals), and the
caller asks again after the change.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.values.arguments import kind_given
from capabilities.values.chain import Chain, Refusal
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Tier
from policies.decision.approval import APPROVERS_OF_TIER
from policies.decision.obligations import SPEED
from policies.decision.pdp import decide
from policies.evidence.evidence import NOT_COLLECTED, DeclaredImpact, ImpactReading
from policies.evidence.model import Effect
from policies.evidence.tiers import runtime_tier
from policies.explain import counterfactuals
from policies.words import canonical
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities.values.bounds import Measured
    from policies.decision.policy import PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision, Finding, Request


class Means(StrEnum):
    """Kind of change, and with it the party that makes it."""

    PARAMETER = "parameter"
    """The caller asks for another value."""
    PROOF = "new proof"
    """The caller signs this very request."""
    ATTESTATION = "new attestation"
    """The agents that are named are attested again, and the token delegated anew."""
    LOGIN = "new log-in"
    """The sponsor logs in again, and issues a new token."""
    TOKEN = "new token"  # noqa: S105 - a word, no secret
    """The delegator or the sponsor lends anew."""
    APPROVAL = "approval"
    """People answer; for tier 4 two of them, and with prior leave."""
    NEWS = "newer word"
    """Newer word of revocations, sensors or behaviour arrives by itself."""
    ROBOT = "person at the robot"
    TOOL = "administrator"
    """An administrator reviews the tool as it is now, and registers it."""
    ALL = "all of it"
    """The first suggestion for each reason, together."""
    NOTHING = "nothing"
    """No change of this request or by any party; `detail` names the act that remains instead."""


@dataclass(frozen=True, slots=True)
class Remedy:
    """Suggested change.

    Attributes:
        means: the kind of change.
        lifts: the reasons that it is for.
        detail: the change in numbers and names, as plain JSON.
        effect: of the changed case; None where that is not known before the next request.
        remains: the reasons that would still stand.
    """

    means: Means
    lifts: tuple[Reason, ...]
    detail: dict[str, object] = field(default_factory=dict)
    effect: Effect | None = None
    remains: tuple[Reason, ...] = ()


Supposed = tuple["Request", "Evidence"]


@dataclass(frozen=True, slots=True)
class _Change:
    """A change that may be supposed; without `suppose` it can only be told."""

    means: Means
    detail: dict[str, object]
    suppose: Callable[[Request, Evidence], Supposed] | None = None


def remedies(request: Request, evidence: Evidence, policies: PolicySet, decision: Decision) -> tuple[Remedy, ...]:
    """Changes that would lift the answer, in the order of its findings; none for a PERMIT.

    Args:
        request: the one that was decided.
        evidence: all readings.
        policies: the set.
        decision: that of the set on this evidence.
    """
    if decision.effect is Effect.PERMIT:
        return ()
    reasons = dict.fromkeys(finding.reason for finding in decision.findings)
    if len(reasons) > 1:
        reasons.pop(Reason.EVIDENCE_MISSING, None)  # it was not collected because of the others
    suggested: dict[str, tuple[_Change, list[Reason]]] = {}  # one suggestion may be for several reasons
    first: dict[str, _Change] = {}
    for reason in reasons:
        finding = next(finding for finding in decision.findings if finding.reason is reason)
        # evidence that was not even of the right shape cannot be supposed to be otherwise
        changes = [] if decision.evidence is None else list(_changes(finding, request, evidence, policies))
        for change in changes or [_Change(Means.NOTHING, {"instead": REASONS[reason].remedy}, _as_it_is)]:
            key = canonical.text((change.means, change.detail))
            suggested.setdefault(key, (change, []))[1].append(reason)
        if changes:
            key = canonical.text((changes[0].means, changes[0].detail))
            first.setdefault(key, changes[0])
    told = [_tried(change, tuple(lifts), request, evidence, policies) for change, lifts in suggested.values()]
    if len(first) > 1:
        lifted = tuple(dict.fromkeys(reason for key in first for reason in suggested[key][1]))
        told.append(_tried(_together(list(first.values())), lifted, request, evidence, policies))
    return tuple(told)


def _as_it_is(request: Request, evidence: Evidence) -> Supposed:
    return request, evidence


def _tried(
    change: _Change, lifts: tuple[Reason, ...], request: Request, evidence: Evidence, policies: PolicySet
) -> Remedy:
    """The suggestion, with the answer to the changed case."""
    if change.suppose is None:
        return Remedy(change.means, lifts, change.detail)
    then = decide(*change.suppose(request, evidence), policies)
    remains = tuple(dict.fromkeys(finding.reason for finding in then.findings))
    # where nothing but the unknown speaks against it, nobody knows before it is asked
    known = then.effect if set(remains) != {Reason.EVIDENCE_MISSING} else None
    return Remedy(change.means, lifts, change.detail, known, remains)


def _together(changes: list[_Change]) -> _Change:
    """All changes one after the other; people are asked last, about the case that the others leave."""
    ordered = sorted(changes, key=lambda change: change.means is Means.APPROVAL)
    means: list[object] = list(dict.fromkeys(str(change.means) for change in ordered))

    def suppose(request: Request, evidence: Evidence) -> Supposed:
        for change in ordered:
            if change.suppose is not None:
                request, evidence = change.suppose(request, evidence)
        return request, evidence

    told_alone = any(change.suppose is None for change in changes)
    return _Change(Means.ALL, {"means": means}, None if told_alone else suppose)


# --- which changes there are for a reason ----------------------------------------------------------------------------

_PROOFS: Final = frozenset(reason for reason in Reason if reason.startswith("PROOF_") or reason is Reason.REPLAYED)
_ASKED: Final = frozenset(
    {
        Reason.TIER_NEEDS_APPROVAL,
        Reason.TIER_SAFETY_CRITICAL,
        Reason.PERCEPTION_MISSING,
        Reason.TRUST_TOO_LOW,
        Reason.APPROVAL_REQUIRED,
        Reason.APPROVAL_USED,
        Reason.APPROVAL_NOT_USABLE,
        Reason.BEHAVIOUR_DEVIATES,
        Reason.SEQUENCE_NEEDS_APPROVAL,
    }
)
_SLOWER: Final = frozenset(
    {
        Reason.TIER_NEEDS_APPROVAL,
        Reason.TIER_SAFETY_CRITICAL,
        Reason.ABOVE_CEILING,
        Reason.TRUST_TOO_LOW,
        Reason.APPROVED_TOO_FAST,
        Reason.SEQUENCE_NEEDS_APPROVAL,
        Reason.SEQUENCE_TOO_HIGH,
    }
)
_LENT_ANEW: Final = frozenset(
    {
        Reason.TOKEN_MISSING,
        Reason.TOKEN_TOO_LARGE,
        Reason.TOO_MANY_HOPS,
        Reason.HOP_NOT_ATTESTED,
        Reason.NOT_NARROWER,
        Reason.LIFETIME_TOO_LONG,
        Reason.CHAIN_OUT_OF_BOUNDS,
        Reason.UNKNOWN_ROOT_KEY,
        Reason.DELEGATE_NOT_ALLOWED,
    }
)
"""Reasons that a new token can lift, though the token to be lent is not known here."""


def _changes(finding: Finding, request: Request, evidence: Evidence, policies: PolicySet) -> Iterator[_Change]:
    """The changes for one finding, the nearest to hand first."""
    reason = finding.reason
    if reason in _PROOFS:
        yield _Change(Means.PROOF, {}, lambda r, e: (r, replace(e, proof=True)))
    if reason in (Reason.LIMIT_EXCEEDED_BY_REQUEST, Reason.ROBOT_LIMIT):
        yield from _inside(request, evidence)
    if reason in _SLOWER:
        yield from _slower(request, evidence)
    if reason in _ASKED:
        tier = runtime_tier(evidence, physical=policies.plan(request).needs.physical)
        people = APPROVERS_OF_TIER.get(tier, 1) if tier is not None else 1
        detail: dict[str, object] = {"people": people, "prior_leave": tier is Tier.SAFETY_CRITICAL}
        yield _Change(Means.APPROVAL, detail, lambda r, e: (r, counterfactuals.approved(r, e, policies, people)))
    if reason is Reason.PERCEPTION_MISSING:
        # what a silent sensor would say of a fact cannot be supposed
        said = isinstance(evidence.impact, DeclaredImpact)
        yield _Change(Means.NEWS, {"of": "sensors"}, None if said else lambda r, e: (r, counterfactuals.sighted(e)))
    if reason is Reason.BEHAVIOUR_OLD and evidence.behaviour is not NOT_COLLECTED:
        news = replace(evidence.behaviour, age_ms=0)
        yield _Change(Means.NEWS, {"of": "behaviour"}, lambda r, e: (r, replace(e, behaviour=news)))
    if reason.startswith(("ROBOT_NOT_", "ROBOT_SAFETY", "PAYLOAD_", "FRAMES_")) and evidence.robot is not NOT_COLLECTED:
        ready = counterfactuals.ready(evidence.robot)
        yield _Change(Means.ROBOT, {}, None if ready is None else lambda r, e: (r, replace(e, robot=ready)))
    if reason in (Reason.TOOL_UNKNOWN, Reason.TOOL_DEFINITION_CHANGED) and evidence.tool is not NOT_COLLECTED:
        tool = replace(evidence.tool, approved_digest=evidence.tool.actual_digest)
        yield _Change(Means.TOOL, {"tool": tool.name}, lambda r, e: (r, replace(e, tool=tool)))
    yield from _of_authority(reason, request, evidence)


def _of_authority(reason: Reason, request: Request, evidence: Evidence) -> Iterator[_Change]:
    """The changes that only who lends can make. A chain that was not verified cannot be supposed."""
    at, chain = int(evidence.at), evidence.chain
    of_chain: dict[Reason, tuple[Means, dict[str, object], Callable[[Chain], Chain]]] = {
        Reason.EXPIRED: (Means.TOKEN, {"valid_at": at}, lambda c: counterfactuals.scoped(c, not_after=at + 1)),
        Reason.NOT_YET_VALID: (Means.TOKEN, {"valid_at": at}, lambda c: counterfactuals.scoped(c, not_before=at)),
        Reason.WRONG_AUDIENCE: (
            Means.TOKEN,
            {"audience": request.audience},
            lambda c: counterfactuals.scoped(c, audiences=c.scope.audiences | {request.audience}),
        ),
        Reason.ATTESTATION_OLD: (Means.ATTESTATION, {"attested_at": at}, lambda c: counterfactuals.attested(c, at)),
        Reason.REATTESTATION_NEEDED: (
            Means.ATTESTATION,
            {"attested_at": at},
            lambda c: counterfactuals.attested(c, at),
        ),
        Reason.SPONSOR_AUTHENTICATION_OLD: (
            Means.LOGIN,
            {"authenticated_at": at},
            lambda c: replace(c, sponsor=replace(c.sponsor, authenticated_at=at)),
        ),
        Reason.REVOCATION_VIEW_STALE: (Means.NEWS, {"of": "revocations"}, lambda c: replace(c, view_age_ms=0)),
    }
    if reason in of_chain:
        means, detail, change = of_chain[reason]
        if isinstance(chain, Chain):
            yield _Change(means, detail, lambda r, e: (r, counterfactuals.with_chain(e, change)))
        else:
            yield _Change(means, detail)
    if reason is Reason.NOT_GRANTED:
        grant: dict[str, object] = {"object": request.object, "operation": request.operation}
        yield _Change(Means.TOKEN, grant, lambda r, e: (r, replace(e, request_fault=None)))
    if reason in _LENT_ANEW:
        yield _Change(Means.TOKEN, {"remedy": REASONS[reason].remedy})


def _inside(request: Request, evidence: Evidence) -> Iterator[_Change]:
    """The nearest request that neither token nor robot refuses, each parameter that is outside moved inside."""
    nearest: dict[str, Measured] = {}
    faults = [evidence.request_fault, evidence.robot_fault]
    while faults:
        fault = faults.pop()
        if not isinstance(fault, Refusal) or fault.code is not FaultCode.LIMIT_EXCEEDED_BY_REQUEST:
            continue
        if fault.parameter is None or fault.nearest is None or fault.parameter in nearest:
            return
        nearest[fault.parameter] = fault.nearest
        faults.append(counterfactuals.refused(counterfactuals.valued(request, nearest), evidence))
    units = {value.name: str(kind_given(value)) for value in request.values}
    told: list[object] = [{"parameter": n, "unit": units.get(n), "nearest": value} for n, value in nearest.items()]

    def suppose(asked: Request, seen: Evidence) -> Supposed:
        # another command has another impact, which nobody has computed yet
        unknown = replace(seen, impact=NOT_COLLECTED, sequence=NOT_COLLECTED, approval=None)
        return counterfactuals.valued(asked, nearest), replace(unknown, request_fault=None, robot_fault=None)

    if told:
        yield _Change(Means.PARAMETER, {"parameters": told}, suppose)


def _slower(request: Request, evidence: Evidence) -> Iterator[_Change]:
    """The highest speed at which the assessment that was made says that the tier falls."""
    impact = evidence.impact
    speed = next((value for value in request.quantities if value.name == SPEED), None)
    if not isinstance(impact, ImpactReading) or impact.lower_tier_speed is None or speed is None or impact.tier < 1:
        return
    if not 0 < impact.lower_tier_speed < speed.value:
        return
    at_most, tier = impact.lower_tier_speed, Tier(impact.tier - 1)
    calmer = replace(impact, tier=tier, index_milli=min(impact.index_milli, 1_000 * tier), lower_tier_speed=None)
    detail: dict[str, object] = {"parameter": SPEED, "unit": str(speed.unit), "at_most": at_most, "tier": int(tier)}

    def suppose(asked: Request, seen: Evidence) -> Supposed:
        return counterfactuals.valued(asked, {SPEED: at_most}), replace(seen, impact=calmer, approval=None)

    yield _Change(Means.PARAMETER, detail, suppose)
