"""Denial of an enforcement point's own: only the findings of the replaced PERMIT are left."""

from __future__ import annotations

from pep.request.denial import denial
from policies.evidence.model import ApprovalUse, Decision, Effect, Finding, Obligation, ObligationKind
from policies.words.reason_table import Reason

FOUND = Finding("TEA-4", Reason.PERMITTED, {"policy": "act"})
PERMIT = Decision(
    request_id="r",
    request_digest="ab" * 32,
    effect=Effect.PERMIT,
    reason=Reason.PERMITTED,
    primitive="",
    findings=(FOUND,),
    tier=None,
    index=900,
    obligations=(Obligation(ObligationKind.WATCH),),
    policy_digest="cd" * 32,
    evidence=None,
    lifetime_ms=50,
    approval=ApprovalUse("a1", 1),
)


def test_a_denial_binds_to_nothing_uses_nothing_and_is_over():
    found = denial(PERMIT, Reason.EFFECT_FAILED, "TEA-6", error="OSError")
    assert (found.effect, found.reason, found.primitive) == (Effect.DENY, Reason.EFFECT_FAILED, "TEA-6")
    assert (found.obligations, found.lifetime_ms, found.approval) == ((), 0, None)
    assert found.findings == (Finding("TEA-6", Reason.EFFECT_FAILED, {"error": "OSError"}), FOUND)
    assert (found.request_id, found.request_digest, found.index) == ("r", "ab" * 32, 900)
