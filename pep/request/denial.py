"""Denials of an enforcement point itself, for reasons found after the policies decided."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from policies.evidence.model import Effect, Finding

if TYPE_CHECKING:
    from policies.evidence.model import Decision
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
