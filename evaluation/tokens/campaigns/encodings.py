"""Campaign A2: every other spelling of two small tokens, put before the whole of `verify`. None may be accepted.

Exhaustive: each byte replaced by every other value, each byte left out, seven insertions at each place, forty fields
appended to each message, twelve families of other texts. The Biscuit library alone accepts some of them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final
from urllib.parse import quote

from capabilities.token.token_text import token_from_text, token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from capabilities.values.scope import Restriction
from evaluation.harness.campaign import missed
from evaluation.tokens.campaigns import fields
from evaluation.tokens.campaigns.issuer import CELLS, SPONSOR, Issuer, chain_of, verified
from evaluation.tokens.campaigns.shapes import SMALL

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from evaluation.tokens.campaigns.fields import Field

_KEPT: Final = 20
_INSERTED: Final = (0x00, 0x01, 0x08, 0x50, 0x80, 0xFF)
"""Six of the seven insertions: ends and beginnings of numbers and tags. The seventh is the byte that is there."""
_ALPHABET: Final = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"


@dataclass(frozen=True, slots=True)
class EncodingFigures:
    """Figures of the campaign.

    Attributes:
        tried: spellings by family, over both tokens.
        codes: faults by code.
        accepted: spellings that were, with their family; the first ones in hex.
        stray: exceptions that were raised.
        tokens: whether both tokens were accepted as they were issued, before and after.
    """

    tried: Mapping[str, int]
    codes: Mapping[str, int]
    accepted: tuple[str, ...]
    stray: tuple[str, ...]
    tokens: bool

    @property
    def missed(self) -> tuple[str, ...]:
        """Misses of the bar."""
        faults = {
            "an issued token is refused": not self.tokens,
            "a family was not tried": len(self.tried) != len(FAMILIES) + 1,
        }
        return missed(faults, {"accepted": self.accepted, "stray exceptions": self.stray})


def tokens(issuer: Issuer) -> tuple[bytes, bytes]:
    """A small token of one block and one of two, each with spare bits at the end of its text."""
    lent = replace(SMALL, audiences=frozenset(CELLS[:2]), delegates=frozenset({"b"}), depth=1)
    one = _spare(lambda purpose: issuer.mint(SMALL, issuer.holder("a", SPONSOR.subject, purpose=purpose)))
    first = issuer.mint(lent, issuer.holder("a", SPONSOR.subject))
    chain = chain_of(issuer.verifier(), first)
    narrower = Restriction(audiences=frozenset(CELLS[:1]))
    two = _spare(lambda purpose: issuer.delegate(first, chain, issuer.holder("b", "a", purpose=purpose), narrower))
    return one, two


def _spare(make: Callable[[str], bytes]) -> bytes:
    """The token with a purpose of such a length that its last digit of base64 has four spare bits."""
    return next(token for length in range(8) if len(token := make("p" * length)) % 3 == 1)


# --- spellings in bytes ----------------------------------------------------------------------------------------------


def substitutions(token: bytes) -> Iterator[bytes]:
    """Every other value of every byte."""
    for at, byte in enumerate(token):
        for value in range(256):
            if value != byte:
                yield token[:at] + bytes((value,)) + token[at + 1 :]


def deletions(token: bytes) -> Iterator[bytes]:
    """Each byte left out, each end cut off, each beginning cut off."""
    for at in range(len(token)):
        yield token[:at] + token[at + 1 :]
        yield token[:at]
        yield token[at + 1 :]


def insertions(token: bytes) -> Iterator[bytes]:
    """Seven bytes at each place, the end included."""
    for at in range(len(token) + 1):
        for byte in (*_INSERTED, token[min(at, len(token) - 1)]):
            yield token[:at] + bytes((byte,)) + token[at:]


def appended(token: bytes) -> Iterator[bytes]:
    """Forty fields after, and before, those of each message in the token, the block's own ones among them."""
    for more in FORTY:
        yield from _with(fields.read(token), more)


def _with(message: tuple[Field, ...], more: bytes) -> Iterator[bytes]:
    parts = [each.raw for each in message]
    whole = b"".join(parts)
    yield whole + more
    yield more + whole
    for at, each in enumerate(message):
        for changed in _with(each.inner, more) if each.inner else ():
            yield b"".join((*parts[:at], fields.write(each.number, each.wire, changed), *parts[at + 1 :]))


def _forty() -> tuple[bytes, ...]:
    """Fields that the format has, doubled or void, and fields that it has not, of every wire type."""
    known = [fields.write(number, fields.LEN, b"") for number in range(1, 9)]
    numbers = [fields.write(number, fields.VARINT, b"\0") for number in range(1, 9)]
    ones = [fields.write(number, fields.VARINT, b"\x01") for number in (1, 2, 5, 9, 15)]
    unknown = [
        fields.write(number, wire, value)
        for number in (9, 15, 16, 2_047, 536_870_911)
        for wire, value in ((fields.LEN, b"x"), (fields.I32, bytes(4)), (fields.I64, bytes(8)))
    ]
    odd = [
        b"\x4b\x4c",
        b"\x00\x00",
        fields.write(1, fields.VARINT, b"\x87\x00"),
        fields.write(4, fields.LEN, b"\x0a\x00"),
    ]
    return (*known, *numbers, *ones, *unknown, *odd)


FORTY: Final = _forty()

# --- spellings as text -----------------------------------------------------------------------------------------------


def texts(token: bytes) -> Iterator[str]:
    """Texts of twelve families that a lax reader of base64 takes for the token.

    Each comes once, and none is the token's own.
    """
    text = token_to_text(token)
    yield from dict.fromkeys(other for other in _texts(token, text) if other != text)


def _texts(token: bytes, text: str) -> Iterator[str]:
    padding = "=" * (-len(text) % 4)
    yield text + padding  # 1: padded
    yield from (text + pad for pad in ("=", "===", "====") if pad != padding)  # 2: padded wrongly
    yield from _letters(text)  # 3: the other alphabet
    yield from (white + text for white in " \t\n\r\v\f\0\ufeff")  # 4: white space before
    yield from (text + white for white in " \t\n\r\v\f\0\u200b")  # 5: and after
    yield from (text[:at] + white + text[at:] for at in (4, 64, 76) for white in ("\n", "\r\n", " ", "\t"))  # 6
    last = _ALPHABET.index(text[-1])
    yield from (text[:-1] + _ALPHABET[last + spare] for spare in range(1, 16))  # 7: spare bits that are not zero
    yield from (text + letter for letter in "A-_.~*,;")  # 8: a letter more
    yield from (text[:at] + chr(ord(text[at]) + 0xFEE0) + text[at + 1 :] for at in (0, 5, -1 % len(text)))  # 9: wide
    yield from (quote(text, safe="")[:-1] + f"%{ord(text[-1]):02X}", text.replace("-", "%2D", 1))  # 10: escaped
    yield from (f"{text}.{text}", f"{text},{text}", f"DPoP {text}", f"Bearer {text}", f'"{text}"', f"'{text}'")  # 11
    yield from (token.hex(), token_to_text(text.encode()), text.swapcase(), text[::-1], text[:-1])  # 12


def _letters(text: str) -> Iterator[str]:
    """Texts with one letter, or all of them, of the other alphabet, or with a letter of neither.

    Some readers skip a letter that is in neither alphabet.
    """
    for ours, theirs in (("-", "+"), ("_", "/")):
        if ours in text:
            yield text.replace(ours, theirs, 1)
            yield text.replace(ours, theirs)
    yield from (text[:9] + letter + text[9:] for letter in "+/=.!~ü")


# --- the run ---------------------------------------------------------------------------------------------------------

FAMILIES: Final[dict[str, Callable[[bytes], Iterator[bytes]]]] = {
    "substitutions": substitutions,
    "deletions": deletions,
    "insertions": insertions,
    "appended fields": appended,
}
TEXTS: Final = "texts"


def run(seed: int = 1, *, every: int = 1) -> EncodingFigures:
    """The figures of the campaign.

    Args:
        seed: of the keys, and of where a part begins.
        every: 1 for all of it; else one spelling in so many.
    """
    issuer = Issuer(f"encodings {seed}")
    verifier = issuer.verifier()
    return search(tokens(issuer), lambda token: verified(verifier, token), every=every, offset=seed % every)


def search(
    of: tuple[bytes, ...], ask: Callable[[bytes], Chain | Fault], *, every: int = 1, offset: int = 0
) -> EncodingFigures:
    """Answers of `ask` to other spellings of these tokens.

    Args:
        of: tokens that `ask` accepts.
        ask: the whole of `verify`, for one token.
        every: one spelling in so many is tried.
        offset: from which on.
    """
    tried: Counter[str] = Counter()
    codes: Counter[str] = Counter()
    accepted: list[str] = []
    stray: list[str] = []
    good = all(isinstance(ask(token), Chain) for token in of)

    def judge(family: str, spelling: bytes | str) -> None:
        tried[family] += 1
        raw = spelling.encode() if isinstance(spelling, str) else spelling
        try:
            found = _from_text(spelling, ask) if isinstance(spelling, str) else ask(spelling)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # noqa: BLE001 - a panic of the library is no Exception
            stray.append(f"{family} {type(error).__name__} {raw.hex() if len(stray) < _KEPT else ''}")
            return
        if isinstance(found, Fault):
            codes[str(found.code)] += 1
        else:
            accepted.append(f"{family} {raw.hex() if len(accepted) < _KEPT else ''}")

    for token in of:
        for family, spell in FAMILIES.items():
            for number, other in enumerate(spell(token)):
                if number % every == offset and other != token:
                    judge(family, other)
        for text in texts(token):
            judge(TEXTS, text)
    good = good and all(isinstance(ask(token), Chain) for token in of)
    return EncodingFigures(tried, codes, tuple(accepted), tuple(stray), good)


def _from_text(text: str, ask: Callable[[bytes], Chain | Fault]) -> Chain | Fault:
    token = token_from_text(text, DEFAULT)
    return token if isinstance(token, Fault) else ask(token)
