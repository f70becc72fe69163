"""Budgets of grants: those of a first block, those of a hop below it, and the rows of a statement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from capabilities.values.errors import FaultCode
from capabilities.values.scope import Budget, Each, Grant, Limit, OneOf, Range, Restriction, Scope
from capabilities.values.units import ListOf, Parameter, Sort, Unit
from tests.vectors.tokens.cases import Accepted, Case, Group, Made, faults, group
from tests.vectors.tokens.ordinary import CELL, OTHER_CELL, SMALL, authority, hop, member

COUNT = Parameter("items", Unit.COUNT)
FILES = Parameter("files", ListOf(Unit.COUNT))
NOTE = Parameter("note", Sort.FREE)
GO = Grant(
    "arm",
    "go",
    (
        Limit(COUNT, Range(0, 9)),
        Limit(Parameter("shift", Unit.COUNT), Range(-1, 9)),
        Limit(FILES, Each(Range(0, 9), 0, 3)),
        Limit(NOTE, Range(1, 9)),
    ),
)
READ = Grant("arm", "read")
WEEK = 604_800
MOST = 2**53 - 1


def acts(most: int, per_s: int, audience: str = CELL, *, of: str = "") -> Budget:
    return Budget(of, audience, per_s, most)


def of(*go: Budget, read: tuple[Budget, ...] = (), **other: Any) -> Scope:
    """A scope of two grants with these budgets."""
    return replace(SMALL, grants=(replace(GO, budgets=go), replace(READ, budgets=read)), **other)


def rows(scope: Scope | Restriction) -> list[list[Any]]:
    return [
        [place, each.parameter, each.audience, each.window_s, each.most]
        for place, grant in enumerate(scope.grants or ())
        for each in grant.budgets
    ]


def stated(*given: Any) -> Callable[[], Made]:
    """An authority block with these very rows."""
    return lambda: authority(of(), says=member(budgets=list(given)))


def minted(scope: Scope) -> Made:
    own = rows(scope)
    return authority(scope, says=member(budgets=own)) if own else authority(scope)


def kept(*go: Budget, read: tuple[Budget, ...] = (), **other: Any) -> Restriction:
    """A restriction that keeps both grants and states these budgets."""
    return Restriction(grants=(Grant("arm", "go", (), go), Grant("arm", "read", (), read)), **other)


def below(parent: Scope, restriction: Restriction, **other: Any) -> Callable[[], Made]:
    """One hop below; a restriction without budgets has no member for them."""
    own = rows(restriction)
    says = {"says": member(budgets=own)} if own else {}
    return lambda: hop(minted(parent), restriction, parent=parent, **{**says, **other})


def whole(title: str, scope: Scope) -> Case:
    return Case(title, "TOK-6", lambda: minted(scope), Accepted(scope))


def narrower(title: str, parent: Scope, restriction: Restriction, **child: Any) -> Case:
    return Case(
        title, "TOK-6", below(parent, restriction), Accepted(replace(parent, **{"depth": parent.depth - 1, **child}))
    )


TEN = acts(10, 60)
PARENT = of(TEN)
BOTH = frozenset({CELL, OTHER_CELL})
SHARED = of(acts(4, 60), acts(6, 60, OTHER_CELL), audiences=BOTH)

NARROWER = {
    "Fewer acts": ((acts(9, 60),), PARENT),
    "As many acts in a longer time": ((acts(10, 61),), PARENT),
    "Half the acts in half the time": ((acts(5, 30),), PARENT),
    "Fewer windows than would fill it": ((acts(3, 25),), PARENT),
    "A slower pace beside the budget": ((acts(8, 20), acts(10, 60)), PARENT),
    "A first budget": ((acts(MOST, 1),), of()),
    "A budget of a quantity beside one of acts": ((acts(10, 60), acts(1, 60, of="items")), PARENT),
    "Less of a quantity": ((acts(8, 60, of="items"),), of(acts(9, 60, of="items"))),
}
"""Budgets of a hop that are narrower than the parent's."""
WIDER = {
    "One act more": ((acts(11, 60),), PARENT),
    "As many acts in a shorter time": ((acts(10, 59),), PARENT),
    "One window more than fills it": ((acts(5, 29),), PARENT),
    "More acts in a much longer time": ((acts(11, WEEK),), PARENT),
    "A budget of a quantity in place of one of acts": ((acts(1, 60, of="items"),), PARENT),
    "A budget of acts in place of one of a quantity": ((acts(1, 60),), of(acts(9, 60, of="items"))),
    "A budget at another audience alone": ((acts(1, 60, OTHER_CELL),), PARENT),
    "One of two budgets dropped": ((acts(8, 20),), of(acts(8, 20), acts(10, 60))),
    "A share of another": ((acts(5, 60), acts(5, 60, OTHER_CELL)), SHARED),
    "The most in a moment below the least in a week": ((acts(MOST, 1),), of(acts(1, WEEK))),
}
ROW = [0, "", CELL, 60, 10]
BROKEN = {
    "No rows": stated(),
    "A row of another length": stated([*ROW, 0]),
    "A row too short": stated(ROW[:4]),
    "A row that is an object": stated({"most": 10}),
    "A row of no grant": stated([2, *ROW[1:]]),
    "A row below the first grant": stated([-1, *ROW[1:]]),
    "A row that names its grant": stated(["go", *ROW[1:]]),
    "Rows out of order": stated([1, *ROW[1:]], ROW),
    "A row twice": stated(ROW, ROW),
    "A budget of none": stated([*ROW[:4], 0]),
    "A budget of less than none": stated([*ROW[:4], -1]),
    "A budget of more than there are": stated([*ROW[:4], MOST + 1]),
    "A budget of half an act": stated([*ROW[:4], 0.5]),
    "A budget of a truth": stated([*ROW[:4], True]),
    "A budget in no time": stated([0, "", CELL, 0, 10]),
    "A budget in more than a week": stated([0, "", CELL, WEEK + 1, 10]),
    "A budget of nobody's parameter": stated([0, "other", CELL, 60, 10]),
    "A budget of another grant's parameter": stated([1, "items", CELL, 60, 10]),
    "A budget of a quantity below 0": stated([0, "shift", CELL, 60, 10]),
    "A budget of a list": stated([0, "files", CELL, 60, 10]),
    "A budget of a free value": stated([0, "note", CELL, 60, 10]),
    "A budget of an invisible parameter": stated([0, "items\u200b", CELL, 60, 10]),
    "A budget at no URL": stated([0, "", "cell", 60, 10]),
    "A budget at a URL in another spelling": stated([0, "", CELL + "/", 60, 10]),
    "A budget at another audience alone, at first": stated([0, "", OTHER_CELL, 60, 10]),
    "Two budgets of one time": stated([*ROW[:4], 9], ROW),
    "A budget that a pace implies": stated([0, "", CELL, 20, 3], [0, "", CELL, 60, 9]),
    "A budget that a longer time implies": stated([0, "", CELL, 59, 10], ROW),
    "More budgets than there may be": stated(*([0, "", CELL, n + 1, n + 1] for n in range(65))),
    "No list of rows": lambda: authority(of(), says=member(budgets=None)),
    "A share for one audience of two": lambda: authority(of(audiences=BOTH), says=member(budgets=[ROW])),
    "A share for one audience of two, of a quantity": lambda: authority(
        of(audiences=BOTH),
        says=member(budgets=[ROW, [0, "", OTHER_CELL, 60, 9], [0, "items", CELL, 60, 9]]),
    ),
    "A hop with a share for one audience of two": below(of(audiences=BOTH), kept(TEN)),
    "A hop with a budget of nobody's parameter": below(PARENT, kept(TEN, acts(1, 60, of="other"))),
    "A hop with a budget of a quantity below 0": below(PARENT, kept(TEN, acts(1, 60, of="shift"))),
    "A hop with budgets and no grants": below(PARENT, Restriction(depth=0), says=member(budgets=[ROW])),
    "A hop with a row of no grant": below(PARENT, kept(TEN), says=member(budgets=[[2, *ROW[1:]]])),
    "A hop with two budgets, one implied": below(PARENT, kept(TEN), says=member(budgets=[[*ROW[:4], 9], ROW])),
}
LESS = OneOf(frozenset({1, 5}))

GROUPS: tuple[Group, ...] = (
    group(
        "budgets",
        "Budgets of grants: rows of a statement, one form, and the order of a hop.",
        whole("A budget of acts", PARENT),
        whole("A budget of a quantity", of(acts(10, 60, of="items"))),
        whole("The largest budget in the shortest time", of(acts(MOST, 1))),
        whole("The least budget in the longest time", of(acts(1, WEEK))),
        whole("A pace and a budget", of(acts(3, 20), acts(8, 60))),
        whole("A share for each audience", SHARED),
        whole("Budgets of both grants", of(TEN, read=(acts(1, 1),))),
        whole("A budget at an audience too many", of(acts(1, 1), acts(2, 2, OTHER_CELL))),
        whole("As many budgets as there may be", of(*(acts(64 * 64 - (63 - n), 64 + n) for n in range(64)))),
        (
            narrower(title, parent, kept(*go), grants=(replace(GO, budgets=go), READ))
            for title, (go, parent) in NARROWER.items()
        ),
        narrower(
            "Budgets that a hop does not state are kept",
            PARENT,
            kept(read=(acts(1, 1),)),
            grants=(replace(GO, budgets=(TEN,)), replace(READ, budgets=(acts(1, 1),))),
        ),
        narrower(
            "Budgets of a hop that states no grants are kept",
            PARENT,
            Restriction(delegates=frozenset()),
            delegates=frozenset(),
        ),
        narrower(
            "A budget of a quantity with fewer values",
            of(acts(9, 60, of="items")),
            Restriction(grants=(Grant("arm", "go", (Limit(COUNT, LESS),)), Grant("arm", "read"))),
            grants=(replace(GO, limits=(Limit(COUNT, LESS), *GO.limits[1:]), budgets=(acts(9, 60, of="items"),)), READ),
        ),
        narrower(
            "The share of an audience that is dropped is kept",
            SHARED,
            Restriction(audiences=frozenset({CELL})),
            audiences=frozenset({CELL}),
        ),
        faults(
            FaultCode.NOT_NARROWER, "TOK-6", {title: below(parent, kept(*go)) for title, (go, parent) in WIDER.items()}
        ),
        faults(FaultCode.NOT_NARROWER, "TOK-6", {"The very same budget, and nothing less": below(PARENT, kept(TEN))}),
        faults(FaultCode.CHAIN_BROKEN, "TOK-6", BROKEN),
    ),
)
