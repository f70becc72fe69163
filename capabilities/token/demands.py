"""Demands of a check on a request's parameters, read back from their encoding: each is the bound that wrote it.

A demand is one or more conditions on one variable, in the forms of the specification (docs/spec.md 2.2). A part is one
condition: on the value itself, on the length of a list, or on each of its members.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.scope import Bound, Each, Flags, OneOf, Range, ScalarBound, Stems, Words

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from capabilities.token.symbols import Texts

# OpBinary.Kind and OpUnary.Kind of eclipse-biscuit/biscuit, schema.proto.
LESS, AT_MOST, AT_LEAST, _CONTAINS, _PREFIX, _ADD, _ALL, _ANY = 0, 2, 3, 5, 6, 9, 25, 26
_PARENTHESES, _LENGTH = 1, 2
STEM: Final = "p"
"""Name of the variable that stands for a stem."""
MEMBER: Final = "x"
"""Name of the variable that stands for a member of a list."""


class _Place(Enum):
    """Thing that a part is about."""

    VALUE = "value"
    LENGTH = "length"
    MEMBERS = "members"


@dataclass(frozen=True, slots=True)
class _End:
    """One end of a range."""

    kind: int
    number: int


_Test: TypeAlias = _End | ScalarBound


@dataclass(frozen=True, slots=True)
class _Part:
    variable: str
    place: _Place
    test: _Test


def read(expressions: Iterable[Any], texts: Texts) -> Iterator[tuple[str, Bound]]:
    """Each variable with its bound, in order; none twice.

    Raises:
        TokenError: `CHAIN_BROKEN` for another form than those of the specification.
    """
    seen: set[str] = set()
    parts = [_part(list(expression.ops), texts) for expression in expressions]
    for name, own in groupby(parts, attrgetter("variable")):
        if name in seen:
            raise odd("two demands of one parameter")
        seen.add(name)
        yield name, _bound(list(own))


def needs_closures(bounds: Iterable[Bound | None]) -> bool:
    """True where a demand of one of these bounds has a function in it, which Datalog has since version 3.3."""
    return any(isinstance(bound, Stems) or (isinstance(bound, Each) and bound.element is not None) for bound in bounds)


def _bound(parts: Sequence[_Part]) -> Bound:
    places = [part.place for part in parts]
    if places[0] is _Place.VALUE and set(places) == {_Place.VALUE}:
        return _scalar([part.test for part in parts])
    if places[:2] != [_Place.LENGTH] * 2 or set(places[2:]) - {_Place.MEMBERS}:
        raise odd("not a demand of one form")
    length = _scalar([part.test for part in parts[:2]])
    if not isinstance(length, Range):
        raise odd("a length without its two ends")
    members = [part.test for part in parts[2:]]
    return Each(_scalar(members) if members else None, length.low, length.high)


def _scalar(tests: Sequence[_Test]) -> ScalarBound:
    match tests:
        case [_End(kind=low, number=least), _End(kind=high, number=most)] if (low, high) == (AT_LEAST, AT_MOST):
            return Range(least, most)
        case [Range() | OneOf() | Flags() | Words() | Stems() as bound]:
            return bound
        case _:
            raise odd("not a range or a set")


# --- one condition ---------------------------------------------------------------------------------------------------


def _part(ops: Sequence[Any], texts: Texts) -> _Part:
    if len(ops) == 4:
        first, length, second, last = ops
        if _unary(length) == _LENGTH:
            return _Part(variable_of(_term(first), texts), _Place.LENGTH, _end(_term(second), binary(last)))
    elif len(ops) == 3 and _content(ops[1]) == "closure" and binary(ops[2]) == _ALL:
        name, inside = _function(ops[1], texts)
        if name == MEMBER:
            of, test = _test(inside, texts)
            if of == MEMBER:
                return _Part(variable_of(_term(ops[0]), texts), _Place.MEMBERS, test)
    else:
        name, test = _test(ops, texts)
        return _Part(name, _Place.VALUE, test)
    raise odd("a condition of another form")


def _test(ops: Sequence[Any], texts: Texts) -> tuple[str, _Test]:
    """A condition on one value, with the variable that it is on."""
    if len(ops) != 3:
        raise odd("not one operation on two terms")
    first, second, last = ops
    kind = binary(last)
    if kind == _CONTAINS:
        return variable_of(_term(second), texts), _set(_term(first), texts)
    if kind != _ANY:
        return variable_of(_term(first), texts), _end(_term(second), kind)
    parameter, inside = _function(second, texts)
    spelled = _set(_term(first), texts)
    if parameter != STEM or not isinstance(spelled, Words):
        raise odd("not a set of stems")
    match inside:
        case [word, stem, prefix]:
            divided, closed = False, spelled.values
        case [word, slash, plus, parentheses, stem, prefix]:
            divided, closed = True, frozenset(each.removesuffix("/") for each in spelled.values)
            if (
                _text(slash, texts) != "/"
                or (binary(plus), _unary(parentheses)) != (_ADD, _PARENTHESES)
                or not all(each.endswith("/") for each in spelled.values if each)
                or "/" in spelled.values  # all words have the empty stem
            ):
                raise odd("not stems that end with a slash")
        case _:
            raise odd("not a comparison with stems")
    if binary(prefix) != _PREFIX or variable_of(_term(stem), texts) != STEM:
        raise odd("not a comparison with stems")
    return variable_of(_term(word), texts), Stems(closed, "/" if divided else "")


def _end(term: Any, kind: int) -> _End:
    return _End(kind, integer_of(term))


def _set(term: Any, texts: Texts) -> OneOf | Flags | Words:
    if kind_of(term) != "set":
        raise odd("not a set")
    members = list(term.set.set)
    match {kind_of(member) for member in members}:
        case kinds if kinds == {"integer"}:
            return OneOf(_ascending([int(member.integer) for member in members]))
        case kinds if kinds == {"bool"}:
            return Flags(_ascending([bool(member.bool) for member in members]))
        case kinds if kinds == {"string"}:
            return Words(frozenset(texts[number] for number in _ascending([member.string for member in members])))
        case _:
            raise odd("a set that is empty, or not of one type")


def _ascending(members: list[Any]) -> frozenset[Any]:
    if members != sorted(set(members)):
        raise odd("a set that is not in order")
    return frozenset(members)


# --- pieces ----------------------------------------------------------------------------------------------------------


def _function(op: Any, texts: Texts) -> tuple[str, list[Any]]:
    """Parameter and operations of a function of one parameter."""
    if _content(op) != "closure" or len(op.closure.params) != 1:
        raise odd("not a function of one parameter")
    return texts[op.closure.params[0]], list(op.closure.ops)


def _text(op: Any, texts: Texts) -> str:
    term = _term(op)
    if kind_of(term) != "string":
        raise odd("not a text")
    return texts[term.string]


def _term(op: Any) -> Any:
    if _content(op) != "value":
        raise odd("not a term")
    return op.value


def _unary(op: Any) -> int:
    if _content(op) != "unary" or op.unary.HasField("ffiName"):
        raise odd("not an operation on one term")
    return int(op.unary.kind)


def binary(op: Any) -> int:
    """The kind of an operation on two terms."""
    if _content(op) != "binary" or op.binary.HasField("ffiName"):
        raise odd("not an operation on two terms")
    return int(op.binary.kind)


def _content(op: Any) -> str | None:
    found: str | None = op.WhichOneof("content")
    return found


def kind_of(term: Any) -> str | None:
    """The type of a term, by its field."""
    found: str | None = term.WhichOneof("content")
    return found


def variable_of(term: Any, texts: Texts) -> str:
    """The name of a term that is a variable."""
    if kind_of(term) != "variable":
        raise odd("not a variable")
    return texts[term.variable]


def integer_of(term: Any) -> int:
    """The number of a term that is an integer."""
    if kind_of(term) != "integer":
        raise odd("not an integer")
    return int(term.integer)


def odd(what: str) -> TokenError:
    """The fault of a check in another form."""
    return TokenError(FaultCode.CHAIN_BROKEN, what)
