"""`policies.decide` against its slow twin, on random triples from a printed seed."""

import os
import random

import pytest
from policies.decision.obligations import CONSUME
from policies.words.reason_table import PRECEDENCE
from tests.model import triples, twin

from policies import decide

ROUNDS = int(os.environ.get("ZTPM_TWIN_ROUNDS", "400"))
"""Triples for each seed; a campaign sets more."""


def disagreement(request, evidence, policies):
    """In what `decide` and its slow twin differ; "" for nothing."""
    decision = decide(request, evidence, policies)
    effect, tier, findings, leading = twin.decide(request, evidence, policies)
    said = {(f.primitive, f.reason.value) for f in decision.findings}
    told = {
        "effect": decision.effect.value == effect,
        "tier": decision.tier == tier,
        "findings": said == findings,
        "approval": (decision.approval is not None) == twin.consumes(request, evidence, policies),
        "use": (CONSUME in decision.obligations) == (decision.approval is not None),
    }
    if effect == "PERMIT":
        told["reason"] = decision.reason.value == "PERMITTED"
    elif said == findings:
        told["leading"] = (decision.primitive, decision.reason.value) in leading
        told["order"] = decision.reason == min(
            (f.reason for f in decision.findings if (f.primitive, f.reason.value) in leading), key=PRECEDENCE.index
        )
    return ", ".join(what for what, agreed in told.items() if not agreed)


@pytest.mark.parametrize("seed", range(10))
def test_decide_agrees_with_the_slow_twin(seed):
    pick = random.Random(seed).choice
    for number in range(ROUNDS):
        assert disagreement(*triples.triple(pick)) == "", f"seed {seed}, triple {number}"


@pytest.mark.long
def test_the_random_triples_reach_every_effect_and_most_reasons():
    """A differential test that only ever sees denials proves little."""
    pick = random.Random(1).choice
    seen = {"effects": {}, "reasons": set()}
    by_people = 0
    for _ in range(6_000):
        decision = decide(*triples.triple(pick))
        seen["effects"][decision.effect] = seen["effects"].get(decision.effect, 0) + 1
        seen["reasons"].add(decision.reason)
        by_people += decision.approval is not None
    assert len(seen["effects"]) == 3
    assert min(seen["effects"].values()) > 100, seen["effects"]
    assert len(seen["reasons"]) > 30
    assert by_people > 50
    assert {"APPROVAL_DENIED", "APPROVED_TOO_FAST", "APPROVAL_USED", "APPROVAL_NOT_USABLE"} <= seen["reasons"]
    assert "POLICY_ERROR" not in seen["reasons"]
