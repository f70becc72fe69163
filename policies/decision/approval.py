"""Standing of an approval for a case as it is now.

Pure; everything is assessed afresh at use.

An approval resolves the deferral reasons that it lists, and lifts no denial. The one denial that people can lift, tier
4, is a deferral only while a person's prior leave (an opening) is in force, and then wants two people.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Chain
from capabilities.values.scope import Tier
from policies.evidence.evidence import ApprovalReading, DeclaredImpact, ImpactReading, prior_leave
from policies.evidence.tiers import FRESH
from policies.primitives.base import found
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from policies.decision.policy import PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Finding
    from policies.primitives.base import Case
    from policies.words.parameters import Parameters

APPROVERS_OF_TIER: Final = {Tier.SAFETY_CRITICAL: 2}
"""Number of different people that a tier needs; any other tier needs one (DESIGN section 6)."""


@dataclass(frozen=True, slots=True)
class Waiting:
    """Waiting: nobody was asked, or not enough people have answered; the deferral stands as it is."""


@dataclass(frozen=True, slots=True)
class Counts:
    """Approval that counts: use number `use` of ask `ask_id` resolves everything that defers."""

    ask_id: str
    use: int


@dataclass(frozen=True, slots=True)
class AskAgain:
    """Answer that does not count for this case: the deferral stands, and the finding leads it."""

    finding: Finding


@dataclass(frozen=True, slots=True)
class Refused:
    """Denial: people said no, or the approved act may not be done as it is now asked."""

    finding: Finding


Standing = Waiting | Counts | AskAgain | Refused


def standing(case: Case, deferred: Iterable[Finding], policies: PolicySet) -> Standing:
    """Standing of the approval in the evidence for this case.

    Args:
        case: as it is now.
        deferred: every finding that defers it; nothing denies it.
        policies: the set that decides, with its parameters.
    """
    approval = case.evidence.approval
    if not isinstance(approval, ApprovalReading):
        return Waiting()
    match approval.state:
        case "open":
            return Waiting()
        case "denied":
            return Refused(found("", Reason.APPROVAL_DENIED, ask_id=approval.ask_id))
        case "used":
            return AskAgain(found("", Reason.APPROVAL_USED, ask_id=approval.ask_id))
        case "granted":
            # first, because it denies: other differences of the world would turn that denial into a question
            fast = _too_fast(case, policies.parameters)
            if fast is not None:
                return Refused(fast)
            differs = list(_differences(case, approval, {str(f.reason) for f in deferred}, policies))
        case state:
            differs = [_difference("state", "granted", state)]
    if differs:
        return AskAgain(found("", Reason.APPROVAL_NOT_USABLE, ask_id=approval.ask_id, differs=differs))
    return Counts(approval.ask_id, approval.use)


def _difference(what: str, shown: object, now: object) -> dict[str, object]:
    return {"what": what, "shown": shown, "now": now}


def _differences(
    case: Case, approval: ApprovalReading, reasons: set[str], policies: PolicySet
) -> Iterator[dict[str, object]]:
    """Differences of the case from the approved one that exceed their slack; none when the approval counts."""
    evidence, parameters = case.evidence, policies.parameters
    chain = evidence.chain
    # its sponsor and its policy set
    sponsor = chain.sponsor.subject if isinstance(chain, Chain) else None
    if sponsor != approval.sponsor:
        yield _difference("sponsor", approval.sponsor, sponsor)
    if policies.digest != approval.policy_digest:
        yield _difference("policy_digest", approval.policy_digest, policies.digest)
    # the shown impact
    if case.tier is None or case.tier != approval.tier:
        yield _difference("tier", int(approval.tier), None if case.tier is None else int(case.tier))
    if unlisted := reasons - approval.reasons:
        yield _difference("reasons", sorted(approval.reasons), sorted(unlisted))
    if case.physical:
        yield from _physical_differences(evidence, approval, parameters)
    # who answered, how often and until when
    # two different people: at most one of them is the sponsor
    people = set(approval.approvers)
    wanted = APPROVERS_OF_TIER.get(approval.tier, 1)
    if not len(people) >= wanted:
        yield _difference("approvers", wanted, len(people))
    if not approval.uses_left >= 1:
        yield _difference("uses_left", 1, approval.uses_left)
    if not evidence.at <= approval.not_after:
        yield _difference("not_after", approval.not_after, evidence.at)
    if not 0 <= approval.age_ms <= parameters.lease_motion_ms:
        yield _difference("age_ms", parameters.lease_motion_ms, approval.age_ms)
    if approval.tier is Tier.SAFETY_CRITICAL:
        yield from _opening_differences(evidence, approval, parameters)


def _physical_differences(
    evidence: Evidence, approval: ApprovalReading, parameters: Parameters
) -> Iterator[dict[str, object]]:
    impact = evidence.impact
    if isinstance(impact, DeclaredImpact):  # beside its tier, which was compared, people were shown the facts behind it
        if others := impact.contributors - approval.contributors:
            yield _difference("contributors", sorted(map(list, approval.contributors)), sorted(map(list, others)))
        return
    if not isinstance(impact, ImpactReading):
        yield _difference("impact", "computed", None)
        return
    if impact.model_digest != approval.model_digest:
        yield _difference("model_digest", approval.model_digest, impact.model_digest)
    if not impact.index_milli <= approval.index_milli + parameters.approved_index_slack_milli:
        yield _difference("index_milli", approval.index_milli, impact.index_milli)
    slack = parameters.approved_start_slack_urad
    same_joints = len(impact.start_urad) == len(approval.start_urad)
    if not same_joints or not all(
        -slack <= now - then <= slack for now, then in zip(impact.start_urad, approval.start_urad, strict=True)
    ):
        yield _difference("start_urad", list(approval.start_urad), list(impact.start_urad))
    if fresh := {(c.kind, c.object) for c in impact.contributions} - approval.contributors:
        yield _difference("contributors", sorted(map(list, approval.contributors)), sorted(map(list, fresh)))
    if impact.perception != FRESH and not approval.sees_clear:
        yield _difference("sees_clear", FRESH, impact.perception)


def _opening_differences(
    evidence: Evidence, approval: ApprovalReading, parameters: Parameters
) -> Iterator[dict[str, object]]:
    opening = prior_leave(evidence)
    if opening is None or opening.opening_id != approval.opening_id:
        yield _difference("opening", approval.opening_id, None if opening is None else opening.opening_id)
    elif not 0 <= opening.age_ms <= parameters.lease_motion_ms:
        yield _difference("opening_age_ms", parameters.lease_motion_ms, opening.age_ms)


def _too_fast(case: Case, parameters: Parameters) -> Finding | None:
    """The refusal for an approved act near people, or in an unseen cell, that is faster than people may approve."""
    impact = case.evidence.impact
    if not case.physical or not isinstance(impact, ImpactReading):
        return None
    if case.tier is not Tier.HIGH_CONSEQUENCE and impact.perception == FRESH:
        return None
    speed, contact = parameters.approved_tcp_speed_um_s, parameters.approved_contact_permille
    within_contact = impact.contact_permille <= contact or case.tier is Tier.SAFETY_CRITICAL
    if impact.tcp_speed_um_s <= speed and within_contact:
        return None
    return found(
        "",
        Reason.APPROVED_TOO_FAST,
        tcp_speed_um_s=impact.tcp_speed_um_s,
        tcp_speed_limit_um_s=speed,
        contact_permille=impact.contact_permille,
        contact_limit_permille=contact,
        nearest_permitted=impact.lower_tier_speed,
    )
