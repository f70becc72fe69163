"""Sets that extend another one and state only what differs: numbers, and policies replaced, removed and added.

A set denies all that the policies of its base deny: a number, and a policy that is replaced or removed, must be as
strict as it was, or be named in `loosens`. A PERMIT is a requirement, and its conditions deny as well as a DENY does.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

from policies.decision.combine import AllOf, Always, AnyOf, Check, Not
from policies.decision.policy import PolicySet
from policies.decision.policy_text import PARTS, parameters_of, policy_of
from policies.decision.table import Table, distinct, table_of, text_of
from policies.evidence.model import SEVERITY, Effect
from policies.words.errors import PolicyError, PolicyFault
from policies.words.parameters import PARAMETERS, Parameters, laxer, stricter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from policies.decision.combine import Predicate
    from policies.decision.policy import Policy
    from policies.primitives.base import Primitive

EXTENDING: Final = ("policy", "replace", "remove", "loosens")
"""Members of a set that extends another one, each of which may be left out."""


@dataclass(frozen=True, slots=True)
class Written:
    """Parts that a set has as text: the numbers that it states, and the table of each policy."""

    parameters: Table
    policies: tuple[Table, ...]


def extended(base: Written, top: Table, parameters: Table) -> Written:
    """Parts of a set that extends `base`: first what is left of that, in its order, then what is added.

    Args:
        base: the parts of the other set.
        top: the whole text of this one.
        parameters: the numbers that it states.

    Raises:
        PolicyError: `UNKNOWN_ID` for a policy that the base does not have, `DUPLICATE_ID` for a further one of its ids.
    """
    known = {table.text("id"): table for table in base.policies}
    removed = {name: place for place, name in _ids(top, "remove")}
    for name, place in removed.items():
        _known(name, place, known)
    replaced: dict[str, Table] = {}
    for table in _tables(top, "replace"):
        table.expect("id", optional=PARTS)
        name = table.text("id")
        _known(name, table.place("id"), known)
        if name in replaced or name in removed:
            raise PolicyError(PolicyFault.DUPLICATE_ID, table.place("id"), f"{name!r} is replaced or removed already")
        if len(table.content) == 1:
            raise PolicyError(PolicyFault.EMPTY, table.where, "a part that differs")
        replaced[name] = Table({**known[name].content, **table.content}, table.where)
    added = _tables(top, "policy")
    for table in added:
        if table.content.get("id") in known:
            raise PolicyError(PolicyFault.DUPLICATE_ID, table.place("id"), "a policy of the base is under [[replace]]")
    kept = (replaced.get(name, table) for name, table in known.items() if name not in removed)
    policies = (*kept, *added)
    if not policies:
        raise PolicyError(PolicyFault.EMPTY, "remove", "no policy is left")
    return Written(Table({**base.parameters.content, **parameters.content}, parameters.where), policies)


def floor_of(
    base: PolicySet, written: Written, top: Table, policies: tuple[Policy, ...], parameters: Parameters
) -> PolicySet:
    """Policies of the base that the set keeps whole: all that one of them denies or asks, the set does.

    Args:
        base: the other set.
        written: its parts.
        top: the whole text of the set that extends it.
        policies: of that set.
        parameters: of that set.

    Raises:
        PolicyError: `LOSES_DENIAL` where a policy or number is laxer than in the base, and not named in `loosens`;
            `LOOSENS_NOTHING` where that names what is not laxer, `UNKNOWN_ID` what is not there.
    """
    ids = [table.text("id") for table in written.policies]
    loosened = {name: place for place, name in _ids(top, "loosens")}
    for name, place in loosened.items():
        _known(name, place, [*ids, *PARAMETERS])
    for name in PARAMETERS:
        was, now = getattr(base.parameters, name), getattr(parameters, name)
        if stricter(name, was, now) and name in loosened:
            raise PolicyError(PolicyFault.LOOSENS_NOTHING, loosened[name], name)
        if not stricter(name, was, now) and name not in loosened:
            raise _loses(f"parameters.{name}", name, f"{now} instead of {was}")
    numbers = {name: laxer(name, getattr(base.parameters, name), getattr(parameters, name)) for name in PARAMETERS}
    floor = parameters_of(Table(numbers, "parameters"))
    now_of = {policy.id: policy for policy in policies}
    removed = {name: place for place, name in _ids(top, "remove")}
    replaced = {table.text("id"): table.where for table in _tables(top, "replace")}
    kept = []
    for name, table in zip(ids, written.policies, strict=True):
        policy = policy_of(table, floor)
        if name in removed:
            lost, why = removed[name], "nothing else denies what it denies"
        else:
            part = next(_laxer_parts(policy, now_of[name]), "")
            lost, why = part and f"{replaced.get(name, name)}.{part}", "it must be as strict as it was"
        if lost and name not in loosened:
            raise _loses(lost, name, why)
        if not lost and name in loosened:
            raise PolicyError(PolicyFault.LOOSENS_NOTHING, loosened[name], f"{name!r} is as strict as it was")
        if not lost:
            kept.append(policy)
    return PolicySet(base.name, base.version, tuple(kept), floor)


def _ids(top: Table, key: str) -> list[tuple[str, str]]:
    """Each id of a list, after its place."""
    if key not in top.content:
        return []
    names = distinct(top.content[key], key, text_of)
    return [(f"{key}[{i}]", name) for i, name in enumerate(names)]


def _tables(top: Table, key: str) -> list[Table]:
    if key not in top.content:
        return []
    return [table_of(each, f"{key}[{i}]") for i, each in enumerate(top.list(key))]


def _known(name: str, place: str, ids: Any) -> None:
    if name not in ids:
        has = ", ".join(repr(each) for each in ids if each not in PARAMETERS)
        raise PolicyError(PolicyFault.UNKNOWN_ID, place, f"the base has no {name!r}, but {has}")


def _loses(place: str, name: str, why: str) -> PolicyError:
    return PolicyError(PolicyFault.LOSES_DENIAL, place, f"{why}; where that is meant, loosens names {name!r}")


# --- as strict as it was ---------------------------------------------------------------------------------------------


def _laxer_parts(was: Policy, now: Policy) -> Iterator[str]:
    """Parts of a policy by which it may deny or ask less than it did.

    A PERMIT with a wider concern requires more, and permits acts that no policy named before: those are for a policy
    that is added.
    """
    permits = was.effect is Effect.PERMIT
    if permits and was.subject != now.subject:
        yield "subject"
    if permits and was.object != now.object:
        yield "object"
    if permits and was.points != now.points:
        yield "ep"
    if not _included(was.subject.agents, now.subject.agents) or not _included(
        was.subject.sponsors, now.subject.sponsors
    ):
        yield "subject"
    named = _included(was.object.ids, now.object.ids) and _included(was.object.operations, now.object.operations)
    if not named or not now.object.without <= was.object.without:
        yield "object"
    if (now.effect is Effect.PERMIT) is not permits or SEVERITY[now.effect] < SEVERITY[was.effect]:
        yield "effect"
    elif not _as_strict(was.predicate, now.predicate, permits=permits):
        yield "predicate"
    if not was.points <= now.points:
        yield "ep"
    if not was.obligations <= now.obligations:
        yield "obligation"
    if was.pit_bound is not None and (now.pit_bound is None or now.pit_bound > was.pit_bound):
        yield "pit_bound"


def _included(was: frozenset[str] | None, now: frozenset[str] | None) -> bool:
    """True where `now` means everybody and everything that `was` means."""
    return now is None or (was is not None and was <= now)


def _as_strict(was: Predicate, now: Predicate, *, permits: bool) -> bool:
    """True where the new predicate has every part of the old one: of a requirement under `all`, else under `any`."""
    if isinstance(now, Always):  # of a DENY or DEFER: it speaks always
        return True
    kind = AllOf if permits else AnyOf
    parts = list(_parts(now, kind))
    return all(any(_same(part, other) for other in parts) for part in _parts(was, kind))


def _parts(predicate: Predicate, kind: type[AllOf | AnyOf]) -> Iterator[Predicate]:
    if isinstance(predicate, kind):
        for part in predicate.parts:
            yield from _parts(part, kind)
    else:
        yield predicate


def at_least_as_strict(was: Primitive, now: Primitive) -> bool:
    """True where the primitive is the same one, and with its numbers it fails wherever the other did."""
    return type(was) is type(now) and all(
        stricter(each.name, getattr(was, each.name), getattr(now, each.name))
        for each in fields(was)  # type: ignore[arg-type]  # every primitive is a dataclass
    )


def _same(was: Predicate, now: Predicate) -> bool:
    """True where `now` is `was`, but for primitives of stricter numbers, which fail wherever the others do."""
    match was, now:
        case Check(before), Check(after):
            return at_least_as_strict(before, after)
        case Not(before), Not(after):
            return _same(before, after)
        case (AllOf(before), AllOf(after)) | (AnyOf(before), AnyOf(after)):
            return len(before) == len(after) and all(map(_same, before, after))
        case _:
            return was == now
