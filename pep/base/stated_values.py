"""Values that a declaration states for an argument, and the parameter with its bound that they make.

Pure, and checked when it is made: numbers in integers of a unit, words, free values, and lists.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

from capabilities.values import bounds
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.scope import Each, Flags, Limit, OneOf, Range, ScalarBound, Stems, Tier, Words
from capabilities.values.units import INT_LIMIT, DeclaredUnit, ListOf, Measure, Parameter, Sort, Unit, kind_of
from capabilities.values.well_formed import LIST_LENGTH, check_limit
from pep.base.errors import DeclarationError, PepFault
from pep.base.operation_row import BoundedParameter
from pep.base.tier_row import TierRow

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SCALE_MOST: Final = 1_000_000_000
_FLAGS: Final = Flags(frozenset({False, True}))
"""Bound of a flag."""


@dataclass(frozen=True, slots=True)
class Within:
    """Numbers that an argument may be, in integers of a unit; both ends included.

    Attributes:
        low, high: the bounds.
        unit: of the integers, as `capabilities.values.units` spells it, "count" for plain numbers; or one's own,
            `x-NAME`, or a currency's minor one, `cur-CODE`, of which `scale` make one of the argument's numbers.
        scale: so many of the unit make one of the argument's numbers; None where the argument is in SI.
        above: tier of an act with a greater value, by value.
        below: tier of an act with a smaller value, by value.
        integer: the argument has whole numbers alone; `int` in an annotation says so, too.
        elements: number of elements of an argument that is a list, each a parameter; 0 for one that is none.
        one_of: exactly these values, in place of the bounds.
        exact: a number finer than the unit is refused; None for as the operation says, and True for a unit of one's
            own.
    """

    low: int | None = None
    high: int | None = None
    unit: str = "count"
    scale: int | None = None
    above: Mapping[int, int] = field(default_factory=dict)
    below: Mapping[int, int] = field(default_factory=dict)
    integer: bool = False
    elements: int = 0
    one_of: tuple[int, ...] = ()
    exact: bool | None = None


@dataclass(frozen=True, slots=True)
class Word:
    """Words that an argument may be; without a set or stems all of its kind.

    Attributes:
        kind: "text", "path" or "url".
        one_of: exactly these.
        starts_with: each text that starts with one of these.
        under: each path or URL that is one of these directories or origins, or lies below one.
        destination: it says where the effect goes, such as an address: the grant names it, or a person's instruction
            does, or no text does that its caller was told.
        root: directory of this machine that stands for "/" in the path: decided on, and given to the tool, is its real
            place beneath it, with every link followed. "/" for a path of this machine as it is.
    """

    kind: str = "text"
    one_of: Sequence[str] = ()
    starts_with: Sequence[str] = ()
    under: Sequence[str] = ()
    destination: bool = False
    root: str = ""


@dataclass(frozen=True, slots=True)
class Free:
    """Any JSON value but a text, of at most so many bytes as canonical JSON (RFC 8785).

    Attributes:
        most_bytes: of the value.
        text: only texts instead, with line breaks and any other characters.
    """

    most_bytes: int
    text: bool = False


@dataclass(frozen=True, slots=True)
class Length:
    """Number of members of an argument that is a list."""

    least: int = 0
    most: int = LIST_LENGTH


@dataclass(frozen=True, slots=True)
class Listed:
    """Lists that an argument may be: of so many members, each as `element` states."""

    element: Within | Word | str
    length: Length


Stated: TypeAlias = Within | Word | Free | Listed | str
"""Values that one argument may have; a text is `FLAG`."""


def parameter_of(place: str, name: str, stated: Stated, *, base_tier: Tier, exact: bool) -> BoundedParameter:
    """The parameter that the stated values are those of.

    Args:
        place: tool and argument, for the error.
        name: of the parameter.
        stated: its values.
        base_tier: least tier of an act.
        exact: a number finer than its unit is refused, where the values do not say.

    Raises:
        DeclarationError: naming the place.
    """
    return _checked(place, _parameter(place, name, stated, base_tier=base_tier, exact=exact))


def _parameter(place: str, name: str, stated: Stated, *, base_tier: Tier, exact: bool) -> BoundedParameter:
    match stated:
        case Within():
            return _limit(place, name, stated, base_tier=base_tier, exact=exact)
        case Word():
            word, bound = _word_bound(place, stated)
            _check_place(place, word, stated.destination, stated.root)
            return BoundedParameter(Parameter(name, word), bound, destination=stated.destination, root=stated.root)
        case Free():
            return BoundedParameter(Parameter(name, Sort.FREE), _free_bound(place, stated))
        case Listed(element, Length(least, most)):
            one = _parameter(place, name, element, base_tier=base_tier, exact=exact)
            kind = one.parameter.kind
            whole = is_whole(least) and is_whole(most) and most >= 1
            if isinstance(kind, ListOf) or kind is Sort.FREE or not whole:
                raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: a list of {least!r} to {most!r}")
            each = Each(one.bound, least, most)  # type: ignore[arg-type]  # the bound of one value
            return replace(one, parameter=Parameter(name, ListOf(kind)), bound=each)
        case str():
            return BoundedParameter(Parameter(name, Sort.FLAG), _FLAGS)
        case _:
            assert_never(stated)


def _check_place(place: str, word: Sort, destination: object, root: object) -> None:
    """Checks what was stated about the place that words name; a table of TOML may have stated anything.

    Raises:
        DeclarationError: `DECLARATION_MALFORMED`, naming the place.
    """
    if not isinstance(destination, bool):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: destination is true or false")
    if root != "" and not (isinstance(root, str) and root.startswith("/") and word is Sort.PATH):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: a root is absolute, and a path's")


def _checked(place: str, limit: BoundedParameter) -> BoundedParameter:
    try:
        check_limit(Limit(limit.parameter, limit.bound), CAPS)
    except ScopeError as error:
        empty = error.code is FaultCode.OUT_OF_RANGE
        raise DeclarationError(
            PepFault.BOUND_EMPTY if empty else PepFault.DECLARATION_MALFORMED, f"{place}: {error.detail}"
        ) from error
    return limit


def _measure(place: str, stated: Within) -> tuple[Measure, int]:
    """Unit, and how many of it make one of the argument's numbers."""
    own = str(stated.unit).startswith(("x-", "cur-"))
    if not own and stated.unit not in set(Unit):
        raise DeclarationError(PepFault.UNIT_UNKNOWN, f"{place}: {stated.unit!r}")
    scale = Unit(stated.unit).per_si if stated.scale is None and not own else stated.scale
    if scale is None or not is_whole(scale) or not 1 <= scale <= SCALE_MOST:
        raise DeclarationError(PepFault.SCALE_INVALID, f"{place}: {scale!r}")
    try:
        unit = kind_of(f"{stated.unit}/{scale}") if own else Unit(stated.unit)
    except ScopeError as error:
        raise DeclarationError(PepFault.UNIT_UNKNOWN, f"{place}: {stated.unit!r}") from error
    return unit, scale  # type: ignore[return-value]  # a name and a scale are a unit's


def _bound(place: str, stated: Within) -> tuple[Range | OneOf, int, int]:
    """The bound of the numbers, with its least and its greatest."""
    low, high = stated.low, stated.high
    if stated.one_of:
        if low is not None or high is not None or not all(map(is_whole, stated.one_of)):
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: low and high, or one_of integers")
        return bounds.one_of(*stated.one_of), min(stated.one_of), max(stated.one_of)  # type: ignore[return-value]
    if low is None or high is None:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: low and high, or one_of")
    if not (is_whole(low) and is_whole(high) and -INT_LIMIT <= low <= high <= INT_LIMIT):
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: {low!r} to {high!r}")
    return Range(low, high), low, high


def _limit(place: str, name: str, stated: Within, *, base_tier: Tier, exact: bool) -> BoundedParameter:
    unit, scale = _measure(place, stated)
    bound, low, high = _bound(place, stated)
    # An edge is inside the bound: beyond one that is not there is no value to raise.
    if not all(is_whole(at) for at in (*stated.above, *stated.below)):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: an edge is an integer")
    if not all(low <= at < high for at in stated.above) or not all(low < at <= high for at in stated.below):
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: an edge outside of {low} to {high}")
    above = [TierRow(Range(at + 1, high), tier_stated(to, place)) for at, to in sorted(stated.above.items())]
    below = [TierRow(Range(low, at - 1), tier_stated(to, place)) for at, to in sorted(stated.below.items())]
    check_rows_raise(place, base_tier, above, below)
    # What is counted, or one of a set, is never rounded to another thing.
    usual = exact or isinstance(unit, DeclaredUnit) if stated.exact is None else stated.exact
    exact = usual or stated.integer or scale == 1 or bool(stated.one_of)
    return BoundedParameter(Parameter(name, unit), bound, scale, exact, (*above, *below))


def check_rows_raise(place: str, base_tier: Tier, above: Sequence[TierRow], below: Sequence[TierRow]) -> None:
    """Checks that no row lowers: outwards each is above the class, and above the row before it.

    Args:
        place: of the rows, for the error.
        base_tier: the class.
        above: rows of greater values, ascending by value.
        below: rows of smaller values, likewise.

    Raises:
        DeclarationError: `ROW_LOWERS`, naming the place.
    """
    for rows in (above, list(reversed(below))):
        tiers = [base_tier, *(each.tier for each in rows)]
        if any(outer <= inner for inner, outer in pairwise(tiers)):
            raise DeclarationError(PepFault.ROW_LOWERS, f"{place}: {[int(each) for each in tiers]}")


def tier_stated(value: object, place: str) -> Tier:
    """The tier of a stated number.

    Raises:
        DeclarationError: `DECLARATION_MALFORMED`, naming the place.
    """
    if not is_whole(value) or value not in set(Tier):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {value!r} is no tier")
    return Tier(value)  # type: ignore[arg-type]  # an integer, as it was just found


def _word_bound(place: str, stated: Word) -> tuple[Sort, ScalarBound]:
    """Kind and bound of the stated words, in its one form but not yet seen to be well-formed.

    Args:
        place: tool and argument, for the error.
        stated: of the argument.

    Raises:
        DeclarationError: `DECLARATION_MALFORMED` for more than one way, or one of another kind.
    """
    ways = {"one_of": stated.one_of, "starts_with": stated.starts_with, "under": stated.under}
    given = {way: values for way, values in ways.items() if values}
    stems = "starts_with" if stated.kind == Sort.TEXT else "under"
    if stated.kind not in (Sort.TEXT, Sort.PATH, Sort.URL) or len(given) > 1 or not given.keys() <= {"one_of", stems}:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: text, path or url; one_of or {stems}")
    kind, divider = Sort(stated.kind), "" if stated.kind == Sort.TEXT else "/"
    ((way, values),) = given.items() or ((stems, ("",)),)
    if isinstance(values, str) or not all(isinstance(each, str) for each in values):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {way} is a list of texts")
    words = Words(frozenset(values)) if way == "one_of" else Stems(frozenset(values), divider)
    return kind, bounds.canonical(words) or words  # type: ignore[return-value]  # no list


def _free_bound(place: str, stated: Free) -> Range:
    """Bound of a free value's size.

    Raises:
        DeclarationError: `BOUND_EMPTY` where no value is as small.
    """
    if not isinstance(stated.text, bool):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: text is true or false")
    most = stated.most_bytes
    if not is_whole(most) or most < 1:
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: at least 1 byte")
    return Range(1, most)


def is_whole(value: object) -> bool:
    """True for an integer that is no truth value."""
    return isinstance(value, int) and not isinstance(value, bool)
