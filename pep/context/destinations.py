"""Destinations of acts, and the texts that name them: where a value stands decides, never how it is asked for.

An argument that says where an act's effect goes (`Word(destination=True)`) takes its authority from the token's grant
where that one names it, or from a person's instruction. One that neither names, and that stands in a text which its
holder was told, takes it from that text, which has none (CII-2): the argument is tainted, and CII-5 refuses the act.

This is the provenance of values as in CaMeL (Debenedetti et al., arXiv:2503.18813) and FIDES (Costa et al.,
arXiv:2505.23643), where no interpreter follows the value itself through the model: it is found by its spelling.
A destination that is paraphrased, encoded or put together out of parts is not found.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from capabilities.values import characters
from capabilities.values.invisible import INVISIBLE
from capabilities.values.scope import Each, Words
from pep.context import json_value as values
from pep.context.json_value import Plain
from policies.words.labels import Integrity, tainted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from capabilities.values.chain import Chain
    from pep.base.operation_row import Operation
    from policies.evidence.content_readings import ArgumentReading
    from policies.evidence.model import Request

TEXT_CHARACTERS: Final = 262_144
"""Most characters of the different texts that are kept of one agent; beyond, every destination counts as told. Ours."""
UNSAID: Final = object()
"""Stands for a value that entered a context unseen: every destination may stand in it."""
_ADDRESS: Final = re.compile(r"[^\s<>()\[\]\"',;:?]+@[^\s<>()\[\]\"',;:?]+")
_GAPS: Final = dict.fromkeys(map(ord, INVISIBLE), " ")


class DestinationFault(StrEnum):
    """Fault of a destination that no authority names."""

    FROM_TEXT = "DESTINATION_FROM_TEXT"
    """A text that is not from a principal names it."""
    UNKNOWN = "DESTINATION_UNKNOWN"
    """Nothing is known here of the texts that its holder was told."""


@dataclass(slots=True)
class Texts:
    """Texts, folded, to be looked through for a destination.

    Attributes:
        most: characters that are kept.
        full: some were not kept.
    """

    most: int = TEXT_CHARACTERS
    full: bool = False
    _kept: set[str] = field(default_factory=set)
    _size: int = 0

    def add(self, value: object) -> None:
        """Adds every text and name in a JSON value; `UNSAID` fills it."""
        if value is UNSAID:
            self.full = True
            return
        text = "\n".join(_texts(value))
        # An invisible character is nothing to one reader, and a gap to another.
        for seen in {_folded(text), _folded(text.translate(_GAPS))} - self._kept:
            if self._size + len(seen) > self.most:
                self.full = True
                return
            self._kept.add(seen)
            self._size += len(seen)

    def have(self, part: str) -> bool:
        """True where the folded part stands in one of them, no letter or digit beside it."""
        pattern = re.compile(f"{_edge(part[:1], '<!')}{re.escape(part)}{_edge(part[-1:], '!')}")
        return any(part in text and pattern.search(text) for text in self._kept)


def parts(word: str) -> tuple[str, ...]:
    """The folded destination as a whole, then each mail address in it, and the host where it is a URL."""
    whole = _folded(word)
    found = [whole, *_ADDRESS.findall(whole)]
    if "://" in whole:
        with suppress(ValueError):  # no URL after all
            found.append(urlsplit(whole).hostname or "")
    return tuple(dict.fromkeys(each for each in found if each))


def from_text(word: str, told: Sequence[Texts], instructed: Sequence[Texts]) -> bool:
    """True where the destination stands in what was told, and no instruction has it.

    Args:
        word: the destination.
        told: texts that are not from a principal.
        instructed: texts of people's instructions for this work; one that was not kept names nothing.
    """
    whole, *inner = parts(word) or ("",)
    if not whole or any(each.have(whole) for each in instructed):
        return False
    derived = [part for part in (whole, *inner) if any(each.full or each.have(part) for each in told)]
    return not all(any(each.have(part) for each in instructed) for part in derived)


def judged(
    readings: Sequence[ArgumentReading],
    request: Request,
    operation: Operation,
    *,
    chain: Chain,
    fault: Callable[[str, Texts], DestinationFault | None],
    shown: Iterable[bytes] = (),
) -> tuple[ArgumentReading, ...]:
    """The readings, tainted for each destination that takes its authority from a text.

    Args:
        readings: of the request's parameters, in their order.
        request: of the call.
        operation: says which parameters are destinations.
        chain: whose scope may name them one by one; a bound of another form names nothing.
        fault: of a destination, given the texts that the call itself shows.
        shown: JSON values that the call shows, which its holder was told.
    """
    unnamed = operation.destinations - _named(operation, chain)
    if not unnamed:
        return tuple(readings)
    texts = Texts()
    for raw in shown:
        read = values.read(raw)
        texts.add(read.value if isinstance(read, Plain) else UNSAID)
    found = []
    for reading, value in zip(readings, request.values, strict=True):
        words = value.value if isinstance(value.value, tuple) else (value.value,)
        vouched = reading.label.integrity is Integrity.PRINCIPAL and not reading.fault
        why = None
        if reading.name in unnamed and not vouched:
            why = next((wrong for word in words if (wrong := fault(str(word), texts)) is not None), None)
        found.append(
            reading if why is None else replace(reading, label=tainted(reading.label), fault=reading.fault or str(why))
        )
    return tuple(found)


def unknown(_word: str, _shown: Texts) -> DestinationFault:
    """The fault of every destination where no admission point is known."""
    return DestinationFault.UNKNOWN


def _named(operation: Operation, chain: Chain) -> frozenset[str]:
    """Parameters whose words the effective scope names one by one."""
    grant = chain.scope.find(operation.object, operation.name)
    limits = () if grant is None else grant.limits
    bounds = {limit.parameter.name: limit.bound for limit in limits}
    each = {name: bound.element if isinstance(bound, Each) else bound for name, bound in bounds.items()}
    return frozenset(name for name, bound in each.items() if isinstance(bound, Words))


def _folded(text: str) -> str:
    return " ".join(characters.folded(text)[0].split())


def _texts(value: object) -> Iterator[str]:
    """Every text, name and number of a JSON value."""
    match value:
        case str():
            yield value
        case bool() | None:
            pass
        case int() | float():
            yield str(value)
        case list():
            for each in value:
                yield from _texts(each)
        case dict():
            for name, each in value.items():
                yield name
                yield from _texts(each)


def _edge(character: str, side: str) -> str:
    """Pattern of the edge of a word at this character of it; a letter of another script is no part."""
    return f"(?{side}[0-9a-z])" if character.isascii() else rf"(?{side}[^\W_])"
