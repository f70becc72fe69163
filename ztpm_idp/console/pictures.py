"""Pictures of a request's motion, as questions to people and records name them, and its end on record. Pure."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.people.ask_words import sentence_of_claims
from capabilities.values.characters import shown
from ztpm_idp.console import journey
from ztpm_idp.domain.audit import claims_of, object_of
from ztpm_idp.domain.pictures import DIGEST

if TYPE_CHECKING:
    from collections.abc import Iterable

MOST: Final = 8
"""Most pictures of one page: a browser keeps no more than sixteen at once."""
_ENDED: Final = ("reason", "detail", "result", "watch")
"""Members of an outcome's record that say how a motion ended, as reported and measured."""


@dataclass(frozen=True, slots=True)
class Pictured:
    """One entry that names the picture of a motion, or says that there is none.

    Attributes:
        number: of the ledger's entry.
        at_ms: of that entry.
        subject: id of the ask, or of the request.
        sentence: on what an ask would have done; "" of a decision's record, whose page says it.
        digest: SHA-256 (hex) of the picture's text; "" where there is none.
        reason: code by which a record says that there is none; "" of an ask.
    """

    number: int
    at_ms: int
    subject: str
    sentence: str
    digest: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Ended:
    """An outcome on record: its word, and what was measured as JSON text, "" of nothing."""

    word: str
    measured: str


def pictures_of(lines: Iterable[bytes]) -> tuple[Pictured, ...]:
    """The entries about pictures of motions among these, in their order ([CON-8], [CON-9]).

    Args:
        lines: of the ledger.
    """
    return tuple(each for each in map(_pictured, lines) if each is not None)


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
    entry, body = object_of(json.loads(line)), journey.body_of(line)
    match entry:
        case {"kind": "ask-taken", "seq": int(number), "at_ms": int(at_ms)}:
            asked = claims_of(body.get("ask"))
            if not asked.get("start_urad"):  # no arm would move
                return None
            digest, sentence = str(asked.get("picture_digest", "")), sentence_of_claims(asked)
            return Pictured(number, at_ms, str(asked.get("ask_id")), shown(sentence), digest)
        case {"kind": "pep-record", "seq": int(number), "at_ms": int(at_ms), "body": {"record": {"kind": "picture"}}}:
            named = DIGEST.fullmatch(str(body.get("digest")))
            reason = shown(str(body.get("reason", "?")))
            return Pictured(number, at_ms, str(body.get("request_id")), "", named[0] if named else "", reason)
        case _:
            return None
