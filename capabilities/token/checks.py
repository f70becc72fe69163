"""Checks of a block: its demands on a request as values, and as encoded for Biscuit's own authorizer.

A scope's grants, ceiling and window are stated in a block once: in its checks. The Biscuit library writes them
(capabilities.token.biscuit) and evaluates them; here they are read back, strictly: each check is one of the two forms
of the specification, with nothing more in it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.token import byte_layout, demands
from capabilities.token.demands import AT_LEAST, AT_MOST, LESS, binary, integer_of, kind_of, odd, variable_of
from capabilities.token.symbols import KNOWN, OWN, Texts
from capabilities.token.wire import exactly
from capabilities.values.fast_dataclass import maker
from capabilities.values.hashed_tuple import HashedTuple
from capabilities.values.scope import Each, Stems

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.scope import Bound

REMEMBERED: Final = 512
"""Checks whose content is remembered; the least recently used go first."""
REQUEST: Final = "req"
CONTEXT: Final = "req_ctx"
TIME: Final = "time"
TIER: Final = "tier"
_IN_ORDER: Final = ((TIME, AT_LEAST), (TIME, LESS), (TIER, AT_MOST))


@dataclass(frozen=True, slots=True)
class Alternative:
    """One operation that a block keeps: ``req(object, operation, v0 .. vn)`` with the bounds that the block states."""

    object: str
    operation: str
    bounds: tuple[Bound | None, ...]


@dataclass(frozen=True, slots=True)
class Checks:
    """Demands of a block on a request: one of the alternatives, a time and a base tier; None demands nothing."""

    alternatives: tuple[Alternative, ...] | None
    not_before: int | None
    not_after: int | None
    ceiling: int | None


make_checks: Final = maker(Checks)


@functools.lru_cache(maxsize=REMEMBERED)
def form(alternatives: tuple[Alternative, ...]) -> str:
    """Objects, operations and kinds of bounds, in order: the alternatives without their numbers."""
    # Names hold no blank, so no two forms have one text.
    return " ".join(" ".join((kept.object, kept.operation, *map(_form_of, kept.bounds), ";")) for kept in alternatives)


def _form_of(bound: Bound | None) -> str:
    match bound:
        case Stems(_, divider):
            return f"Stems{divider}"
        case Each(element):
            return f"Each[{_form_of(element)}]"
        case _:
            return type(bound).__name__


@functools.lru_cache(maxsize=REMEMBERED)
def needs_closures(alternatives: tuple[Alternative, ...]) -> bool:
    """True where one of the alternatives makes a demand that Datalog has since version 3.3."""
    return any(demands.needs_closures(kept.bounds) for kept in alternatives)


def variable(position: int) -> str:
    """Name of the variable that stands for a request's parameter."""
    return f"v{position}"


def read(symbols: tuple[str, ...], encoded: Sequence[bytes]) -> Checks:
    """The checks of a block.

    Args:
        symbols: the block's own texts.
        encoded: its checks, each as a message.

    Raises:
        TokenError: `CHAIN_BROKEN` when they are not, in order, at most one over the request and at most one over its
            context, in the forms of the specification.
    """
    spelling = _spelling(symbols)
    alternatives = _request(symbols, encoded[0]) if encoded else None
    rest = encoded if alternatives is None else encoded[1:]
    if len(rest) > 1:
        raise odd("a check too many")
    if not rest:
        return make_checks(alternatives, None, None, None)
    stated = None if spelling is None else byte_layout.context(rest[0], spelling)
    return make_checks(alternatives, *(stated or _context(symbols, rest[0])))


@functools.lru_cache(maxsize=REMEMBERED)
def _spelling(symbols: tuple[str, ...]) -> byte_layout.Demands | None:
    """Encoding of a check over the context in a block with these new texts; None where there is none.

    Raises:
        TokenError: `CHAIN_BROKEN` for a text that is there twice.
    """
    if len(set(symbols)) != len(symbols) or not set(symbols).isdisjoint(KNOWN):
        raise odd("a text twice")
    numbers = {text: number for number, text in (*enumerate(KNOWN), *enumerate(symbols, OWN))}
    if CONTEXT not in numbers or TIER not in numbers:
        return None
    places = tuple([(numbers[name], kind) for name, kind in _IN_ORDER])
    return byte_layout.demands(numbers[CONTEXT], (numbers[TIME], numbers[TIER]), places)


# --- over the request ------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=REMEMBERED)
def _request(symbols: tuple[str, ...], encoded: bytes) -> tuple[Alternative, ...] | None:
    """The alternatives of a check over the request; None for a check over something else.

    Remembered: the same operations under the same limits come in every token that is renewed.
    """
    check = _message(encoded)
    texts = Texts(symbols)
    if any(len(query.body) != 1 or texts[query.body[0].name] != REQUEST for query in check.queries):
        return None
    return HashedTuple(_alternative(query, texts) for query in check.queries)


def _alternative(query: Any, texts: Texts) -> Alternative:
    terms = _body(query)
    if len(terms) < 2 or any(kind_of(term) != "string" for term in terms[:2]):
        raise odd("an alternative without object and operation")
    thing, operation = (texts[term.string] for term in terms[:2])
    variables = [variable_of(term, texts) for term in terms[2:]]
    if variables != [variable(i) for i in range(len(variables))]:
        raise odd("a parameter that is no variable of its own")
    stated = dict(demands.read(query.expressions, texts))
    if list(stated) != [name for name in variables if name in stated]:
        raise odd("a demand of no parameter, or not in the order of the parameters")
    return Alternative(thing, operation, tuple(stated.get(name) for name in variables))


# --- over its context ------------------------------------------------------------------------------------------------


def _context(symbols: tuple[str, ...], encoded: bytes) -> tuple[int | None, int | None, int | None]:
    """Lower and upper end of the window, and the ceiling, as far as they are stated; at least one is."""
    check = _message(encoded)
    numbers = [_taken_out(expression) for query in check.queries for expression in query.expressions]
    found: list[int | None] = [None, None, None]
    for place, number in zip(_stated(symbols, check.SerializeToString()), numbers, strict=True):
        found[place] = number
    not_before, not_after, ceiling = found
    return not_before, not_after, ceiling


def _taken_out(expression: Any) -> int:
    """The integer on the right of a comparison, which has a zero there from now on."""
    try:
        constant = expression.ops[1].value
    except IndexError:
        raise odd("not one operation on two terms") from None
    if not constant.HasField("integer"):
        raise odd("not an integer")
    number, constant.integer = int(constant.integer), 0
    return number


@functools.lru_cache(maxsize=REMEMBERED)
def _stated(symbols: tuple[str, ...], encoded: bytes) -> tuple[int, ...]:
    """Demands of the context that a check makes, as places among the three, in order.

    Remembered for a check whose numbers are taken out: another window comes with every token.
    """
    queries = _message(encoded).queries
    if len(queries) != 1:
        raise odd("a check over no request and no context")
    query, texts = queries[0], Texts(symbols)
    terms = _body(query)
    if texts[query.body[0].name] != CONTEXT or [variable_of(term, texts) for term in terms] != [TIME, TIER]:
        raise odd("not the context of a request")
    places: list[int] = []
    for expression in query.expressions:
        first, second, kind = _binary(expression)
        demand = variable_of(first, texts), kind
        integer_of(second)
        if demand not in _IN_ORDER or (places and _IN_ORDER.index(demand) <= places[-1]):
            raise odd("a demand of the context that is none of the three, twice, or out of order")
        places.append(_IN_ORDER.index(demand))
    if not places:
        raise odd("a check that demands nothing")
    return tuple(places)


# --- pieces ----------------------------------------------------------------------------------------------------------


def _message(encoded: bytes) -> Any:
    try:
        check = exactly("Check", encoded)
    except ValueError:
        raise odd("not a check in its one encoding") from None
    if check.HasField("kind") or not check.queries:
        raise odd("not a plain check")
    return check


def _body(query: Any) -> Any:
    """The terms of the query's only predicate."""
    if query.head.name != KNOWN.index("query") or query.head.terms or query.scope or len(query.body) != 1:
        raise odd("not a query over one fact")
    return query.body[0].terms


def _binary(expression: Any) -> tuple[Any, Any, int]:
    """The two terms and the kind of an expression of one binary operation."""
    ops = list(expression.ops)
    if len(ops) != 3:
        raise odd("not one operation on two terms")
    first, second, operation = ops
    if not (first.HasField("value") and second.HasField("value")):
        raise odd("not one operation on two terms")
    return first.value, second.value, binary(operation)
