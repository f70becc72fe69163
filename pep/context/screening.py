"""Screening of a text: hidden characters, look-alikes, instructions, and these in other encodings.

Screening is evidence and never authority. A clean finding proves nothing; a sign taints all that derives from the text.
The text itself is never changed, so that its signature still holds.
"""

from __future__ import annotations

import base64
import binascii
import html
import re
from bisect import bisect_right
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Final
from urllib.parse import unquote

from capabilities.values import characters
from pep.context import instruction_rules

if TYPE_CHECKING:
    from collections.abc import Iterator

INSTRUCTION_LIKE: Final = "instruction-like"
ENCODED: Final = "encoded instructions"
SIGNS: Final = (characters.HIDDEN, characters.MIXED, characters.COMPATIBLE, INSTRUCTION_LIKE, ENCODED)
"""All signs."""
TRACES: Final = 64
"""Most places of one sign that are told; the sign itself is always told."""
DECODINGS: Final = 3
"""Depth to which encodings inside each other are followed."""
DECODED: Final = 6
"""Most decoded characters for each one of the text: one long blob needs three in its four positions."""
_BASE64: Final = re.compile(r"[A-Za-z0-9+/_-]{20,}(?:\r?\n[ \t]{0,8}[A-Za-z0-9+/_-]{4,})*={0,2}")
_HEX: Final = re.compile(r"(?:[0-9A-Fa-f]{2}[ :]?){16,}")
_BREAKS: Final = re.compile(r"[\s:]")
_ESCAPED: Final = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|x([0-9A-Fa-f]{2}))")
_SPELLED: Final = re.compile(r"&#|&[a-z]{2,8};|%[0-9A-Fa-f]{2}|\\[ux][0-9A-Fa-f]{2}")

_ASCII: Final = bytes(code if code < 0x80 else 0x20 for code in range(256))


@dataclass(frozen=True, slots=True)
class Suspicion:
    """One suspicion: its sign, its exact finding, and its place (index of a character in the text).

    `where` is the JSON pointer of the text inside a value, "" for a text alone.
    """

    sign: str
    what: str
    at: int
    where: str = ""


def screen(text: str) -> tuple[Suspicion, ...]:
    """All suspicions about a text, in the order of `SIGNS`; linear in its length, and never raises."""
    return tuple(_all(text))


def screen_value(value: object) -> tuple[Suspicion, ...]:
    """All suspicions about the texts and names of a JSON value, also those spread over several of them."""
    texts = [(where, text) for where, text in _texts(value, "") if text]
    if not texts:
        return ()
    starts, at = [], 0
    for _, text in texts:
        starts.append(at)
        at += len(text) + 1
    found = []
    for trace in screen("\n".join(text for _, text in texts) if len(texts) > 1 else texts[0][1]):
        n = bisect_right(starts, trace.at) - 1
        found.append(Suspicion(trace.sign, trace.what, trace.at - starts[n], texts[n][0]))
    if len(texts) > 1 and not any(trace.sign == INSTRUCTION_LIKE for trace in found):
        # an order over several texts, which a model reads one after the other
        folded, _ = characters.folded(" ".join(text for _, text in texts))
        found += [Suspicion(INSTRUCTION_LIKE, what, 0) for what, _ in instruction_rules.matches(folded)][:TRACES]
    return tuple(found)


def signs(traces: tuple[Suspicion, ...], *, spared: frozenset[str] = frozenset()) -> tuple[str, ...]:
    """The signs of these traces, each once, in the order of `SIGNS`, without those that are spared here."""
    found = {trace.sign for trace in traces} - spared
    return tuple(sign for sign in SIGNS if sign in found)


def _all(text: str) -> Iterator[Suspicion]:
    for sign, places in (
        (characters.HIDDEN, characters.hidden(text)),
        (characters.MIXED, characters.mixed(text)),
        (characters.COMPATIBLE, characters.compatible(text)),
    ):
        yield from (Suspicion(sign, what, at) for what, at in islice(places, TRACES))
    folded, moved = characters.folded(text)
    for what, at in islice(instruction_rules.matches(folded), TRACES):
        yield Suspicion(INSTRUCTION_LIKE, what, at if moved is None else moved[at])
    yield from islice(_encoded(text, DECODINGS, _Budget(DECODED * len(text))), TRACES)


@dataclass(slots=True)
class _Budget:
    """Characters that may still be decoded: encodings inside encodings must not multiply the work."""

    left: int


def _encoded(text: str, depth: int, budget: _Budget) -> Iterator[Suspicion]:
    """Encoded parts that read like an instruction once decoded, or that are too long to decode."""
    for what, at, decoded in _decoded(text):
        if budget.left < len(decoded):
            yield Suspicion(ENCODED, "more than is decoded", at)
            return
        budget.left -= len(decoded)
        folded, _ = characters.folded(decoded)
        plainly = next(instruction_rules.matches(folded), None)
        if plainly or (depth > 1 and next(_encoded(decoded, depth - 1, budget), None)):
            yield Suspicion(ENCODED, what, at)


def _decoded(text: str) -> Iterator[tuple[str, int, str]]:
    for match in _BASE64.finditer(text):
        blob = _BREAKS.sub("", match.group()).rstrip("=").replace("-", "+").replace("_", "/")
        # characters before a blob without a gap shift it: of its four positions one is the right one
        for shift in range(4):
            whole = blob[shift : shift + (len(blob) - shift) // 4 * 4]
            rest = blob[shift + len(whole) :]
            padded = whole + (rest + "=" * (4 - len(rest)) if len(rest) > 1 else "")
            yield "base64", match.start(), _text(base64.b64decode(padded))
    for match in _HEX.finditer(text):
        yield "hex", match.start(), _text(binascii.unhexlify(_BREAKS.sub("", match.group())))
    first = _SPELLED.search(text)
    if first is not None:
        plain = _ESCAPED.sub(lambda match: chr(int(match[1] or match[2], 16)), html.unescape(unquote(text)))
        if plain != text and len(plain) < len(text):
            yield "escapes", first.start(), plain


def _text(raw: bytes) -> str:
    """Bytes as text: UTF-8 where it is, else the ASCII in it; the zeros of wider encodings go."""
    raw = raw.replace(b"\x00", b"")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.translate(_ASCII).decode("ascii")


def _texts(value: object, where: str) -> Iterator[tuple[str, str]]:
    """Every text of a JSON value, and every name in it, with its pointer."""
    match value:
        case str():
            yield where, value
        case dict():
            for name, member in value.items():
                inside = f"{where}/{name.replace('~', '~0').replace('/', '~1')}"
                yield inside, name
                yield from _texts(member, inside)
        case list():
            for n, member in enumerate(value):
                yield from _texts(member, f"{where}/{n}")
        case _:
            pass
