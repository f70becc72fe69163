"""Explanation of a hop that is not narrower, for machines and in one sentence, and the nearest accepted hop.

The reader of an explanation holds the parent's scope: nothing here says more than the holder's own token does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capabilities.values import algebra, budgets
from capabilities.values.bounds import kind_to_json, size
from capabilities.values.boxes import boxes_of
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Grant, Restriction, Scope, Widening
from capabilities.values.scope_json import restriction_to_json

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.scope import Bound, Limit

__all__ = ["Explanation", "difference", "explain", "explanation_to_json", "narrowable", "repair"]

TOLD: Final = 4
"""Places that the sentence tells one by one."""
NAMED: Final = 4
"""Names and numbers of one list that the sentence spells."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Explanation of a restriction that is refused under its parent.

    Attributes:
        widenings: every place where it asks for more, with the nearest that is permitted. Empty when it asks for
            nothing more and takes nothing away.
        axes: the place of a widening in a vector parameter, by `Widening.what`: the parameter's name and the axis.
        could_narrow: when it takes nothing away, the dimensions in which something could be; otherwise empty.
        repaired: the nearest restriction that is accepted, or None: see `repair`.
        sentence: all this in one sentence, for people.
    """

    widenings: tuple[Widening, ...]
    axes: dict[str, tuple[str, int]]
    could_narrow: tuple[str, ...]
    repaired: Restriction | None
    sentence: str


def explain(parent: Scope, restriction: Restriction) -> Explanation | None:
    """Explanation of a hop that would be refused as not narrower; None when it would be accepted."""
    found = algebra.hop(parent, restriction)
    if isinstance(found, Scope):
        return None
    axes = _axes(parent, found.widenings)
    could = () if found.widenings else narrowable(parent)
    return Explanation(
        found.widenings, axes, could, repair(parent, restriction), _sentence(found.widenings, axes, could)
    )


def repair(parent: Scope, restriction: Restriction) -> Restriction | None:
    """The nearest restriction that a hop below `parent` may state: all that it asks for and the parent has.

    It is the restriction itself when that is accepted, and otherwise states the meet of the two: never more than was
    asked, nor more than the parent has, and no accepted restriction between. None when the meet takes nothing away in
    any of `algebra.COUNTED`, or nothing is left of it.
    """
    if isinstance(algebra.hop(parent, restriction), Scope):
        return restriction
    if parent.depth < 1:
        return None
    both = algebra.meet(replace(parent, depth=parent.depth - 1), algebra.stated(parent, restriction))
    if both is None or not algebra.narrows(both, parent).strict or _without_form(both):
        return None
    return difference(parent, both)


def _without_form(child: Scope) -> bool:
    """True where the budgets that a restriction asked for have no form of the profile, however narrow."""
    return budgets.defect(child) is not None or any(len(each.budgets) > DEFAULT.budgets for each in child.grants)


def difference(parent: Scope, child: Scope) -> Restriction:
    """The least restriction that states `child`, which narrows `parent` and has less depth: nothing in it is kept."""
    return Restriction(
        grants=None if child.grants == parent.grants else tuple(_tightened(parent, grant) for grant in child.grants),
        ceiling=None if child.ceiling == parent.ceiling else child.ceiling,
        audiences=None if child.audiences == parent.audiences else child.audiences,
        delegates=None if child.delegates == parent.delegates else child.delegates,
        depth=None if child.depth == parent.depth - 1 else child.depth,
        not_before=None if child.not_before == parent.not_before else child.not_before,
        not_after=None if child.not_after == parent.not_after else child.not_after,
    )


def _tightened(parent: Scope, grant: Grant) -> Grant:
    above = parent.find(grant.object, grant.operation)
    kept: Iterable[Limit] = () if above is None else above.limits
    bound_of: dict[object, Bound] = {limit.parameter: limit.bound for limit in kept}
    limits = tuple(limit for limit in grant.limits if limit.bound != bound_of.get(limit.parameter))
    stated = () if above is not None and grant.budgets == above.budgets else grant.budgets
    return Grant(grant.object, grant.operation, limits, stated)


def narrowable(parent: Scope) -> tuple[str, ...]:
    """The dimensions out of `algebra.COUNTED` in which a scope can have less and still be one."""
    could = {
        "grants": len(parent.grants) > 1,
        "limits": any(size(limit.bound) > 1 for grant in parent.grants for limit in grant.limits),
        "budgets": budgets.shrinkable(parent),
        "ceiling": parent.ceiling > 0,
        "audiences": len(parent.audiences) > 1,
        "delegates": bool(parent.delegates),
    }
    return tuple(dimension for dimension in algebra.COUNTED if could[dimension])


def explanation_to_json(explanation: Explanation) -> dict[str, object]:
    """The explanation as plain JSON. `repaired` has the wire form of a restriction."""
    return {
        "sentence": explanation.sentence,
        "places": [_place(place, explanation.axes.get(place.what)) for place in explanation.widenings],
        "could_narrow": list(explanation.could_narrow),
        "repaired": None if explanation.repaired is None else restriction_to_json(explanation.repaired),
    }


def _place(place: Widening, axis: tuple[str, int] | None) -> dict[str, object]:
    told: dict[str, object] = {
        "dimension": place.dimension,
        "what": place.what,
        "parent": place.parent,
        "child": place.child,
        "nearest": place.nearest,
    }
    if place.kind is not None:
        told |= kind_to_json(place.kind)
    if axis is not None:
        told["vector"], told["axis"] = axis
    return told


def _axes(parent: Scope, widenings: tuple[Widening, ...]) -> dict[str, tuple[str, int]]:
    """Places of widenings that are an axis of a vector parameter."""
    wider = {place.what for place in widenings if place.dimension == "limits"}
    found: dict[str, tuple[str, int]] = {}
    for grant in parent.grants:
        where = f"{grant.object}/{grant.operation}"
        for box in boxes_of(grant):
            for axis in range(len(box.bounds)):
                if (what := f"{where}/{box.name}{axis}") in wider:
                    found[what] = (f"{where}/{box.name}", axis)
    return found


# --- in words --------------------------------------------------------------------------------------------------------


def _sentence(widenings: tuple[Widening, ...], axes: dict[str, tuple[str, int]], could: tuple[str, ...]) -> str:
    if not widenings:
        return (
            f"Nothing is taken away: take something from {_or(could)}." if could else "Nothing more can be taken away."
        )
    told = [_told(place, axes.get(place.what)) for place in widenings[:TOLD]]
    more = len(widenings) - len(told)
    return "; ".join(told) + (f"; and {more} more." if more else ".")


def _told(place: Widening, axis: tuple[str, int] | None) -> str:
    match place.dimension, place.child:
        case "grants", _:
            return f"{place.what} is not granted"
        case "limits", list():
            return f"{place.what} takes {_parameters(place.parent)}, not {_parameters(place.child)}"
        case "budgets", _:
            return f"{place.what}: at most {_rates(place.child)} asked, {_rates(place.parent)} permitted"
        case "depth", _ if place.nearest is None:
            return "no depth is left for a further hop"
        case _:
            what = place.what if axis is None else f"{axis[0]}, axis {axis[1]}"
            unit = "" if place.kind is None else f" {place.kind}"
            shown = _span if place.dimension == "window" else _shown
            nearest = "" if place.nearest in (None, place.parent) else f", nearest {shown(place.nearest)}"
            return f"{what}: {shown(place.child)} asked, {shown(place.parent)} permitted{nearest}{unit}"


def _span(value: object) -> str:
    return f"{value[0]} until {value[1]}" if isinstance(value, list) else str(value)


def _shown(value: object) -> str:
    match value:
        case {"low": low, "high": high}:
            return f"{low} to {high}" if low != high else f"{low}"
        case {"starts_with": list(stems)} | {"under": list(stems)} if "" in stems:
            return "any"
        case {"starts_with": list(stems)}:
            return f"what starts with {_shown(stems)}"
        case {"under": list(stems)}:
            return f"what is under {_shown(stems)}"
        case {"each": None}:
            return "the empty list"
        case {"each": element, "least": least, "most": most}:
            return f"{least} to {most} times {_shown(element)}"
        case {"one_of": list(members)} | list(members):
            spelled = [_spelled(member) for member in members[:NAMED]]
            more = len(members) - len(spelled)
            return (", ".join(spelled) + (f" and {more} more" if more else "")) or "nobody"
        case int():
            return f"at most {int(value)}"
        case _:
            return str(value)


def _spelled(member: object) -> str:
    """A member for people: a truth value as JSON spells it, the empty word by its marks."""
    return str(member).lower() if isinstance(member, bool) else str(member) or '""'


def _parameters(limits: object) -> str:
    of = [(limit["parameter"], limit.get("unit") or limit.get("kind")) for limit in _listed(limits)]
    listed = [f"{name} ({kind})" for name, kind in of]
    return _shown(listed) if listed else "no parameters"


def _listed(limits: object) -> list[dict[str, object]]:
    return limits if isinstance(limits, list) else []


def _rates(budgets: object) -> str:
    told = [
        f"{each['most']} {'of ' + str(each['parameter']) if 'parameter' in each else 'acts'} in {each['per_s']} s at "
        f"{each['audience']}"
        for each in _listed(budgets)[:NAMED]
    ]
    return " and ".join(told) or "any number of acts"


def _or(words: tuple[str, ...]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
