"""Plain YAML as one value: mappings, lists, texts and numbers of one document, and nothing else that YAML has.

No object is built by a tag, nothing is repeated by an alias, and a word is a text unless it is a number, true, false or
null: what one reader takes for a date or a "yes" is no value here.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import yaml

from capabilities.values.strict_json import JsonDefect, JsonError

if TYPE_CHECKING:
    from collections.abc import Iterator

VALUES_MOST: Final = 20_000  # ours: a trajectory of the most points has some thousand numbers
_INTEGER: Final = re.compile(r"[+-]?[0-9]{1,15}", re.ASCII)
_REAL: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", re.ASCII)
_NO_NUMBER: Final = re.compile(r"[+-]?\.?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_WORDS: Final = {"true": True, "false": False, "null": None, "~": None, "": None}
_LOADER: Final[Any] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)  # the same events, ten times as fast


def yaml_value(text: str, *, limit_depth: int) -> object:
    """The value that one YAML document spells.

    Args:
        text: the document.
        limit_depth: cap on the nesting.

    Raises:
        JsonError: with the line. `NOT_FINITE` for a number that is none, `TOO_LARGE` for too many values, else
            `MALFORMED`: no YAML, a tag, anchor or alias, a key twice or that is no text, a second document, too deep.
    """
    try:
        reader = _Reader(yaml.parse(text, Loader=_LOADER), limit_depth)
        return reader.document()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f"line {mark.line + 1}: "
        raise JsonError(JsonDefect.MALFORMED, f"{where}not YAML") from error


class _Reader:
    """One document, read event by event."""

    def __init__(self, events: Iterator[Any], limit_depth: int) -> None:
        self._events, self._limit, self._count = events, limit_depth, 0

    def document(self) -> object:
        """The value of all events."""
        self._next(yaml.StreamStartEvent)
        self._next(yaml.DocumentStartEvent)
        value = self._value(self._any(), 0)
        self._next(yaml.DocumentEndEvent)
        self._next(yaml.StreamEndEvent)
        return value

    def _next(self, kind: type[Any]) -> None:
        event = next(self._events)
        if not isinstance(event, kind):
            raise _at(event, "more than one document")

    def _any(self) -> Any:
        event = next(self._events)
        self._count += 1
        if self._count > VALUES_MOST:
            raise JsonError(JsonDefect.TOO_LARGE, f"line {event.start_mark.line + 1}: more than {VALUES_MOST} values")
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _at(event, "an anchor or alias: write the value out")
        if getattr(event, "tag", None) is not None:
            raise _at(event, "a tag: write the plain value")
        return event

    def _value(self, event: Any, depth: int) -> object:
        if depth > self._limit:
            raise _at(event, f"more than {self._limit} levels")
        if isinstance(event, yaml.ScalarEvent):
            return _scalar(event)
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[object] = []
            while not isinstance(event := self._any(), yaml.SequenceEndEvent):
                items.append(self._value(event, depth + 1))
            return items
        if isinstance(event, yaml.MappingStartEvent):
            members: dict[str, object] = {}
            while not isinstance(event := self._any(), yaml.MappingEndEvent):
                if not isinstance(event, yaml.ScalarEvent) or event.value == "<<":
                    raise _at(event, "a key that is no plain text")
                if event.value in members:
                    raise _at(event, f"the key {event.value[:40]!r} occurs twice")
                members[event.value] = self._value(self._any(), depth + 1)
            return members
        raise _at(event, "no value")


def _scalar(event: Any) -> object:
    word: str = event.value
    if event.style:  # quoted: a text, whatever it looks like
        return word
    if word.lower() in _WORDS:
        return _WORDS[word.lower()]
    if _INTEGER.fullmatch(word):
        return int(word)
    if _REAL.fullmatch(word):
        return float(word)
    if _NO_NUMBER.fullmatch(word):
        raise JsonError(JsonDefect.NOT_FINITE, f"line {event.start_mark.line + 1}: a number that is none")
    return word


def _at(event: Any, what: str) -> JsonError:
    return JsonError(JsonDefect.MALFORMED, f"line {event.start_mark.line + 1}: {what}")
