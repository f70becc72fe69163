"""Shape of a request and its evidence: exact types and finite numbers, all the way down.

Python compares -0.0, True and 5e-324 with integers without a word. So nothing is judged before every value that a
primitive could look at is of exactly the type that its field declares. A value that is not is named by its place.
"""

from __future__ import annotations

import math
import sys
import types
from dataclasses import fields, is_dataclass
from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, TypeAlias, Union, get_args, get_origin, get_type_hints

from capabilities.values.arguments import Argument, Fingerprint, Value
from capabilities.values.chain import Attestation, Chain, EvidenceKind, Hop, Refusal, Sponsor
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Bound, OneOf, Range, Scope, Tier
from capabilities.values.units import Kind, Quantity, Unit
from policies.evidence import conduct_readings, content_readings, evidence, fact_reading
from policies.evidence.model import Point, Request
from policies.words import labels
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from policies.evidence.evidence import Evidence

Checker: TypeAlias = "Callable[[Any], str | None]"
"""Says where inside a value something is wrong: "" for the value itself, None for nowhere."""

NAMES: Final[dict[str, Any]] = {
    **vars(conduct_readings),
    **vars(labels),
    **vars(content_readings),
    **vars(fact_reading),
    **vars(evidence),
    **{kind.__name__: kind for kind in (Attestation, Chain, EvidenceKind, Fault, FaultCode, Hop, Refusal, Sponsor)},
    **{kind.__name__: kind for kind in (OneOf, Point, Quantity, Range, Scope, Tier, Unit)},
    **{kind.__name__: kind for kind in (Argument, Fingerprint)},
    "Bound": Bound,
    "Kind": Kind,
    "Value": Value,
}
"""Types that the annotations of readings name; most of their imports are for the type checker alone."""

WORDS: Final = frozenset({str, Reason, FaultCode})
"""Types that may stand where a text is declared: a text, or a word of a closed list."""

UNSEEN: Final = frozenset({(Scope, "grants")})
"""Fields that no primitive looks into: verification compiled them into its answer to the request."""


def fault(request: Request, seen: Evidence) -> str | None:
    """The place of the first value that is not of its declared type, e.g. "evidence.trust.score_permille"; else None.

    Args:
        request: the one to check.
        seen: all readings.
    """
    for kind, value, name in ((Request, request, "request"), (evidence.Evidence, seen, "evidence")):
        wrong = "" if type(value) is not kind else _checker(kind)(value)
        if wrong is not None:
            return name + wrong
    return None


@cache
def _checker(kind: type) -> Checker:
    """The checker of values of exactly this dataclass.

    A combination of types that was found right once is known by itself; deeper values are looked at every time.
    """
    hints = get_type_hints(kind, {**vars(sys.modules[kind.__module__]), **NAMES})
    names = tuple(field.name for field in fields(kind) if (kind, field.name) not in UNSEEN)
    read: Any = attrgetter(*names) if len(names) > 1 else lambda value: tuple(getattr(value, name) for name in names)
    allowed = [_types(hints[name]) for name in names]
    deep = [(n, name, inside) for n, name in enumerate(names) if (inside := _inside(hints[name]))]
    known: set[tuple[type, ...]] = set()

    def check(value: Any) -> str | None:
        values = read(value)
        found = tuple(map(type, values))
        if found not in known:
            for name, has, may in zip(names, found, allowed, strict=True):
                if has not in may:
                    return f".{name}"
            known.add(found)
        for n, name, inside in deep:
            further = inside.get(found[n])
            if further is not None and (wrong := further(values[n])) is not None:
                return f".{name}{wrong}"
        return None

    return check


def _alternatives(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _types(hint: Any) -> frozenset[type]:
    """Exact types that a value of this annotation may have.

    A text may also be a word of a closed list.
    """
    found: set[type] = set()
    for each in _alternatives(hint):
        plain = get_origin(each) or each
        found |= {float, int} if plain is float else WORDS if plain is str else {plain}
    return frozenset(found)


def _inside(hint: Any) -> dict[type, Checker]:
    """Checkers by type, for each type of this annotation that has values inside."""
    found: dict[type, Checker] = {}
    for each in _alternatives(hint):
        plain = get_origin(each) or each
        if plain is float:
            found[float] = lambda value: None if math.isfinite(value) else ""
        elif plain in (tuple, frozenset):
            found[plain] = _members(get_args(each)[0])
        elif isinstance(plain, type) and is_dataclass(plain):
            found[plain] = _checker(plain)
    return found


def _members(hint: Any) -> Checker:
    """The checker of a container; the members of a pair are of one kind here."""
    may, inside = _types(hint), _inside(hint)

    def check(values: Any) -> str | None:
        if may.issuperset(map(type, values)) and not inside:
            return None
        for n, value in enumerate(values):
            further = inside.get(type(value))
            wrong = "" if type(value) not in may else None if further is None else further(value)
            if wrong is not None:
                return f"[{n}]{wrong}"
        return None

    return check
