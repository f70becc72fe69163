"""Characters that a reader does not see, or takes for others, and the places where they belong.

Sources: the table of [capabilities.values.invisible], the General_Category of the Unicode Character Database
(`unicodedata`), UAX #9 (bidirectional controls), UTS #51 (emoji sequences), UTS #39 (confusable characters; a small
part of its table: letters that look like one Latin letter in most fonts), and the blocks of tag characters and
variation selectors, in which text can be smuggled whole.
"""

from __future__ import annotations

import functools
import re
import unicodedata
from typing import TYPE_CHECKING, Final

from capabilities.values.invisible import BLANKS, IGNORABLE, INVISIBLE

if TYPE_CHECKING:
    from collections.abc import Iterator

HIDDEN: Final = "hidden text"
MIXED: Final = "mixed scripts"
COMPATIBLE: Final = "compatibility forms"
"""Letters that become plain ASCII in normal form KC: mathematical, full-width, circled."""

_SPECIAL: Final = re.compile(r"[^\t\n\f\r -~]")
"""Every character beyond printable ASCII."""
_LETTERS: Final = re.compile(r"[^\W\d_]+")
_COMPATIBLE_RUN: Final = 3
"""Least number of compatibility letters in a row that are more than a symbol. Ours."""
_FOREIGN_WORD: Final = 3
"""Letters of a word that is made of look-alikes alone. Ours: shorter ones are words of their own language."""
_MOSTLY: Final = 0.75
"""Least share of Latin letters of a Latin text. Ours."""
_TAGS: Final = range(0xE0000, 0xE0080)
_SELECTORS: Final = (*range(0x180B, 0x180E), 0x180F, *range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0))
_BIDI: Final = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
_JOINERS: Final = frozenset("\u200c\u200d")
_SOFT_HYPHEN: Final = "\u00ad"
_BYTE_ORDER: Final = "\ufeff"
_OPEN, _CLOSE = "\u27e8", "\u27e9"
"""Mathematical angle brackets, between which `shown` spells a character by its number."""
_PICTOGRAPHS: Final = range(0x1F000, 0x1FB00)
"""Blocks whose unassigned characters are kept for emoji (UTS #51): a newer emoji is no hidden text."""
_KEYCAPS: Final = frozenset("0123456789#*")
_DRAWN: Final = frozenset({"So", "Sm", "Sk"})
_PRESENTED: Final = frozenset("\u203c\u2049\u2139\u3030\u2b05\u2b06\u2b07")
"""Characters of other categories that have an emoji presentation (emoji-variation-sequences.txt)."""
_JOINING: Final = frozenset(
    {"ARABIC", "BENGALI", "DEVANAGARI", "GUJARATI", "GURMUKHI", "KANNADA", "KHMER", "MALAYALAM", "MONGOLIAN"}
    | {"MYANMAR", "ORIYA", "SINHALA", "SYRIAC", "TAMIL", "TELUGU", "TIBETAN"}
)
"""Scripts that are written with joiners and non-joiners."""
_DIRECTED: Final = frozenset({"ARABIC", "HEBREW", "SYRIAC", "THAANA", "NKO"})
"""Scripts whose texts may need marks of direction."""
_ALPHABETS: Final = frozenset({"CYRILLIC", "ARMENIAN", "CHEROKEE", "COPTIC", "LISU", "GEORGIAN", "DESERET", "OSAGE"})
"""Alphabets without a letter that belongs into a Latin word."""

LOOK_ALIKES: Final = dict(
    zip(
        "асеорхуіјѕԁһԛԝкмтвнАВСЕНІЈКМОРЅТХУΑΒΕΖΗΙΚΜΝΟΡΤΥΧοαινρυτκօոսհցɑɡ",
        "aceopxyijsdhqwkmtbhABCEHIJKMOPSTXYABEZHIKMNOPTYXoaivputkonuhgag",
        strict=True,
    )
)
"""Latin letter that each character looks like.

UTS #39 confusables.txt; small Cyrillic letters drawn like capitals.
"""
_DRAWN_ALIKE: Final = LOOK_ALIKES.keys() - set("кмтвн")
"""Those that are drawn as the letter, and not as its capital in small."""
_SYMBOLS: Final = frozenset("αινρυτκ")
"""Greek letters that stand for quantities: they are look-alikes only between Latin letters."""


def hidden(text: str) -> Iterator[tuple[str, int]]:
    """Characters of the text that a reader does not see, by kind and place."""
    for match in _SPECIAL.finditer(text):
        at, character = match.start(), match.group()
        what = _unseen(character) and _why(text, at, character)
        if what:
            yield what, at


def compatible(text: str) -> Iterator[tuple[str, int]]:
    """Runs of letters that are plain ASCII letters in normal form KC."""
    for match in _LETTERS.finditer(text):
        word = match.group()
        if word.isascii():
            continue
        run = 0
        for n, character in enumerate(word):
            run = run + 1 if _folds(character) else 0
            if run == _COMPATIBLE_RUN:
                yield "letters in another form", match.start() + n + 1 - _COMPATIBLE_RUN
                break


def mixed(text: str) -> Iterator[tuple[str, int]]:
    """Words that are made to look like other words: letters of two alphabets in one, or look-alikes alone."""
    words = [match for match in _LETTERS.finditer(text) if not match.group().isascii()]
    if not words:
        return
    letters = [script(character) for character in text if character > "\x7f" and character.isalpha()]
    plain = sum(character.isalpha() for character in text) - len(letters)
    latin = plain + letters.count("LATIN")
    mostly = latin >= _MOSTLY * (plain + len(letters))
    for match in words:
        word = match.group()
        scripts = {script(character) for character in word}
        if "LATIN" in scripts and any(_misplaced(word, n) for n in range(len(word))):
            yield "letters of two alphabets in one word", match.start()
        elif mostly and "LATIN" not in scripts and len(word) >= _FOREIGN_WORD and LOOK_ALIKES.keys() >= set(word):
            yield "a word of look-alikes", match.start()


def folded(text: str) -> tuple[str, list[int] | None]:
    """The text as a reader takes it, and the place of each character in `text` (None where none moved).

    In normal form KC and lower case, look-alikes as Latin letters, without invisible characters. Tag characters, which
    spell an invisible text, are read as that text.
    """
    if text.isascii():
        return text.lower(), None
    out: list[str] = []
    places: list[int] = []
    for at, character in enumerate(text):
        if character <= "\x7f":
            out.append(character.lower())
            places.append(at)
            continue
        for piece in _read_as(character):
            out.append(piece)
            places.append(at)
    return "".join(out), places


def shown(text: str) -> str:
    """The text as people are shown it: no two texts look alike.

    A character that is not seen, and a letter that passes for a Latin one, stands as `\u27e8U+043E\u27e9`.
    """
    if text.isascii() and text.isprintable():
        return text
    disguised = set(_disguised(text))
    return "".join(
        f"{_OPEN}U+{ord(each):04X}{_CLOSE}"
        if at in disguised or each in INVISIBLE or not each.isprintable() or each in (_OPEN, _CLOSE)
        else each
        for at, each in enumerate(text)
    )


def _disguised(text: str) -> Iterator[int]:
    """Places of the letters and digits that nothing around them tells from Latin ones."""
    yield from (at for at, each in enumerate(text) if each > "\x7f" and _drawn_as_ascii(each))
    letters = [each for each in text if each.isalpha()]
    latin = sum(script(each) == "LATIN" for each in letters)
    foreign = [each for each in letters if script(each) != "LATIN"]
    doubtful = latin >= _MOSTLY * len(letters) or set(foreign) <= _DRAWN_ALIKE
    for match in _LETTERS.finditer(text):
        word = match.group()
        if word.isascii():
            continue
        mixed_in = any(script(each) == "LATIN" for each in word)
        alike = set(word) <= _DRAWN_ALIKE
        for n, each in enumerate(word):
            if (each in LOOK_ALIKES or script(each) in _ALPHABETS) and (mixed_in or (doubtful and alike)):
                yield match.start() + n


@functools.lru_cache(maxsize=65_536)
def _drawn_as_ascii(character: str) -> bool:
    """True for a letter or digit whose compatibility form is ASCII letters or digits."""
    plain = unicodedata.normalize("NFKC", character)
    kinds = {"Ll", "Lu", "Lm", "Nd", "Nl"}
    return plain != character and plain.isascii() and plain.isalnum() and unicodedata.category(character) in kinds


@functools.lru_cache(maxsize=65_536)
def _read_as(character: str) -> str:
    if ord(character) in _TAGS:
        spelled = chr(ord(character) - _TAGS.start)
        return spelled.lower() if spelled.isprintable() else ""
    if _unseen(character):
        return ""
    piece = unicodedata.normalize("NFKC", character)
    return "".join(LOOK_ALIKES.get(each, each) for each in piece).casefold()


@functools.lru_cache(maxsize=65_536)
def script(character: str) -> str:
    """The first word of the character's name, which names its script for every letter of an alphabet."""
    name = unicodedata.name(character, "")
    if name.startswith(("MICRO SIGN", "OHM SIGN", "KELVIN SIGN", "ANGSTROM SIGN")):
        return "COMMON"
    if name.startswith(("FULLWIDTH LATIN", "FEMININE", "MASCULINE")):
        return "LATIN"
    return name.partition(" ")[0]


@functools.lru_cache(maxsize=65_536)
def _unseen(character: str) -> str:
    """Kind of a character that is not seen, "" for a visible one."""
    code = ord(character)
    if code in _TAGS:
        return "tag character"
    if code in _SELECTORS:
        return "variation selector"
    if character in _BIDI:
        return "bidirectional control"
    category = unicodedata.category(character)
    if category == "Cc":
        return "control character"
    if category == "Cf" or character in IGNORABLE or character in BLANKS:
        return "zero width"
    if category == "Co":
        return "private use"
    if category == "Cs" or (category == "Cn" and code not in _PICTOGRAPHS):
        return "unassigned"
    return "line separator" if category in {"Zl", "Zp"} else ""


def _why(text: str, at: int, character: str) -> str:
    """Kind of a character that is not seen, or "" where it belongs."""
    what = _unseen(character)
    before = text[at - 1] if at else ""
    after = text[at + 1 : at + 2]
    if what == "variation selector":
        return "" if _selects(before, character, after) else what
    if character in _JOINERS:
        return "" if _joins(before, after) else what
    if character == _SOFT_HYPHEN:
        return "" if before.isalpha() and after.isalpha() else what
    if character == _BYTE_ORDER:
        return what if at else ""
    if what == "bidirectional control" and character in "\u200e\u200f":
        near = (text[max(0, at - 3) : at].strip()[-1:], text[at + 1 : at + 4].strip()[:1])
        return "" if {script(each) for each in near if each} & _DIRECTED else what
    return what


def _selects(before: str, selector: str, after: str) -> bool:
    """True where a variation selector stands after one character that has variants."""
    if not before or _unseen(before):
        return False
    if selector in "\ufe0e\ufe0f":
        keycap = before in _KEYCAPS and after == "\u20e3"
        return keycap or before in _PRESENTED or unicodedata.category(before) in _DRAWN or ord(before) in _PICTOGRAPHS
    ideograph = unicodedata.name(before, "").startswith("CJK")
    return ideograph and (ord(selector) >= 0xE0100 or ord(selector) < 0xFE03)


def _joins(before: str, after: str) -> bool:
    """True where a joiner stands inside an emoji or a word of a script that is written with joiners."""
    if not before or not after:
        return False
    drawn = before == "\ufe0f" or unicodedata.category(before) in _DRAWN or ord(before) in _PICTOGRAPHS
    if drawn and (unicodedata.category(after) in _DRAWN or ord(after) in _PICTOGRAPHS):
        return True
    return script(before) in _JOINING and (script(after) in _JOINING or not after.isalpha())


@functools.lru_cache(maxsize=65_536)
def _folds(character: str) -> bool:
    """True for a letter of a compatibility form of one ASCII letter."""
    plain = unicodedata.normalize("NFKC", character)
    return character != plain and len(plain) == 1 and plain.isascii() and plain.isalpha() and character not in "ªº"


def _misplaced(word: str, at: int) -> bool:
    """True where a letter of a Latin word belongs to another alphabet and looks Latin."""
    letter = word[at]
    found = script(letter)
    if found in _ALPHABETS:
        return True
    if found != "GREEK" or letter not in LOOK_ALIKES:
        return False
    latin = [script(near) == "LATIN" for near in (*word[max(0, at - 1) : at], *word[at + 1 : at + 2])]
    return all(latin) and (letter not in _SYMBOLS or len(latin) == 2)
