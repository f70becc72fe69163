"""Primitives that records name, and when each was first named."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from policies.primitives.cognition import InstructionIsolation
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

CODES: Final = ("reason", "code")
"""Fields of a record that is no decision in which the code of a refusal stands."""

_KNOWN: Final = frozenset(map(str, Reason))


def named(rows: Iterable[Mapping[str, Any]]) -> Mapping[str, float]:
    """Primitives that any of these records names: each with the time of the first one, seconds since the epoch.

    A decision names the primitives of its findings, and CII-2 by the signs that its screening found in a text: a text
    with signs may be admitted, tainted. Any other refusal names those that find its reason. A primitive that had no
    evidence, since an earlier check had refused, has found nothing.

    Args:
        rows: records of enforcement points and entries of a provider's ledger, in any order.
    """
    first: dict[str, float] = {}
    for row in rows:
        at_s = float(row["at_ms"]) / 1_000
        for primitive in _names(row.get("body")):
            first[primitive] = min(at_s, first.get(primitive, at_s))
    return first


def _names(body: Any) -> Iterator[str]:
    if not isinstance(body, dict):
        return
    decided = body.get("decision")
    if isinstance(decided, dict):
        findings = [each for each in decided.get("findings", ()) if each.get("reason") != Reason.EVIDENCE_MISSING]
        yield from (str(each["primitive"]) for each in findings if each.get("primitive"))
        yield from _screened(body.get("evidence"))
        return
    for field in CODES:
        code = body.get(field)
        if isinstance(code, str) and code in _KNOWN:
            yield from REASONS[Reason(code)].owners


def _screened(evidence: Any) -> Iterator[str]:
    """CII-2 for each item of a recorded case in which its screening found a sign."""
    context = evidence.get("context") if isinstance(evidence, dict) else None
    items = context.get("items", ()) if isinstance(context, dict) else ()
    yield from (InstructionIsolation.id for each in items if each.get("signs"))
