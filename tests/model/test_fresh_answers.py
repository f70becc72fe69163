"""Fresh answers: earlier decisions, neighbours and order change nothing (bars B2 and B4)."""

import dataclasses
import os
import random
from concurrent.futures import ThreadPoolExecutor

import pytest
from policies.words import canonical
from tests.model import triples

from policies import PolicySet, decide, load_shipped

ROUNDS = int(os.environ.get("ZTPM_FRESH_ROUNDS", "150"))
"""Cases for each seed; a campaign sets more."""
SHIPPED = load_shipped("paper-default")


def unused(policies):
    """The same set, which has decided nothing yet."""
    return PolicySet(policies.name, policies.version, policies.policies, policies.parameters)


def digest(decision):
    return canonical.digest("decision", decision)


def changed_once(pick, request, evidence):
    """One input is another one: a reading, or a part of the request."""
    other_request, other_evidence = triples.request(pick), triples.evidence(pick)
    if pick(range(3)) == 0:
        name = pick([field.name for field in dataclasses.fields(request)])
        return dataclasses.replace(request, **{name: getattr(other_request, name)}), evidence
    name = pick([field.name for field in dataclasses.fields(evidence)])
    return request, dataclasses.replace(evidence, **{name: getattr(other_evidence, name)})


@pytest.mark.parametrize("seed", range(4))
def test_the_answer_follows_each_input(seed):
    pick = random.Random(seed).choice
    for _ in range(ROUNDS // 10):
        request, evidence, drawn = triples.triple(pick)
        used = pick([drawn, SHIPPED])
        decide(request, evidence, used)
        for _ in range(10):
            request, evidence = changed_once(pick, request, evidence)
            assert decide(request, evidence, used) == decide(request, evidence, unused(used))


@pytest.mark.long
def test_batches_singles_orders_and_threads_agree():
    pick = random.Random(9).choice
    cases = [(*triples.triple(pick)[:2], pick([SHIPPED, triples.policy_set(pick)])) for _ in range(ROUNDS)]
    singles = [digest(decide(request, evidence, unused(policies))) for request, evidence, policies in cases]
    assert [digest(decide(*case)) for case in cases] == singles
    chance = random.Random(10)
    for _ in range(16):
        order = list(range(len(cases)))
        chance.shuffle(order)
        assert {n: digest(decide(*cases[n])) for n in order} == dict(enumerate(singles))
    with ThreadPoolExecutor(8) as pool:
        for _ in range(4):
            assert list(pool.map(lambda case: digest(decide(*case)), cases)) == singles


def test_an_answer_that_is_kept_by_too_little_is_seen(monkeypatch):
    """A set that knows a plan by its operation alone, for any points and object, is seen."""
    plan, kept = PolicySet.plan, {}

    def by_operation(self, request):
        return kept.setdefault((id(self), request.operation), plan(self, request))

    pick = random.Random(11).choice
    wrong = 0
    for _ in range(400):
        request, evidence, policies = triples.triple(pick)
        expected = decide(request, evidence, unused(policies))
        other = dataclasses.replace(triples.request(pick), operation=request.operation)
        with monkeypatch.context() as patched:
            patched.setattr(PolicySet, "plan", by_operation)
            decide(other, evidence, policies)
            wrong += decide(request, evidence, policies) != expected
    assert wrong
