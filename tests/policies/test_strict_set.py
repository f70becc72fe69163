"""The stricter shipped set permits nothing that the default one does not, and every number of it is inside."""

import random
from dataclasses import replace

import pytest
from tests.model import triples
from tests.policies import world

from policies import NOT_COLLECTED, PARAMETERS, Effect, Point, Reason, decide, load_shipped

pytestmark = pytest.mark.version

DEFAULT, STRICT = load_shipped("paper-default"), load_shipped("strict")
SEVERITY = {Effect.PERMIT: 0, Effect.DEFER: 1, Effect.DENY: 2}
RISING = {"trust_theta_permille"}
"""Parameters of which more is stricter; of all others less is."""


def test_every_number_is_inside_that_of_the_default_set():
    for name in PARAMETERS:
        ours, theirs = getattr(STRICT.parameters, name), getattr(DEFAULT.parameters, name)
        assert ours >= theirs if name in RISING else ours <= theirs, name


@pytest.mark.long
def test_nothing_is_permitted_that_the_default_set_does_not_permit():
    pick = random.Random(30).choice
    seen = {effect: 0 for effect in Effect}
    for _ in range(4_000):
        request, evidence = triples.request(pick), replace(triples.evidence(pick), approval=None)
        strict, default = decide(request, evidence, STRICT), decide(request, evidence, DEFAULT)
        assert SEVERITY[strict.effect] >= SEVERITY[default.effect], (request, evidence)
        seen[default.effect] += 1
    assert all(count > 20 for count in seen.values()), seen


def test_a_number_of_the_agents_own_is_believed_up_to_tier_1():
    request, evidence = world.asked()
    assert decide(request, evidence, STRICT).effect is Effect.PERMIT
    request, evidence = world.asked({"evidence.impact.tier": 2, "evidence.sequence.tier": 2})
    decision = decide(request, evidence, STRICT)
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.ARGUMENT_NOT_VOUCHED)
    vouched = {f"evidence.context.arguments.{n}.label.integrity": 5 for n in (0, 1)}
    request, evidence = world.asked({"evidence.impact.tier": 2, "evidence.sequence.tier": 2, **vouched})
    decision = decide(request, evidence, STRICT)
    assert (decision.effect, decision.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)


def test_nothing_suspicious_is_admitted():
    given = {"evidence.context.items.0.signs": ["hidden text"], "evidence.context.items.0.label.tainted": True}
    request, evidence = world.asked({**given, "request.operation": "retrieve", "request.object": "context"})
    request = replace(request, points=frozenset({Point.CONTEXT}))
    assert decide(request, evidence, DEFAULT).effect is Effect.PERMIT
    assert decide(request, evidence, STRICT).reason is Reason.TEXT_SUSPICIOUS


def test_a_stop_is_asked_for_as_little_as_ever():
    request, evidence = world.asked({"request.operation": "stop", "request.values": []})
    bare = replace(
        evidence, impact=NOT_COLLECTED, robot=NOT_COLLECTED, trust=NOT_COLLECTED, context=NOT_COLLECTED,
        behaviour=NOT_COLLECTED, sequence=NOT_COLLECTED, perception=NOT_COLLECTED,
    )  # fmt: skip
    assert decide(request, bare, STRICT).effect is Effect.PERMIT
