"""Obligations: those of a PERMIT, and those of the findings of a DENY."""

from dataclasses import replace
from importlib import resources

import pytest
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Unit
from policies.decision.obligations import AFTER, LOWER_TRUST, NOTIFY, REATTEST, RECORD
from tests.policies import world

from policies import (
    Effect,
    Obligation,
    ObligationKind,
    PolicyError,
    PolicyFault,
    PolicySet,
    Reason,
    decide,
    load,
    load_shipped,
)

SET = load_shipped("paper-default")
TEXT = resources.files("policies").joinpath("sets", "paper-default.toml").read_text("utf-8")
KIND = ObligationKind


def kinds(decision):
    return [o.kind for o in decision.obligations]


def answer(given=None, policies=SET):
    return decide(*world.asked(given), policies)


def test_a_physical_permit_holds_up_to_the_speed_that_was_decided():
    request, evidence = world.asked()
    (speed,) = [v for v in request.values if v.name == "speed"]
    decision = decide(request, evidence, SET)
    assert kinds(decision) == [KIND.CLAMP, KIND.RECORD, KIND.WATCH]
    assert decision.obligations[0].at_most == speed
    slower = Quantity("speed", speed.unit, speed.value - 1)
    again = decide(replace(request, values=tuple(slower if v is speed else v for v in request.values)), evidence, SET)
    assert again.obligations[0].at_most == slower


def test_what_has_no_speed_or_no_physical_dependency_is_not_clamped():
    assert KIND.CLAMP not in kinds(answer({"request.operation": "read_state"}))
    arguments = world.WORLD["evidence"]["context"]["arguments"]
    request, evidence = world.asked({"evidence.context.arguments": [a for a in arguments if a["name"] != "speed"]})
    still = replace(request, values=tuple(v for v in request.values if v.name != "speed"))
    assert kinds(decide(still, evidence, SET)) == [KIND.RECORD, KIND.WATCH]


def test_a_permit_by_people_consumes_and_clamps():
    decision = decide(*world.approved(Tier.HIGH_CONSEQUENCE))
    assert kinds(decision) == [KIND.CLAMP, KIND.CONSUME, KIND.RECORD, KIND.WATCH]


@pytest.mark.parametrize(
    ("given", "owed"),
    [
        ({"evidence.chain": {"fault": "NOT_NARROWER"}}, [LOWER_TRUST, RECORD]),
        ({"evidence.chain": {"fault": "SIGNATURE_INVALID"}}, [LOWER_TRUST, RECORD]),
        ({"evidence.proof": {"fault": "REPLAYED"}}, [LOWER_TRUST, RECORD]),
        ({"evidence.impact.tier": 3, "evidence.chain.hops.1.ceiling": 2}, [LOWER_TRUST, RECORD]),
        ({"evidence.request_fault": {"refusal": "NOT_GRANTED"}}, [LOWER_TRUST, RECORD]),
        ({"evidence.request_fault": {"refusal": "LIMIT_EXCEEDED_BY_REQUEST"}}, [RECORD]),
        ({"evidence.chain": {"fault": "EXPIRED"}}, [RECORD]),
        ({"evidence.request_fault": {"fault": "ENGINES_DISAGREE"}}, [NOTIFY, RECORD]),
        ({"evidence.tool.actual_digest": "ff" * 32}, [NOTIFY, RECORD]),
        ({"evidence.chain.hops.0.attested_at": 900_000}, [REATTEST, RECORD]),
        ({"evidence.proof": {"fault": "REPLAYED"}, "evidence.tool.actual_digest": "ff" * 32}, [LOWER_TRUST, NOTIFY, RECORD]),
        ({"evidence.impact.tier": 3}, [RECORD]),
        ({"evidence.impact.tier": 3, "evidence.proof": {"fault": "PROOF_STALE"}}, [RECORD]),
    ],
)  # fmt: skip
def test_what_a_refusal_found_obliges(given, owed):
    decision = answer(given)
    assert decision.effect is not Effect.PERMIT
    assert list(decision.obligations) == owed


def test_what_cannot_be_decided_is_told_to_a_person():
    assert list(decide(None, None, SET).obligations) == [NOTIFY, RECORD]


def test_no_reason_of_a_permit_or_of_people_obliges_to_more_than_the_record():
    assert (
        not {Reason.PERMITTED, Reason.APPROVAL_DENIED, Reason.TIER_NEEDS_APPROVAL, Reason.TRUST_TOO_LOW} & AFTER.keys()
    )


def asking(text, *, of='id = "impact"'):
    """The shipped set, where the policy `of` also asks for `text`."""
    head, mark, tail = TEXT.partition(of)
    return head + mark + tail.replace('obligation = ["record"', f'obligation = ["record", {text}', 1)


@pytest.mark.parametrize("word", ["notify", "re-attest", "lower trust"])
def test_a_policy_may_ask_for_it_with_its_permit(word):
    policies = load(asking(f'"{word}"'))
    assert KIND(word) in kinds(answer(policies=policies))
    assert KIND(word) not in kinds(answer({"evidence.impact.tier": 3}, policies)), "it was not its PERMIT"


@pytest.mark.parametrize("word", ["clamp", "consume approval"])
def test_what_only_a_decision_knows_no_policy_asks_for(word):
    with pytest.raises(PolicyError) as error:
        load(asking(f'"{word}"'))
    assert error.value.code is PolicyFault.UNKNOWN_VALUE
    assert error.value.where.endswith(".obligation")


def test_a_clamp_and_a_bound_come_together():
    bound = Quantity("speed", Unit.MICRORADIAN_PER_SECOND, 1)
    assert Obligation(KIND.CLAMP, bound).at_most == bound
    for kind, at_most in [(KIND.CLAMP, None), *((kind, bound) for kind in KIND if kind is not KIND.CLAMP)]:
        with pytest.raises(PolicyError) as error:
            Obligation(kind, at_most)
        assert error.value.code is PolicyFault.UNKNOWN_VALUE


FORBIDDING = """
[[policy]]
id = "no-{word}"
subject = {{ agents = "any", sponsors = "any" }}
object = {{ ids = "any", operations = ["{operation}"] }}
predicate = "always"
ep = ["e4"]
effect = "{effect}"
obligation = ["record", "{word}"]
pit_bound = "none"
"""


@pytest.mark.parametrize("effect", ["DENY", "DEFER"])
def test_a_prohibition_or_question_that_speaks_obliges_and_a_silent_one_does_not(effect):
    speaks = load(TEXT + FORBIDDING.format(word="notify", operation="move_joint", effect=effect))
    silent = load(TEXT + FORBIDDING.format(word="notify", operation="read_state", effect=effect))
    assert list(answer(policies=speaks).obligations) == [NOTIFY, RECORD]
    assert answer(policies=silent).effect is Effect.PERMIT
    assert NOTIFY not in answer(policies=silent).obligations


def test_a_question_that_was_overruled_by_a_denial_obliges_to_nothing():
    asked = load(TEXT + FORBIDDING.format(word="notify", operation="move_joint", effect="DEFER"))
    assert list(answer({"evidence.chain": {"fault": "EXPIRED"}}, asked).obligations) == [RECORD]


def test_a_prohibition_that_is_silent_while_another_policy_denies_obliges_to_nothing():
    silent = FORBIDDING.format(word="notify", operation="move_joint", effect="DENY").replace(
        '"always"', '{ not = "CATP-3" }'
    )
    assert list(answer({"evidence.chain": {"fault": "EXPIRED"}}, load(TEXT + silent)).obligations) == [RECORD]
    assert NOTIFY in answer({"evidence.trust": "not collected"}, load(TEXT + silent)).obligations


def test_the_order_of_policies_does_not_matter():
    policies = load(asking('"notify"') + FORBIDDING.format(word="re-attest", operation="read_state", effect="DENY"))
    other = PolicySet(policies.name, policies.version, policies.policies[::-1], policies.parameters)
    for given in ({}, {"request.operation": "read_state"}):
        assert answer(given, policies).obligations == answer(given, other).obligations


OWED = {
    LOWER_TRUST: """
        SIGNATURE_INVALID HOP_NOT_ATTESTED NOT_CANONICAL CHAIN_BROKEN
        NOT_NARROWER PROOF_WRONG_KEY PROOF_NOT_FOR_THIS_REQUEST REPLAYED
        DELEGATE_NOT_ALLOWED NOT_GRANTED ABOVE_CEILING INSTRUCTION_UNAUTHENTIC
        INTENT_NOT_BOUND TEXT_WITHOUT_AUTHORITY MESSAGE_UNAUTHENTIC MESSAGE_OUT_OF_DELEGATION
    """,
    REATTEST: """
        ATTESTATION_INVALID ATTESTATION_OLD REATTESTATION_NEEDED BEHAVIOUR_DEVIATES
    """,
    NOTIFY: """
        POLICY_ERROR ENGINES_DISAGREE PHYSICS_FAULT PERCEPTION_INVALID
        STATEMENT_UNTRUSTED TOOL_DEFINITION_CHANGED DOCUMENT_UNSIGNED TRUST_NOT_OF_EDGE
        BEHAVIOUR_DRIFTS SCOPE_CONTRACTED
    """,
}


@pytest.mark.parametrize("owed", OWED)
def test_what_each_reason_obliges_to(owed):
    assert {str(reason) for reason, what in AFTER.items() if what is owed} == set(OWED[owed].split())
