"""One sentence on an ask, in a person's words, and one on who asks, and why.

Every figure is the ask's own; a distance is rounded down and a speed up. The page's script says the same of the signed
text, out of the same words, and takes no vote where the page says otherwise ([PSK-8]).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.people.ask import NO_ROBOT, claims

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.people.ask import Ask

WORDS_FILE: Final = Path(__file__).parent / "templates" / "ask_words.json"
WORDS: Final[dict[str, Any]] = json.loads(WORDS_FILE.read_text("utf-8"))
"""All English texts of the sentence."""
CODE_DIGITS: Final = 8
NAME_LIMIT: Final = 40
"""Characters of another's name that the sentence has, so that figures stay in sight; all of it stands below."""
UM_PER_MM: Final = 1_000
UM_PER_CM: Final = 10_000
CM_PER_M: Final = 100


def code_of(digest: str) -> str:
    """Short code of an ask, on the page and at a terminal: first eight hex digits of its text's digest."""
    return digest[:CODE_DIGITS]


def sentence_of(ask: Ask) -> str:
    """The sentence on what would happen."""
    return sentence_of_claims(claims(ask))


def sentence_of_claims(shown: Mapping[str, Any]) -> str:
    """The same sentence, of the members of an ask as plain JSON."""
    if shown["contributors"]:
        return _of_contributor(shown["contributors"][0])
    named = {"operation": _short(shown["operation"]), "name": _short(shown["object"])}
    return str(WORDS["act" if shown["perception"] == NO_ROBOT else "alone"]).format(**named)


def reason_of(ask: Ask) -> str:
    """The sentence on who asks, and why a person is asked."""
    return str(WORDS["who"]).format(agent=_short(ask.agent), sponsor=_short(ask.sponsor), tier=int(ask.tier))


def _of_contributor(first: Mapping[str, Any]) -> str:
    hundredths = -(-first["speed_um_s"] // UM_PER_CM)
    told = {
        "kind": _short(first["kind"]),
        "link": _link(first["link"]),
        "object": _object(first["kind"], first["object"]),
        "mm": str(first["clearance_um"] // UM_PER_MM),
        "speed": f"{hundredths // CM_PER_M}.{hundredths % CM_PER_M:02d}",
    }
    kinds = WORDS["kinds"] if first["clearance_um"] > 0 else WORDS["kinds"] | WORDS["meets"]
    return str(kinds.get(first["kind"], WORDS["other"])).format(**told)


def _link(name: str) -> str:
    return next((word for begins, word in WORDS["links"].items() if name.startswith(begins)), _short(name) or "arm")


def _object(kind: str, thing: str) -> str:
    if kind == "self":
        return _link(thing)
    name, slash, region = thing.partition("/")
    if kind == "person" and slash:
        return str(WORDS["person"]).format(name=_short(name), region=_short(region.replace("_", " ")))
    return _short(thing)


def _short(name: str) -> str:
    return name if len(name) <= NAME_LIMIT else f"{name[: NAME_LIMIT - 1]}…"
