"""Declaration of a tool's operation beside the tool, by a decorator with annotated types or a table of TOML.

    @operation("valve-7", base_tier=2)
    def open_valve(opening: Annotated[float, Within(0, 1000, "permille", above={800: 3})]) -> str: ...

A declaration is checked when it is made, so a wrong one never serves.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar, get_args, get_origin, get_type_hints

from capabilities.values import text as forms
from capabilities.values.scope import Range, Tier
from capabilities.values.units import INT_LIMIT, Parameter, Unit
from pep.base.errors import DeclarationError, PepFault
from pep.base.fact_declaration import fact_rows
from pep.base.operation_row import ArgumentForm, BoundedParameter, Operation, OperationKind, TierRow, ToolArgument

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.base.fact_declaration import Fact

    F = TypeVar("F", bound="Callable[..., Any]")

ROW: Final = "__ztpm_operation__"
"""Attribute of a decorated function that holds its row."""
FLAG: Final = "flag"
"""The word of TOML for an argument that is true or false; in Python it is `bool`."""
SCALE_MOST: Final = 1_000_000_000
ELEMENTS: Final = 32
"""Most elements of a list; an ask holds no more values."""


@dataclass(frozen=True, slots=True)
class Within:
    """Numbers that an argument may be, in integers of a unit; both ends included.

    Attributes:
        low, high: the bounds.
        unit: of the integers, as `capabilities.values.units` spells it; "count" for plain numbers.
        scale: so many of the unit make one of the argument's numbers; None where the argument is in SI.
        above: tier of an act with a greater value, by value.
        below: tier of an act with a smaller value, by value.
        integer: the argument has whole numbers alone; `int` in an annotation says so, too.
        elements: number of elements of an argument that is a list; 0 for one that is none.
    """

    low: int
    high: int
    unit: str = "count"
    scale: int | None = None
    above: Mapping[int, int] = field(default_factory=dict)
    below: Mapping[int, int] = field(default_factory=dict)
    integer: bool = False
    elements: int = 0


def operation(
    object: str,  # noqa: A002 - a request's word
    *,
    base_tier: int,
    exact: bool = False,
    when: Mapping[str, Fact] | None = None,
) -> Callable[[F], F]:
    """Declares the function as the operation of its name on the object; the function itself stays as it is.

    Args:
        object: the thing acted on.
        base_tier: least tier of an act, 0 to 4; an operation of tier 0 changes nothing.
        exact: a number finer than its unit is refused; else it is rounded first.
        when: facts of sensors that raise the tier, by "SENSOR/NAME".

    Raises:
        DeclarationError: naming function and argument.
    """

    def declare(function: F) -> F:
        name = function.__name__
        arguments = {each: stated for each, hint in _hints(function).items() if (stated := _stated(name, each, hint))}
        setattr(function, ROW, row(object, name, arguments, base_tier=base_tier, exact=exact, when=when))
        return function

    return declare


def declared(function: object) -> Operation | None:
    """The row that the function was decorated with, or None."""
    found = getattr(function, ROW, None)
    return found if isinstance(found, Operation) else None


def row_from_toml(name: str, table: object) -> Operation:
    """The row of one tool out of its table in a configuration.

    Args:
        name: of the tool.
        table: `object`, `base_tier`, `arguments`, and maybe `exact` and `when`.

    Raises:
        DeclarationError: naming tool and member.
    """
    if not isinstance(table, dict) or not {"object", "base_tier"} <= set(table) <= {*_TABLE}:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}: members are {', '.join(_TABLE)}")
    given, exact = table.get("arguments", {}), table.get("exact", False)
    if not isinstance(given, dict) or not isinstance(exact, bool):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}.arguments")
    arguments = {each: _from_toml(f"{name}.{each}", stated) for each, stated in given.items()}
    return row(table["object"], name, arguments, base_tier=table["base_tier"], exact=exact, when=table.get("when", {}))


def row(
    object: str,  # noqa: A002 - a request's word
    name: str,
    arguments: Mapping[str, Within | str],
    *,
    base_tier: int,
    exact: bool,
    when: Mapping[str, Fact] | None = None,
) -> Operation:
    """The row of a tool without a robot.

    Args:
        object: the thing acted on.
        name: of the tool and its operation.
        arguments: the numbers of each, or `FLAG`, in their order.
        base_tier: least tier of an act.
        exact: a number finer than its unit is refused.
        when: facts of sensors that raise the tier; None for none.

    Raises:
        DeclarationError: naming tool and argument.
    """
    for word, form in ((object, forms.NAME), (name, re.compile(forms.OPERATION, re.ASCII))):
        if form.fullmatch(str(word)) is None:
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}: {word!r} is no name")
    tier = _tier(base_tier, name)
    limits: list[BoundedParameter] = []
    form_of: list[ToolArgument] = []
    for each, stated in arguments.items():
        place = f"{name}.{each}"
        if not isinstance(stated, Within):
            limits.append(BoundedParameter(Parameter(each, Unit.COUNT), Range(0, 1), 1))
            form_of.append(ToolArgument(each, ArgumentForm.FLAG))
            continue
        limit = _limit(place, each, stated, base_tier=tier, exact=exact)
        if not stated.elements:
            limits.append(limit)
            form_of.append(ToolArgument(each, ArgumentForm.INTEGER if stated.integer else ArgumentForm.NUMBER))
            continue
        if stated.integer or not 1 <= stated.elements <= ELEMENTS:
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: a list of 1 to {ELEMENTS} numbers")
        named = (Parameter(f"{each}_{at}", limit.parameter.unit) for at in range(stated.elements))
        limits.extend(replace(limit, parameter=parameter) for parameter in named)
        form_of.append(ToolArgument(each, ArgumentForm.VECTOR, stated.elements))
    names = [limit.parameter.name for limit in limits]
    if len(set(names)) < len(names):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}: two parameters of one name")
    kind = OperationKind.READ if tier is Tier.NO_EFFECT else OperationKind.ACT
    facts = fact_rows(f"{name}.when", {} if when is None else when, base_tier=tier)
    return Operation(object, name, tuple(limits), kind, tier, arguments=tuple(form_of), facts=facts)


_TABLE: Final = ("object", "base_tier", "arguments", "exact", "when")
_MEMBERS: Final = frozenset(each.name for each in fields(Within))


def _limit(place: str, name: str, stated: Within, *, base_tier: Tier, exact: bool) -> BoundedParameter:
    try:
        unit = Unit(stated.unit)
    except ValueError as error:
        raise DeclarationError(PepFault.UNIT_UNKNOWN, f"{place}: {stated.unit!r}") from error
    scale = unit.per_si if stated.scale is None else stated.scale
    if not _whole(scale) or not 1 <= scale <= SCALE_MOST:
        raise DeclarationError(PepFault.SCALE_INVALID, f"{place}: {scale!r}")
    low, high = stated.low, stated.high
    if not (_whole(low) and _whole(high) and -INT_LIMIT <= low <= high <= INT_LIMIT):
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: {low!r} to {high!r}")
    # An edge is inside the bound: beyond one that is not there is no value to raise.
    if not all(_whole(at) for at in (*stated.above, *stated.below)):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: an edge is an integer")
    if not all(low <= at < high for at in stated.above) or not all(low < at <= high for at in stated.below):
        raise DeclarationError(PepFault.BOUND_EMPTY, f"{place}: an edge outside of {low} to {high}")
    above = [TierRow(Range(at + 1, high), _tier(to, place)) for at, to in sorted(stated.above.items())]
    below = [TierRow(Range(low, at - 1), _tier(to, place)) for at, to in sorted(stated.below.items())]
    # Outwards, each row is above the class and above the row before it: one that is not would lower.
    for rows in (above, list(reversed(below))):
        tiers = [base_tier, *(each.tier for each in rows)]
        if any(outer <= inner for inner, outer in pairwise(tiers)):
            raise DeclarationError(PepFault.ROW_LOWERS, f"{place}: {[int(each) for each in tiers]}")
    # What is counted is never rounded to another thing.
    exact = exact or stated.integer or scale == 1
    return BoundedParameter(Parameter(name, unit), Range(low, high), scale, exact, (*above, *below))


def _tier(value: object, place: str) -> Tier:
    if not _whole(value) or value not in set(Tier):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {value!r} is no tier")
    return Tier(value)  # type: ignore[arg-type]  # an integer, as it was just found


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    """Annotations of the parameters, in their order."""
    hints = get_type_hints(function, include_extras=True)
    return {name: hints[name] for name in inspect.signature(function).parameters if name in hints}


def _stated(function: str, name: str, hint: Any) -> Within | str | None:
    """The numbers of one annotated parameter, or `FLAG`; None for one that is no argument of ours.

    A server's own parameter, such as its context, is none; an argument that is left out so is found at start, when the
    row is compared with the tool's schema.
    """
    if hint is bool:
        return FLAG
    if get_origin(hint) is not Annotated:
        return None
    kind, *extras = get_args(hint)
    found = next((each for each in extras if isinstance(each, Within)), None)
    if found is None:
        return None
    if kind in (int, float):
        return replace(found, integer=kind is int)
    if kind == list[float] and found.elements:
        return found
    raise DeclarationError(
        PepFault.DECLARATION_MALFORMED, f"{function}.{name}: int, float, or list[float] of `elements`"
    )


def _from_toml(place: str, stated: object) -> Within | str:
    if stated == FLAG:
        return FLAG
    if not isinstance(stated, dict) or not {"low", "high"} <= set(stated) <= _MEMBERS:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: low, high, ... or the word {FLAG}")
    try:
        rows = {side: {int(at): to for at, to in stated[side].items()} for side in ("above", "below") if side in stated}
        return Within(**{**stated, **rows})
    except (AttributeError, ValueError, TypeError) as error:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, place) from error
