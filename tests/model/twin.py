"""The slow, obvious decision: the same promise as `policies.decide`, written a second time with other means.

Truth is a number (0 no, 1 ask, 2 yes); `all` is min, `any` is max, `not` is 2 - x. What a primitive finds is a set of (primitive, reason).
Nothing is shared with the package but its types and its table of reasons' owners.
"""

from dataclasses import replace

from capabilities.values.chain import Chain, Refusal
from capabilities.values.errors import Fault
from policies.decision.combine import AllOf, Always, AnyOf, Check, Not
from policies.evidence.evidence import (
    NOT_COLLECTED,
    ApprovalReading,
    ImpactFault,
    ImpactReading,
    OpeningReading,
    ToolReading,
    TrustReading,
)
from policies.words.reason_table import REASONS, Reason

NO, ASK, YES = 0, 1, 2
BELIEVABLE = {
    "NOT_A_NUMBER", "NOT_FINITE", "NOT_ON_GRID", "OUT_OF_RANGE", "ENGINES_DISAGREE", "STATEMENT_MALFORMED", "STATEMENT_WRONG_KIND",
    "STATEMENT_UNTRUSTED", "PHYSICS_FAULT", "UNPROVEN", "PERCEPTION_INVALID", "PERCEPTION_MISSING", "BUSY",
}  # fmt: skip


def fault_of(asker, fault):
    if fault.code == "REVOKED":
        owners = ["AID-2"] if fault.detail.startswith("sponsor") else ["AID-3"]
    else:
        owners = list(REASONS[Reason(fault.code.value)].owners)
    owner = asker if asker in owners or not owners else owners[0]
    return {(owner, fault.code.value)}


def missing(asker):
    return {(asker, "EVIDENCE_MISSING")}


def broken_chain(asker, e):
    """The findings of a chain that is not verified, or the empty set."""
    if isinstance(e.chain, Chain):
        return set()
    if isinstance(e.chain, Fault):
        return fault_of(asker, e.chain)
    return missing(asker)


def base(e):
    return e.tool.base_tier if isinstance(e.tool, ToolReading) else None


def pit(e, physical):
    if base(e) is None:
        return None
    if not physical:
        return int(base(e))
    if not isinstance(e.impact, ImpactReading):
        return None
    tiers = [int(base(e)), int(e.impact.tier)]
    if e.impact.perception != "fresh":
        tiers.append(3)
    return sorted(tiers)[-1]


def in_age(e, then, bound):
    return not (e.at - then > bound or then - e.at > 5)


def judge(primitive, r, e, physical):
    """(truth, findings) of one primitive with the default parameters of its set."""
    me = primitive.id
    if me not in {"TEA-3", "TEA-5", "CATP-3", "CII-1", "CII-2", "CII-3", "CII-4", "CII-5", "CII-6"}:
        found = broken_chain(me, e)
        if found:
            return NO, found
    c = e.chain
    if me == "AID-1":
        if isinstance(e.proof, Fault):
            return NO, fault_of(me, e.proof)
        if e.proof is NOT_COLLECTED:
            return NO, missing(me)
        if e.proof is not True:
            return NO, {(me, "PROOF_MISSING")}
        if not in_age(e, c.hops[-1].attestation.at, primitive.attestation_age_s):
            return NO, {(me, "ATTESTATION_OLD")}
        return YES, set()
    if me == "AID-2":
        if c.sponsor.subject == "" or c.sponsor.issuer == "":
            return NO, {(me, "CHAIN_BROKEN")}
        tier = pit(e, physical)
        if tier is None:
            tier = base(e)
        if tier is None:
            return NO, missing(me)
        bound = [604_800, 86_400, 28_800, 3_600, 900][tier]
        return (
            (YES, set()) if in_age(e, c.sponsor.authenticated_at, bound) else (NO, {(me, "SPONSOR_AUTHENTICATION_OLD")})
        )
    if me == "AID-3":
        if e.at < c.hops[-1].scope.not_before:
            return NO, {(me, "NOT_YET_VALID")}
        if e.at >= c.hops[-1].scope.not_after:
            return NO, {(me, "EXPIRED")}
        if c.view_age_ms < 0 or c.view_age_ms > (2_000 if physical else 30_000):
            return NO, {(me, "REVOCATION_VIEW_STALE")}
        return YES, set()
    if me in {"AID-4", "CATP-2"}:
        return YES, set()
    if me == "AID-5":
        scope = c.hops[-1].scope
        if r.audience not in scope.audiences:
            return NO, {(me, "WRONG_AUDIENCE")}
        if len(c.hops) > 9 or scope.not_after - scope.not_before > 86_400 or scope.not_after <= scope.not_before:
            return NO, {(me, "CHAIN_OUT_OF_BOUNDS")}
        return YES, set()
    if me == "CATP-3":
        if not isinstance(e.trust, TrustReading) or e.trust.score_permille < 0 or e.trust.score_permille > 1_000:
            return NO, missing(me)
        tier = pit(e, physical)
        if e.trust.score_permille < primitive.trust_theta_permille and tier not in {0, 1}:
            return ASK, {(me, "TRUST_TOO_LOW")}
        return YES, set()
    if me == "CATP-4":
        if any(not in_age(e, hop.attestation.at, primitive.attestation_age_s) for hop in c.hops):
            return NO, {(me, "ATTESTATION_OLD")}
        return YES, set()
    if me in {"TEA-1", "TEA-2"}:
        f = e.request_fault
        if f is NOT_COLLECTED:
            return NO, missing(me)
        if isinstance(f, Fault):
            return NO, fault_of(me, f)
        if isinstance(f, Refusal) and not (
            me == "TEA-1" and f.code in {"PARAMETERS_WRONG", "LIMIT_EXCEEDED_BY_REQUEST"}
        ):
            owners = REASONS[Reason(f.code.value)].owners
            return NO, {(me if me in owners or not owners else owners[0], f.code.value)}
        if me == "TEA-2":
            f = e.robot_fault
            if f is NOT_COLLECTED:
                return NO, missing(me)
            if f is not None:
                return NO, {(me, "ROBOT_LIMIT" if f.code == "LIMIT_EXCEEDED_BY_REQUEST" else f.code.value)}
        return YES, set()
    if me == "CII-4":
        if e.perception is NOT_COLLECTED:
            return NO, missing(me)
        words = {s.state for s in e.perception.sensors}
        lying = isinstance(e.impact, ImpactReading) and e.impact.perception == "fresh" and words != {"fresh"}
        if lying or words - {"fresh", "stale", "missing"}:
            return NO, {(me, "PERCEPTION_INVALID")}
        return YES, set()
    if me == "TEA-3":
        if e.tool is NOT_COLLECTED:
            return NO, missing(me)
        if not e.tool.approved_digest or e.tool.base_tier is None:
            return NO, {(me, "TOOL_UNKNOWN")}
        return (
            (YES, set()) if e.tool.approved_digest == e.tool.actual_digest else (NO, {(me, "TOOL_DEFINITION_CHANGED")})
        )
    if me == "TEA-4":
        ceiling = int(c.hops[-1].scope.ceiling)
        if isinstance(e.impact, ImpactFault):
            return NO, {(me, e.impact.reason if e.impact.reason in BELIEVABLE else "PHYSICS_FAULT")}
        if e.impact is NOT_COLLECTED:
            return NO, {(me, "ABOVE_CEILING")} if base(e) is not None and base(e) > ceiling else missing(me)
        if base(e) is None:
            return NO, missing(me)
        if e.impact.index_milli < 0 or e.impact.index_milli > 4_000:
            return NO, {(me, "PHYSICS_FAULT")}
        tier = pit(e, True)
        refused = set()
        if e.impact.violations:
            refused.add((me, "PHYSICS_VIOLATION"))
        if tier > ceiling:
            refused.add((me, "ABOVE_CEILING"))
        if refused:
            return NO, refused
        if tier == 4 and not opened(e):
            return NO, {(me, "TIER_SAFETY_CRITICAL")}
        if tier == 4:
            asked = {(me, "TIER_SAFETY_CRITICAL")}
            return ASK, asked | ({(me, "PERCEPTION_MISSING")} if e.impact.perception != "fresh" else set())
        if tier == 3:
            asked = {(me, "TIER_NEEDS_APPROVAL")}
            return ASK, asked | ({(me, "PERCEPTION_MISSING")} if e.impact.perception != "fresh" else set())
        return YES, set()
    if me == "TEA-5":
        b = e.robot
        if b is NOT_COLLECTED:
            return NO, missing(me)
        if b.robot_mode == -1:
            return NO, {(me, "ROBOT_NOT_RUNNING")}
        bad = set()
        if b.robot_mode != 7:
            bad.add((me, "ROBOT_NOT_RUNNING"))
        if b.safety_mode < 1 or b.safety_mode > 2:
            bad.add((me, "ROBOT_SAFETY_STOP"))
        if not b.remote_control:
            bad.add((me, "ROBOT_NOT_REMOTE"))
        if not b.exclusive:
            bad.add((me, "ROBOT_NOT_EXCLUSIVE"))
        if b.expected_payload_g is None or b.expected_payload_g - b.payload_g:
            bad.add((me, "PAYLOAD_MISMATCH"))
        if not b.frames_match:
            bad.add((me, "FRAMES_MISMATCH"))
        return (NO, bad) if bad else (YES, bad)
    if me.startswith("ABG"):
        return conduct(primitive, r, e, physical)
    if me.startswith("CII"):
        return said(primitive, r, e, physical)
    if me == "CATP-1":
        t = e.trust
        if t is NOT_COLLECTED:
            return NO, missing(me)
        same = len(t.edges) == len(c.hops) and all(
            a.delegator == b.delegator and a.delegate == b.agent for a, b in zip(t.edges, c.hops)
        )
        scores = [a.score_permille for a in t.edges]
        good = same and min(scores) >= 0 and max(scores) <= 800 and 0 <= t.score_permille <= sorted(scores)[0]
        return (YES, set()) if good else (NO, {(me, "TRUST_NOT_OF_EDGE")})
    if me == "TEA-6":
        s = e.sequence
        if s is NOT_COLLECTED:
            return NO, missing(me)
        bad = set()
        if s.unfinished:
            bad.add((me, "BUSY"))
        if not s.held_known:
            bad.add((me, "SEQUENCE_UNKNOWN"))
        if s.drift_urad < 0 or s.drift_urad > 20_000:
            bad.add((me, "SEQUENCE_DRIFT"))
        if s.alternations < 0 or s.alternations > 6:
            bad.add((me, "SEQUENCE_ALTERNATES"))
        if bad:
            return NO, bad
        if s.tier is None or pit(e, physical) is None:
            return NO, missing(me)
        whole = max(int(s.tier), pit(e, physical))
        if whole > int(c.hops[-1].scope.ceiling) or (whole == 4 and not opened(e)):
            return NO, {(me, "SEQUENCE_TOO_HIGH")}
        return (ASK, {(me, "SEQUENCE_NEEDS_APPROVAL")}) if whole > 2 else (YES, set())
    raise AssertionError(me)


def conduct(primitive, r, e, physical):
    """The ABG domain, for a chain that is verified."""
    me, b, leaf = primitive.id, e.behaviour, e.chain.hops[-1]
    if b is NOT_COLLECTED or b.agent != leaf.agent or b.age_ms < 0:
        return NO, missing(me)
    if physical and b.age_ms > 5_000:
        return NO, {(me, "BEHAVIOUR_OLD")}
    drift = [d for d in b.deviations if d.feature in {"near boundary", "escalation"}]
    if me == "ABG-1":
        return (ASK, {(me, "BEHAVIOUR_DEVIATES")}) if len(drift) < len(b.deviations) else (YES, set())
    if me == "ABG-2":
        return (NO, {(me, "BEHAVIOUR_DRIFTS")}) if drift else (YES, set())
    if me == "ABG-3":
        asked = b.deviated_at is not None and (physical or "e2" in r.points)
        return (NO, {(me, "REATTESTATION_NEEDED")}) if asked and leaf.attestation.at <= b.deviated_at else (YES, set())
    tier = pit(e, physical)
    harmless = tier is not None and tier <= primitive.contracted_max_tier
    return (NO, {(me, "SCOPE_CONTRACTED")}) if b.contracted and not harmless else (YES, set())


def said(primitive, r, e, physical):
    """The CII domain, but for CII-4."""
    me, bad = primitive.id, set()
    if me == "CII-1":
        i = e.instruction
        if i is NOT_COLLECTED:
            return NO, missing(me)
        for wrong, word in (
            (i.fault != "" or i.principal == "", "INSTRUCTION_UNAUTHENTIC"),
            (not i.well_formed or i.intent_digest == "", "INSTRUCTION_MALFORMED"),
            (not in_age(e, i.signed_at, 3_600), "INSTRUCTION_OLD"),
            (i.bound_digest != i.intent_digest, "INTENT_NOT_BOUND"),
        ):
            if wrong:
                return NO, {(me, word)}
        return YES, set()
    if me == "CII-6":
        m = e.message
        if m is NOT_COLLECTED:
            return NO, missing(me)
        for wrong, word in (
            (m.fault != "" or not m.by_holder, "MESSAGE_UNAUTHENTIC"),
            (not m.in_schema, "MESSAGE_MALFORMED"),
            (not m.addressed, "MESSAGE_MISDIRECTED"),
            (not m.in_sequence, "MESSAGE_OUT_OF_SEQUENCE"),
            (not m.in_delegation, "MESSAGE_OUT_OF_DELEGATION"),
            (m.age_s is None or m.age_s > 60 or m.age_s < -5, "MESSAGE_OLD"),
        ):
            if wrong:
                bad.add((me, word))
        return (NO, bad) if bad else (YES, bad)
    x = e.context
    if x is NOT_COLLECTED or (me in {"CII-2", "CII-3"} and len(x.items) == 0):
        return NO, missing(me)
    if me == "CII-2":
        for i in x.items:
            if i.as_authority and (i.label.integrity < 5 or i.label.tainted):
                bad.add((me, "TEXT_WITHOUT_AUTHORITY"))
            if i.signs and (not i.label.tainted or primitive.suspicious_admitted_count == 0):
                bad.add((me, "TEXT_SUSPICIOUS"))
    elif me == "CII-3":
        for i in [i for i in x.items if i.kind in {"document", "scenario"}]:
            if i.fault != "" or i.label.integrity < 3:
                bad.add((me, "DOCUMENT_UNSIGNED"))
            elif not i.listed:
                bad.add((me, "DOCUMENT_NOT_LISTED"))
            elif i.manifest_age_s is None or i.manifest_age_s < 0 or i.manifest_age_s > 604_800:
                bad.add((me, "MANIFEST_OLD"))
    else:
        if sorted(a.name for a in x.arguments) != ["speed"]:
            return NO, missing(me)
        for i in x.items:
            answered = i.kind == "tool response"
            if (i.kind == "memory" and (i.fault or not i.writer_authorised)) or (
                answered and (i.fault or i.label.integrity < 2)
            ):
                bad.add((me, "PROVENANCE_MISSING"))
            elif answered and not (i.of_request and i.of_pin):
                bad.add((me, "RESPONSE_MISMATCH"))
        tier = pit(e, physical)
        for a in x.arguments:
            highest = [0, primitive.agent_max_tier, *[primitive.recorded_max_tier] * 2, 4, 4][a.label.integrity]
            if a.fault or a.label.tainted:
                highest = 0
            if tier is None and highest < 4:
                bad.add((me, "EVIDENCE_MISSING"))
            elif tier is not None and tier > highest:
                bad.add((me, "ARGUMENT_NOT_VOUCHED"))
    return (NO, bad) if bad else (YES, bad)


def truth(predicate, r, e, physical):
    """(truth, findings, findings that a `not` would bring out)."""
    if isinstance(predicate, Always):
        return YES, set(), set()
    if isinstance(predicate, Check):
        value, found = judge(predicate.primitive, r, e, physical)
        return value, found, set()
    if isinstance(predicate, Not):
        value, found, hidden = truth(predicate.part, r, e, physical)
        return (ASK, found, set()) if value == ASK else (YES - value, hidden, found)
    parts = [truth(part, r, e, physical) for part in predicate.parts]
    worst = (min if isinstance(predicate, AllOf) else max)(value for value, _, _ in parts)
    assert isinstance(predicate, AllOf | AnyOf)
    if isinstance(predicate, AllOf):
        found = set().union(*(f for value, f, _ in parts if value in {NO, ASK})) if worst == NO else set()
        found = set().union(*(f for value, f, _ in parts if value == ASK)) if worst == ASK else found
        hidden = set().union(*(h for _, _, h in parts)) if worst == YES else set()
        return worst, found, hidden
    hidden = (
        set().union(*(h for value, _, h in parts if value == YES), *(f for value, f, _ in parts if value == ASK))
        if worst == YES
        else set()
    )
    found = set().union(*(f for value, f, _ in parts if value == ASK)) if worst == ASK else set()
    found = set().union(*(f for _, f, _ in parts)) if worst == NO else found
    return worst, found, hidden


def opened(e):
    """True where a person has opened the way to tier 4, and it is still open."""
    o = e.opening
    return isinstance(o, OpeningReading) and o.uses_left > 0 and o.not_after >= e.at


def fits(e, policies, physical, tier, asked):
    """True where the granted approval fits the case: a list of plain yes or no."""
    a, p, c = e.approval, policies.parameters, e.chain
    four = a.tier == 4
    yes = [
        a.state == "granted",
        isinstance(c, Chain) and c.sponsor.subject == a.sponsor,
        a.policy_digest == policies.digest,
        a.tier == tier,
        all(reason in a.reasons for _, reason in asked),
        len(set(a.approvers)) >= (2 if four else 1),
        not four or any(person != a.sponsor for person in a.approvers),
        a.uses_left > 0,
        a.not_after >= e.at,
        0 <= a.age_ms <= p.lease_motion_ms,
        not four or (opened(e) and e.opening.opening_id == a.opening_id),
        not four or (opened(e) and 0 <= e.opening.age_ms <= p.lease_motion_ms),
    ]
    if physical:
        i = e.impact
        if not isinstance(i, ImpactReading):
            return False
        yes += [
            i.model_digest == a.model_digest,
            i.index_milli - a.index_milli <= 50,
            len(i.start_urad) == len(a.start_urad),
            max((abs(x - y) for x, y in zip(i.start_urad, a.start_urad)), default=0) <= 2_000,
            all((x.kind, x.object) in a.contributors for x in i.contributions),
            a.sees_clear or i.perception == "fresh",
        ]
    return all(yes)


def answered(e, policies, physical, tier, asked):
    """Decision on a deferral after people's answer."""
    if tier == 4 and not opened(e):
        denied = {("TEA-4", "TIER_SAFETY_CRITICAL")}
        return "DENY", tier, asked | denied, denied
    a, i = e.approval, e.impact
    if not isinstance(a, ApprovalReading) or a.state == "open":
        return "DEFER", tier, asked, asked
    if a.state == "denied":
        word = ("DENY", "APPROVAL_DENIED")
    elif a.state == "used":
        word = ("DEFER", "APPROVAL_USED")
    elif (
        a.state == "granted"
        and physical
        and isinstance(i, ImpactReading)
        and (
            (i.tcp_speed_um_s > 250_000 and (tier == 3 or i.perception != "fresh"))
            or (i.contact_permille > 1_000 and tier == 3)
        )
    ):
        word = ("DENY", "APPROVED_TOO_FAST")
    elif not fits(e, policies, physical, tier, asked):
        word = ("DEFER", "APPROVAL_NOT_USABLE")
    else:
        return "PERMIT", tier, set(), set()
    lead = {("", word[1])}
    return word[0], tier, asked | lead, lead


def decide(r, e, policies):
    """(effect, tier, findings) as plain words."""
    about = [
        p
        for p in policies.policies
        if p.points & r.points
        and (p.object.ids is None or r.object in p.object.ids)
        and (p.object.operations is None or r.operation in p.object.operations)
        and r.operation not in p.object.without
    ]
    physical = about == [] or any(p.pit_bound is not None for p in about)
    tier = pit(e, physical)
    denied, deferred, permitting = set(), set(), 0
    denies = defers = False
    for p in about:
        effect = p.effect.value
        anybody = p.subject.agents is None and p.subject.sponsors is None
        if isinstance(e.chain, Chain):
            if p.subject.agents is not None and e.chain.hops[-1].agent not in p.subject.agents:
                continue
            if p.subject.sponsors is not None and e.chain.sponsor.subject not in p.subject.sponsors:
                continue
        elif not anybody and effect == "PERMIT":
            permitting += 1
            denies = True
            denied |= broken_chain("AID-1", e)
            continue
        value, found, hidden = truth(p.predicate, r, e, physical)
        if effect == "PERMIT":
            permitting += 1
            if value == NO:
                denies = True
                denied |= found
            elif value == ASK:
                defers = True
                deferred |= found
            elif p.pit_bound is not None:
                if tier is None:
                    denies = True
                    denied |= missing("TEA-4")
                elif tier >= p.pit_bound and tier == 4 and opened(e):
                    defers = True
                    deferred.add(("TEA-4", "TIER_SAFETY_CRITICAL"))
                elif tier >= p.pit_bound and tier == 4:
                    denies = True
                    denied.add(("TEA-4", "TIER_SAFETY_CRITICAL"))
                elif tier >= p.pit_bound:
                    defers = True
                    deferred.add(("TEA-4", "TIER_NEEDS_APPROVAL"))
        elif value == ASK:
            defers = True
            deferred |= found
        elif value == YES and effect == "DENY":
            denies = True
            denied |= hidden | {("", "PROHIBITED")}
        elif value == YES:
            defers = True
            deferred |= hidden | {("", "APPROVAL_REQUIRED")}
    if not permitting:
        denies = True
        denied.add(("", "NO_POLICY"))
    if denies:
        return "DENY", tier, denied | deferred, denied
    if defers:
        return answered(e, policies, physical, tier, deferred)
    return "PERMIT", tier, set(), set()


def consumes(r, e, policies):
    """True where it is permitted only because people approved it: without their answer it would be a deferral."""
    return decide(r, e, policies)[0] == "PERMIT" and decide(r, replace(e, approval=None), policies)[0] != "PERMIT"
