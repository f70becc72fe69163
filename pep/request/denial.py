"""Denials of an enforcement point itself, for reasons found after the policies decided."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from policies.evidence.model import Decision, Effect, Finding

if TYPE_CHECKING:
    from policies.evidence.model import Request
    from policies.words.reason_table import Reason


def denial(decided: Decision, reason: Reason, primitive: str = "", **detail: object) -> Decision:
    """The decision as a denial for `reason`; its own findings stay behind it."""
    return replace(
        decided,
        effect=Effect.DENY,
        reason=reason,
        primitive=primitive,
        findings=(Finding(primitive, reason, detail), *decided.findings),
        obligations=(),
        lifetime_ms=0,
        approval=None,
    )


def broken(request: Request, reason: Reason, error: Exception, *, policy_digest: str) -> Decision:
    """Denial of a request on whose way an exception came.

    Args:
        request: of it.
        reason: the code.
        error: the exception, of which the type is told.
        policy_digest: of the policy set, hex.
    """
    return Decision(
        request_id=request.request_id,
        request_digest=request.digest,
        effect=Effect.DENY,
        reason=reason,
        primitive="",
        findings=(Finding("", reason, {"error": type(error).__name__}),),
        tier=None,
        index=None,
        obligations=(),
        policy_digest=policy_digest,
        evidence=None,
        lifetime_ms=0,
    )
