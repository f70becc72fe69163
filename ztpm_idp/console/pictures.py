"""Pictures of a request's motion, as its questions to people named them, and its end on record. Pure."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.characters import shown
from ztpm_idp.console import journey
from ztpm_idp.domain.audit import claims_of
from ztpm_idp.provider.ask_words import sentence_of_claims

if TYPE_CHECKING:
    from collections.abc import Iterable

MOST: Final = 8
"""Most pictures of one page: a browser keeps no more than sixteen at once."""
_KIND: Final = "ask-taken"
"""Kind of the entry that has a signed ask."""
_ENDED: Final = ("reason", "detail", "result", "watch")
"""Members of an outcome's record that say how a motion ended, as reported and measured."""


@dataclass(frozen=True, slots=True)
class Pictured:
    """One question about a motion, with the digest of the picture that people were shown.

    Attributes:
        number: of the ledger's entry that has the ask.
        at_ms: of that entry.
        ask_id: of the ask.
        sentence: on what would happen.
        digest: SHA-256 (hex) of the picture's text; "" where the ask names none.
    """

    number: int
    at_ms: int
    ask_id: str
    sentence: str
    digest: str


@dataclass(frozen=True, slots=True)
class Ended:
    """An outcome on record: its word, and what was measured as JSON text, "" of nothing."""

    word: str
    measured: str


def pictures_of(lines: Iterable[bytes]) -> tuple[Pictured, ...]:
    """The questions about motions among these entries, in their order, at most `MOST` ([CON-8]).

    Args:
        lines: of the ledger.
    """
    return tuple(islice((each for each in map(_pictured, lines) if each is not None), MOST))


def ends_of(lines: Iterable[bytes]) -> tuple[Ended, ...]:
    """The outcomes among these entries, in their order.

    Args:
        lines: of the ledger.
    """
    bodies = [body for body in map(journey.body_of, lines) if isinstance(body.get("outcome"), str)]
    return tuple(_ended(body) for body in bodies)


def _ended(body: dict[str, Any]) -> Ended:
    measured = {name: body[name] for name in _ENDED if body.get(name)}
    return Ended(body["outcome"], journey.pretty(measured) if measured else "")


def _pictured(line: bytes) -> Pictured | None:
    entry = json.loads(line)
    asked = claims_of(journey.body_of(line).get("ask")) if entry.get("kind") == _KIND else {}
    if not asked.get("start_urad"):  # no arm would move
        return None
    digest = str(asked.get("picture_digest", ""))
    return Pictured(entry["seq"], entry["at_ms"], str(asked.get("ask_id")), shown(sentence_of_claims(asked)), digest)
