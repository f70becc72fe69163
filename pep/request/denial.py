"""A denial that is an enforcement point's own: not what the policies say, but what it found on the way."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from policies.evidence.model import Effect, Finding

if TYPE_CHECKING:
    from policies.evidence.model import Decision
    from policies.words.reason_table import Reason


def denial(decided: Decision, reason: Reason, primitive: str = "", **detail: object) -> Decision:
    """`decided` turned into a denial for `reason`; its own findings stay behind it."""
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
