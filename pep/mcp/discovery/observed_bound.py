"""Bound of one parameter that lets the values on record pass, and as few others as its form can say."""

from __future__ import annotations

import posixpath
from typing import TYPE_CHECKING, Any, Final, cast
from urllib.parse import urlsplit

from capabilities.values import bounds
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import ScopeError
from capabilities.values.scope import Bound, Each, Flags, Limit, OneOf, Range, ScalarBound, Stems, Words
from capabilities.values.units import DeclaredUnit, Kind, ListOf, Parameter, Sort, Unit
from capabilities.values.well_formed import check_limit

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

FEW: Final = 8
"""Ours: so many words, or numbers of things, are named one by one."""


def observed_bound(parameter: Parameter, values: Sequence[bounds.Measured]) -> Bound:
    """The bound around the values, one at least, each as `capabilities.values.arguments.measured` gives it."""
    if not isinstance(parameter.kind, ListOf):
        return _scalar(parameter, parameter.kind, cast("Sequence[Any]", values))
    lists = cast("Sequence[tuple[Any, ...]]", values)
    members = [member for each in lists for member in each]
    element = _scalar(parameter, parameter.kind.element, members) if members else None
    return bounds.canonical(Each(element, min(map(len, lists)), max(map(len, lists)))) or Each(None, 0, 0)


def widens(bound: Bound) -> bool:
    """True for a bound that lets every word pass: the values on record have nothing in common."""
    if isinstance(bound, Each):
        return bound.element is not None and widens(bound.element)
    return isinstance(bound, Stems) and "" in bound.values


def _scalar(parameter: Parameter, kind: Kind, values: Sequence[Any]) -> ScalarBound:
    match kind:
        case Sort.FLAG:
            return Flags(frozenset(values))
        case Sort.FREE:
            return Range(1, max(values))
        case Sort.TEXT:
            return _words(parameter, kind, values, [_common_text(values)], "")
        case Sort.PATH:
            return _words(parameter, kind, values, _common_folders(set(values)), "/")
        case Sort.URL:
            return _words(parameter, kind, values, _common_places(set(values)), "/")
        case _:
            return _numbers(kind, values)


def _numbers(kind: Kind, values: Sequence[int]) -> Range | OneOf:
    """The range of measured numbers; of counts, such as the number of a valve, the few that were named."""
    if isinstance(kind, (Unit, DeclaredUnit)) and kind is Unit.COUNT and len(set(values)) <= FEW:
        return cast("Range | OneOf", bounds.one_of(*values))
    return Range(min(values), max(values))


def _words(
    parameter: Parameter, kind: Kind, values: Sequence[str], stems: Iterable[str], divider: str
) -> Words | Stems:
    """The words themselves while they are few, else what they begin with, else every word."""
    exactly, begun, every = Words(frozenset(values)), Stems(frozenset(stems), divider), Stems(frozenset({""}), divider)
    found = ([exactly] if len(exactly.values) <= FEW else []) + [begun]
    for bound in found:
        one = bounds.canonical(bound)
        if one is not None and _fits(Parameter(parameter.name, kind), one):
            return cast("Words | Stems", one)
    return every


def _fits(parameter: Parameter, bound: Bound) -> bool:
    try:
        check_limit(Limit(parameter, bound), CAPS)
    except ScopeError:
        return False
    return True


def _common_text(values: Iterable[str]) -> str:
    """The common beginning, as long as a limit may be."""
    first, last = min(values), max(values)
    common = next((at for at, (one, other) in enumerate(zip(first, last, strict=False)) if one != other), len(first))
    return first[:common].encode()[: CAPS.text_bytes].decode(errors="ignore")


def _common_folders(values: Iterable[str]) -> list[str]:
    """The one directory of all paths; where that is the root, the common one below each first component."""
    common = posixpath.commonpath(values)
    if common != "/":
        return [common]
    groups: dict[str, list[str]] = {}
    for path in values:
        groups.setdefault(path.split("/")[1], []).append(path)
    return [""] if len(groups) > FEW or "" in groups else [posixpath.commonpath(each) for each in groups.values()]


def _common_places(values: Iterable[str]) -> list[str]:
    """The common place below each origin, or every URL where there are many origins."""
    groups: dict[str, list[str]] = {}
    for url in values:
        parts = urlsplit(url)
        groups.setdefault(f"{parts.scheme}://{parts.netloc}", []).append(parts.path or "/")
    if len(groups) > FEW:
        return [""]
    return [origin + posixpath.commonpath(paths).rstrip("/") for origin, paths in groups.items()]
