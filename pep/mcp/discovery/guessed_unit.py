"""Unit of a number, guessed from what a server calls and says of it.

A guess is a proposal: the name and the description are the server's own words.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

THOUSAND: Final = 1_000
MILLION: Final = 1_000_000
HOUR_MS: Final = 3_600_000
MINUTE_MS: Final = 60_000


@dataclass(frozen=True, slots=True)
class GuessedUnit:
    """Unit of a number, and the words that it was guessed from.

    Attributes:
        unit: as a declaration spells it.
        scale: so many of the unit make one of the argument's numbers.
        said: the words.
    """

    unit: str
    scale: int
    said: str


@dataclass(frozen=True, slots=True)
class _Row:
    """One unit that servers write.

    Attributes:
        unit, scale: as of `GuessedUnit`.
        endings: of an argument's name, in lower case, its words joined by underscores.
        phrases: spelled out, anywhere in a description.
        symbols: only in brackets, or behind "in" or "unit", since a letter is many things.
    """

    unit: str
    scale: int
    endings: tuple[str, ...]
    phrases: tuple[str, ...] = ()
    symbols: tuple[str, ...] = ()


_ROWS: Final = (
    _Row("x-deg", THOUSAND, ("deg", "degree", "degrees"), ("degrees",), ("deg", "°")),
    _Row("x-deg_s", THOUSAND, ("deg_s", "deg_per_s"), ("degrees per second", "degrees/second"), ("deg/s", "°/s")),
    _Row("x-deg_s2", THOUSAND, ("deg_s2",), ("degrees per second squared",), ("deg/s2", "deg/s^2", "deg/s²", "°/s²")),
    _Row("urad", MILLION, ("rad", "radian", "radians"), ("radians",), ("rad",)),
    _Row("urad_s", MILLION, ("rad_s", "rad_per_s"), ("radians per second", "radians/second"), ("rad/s",)),
    _Row(
        "urad_s2", MILLION, ("rad_s2", "rad_per_s2"),
        ("radians per second squared", "radians/second squared"), ("rad/s2", "rad/s^2", "rad/s²"),
    ),
    _Row("um", MILLION, ("m", "meter", "meters", "metre", "metres"), ("meters", "metres"), ("m",)),
    _Row("um", 10 * THOUSAND, ("cm",), ("centimeters", "centimetres"), ("cm",)),
    _Row("um", THOUSAND, ("mm",), ("millimeters", "millimetres"), ("mm",)),
    _Row("um", 1, ("um",), ("micrometers", "micrometres", "microns"), ("um", "µm", "μm")),
    _Row(
        "um_s", MILLION, ("m_s", "m_per_s", "mps"),
        ("meters per second", "metres per second", "meters/second", "metres/second"), ("m/s",),
    ),
    _Row("um_s", THOUSAND, ("mm_s", "mm_per_s"), ("millimeters per second", "millimetres per second"), ("mm/s",)),
    _Row(
        "um_s2", MILLION, ("m_s2", "m_per_s2"),
        ("meters per second squared", "metres per second squared"), ("m/s2", "m/s^2", "m/s²"),
    ),
    _Row("um_s2", THOUSAND, ("mm_s2",), ("millimeters per second squared",), ("mm/s2", "mm/s^2", "mm/s²")),
    _Row("mN", THOUSAND, ("newton", "newtons"), ("newtons",), ("N",)),
    _Row("mNm", THOUSAND, ("nm", "newton_meters"), ("newton meters", "newton metres"), ("Nm", "N·m", "N*m", "N.m")),
    _Row("g", THOUSAND, ("kg", "kilogram", "kilograms"), ("kilograms",), ("kg",)),
    _Row("g", 1, ("grams",), ("grams",), ("g",)),
    _Row("ms", THOUSAND, ("s", "sec", "secs", "seconds"), ("seconds",), ("s", "sec", "secs")),
    _Row("ms", 1, ("ms", "msec", "millis", "milliseconds"), ("milliseconds",), ("ms",)),
    _Row("ms", MINUTE_MS, ("minutes", "mins"), ("minutes",), ("min",)),
    _Row("ms", HOUR_MS, ("hours",), ("hours",), ("h",)),
    _Row("permille", 10, ("percent", "percentage", "pct"), ("percent", "percentage"), ("%",)),
    _Row("permille", THOUSAND, ("ratio", "fraction"), ("ratio", "fraction")),
    _Row("mdegC", THOUSAND, ("celsius", "degc"), ("degrees celsius", "celsius"), ("°C", "degC")),
    _Row("mK", THOUSAND, ("kelvin",), ("kelvin",), ("K",)),
    _Row("mV", THOUSAND, ("volt", "volts"), ("volts",), ("V",)),
    _Row("mV", 1, ("mv", "millivolts"), ("millivolts",), ("mV",)),
    _Row("mA", THOUSAND, ("amps", "amperes"), ("amperes", "amps"), ("A",)),
    _Row("mA", 1, ("ma", "milliamps"), ("milliamperes", "milliamps"), ("mA",)),
    _Row("mW", THOUSAND, ("watt", "watts"), ("watts",), ("W",)),
    _Row("mL", THOUSAND, ("liters", "litres"), ("liters", "litres"), ("L", "l")),
    _Row("mL", 1, ("ml", "milliliters", "millilitres"), ("milliliters", "millilitres"), ("mL", "ml")),
    _Row("Pa", 1, ("pa", "pascal", "pascals"), ("pascals",), ("Pa",)),
    _Row("Pa", THOUSAND, ("kpa",), ("kilopascals",), ("kPa",)),
    _Row("Pa", 100 * THOUSAND, ("bar",), (), ("bar",)),
    _Row("Hz", 1, ("hz", "hertz"), ("hertz",), ("Hz",)),
    _Row("Hz", THOUSAND, ("khz",), ("kilohertz",), ("kHz",)),
    _Row("cur-EUR", 100, ("eur", "euro", "euros"), ("euros",), ("EUR", "€")),
    _Row("cur-USD", 100, ("usd", "dollars"), ("dollars",), ("USD", "$")),
)  # fmt: skip
_ENDINGS: Final = {ending: row for row in _ROWS for ending in row.endings}
_PHRASES: Final = {phrase: row for row in _ROWS for phrase in row.phrases}
_SYMBOLS: Final = {symbol: row for row in _ROWS for symbol in row.symbols}
_PHRASE: Final = re.compile(
    r"(?<![\w/])(" + "|".join(map(re.escape, sorted(_PHRASES, key=len, reverse=True))) + r")(?![\w/])", re.IGNORECASE
)
_SYMBOL: Final = re.compile(
    r"(?:[(\[]\s*(?:in )?|\b(?:in|units?:?)\s+)("
    + "|".join(map(re.escape, sorted(_SYMBOLS, key=len, reverse=True)))
    + r")(?![\w/²^])"
)
_CAMEL: Final = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_WORD: Final = re.compile(r"[^A-Za-z0-9]+")
_NAMED: Final = re.compile(r"\w+")
_NUMBERED: Final = re.compile(r"([A-Za-z_]+)([0-9]{1,3})", re.ASCII)
_ROW_OF: Final = re.compile(r"\b([A-Za-z_]+)([0-9]{1,3}) ?(?:-|\u2013|to|\.\.) ?\1?([0-9]{1,3})\b", re.ASCII)
LINES: Final = 200
"""Lines of a tool's description that are read, and characters of each: more is no description of arguments."""
LINE_CHARACTERS: Final = 400


def name_words(name: str) -> tuple[str, ...]:
    """The words of an argument's or tool's name, in lower case: split at capitals and at what is no letter."""
    return tuple(word.lower() for word in _WORD.split(_CAMEL.sub("_", name)) if word)


def words_about(name: str, description: str) -> str:
    """The words of a tool's description about one argument: lines such as "x, y: place (meters)".

    Args:
        name: of the argument.
        description: of the tool.
    """
    found: list[str] = []
    for line in description.splitlines()[:LINES]:
        head, colon, rest = line[:LINE_CHARACTERS].partition(":")
        if colon and _names(head, name):
            found.append(rest)
    return "\n".join(found)


def _names(head: str, name: str) -> bool:
    """True where the head of a line names the argument, alone or in a row such as "joint1-joint6"."""
    if name in _NAMED.findall(head):
        return True
    own = _NUMBERED.fullmatch(name)
    rows = _ROW_OF.findall(head) if own else ()
    return own is not None and any(
        stem == own[1] and int(first) <= int(own[2]) <= int(last) for stem, first, last in rows
    )


def guess_units(name: str, text: str) -> tuple[GuessedUnit, ...]:
    """Each unit that name and text speak of, that of the name first; more than one is a doubt.

    Args:
        name: of the argument.
        text: its title and description.
    """
    found: list[GuessedUnit] = []
    words = name_words(name)
    for length in (3, 2, 1):
        row = _ENDINGS.get("_".join(words[-length:])) if len(words) >= length else None
        # A name of one letter is a place or a count, not a unit.
        if row is not None and len(name) > 1:
            found.append(GuessedUnit(row.unit, row.scale, f'the name "{name}"'))
            break
    for table, pattern, fold in ((_PHRASES, _PHRASE, True), (_SYMBOLS, _SYMBOL, False)):
        for match in pattern.finditer(text):
            row = table[match[1].lower() if fold else match[1]]
            if all((each.unit, each.scale) != (row.unit, row.scale) for each in found):
                found.append(GuessedUnit(row.unit, row.scale, f'"{match[1]}" in its description'))
    return tuple(found)
