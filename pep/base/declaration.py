"""Declaration of a tool's operation beside the tool, by a decorator with annotated types or a table of TOML.

    @operation("valve-7", base_tier=2)
    def open_valve(opening: Annotated[float, Within(0, 1000, "permille", above={800: 3})]) -> str: ...

A declaration is checked when it is made, so a wrong one never serves.
"""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar, get_args, get_origin, get_type_hints

from capabilities.values import bounds
from capabilities.values import text as forms
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import ScopeError
from capabilities.values.scope import Grant, Limit, Tier
from capabilities.values.units import Parameter, Sort
from capabilities.values.well_formed import check_limit
from pep.base.errors import DeclarationError, PepFault
from pep.base.fact_declaration import fact_rows
from pep.base.operation_row import ArgumentForm, BoundedParameter, Operation, OperationKind, ToolArgument
from pep.base.stated_values import (
    Free,
    Length,
    Listed,
    Stated,
    Within,
    Word,
    is_whole,
    parameter_of,
    tier_stated,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from capabilities.values.scope import Bound, Budget
    from pep.base.fact_declaration import Fact

    F = TypeVar("F", bound="Callable[..., Any]")

ROW: Final = "__ztpm_operation__"
"""Attribute of a decorated function that holds its row."""
ELEMENTS: Final = 32
"""Most elements of a list that are parameters of their own; an ask holds no more values."""
FLAG: Final = "flag"
"""The word of TOML for an argument that is true or false; in Python it is `bool`."""
_UNREAD: Final = (Any, dict, dict[str, Any], list, list[Any])
"""Types that a free value reaches unchanged. A reader of a tool's arguments would change it to fit another."""


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
        hints = _hints(function)
        arguments = {each: stated for each in hints if (stated := _stated(f"{name}.{each}", hints[each])) is not None}
        made = row(object, name, arguments, base_tier=base_tier, exact=exact, when=when)
        setattr(function, ROW, _with_defaults(made, function))
        return function

    return declare


def declared(function: object) -> Operation | None:
    """The row that the function was decorated with, or None."""
    found = getattr(function, ROW, None)
    return found if isinstance(found, Operation) else None


def grant(function: Callable[..., Any] | Operation, *budgets: Budget, **tighter: Bound) -> Grant:
    """A grant of a declared function, as wide as it is declared but for the named bounds.

    Example::

        grant(open_valve, Budget("", url, 3600, 20), percent=Range(0, 400))

    Args:
        function: decorated by `operation`; or its row, as `GuardConfig.rows` has it.
        budgets: of the grant.
        tighter: bounds by the parameter's name, in its unit, inside the declared ones.

    Raises:
        DeclarationError: `TOOL_UNDECLARED`, or `DECLARATION_MALFORMED` for a bound of no parameter or outside its own.
    """
    row = function if isinstance(function, Operation) else declared(function)
    if row is None:
        raise DeclarationError(PepFault.TOOL_UNDECLARED, str(getattr(function, "__name__", function)))
    if strange := sorted(tighter.keys() - {each.parameter.name for each in row.limits}):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{row.name}.{strange[0]}: no parameter")
    limits = tuple(Limit(each.parameter, tighter.get(each.parameter.name, each.bound)) for each in row.limits)
    for limit, own in zip(limits, row.limits, strict=True):
        place = f"{row.name}.{limit.parameter.name}"
        try:
            check_limit(limit, CAPS)
        except ScopeError as error:
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {error.detail}") from None
        if not bounds.within(limit.bound, own.bound):
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {limit.bound} is wider than {own.bound}")
    return Grant(row.object, row.name, limits, tuple(sorted(budgets)))


def defined_twice(function: Callable[..., Any]) -> bool:
    """True where the function's module has another one under its name, which a server may have passed over."""
    own = inspect.unwrap(function)
    if not inspect.isfunction(own):
        return False
    named = own.__globals__.get(own.__name__)
    other = inspect.unwrap(named) if callable(named) else None
    # The same definition may run again, as in a function that makes a server.
    return inspect.isfunction(other) and other.__qualname__ == own.__qualname__ and other.__code__ != own.__code__


def _with_defaults(stated: Operation, function: Callable[..., Any]) -> Operation:
    """The row with the defaults of the function's own signature; one that is no JSON value is none."""
    parameters = inspect.signature(function).parameters
    arguments = []
    for argument in stated.arguments or ():
        try:
            default = json.dumps(parameters[argument.name].default, allow_nan=False)
        except (TypeError, ValueError):
            default = None
        arguments.append(replace(argument, default=default))
    return replace(stated, arguments=tuple(arguments))


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
    arguments: Mapping[str, Stated],
    *,
    base_tier: int,
    exact: bool,
    when: Mapping[str, Fact] | None = None,
) -> Operation:
    """The row of a tool without a robot.

    Args:
        object: the thing acted on.
        name: of the tool and its operation.
        arguments: the values of each, in their order.
        base_tier: least tier of an act.
        exact: a number finer than its unit is refused.
        when: facts of sensors that raise the tier; None for none.

    Raises:
        DeclarationError: naming tool and argument.
    """
    for word, form in ((object, forms.NAME), (name, re.compile(forms.OPERATION, re.ASCII))):
        if form.fullmatch(str(word)) is None:
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}: {word!r} is no name")
    tier = tier_stated(base_tier, name)
    limits: list[BoundedParameter] = []
    form_of: list[ToolArgument] = []
    for each, stated in arguments.items():
        place = f"{name}.{each}"
        limit = parameter_of(place, each, stated, base_tier=tier, exact=exact)
        if not isinstance(stated, Within):
            limits.append(limit)
            form_of.append(ToolArgument(each, _form(stated)))
            continue
        if not stated.elements:
            limits.append(limit)
            form_of.append(ToolArgument(each, ArgumentForm.INTEGER if stated.integer else ArgumentForm.NUMBER))
            continue
        if stated.integer or not 1 <= stated.elements <= ELEMENTS:
            raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: a list of 1 to {ELEMENTS} numbers")
        named = (Parameter(f"{each}_{at}", limit.parameter.kind) for at in range(stated.elements))
        limits.extend(replace(limit, parameter=parameter) for parameter in named)
        form_of.append(ToolArgument(each, ArgumentForm.VECTOR, stated.elements))
    names = [limit.parameter.name for limit in limits]
    if len(set(names)) < len(names):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{name}: two parameters of one name")
    kind = OperationKind.READ if tier is Tier.NO_EFFECT else OperationKind.ACT
    facts = fact_rows(f"{name}.when", {} if when is None else when, base_tier=tier)
    return Operation(object, name, tuple(limits), kind, tier, arguments=tuple(form_of), facts=facts)


_TABLE: Final = ("object", "base_tier", "arguments", "exact", "when")


def _form(stated: Word | Free | Listed | str) -> ArgumentForm:
    if isinstance(stated, Listed) and isinstance(stated.element, Within):
        return ArgumentForm.INTEGERS if stated.element.integer else ArgumentForm.NUMBERS
    return ArgumentForm.TEXT if isinstance(stated, Free) and stated.text else ArgumentForm.VALUE


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    """Annotations of the parameters, in their order."""
    hints = get_type_hints(function, include_extras=True)
    return {name: hints[name] for name in inspect.signature(function).parameters if name in hints}


def _stated(place: str, hint: Any) -> Stated | None:
    """The values of one annotated parameter; None for one that is no argument of ours.

    A server's own parameter, such as its context, is none; an argument that is left out so is found at start, when the
    row is compared with the tool's schema.
    """
    kind, *extras = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    own = [each for each in extras if isinstance(each, (Within, Word, Free, Length))]
    lengths, found = [each for each in own if isinstance(each, Length)], [e for e in own if not isinstance(e, Length)]
    if len(lengths) > 1 or len(found) > 1:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: stated twice")
    said = found[0] if found else None
    if isinstance(said, Within) and said.elements:
        if kind == list[float] and not lengths:
            return said
    elif isinstance(said, Free):
        if kind in ((str,) if said.text else _UNREAD) and not lengths:
            return said
    elif get_origin(kind) is list:
        element = _one(get_args(kind)[0], said)
        if element is not None:
            return Listed(element, *(lengths or (Length(),)))
    elif not lengths and (one := _one(kind, said)) is not None:
        return one
    if own:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: annotation and values do not go together")
    return None


def _one(kind: Any, said: object) -> Within | Word | str | None:
    """Values of a parameter of this type, or of a list's member; None where the two do not go together."""
    match said:
        case Within() if kind in (int, float):
            return replace(said, integer=kind is int)
        case Word() if kind is str:
            return said
        case None if kind in (bool, str):
            return FLAG if kind is bool else Word()
        case None if get_origin(kind) is Literal and all(isinstance(each, str) for each in get_args(kind)):
            return Word(one_of=get_args(kind))
        case None if get_origin(kind) is Literal and all(map(is_whole, get_args(kind))):
            return Within(one_of=get_args(kind), integer=True)
        case _:
            return None


def _from_toml(place: str, stated: object) -> Stated:
    if isinstance(stated, str):
        stated = {"kind": stated}
    if not isinstance(stated, dict):
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: a kind, or a table")
    given = dict(stated)
    length, kind = given.pop("list", None), given.pop("kind", None)
    try:
        rows = {side: {int(at): to for at, to in given[side].items()} for side in ("above", "below") if side in given}
        for way in ("one_of", "starts_with", "under"):
            if way in given:
                given[way] = tuple(list.copy(given[way]))
        one: Stated
        match kind:
            case None:
                one = Within(**{**given, **rows})
            case str() if kind == FLAG and not given:
                one = FLAG
            case str() if kind == Sort.FREE:
                one = Free(**given)
            case _:
                one = Word(kind, **{**given, **rows})
        if length is None:
            return one
        return Listed(one, Length(*length))  # type: ignore[arg-type]  # free values are refused with their place
    except (AttributeError, ValueError, TypeError) as error:
        raise DeclarationError(PepFault.DECLARATION_MALFORMED, f"{place}: {error}"[:200]) from error
