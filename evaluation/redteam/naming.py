"""Primitives that records name, and when each was first named."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

CODES: Final = ("reason", "code")
"""Fields of a record that is no decision in which the code of a refusal stands."""

_KNOWN: Final = frozenset(map(str, Reason))


def named(rows: Iterable[Mapping[str, Any]]) -> Mapping[str, float]:
    """Primitives that any of these records names: each with the time of the first one, seconds since the epoch.

    A decision names the primitives of its findings. Any other refusal names those that find its reason.

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
        yield from (str(each["primitive"]) for each in decided.get("findings", ()) if each.get("primitive"))
        return
    for field in CODES:
        code = body.get(field)
        if isinstance(code, str) and code in _KNOWN:
            yield from REASONS[Reason(code)].owners
