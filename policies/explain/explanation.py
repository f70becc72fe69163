"""Explanation of a decision: every policy, every primitive, and the combination of their answers. Pure.

It asks the same functions as `policies.decision.pdp.decide` and decides nothing itself: the decision of an explanation
is that of `decide`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, assert_never

from capabilities.values.chain import Chain
from policies.decision import pdp
from policies.decision.combine import AllOf, Always, AnyOf, Check, Not, Predicate, evaluate
from policies.decision.policy import Concern, requirement
from policies.evidence.model import Effect
from policies.evidence.tiers import runtime_tier
from policies.primitives.base import Case, Defers, Fails, Holds, Verdict
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from policies.decision.policy import Policy, PolicySet
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision, Finding, Request
    from policies.primitives.base import Primitive


@dataclass(frozen=True, slots=True)
class PredicateVerdict:
    """One node of a predicate with its verdict.

    Attributes:
        what: a primitive's id, or "all", "any", "not" or "always".
        verdict: "holds", "fails", "defers", or "raises" for a primitive that broke.
        findings: of this very node; of a connective none, since they are those of its parts.
        parameters: of a primitive, by name.
        parts: of a connective.
    """

    what: str
    verdict: str
    findings: tuple[Finding, ...] = ()
    parameters: tuple[tuple[str, int], ...] = ()
    parts: tuple[PredicateVerdict, ...] = ()


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a policy beside that of the request: "point", "object", "operation", "agent" or "sponsor"."""

    what: str
    of_policy: str
    of_request: str
    meant: Concern


@dataclass(frozen=True, slots=True)
class PolicyExplanation:
    """Explanation of one policy's answer.

    Attributes:
        policy: the explained one.
        concern: whether it concerns the request: every part of it is meant.
        parts: the verdict on each of these parts.
        predicate: its verdict, part for part; None where nothing was asked.
        effect: the answer of the policy; None for no opinion.
        findings: the reasons of that answer.
    """

    policy: Policy
    concern: Concern
    parts: tuple[Part, ...]
    predicate: PredicateVerdict | None
    effect: Effect | None
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A decision and everything that led to it.

    Attributes:
        decision: of `decide`.
        physical: whether the set makes the answer depend on the physical impact.
        said: the answer of each policy of the set, in the set's order.
        combined: how these make the decision, one sentence a step.
    """

    request: Request
    decision: Decision
    physical: bool
    said: tuple[PolicyExplanation, ...]
    combined: tuple[str, ...]

    @property
    def text(self) -> str:
        """The fixed sentence of the leading reason."""
        return REASONS[self.decision.reason].text

    @property
    def remedy(self) -> str:
        """Remedy of the leading reason, for the holder."""
        return REASONS[self.decision.reason].remedy


def explain(request: Request, evidence: Evidence, policies: PolicySet) -> Explanation:
    """Explanation of the answer of `policies` to `request` on `evidence`.

    Total, as `decide` is: where the evidence is so broken that nothing was asked, the policies say nothing.
    """
    decision = pdp.decide(request, evidence, policies)
    if not decision.evidence_digest:
        return Explanation(request, decision, physical=True, said=(), combined=("nothing was asked: DENY",))
    physical = requirement(request, policies).physical
    case = Case(request, evidence, physical, runtime_tier(evidence, physical=physical))
    said = tuple(_said(policy, case) for policy in policies.policies)
    return Explanation(request, decision, physical, said, _combined(said, decision))


def _said(policy: Policy, case: Case) -> PolicyExplanation:
    parts = _parts(policy, case)
    concern = policy.concerns(case.request)
    if concern is Concern.YES:
        concern = policy.subject.concern(case.evidence)
    if concern is Concern.NO:
        return PolicyExplanation(policy, concern, parts, None, None, ())
    answer = pdp._answer(policy, case)  # noqa: SLF001 - the very function that decides; a second one could differ
    unspoken = concern is Concern.UNKNOWN and policy.effect is Effect.PERMIT
    asked = None if unspoken else _asked(policy.predicate, case)
    return PolicyExplanation(policy, concern, parts, asked, answer.effect, answer.findings)


def _parts(policy: Policy, case: Case) -> tuple[Part, ...]:
    """Each part of the policy's subject, object and points beside the request's."""
    request, chain, thing = case.request, case.evidence.chain, policy.object
    agent, sponsor = (chain.leaf.agent, chain.sponsor.subject) if isinstance(chain, Chain) else (None, None)
    operations = _names(thing.operations) + (f" without {_names(thing.without)}" if thing.without else "")
    meant = (thing.operations is None or request.operation in thing.operations) and (
        request.operation not in thing.without
    )
    return (
        Part("point", _names(policy.points), _names(request.points), _concern(bool(policy.points & request.points))),
        Part("object", _names(thing.ids), request.object, _concern(thing.ids is None or request.object in thing.ids)),
        Part("operation", operations, request.operation, _concern(meant)),
        _of_subject("agent", policy.subject.agents, agent),
        _of_subject("sponsor", policy.subject.sponsors, sponsor),
    )


def _of_subject(what: str, named: frozenset[str] | None, caller: str | None) -> Part:
    shown = "nobody knows" if caller is None else caller
    if named is None:
        return Part(what, "any", shown, Concern.YES)
    return Part(what, _names(named), shown, Concern.UNKNOWN if caller is None else _concern(caller in named))


def _concern(meant: bool) -> Concern:  # noqa: FBT001 - a plain translation
    return Concern.YES if meant else Concern.NO


def _names(names: frozenset[str] | None) -> str:
    return "any" if names is None else " ".join(sorted(map(str, names)))


def _asked(predicate: Predicate, case: Case) -> PredicateVerdict:
    match predicate:
        case Check(primitive):
            return _judged(primitive, case)
        case Always():
            return PredicateVerdict("always", "holds")
        case AllOf(parts) | AnyOf(parts):
            what = "all" if isinstance(predicate, AllOf) else "any"
            return PredicateVerdict(what, _verdict(predicate, case), parts=tuple(_asked(part, case) for part in parts))
        case Not(part):
            return PredicateVerdict("not", _verdict(predicate, case), parts=(_asked(part, case),))
        case _:
            assert_never(predicate)


def _judged(primitive: Primitive, case: Case) -> PredicateVerdict:
    parameters = tuple((f.name, getattr(primitive, f.name)) for f in fields(primitive))  # type: ignore[arg-type]
    try:
        verdict = primitive.judge(case)
    except Exception:  # noqa: BLE001 - a primitive that breaks makes its policy deny, and the explanation says so
        return PredicateVerdict(primitive.id, "raises", parameters=parameters)
    match verdict:
        case Holds(findings) | Fails(findings) | Defers(findings):
            return PredicateVerdict(primitive.id, _word(verdict), findings, parameters)
        case _:
            assert_never(verdict)


def _verdict(predicate: Predicate, case: Case) -> str:
    try:
        return _word(evaluate(predicate, case))
    except Exception:  # noqa: BLE001 - likewise
        return "raises"


def _word(verdict: Verdict) -> str:
    match verdict:
        case Holds():
            return "holds"
        case Fails():
            return "fails"
        case Defers():
            return "defers"
        case _:
            assert_never(verdict)


def _combined(said: tuple[PolicyExplanation, ...], decision: Decision) -> tuple[str, ...]:
    """Steps of combining: deny-overrides, then DEFER over PERMIT, then people's answer."""
    steps = []
    for effect in (Effect.DENY, Effect.DEFER, Effect.PERMIT):
        who = [s.policy.id for s in said if s.effect is effect]
        if who:
            steps.append(f"{effect}: {', '.join(who)}")
    grants = any(s.policy.effect is Effect.PERMIT and s.effect is not None for s in said)
    if not grants:
        steps.append("no policy that may permit concerns the request: DENY")
    effects = {s.effect for s in said}
    if Effect.DENY in effects or not grants:
        steps.append("DENY overrides")
    elif Effect.DEFER in effects:
        steps.append("DEFER goes over PERMIT")
        if decision.approval is not None:
            steps.append(f"use {decision.approval.use} of approval {decision.approval.ask_id} resolves it: PERMIT")
        elif decision.effect is Effect.DENY:
            steps.append("no person's answer makes it a PERMIT: DENY")
        elif decision.reason in (Reason.APPROVAL_USED, Reason.APPROVAL_NOT_USABLE):
            steps.append("there is an answer, and it does not count for this case")
        else:
            steps.append("nobody has answered")
    else:
        steps.append("nothing denies or defers: PERMIT")
    return tuple(steps)
