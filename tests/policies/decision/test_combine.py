"""Three values and how they combine, part by part and answer by answer."""

from dataclasses import dataclass
from itertools import permutations, product

import pytest
from capabilities.values.errors import Fault, FaultCode
from policies.decision.combine import (
    PERMITS,
    SILENT,
    AllOf,
    Always,
    AnyOf,
    Check,
    Not,
    PolicyAnswer,
    checks,
    conjuncts,
    deny_overrides,
    evaluate,
)
from policies.primitives.base import Defers, Fails, Holds, age_within, chain_fault, fails, fault_owners, found, missing
from policies.words.reason_table import REASONS

from policies import Effect, PolicyError, PolicyFault, Reason


@dataclass(frozen=True)
class Fixed:
    """A primitive of one verdict."""

    id: str
    verdict: object

    def judge(self, case):
        return self.verdict


def says(name, verdict):
    return Check(Fixed(name, verdict((found(name, Reason.NOT_GRANTED),))))


GOOD = Check(Fixed("good", Holds()))
BECAUSE, BAD, ASKS = says("because", Holds), says("bad", Fails), says("asks", Defers)
RANK = {Fails: 0, Defers: 1, Holds: 2}
PARTS = (GOOD, BECAUSE, BAD, ASKS)


@pytest.mark.parametrize(("connective", "name"), [(AllOf, "all"), (AnyOf, "any")])
def test_a_connective_of_nothing_does_not_exist(connective, name):
    with pytest.raises(PolicyError) as error:
        connective(())
    assert (error.value.code, error.value.where) == (PolicyFault.EMPTY, name)


def verdict_of(predicate):
    return evaluate(predicate, None)


def names(verdict):
    findings = verdict.because if isinstance(verdict, Holds) else verdict.findings
    return [finding.primitive for finding in findings]


@pytest.mark.parametrize("parts", [*product(PARTS, repeat=1), *product(PARTS, repeat=2), *product(PARTS, repeat=3)])
def test_all_is_the_least_and_any_the_greatest(parts):
    ranks = [RANK[type(verdict_of(part))] for part in parts]
    assert RANK[type(verdict_of(AllOf(parts)))] == min(ranks)
    assert RANK[type(verdict_of(AnyOf(parts)))] == max(ranks)


def test_not_turns_round_and_keeps_what_was_found():
    assert verdict_of(Not(BAD)) == Holds(BAD.primitive.verdict.findings)
    assert verdict_of(Not(BECAUSE)) == Fails(BECAUSE.primitive.verdict.because)
    assert verdict_of(Not(ASKS)) == ASKS.primitive.verdict
    assert verdict_of(Not(GOOD)) == Fails()
    assert verdict_of(Always()) == Holds()
    assert verdict_of(Not(Always())) == Fails()


@pytest.mark.parametrize(
    ("predicate", "found_by"),
    [
        (AllOf((GOOD, GOOD)), []),
        (AllOf((BECAUSE, GOOD, BECAUSE)), ["because", "because"]),
        (AllOf((ASKS, BECAUSE, GOOD)), ["asks"]),
        (AllOf((ASKS, BAD, BECAUSE)), ["bad", "asks"]),
        (AnyOf((BAD, BAD)), ["bad", "bad"]),
        (AnyOf((BAD, ASKS)), ["asks"]),
        (AnyOf((BAD, ASKS, BECAUSE)), ["because", "asks"]),
        (AnyOf((GOOD, BAD)), []),
    ],
)
def test_what_decided_is_what_is_told(predicate, found_by):
    assert names(verdict_of(predicate)) == found_by


def test_every_primitive_of_a_predicate_with_the_parity_above_it():
    predicate = AllOf((GOOD, Not(AnyOf((BAD, Not(ASKS)))), Always(), Not(Always())))
    told = [(primitive.id, negated) for primitive, negated in checks(predicate)]
    assert told == [("good", False), ("bad", True), ("asks", False)]
    assert [negated for _, negated in checks(predicate, negated=True)] == [True, False, True]


def test_what_a_predicate_cannot_hold_without():
    predicate = AllOf((GOOD, AllOf((BAD, AnyOf((ASKS,)))), Not(BECAUSE), Always()))
    assert [primitive.id for primitive in conjuncts(predicate)] == ["good", "bad"]


def denied(*findings):
    return PolicyAnswer(Effect.DENY, findings, grants=True)


def asked(*findings):
    return PolicyAnswer(Effect.DEFER, findings, grants=True)


SCOPE, LIMIT, GATE = (
    found("TEA-1", Reason.NOT_GRANTED),
    found("TEA-2", Reason.LIMIT_EXCEEDED_BY_REQUEST),
    found("TEA-4", Reason.TIER_NEEDS_APPROVAL),
)


@pytest.mark.parametrize(
    ("answers", "effect", "findings"),
    [
        ((PERMITS,), Effect.PERMIT, ()),
        ((PERMITS, SILENT), Effect.PERMIT, ()),
        ((PERMITS, asked(GATE)), Effect.DEFER, (GATE,)),
        ((PERMITS, asked(GATE), denied(SCOPE)), Effect.DENY, (SCOPE, GATE)),
        ((PERMITS, denied(SCOPE), asked(SCOPE, GATE)), Effect.DENY, (SCOPE, GATE)),
        ((denied(SCOPE), denied(SCOPE, LIMIT)), Effect.DENY, (SCOPE, LIMIT)),
    ],
)
def test_deny_overrides_whatever_the_order(answers, effect, findings):
    for order in permutations(answers):
        assert deny_overrides(iter(order)) == (effect, findings)


def test_nothing_is_permitted_that_no_policy_grants():
    nobody = found("", Reason.NO_POLICY)
    question = PolicyAnswer(Effect.DEFER, (GATE,))
    assert deny_overrides(()) == (Effect.DENY, (nobody,))
    assert deny_overrides((SILENT,)) == (Effect.DENY, (nobody,))
    assert deny_overrides((question,)) == (Effect.DENY, (nobody, GATE))
    assert deny_overrides((PolicyAnswer(Effect.DENY, (SCOPE,)),))[0] is Effect.DENY
    assert deny_overrides((question, PERMITS)) == (Effect.DEFER, (GATE,))
    assert not PolicyAnswer(Effect.DEFER).grants
    assert (SILENT.effect, SILENT.findings) == (None, ())


def test_of_two_that_say_the_same_the_fuller_one_is_told():
    short, long, other = (found("TEA-1", Reason.NOT_GRANTED, **detail) for detail in ({}, {"a": 1}, {"a": 2}))
    for some, told in (
        ((short, long), long),
        ((short, long, other), other),
        ((long, other), other),
        ((short, short), short),
    ):
        for order in permutations(some):
            assert deny_overrides([denied(finding) for finding in order]) == (Effect.DENY, (told,))


def test_the_owner_of_a_reason_leads_then_its_other_owners_then_strangers_by_id():
    reason = Reason.NOT_NARROWER
    first, second = REASONS[reason].owners
    by = [first, second, "AID-1", "TEA-9"]
    for order in permutations(by):
        _, findings = deny_overrides([denied(*(found(name, reason) for name in order))])
        assert [finding.primitive for finding in findings] == by


NOW = 1_000.0


@pytest.mark.parametrize(
    ("since", "age"), [(1_000, 0.0), (900, 100.0), (899, None), (1_005, -5.0), (1_006, None), (1_001, -1.0)]
)
def test_an_age_is_inside_both_bounds_or_none(since, age):
    assert age_within(NOW, since, bound_s=100, skew_s=5) == age


@pytest.mark.parametrize("now", [float("nan"), float("inf"), float("-inf")])
def test_no_age_at_no_time(now):
    assert age_within(now, 0, bound_s=100, skew_s=5) is None


def test_whose_a_fault_is():
    assert fault_owners(Fault(FaultCode.REVOKED, "TOK-9", "sponsor alice")) == ("AID-2",)
    assert fault_owners(Fault(FaultCode.REVOKED, "TOK-9", "hop 1")) == ("AID-3",)
    assert fault_owners(Fault(FaultCode.NOT_NARROWER, "TOK-6")) == ("CATP-2", "AID-4")


def test_a_fault_is_told_by_its_owner_and_without_its_detail():
    fault = Fault(FaultCode.NOT_NARROWER, "TOK-6", "secret")
    for asking, tells in (("AID-4", "AID-4"), ("CATP-2", "CATP-2"), ("TEA-1", "CATP-2")):
        (finding,) = chain_fault(asking, fault).findings
        assert (finding.primitive, finding.reason) == (tells, Reason.NOT_NARROWER)
        assert finding.detail == {"clause": "TOK-6", "remedy": REASONS[Reason.NOT_NARROWER].remedy}


def test_a_refusal_is_one_finding_with_its_remedy():
    row = REASONS[Reason.NOT_GRANTED]
    (finding,) = fails("TEA-1", Reason.NOT_GRANTED, a=1).findings
    assert (finding.primitive, finding.reason, finding.detail) == (
        "TEA-1",
        Reason.NOT_GRANTED,
        {"a": 1, "remedy": row.remedy},
    )
    (finding,) = missing("TEA-1", "chain").findings
    assert (finding.primitive, finding.reason, finding.detail["evidence"]) == (
        "TEA-1",
        Reason.EVIDENCE_MISSING,
        "chain",
    )
