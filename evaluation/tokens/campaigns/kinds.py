"""Kinds of parameters beside integers: one parameter of each, and random bounds, inner ones, and ones with more.

Nothing here asks the algebra of bounds. A word is drawn from few components, so that two of them often touch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, cast

from capabilities.values.arguments import Argument, Fingerprint
from capabilities.values.scope import Bound, Each, Flags, Limit, OneOf, Range, ScalarBound, Stems, Words
from capabilities.values.units import DeclaredUnit, ListOf, Parameter, Quantity, Sort, Unit

if TYPE_CHECKING:
    from random import Random

    from capabilities.values.arguments import Value
    from capabilities.values.units import Kind

DIMENSIONS: Final = {
    "flags": Parameter("sure", Sort.FLAG),
    "texts": Parameter("title", Sort.TEXT),
    "paths": Parameter("file", Sort.PATH),
    "urls": Parameter("page", Sort.URL),
    "sizes": Parameter("body", Sort.FREE),
    "lists": Parameter("files", ListOf(Sort.PATH)),
    "counts": Parameter("counts", ListOf(DeclaredUnit("x-bar", 1_000))),
}
"""Parameters of the kinds, by the dimension of a pair that is about them."""
_COMPONENTS: Final = ("a", "b", "ab", "a.b", "é", "read")
_ORIGINS: Final = ("https://a.example", "https://a.example:8443", "https://a.example.org", "http://[::1]")
_LONGEST: Final = 3
"""Components of a word."""
_LENGTH: Final = 3
"""Most members of a list."""


def given(parameter: Parameter, value: Any) -> Value:
    """A request's parameter with this value, which need not be of the parameter's kind."""
    kind = parameter.kind
    if isinstance(kind, (Unit, DeclaredUnit)):
        return Quantity(parameter.name, kind, value)
    return Argument(parameter.name, kind, Fingerprint(value, "0" * 64) if kind is Sort.FREE else value)


# --- random bounds ---------------------------------------------------------------------------------------------------


def limits(chance: Random) -> tuple[Limit, ...]:
    """A limit of each kind."""
    return tuple(Limit(parameter, drawn(parameter.kind, chance)) for parameter in DIMENSIONS.values())


def drawn(kind: object, chance: Random) -> Bound:
    """A bound of this kind, mostly a wide one."""
    match kind:
        case Sort.FLAG:
            return Flags(frozenset({False, True}) if chance.random() < 0.9 else frozenset({chance.random() < 0.5}))
        case Sort.FREE:
            return Range(1, chance.choice((2, 100, 5_000)))
        case Sort.TEXT | Sort.PATH | Sort.URL:
            words = {_word(kind, chance) for _ in range(chance.choice((1, 2, 4)))}
            if chance.random() < 0.3:
                return Words(frozenset(words))
            divider = "" if kind is Sort.TEXT else "/"
            return _stems({""} if chance.random() < 0.4 else words - {"/"}, divider)
        case ListOf(element):
            least = chance.choice((0, 0, 1))
            return Each(cast("ScalarBound", drawn(element, chance)), least, chance.randint(max(least, 1), _LENGTH))
        case _:
            return Range(chance.randint(-9, 0), chance.randint(1, 9))


def _word(kind: object, chance: Random) -> str:
    some = [chance.choice(_COMPONENTS) for _ in range(chance.randint(1, _LONGEST))]
    match kind:
        case Sort.TEXT:
            return "".join(some)
        case Sort.PATH:
            return "/" + "/".join(some)
        case _:
            rest = [each.replace("é", "%C3%A9") for each in some[1:]]
            return "/".join([chance.choice(_ORIGINS), *rest])


def _stems(values: set[str], divider: str) -> Stems:
    """Stems without those that another one leads to."""
    kept = {one for one in values if not any(one != other and _leads(other, one, divider) for other in values)}
    return Stems(frozenset(kept or {""}), divider)


def _leads(stem: str, word: str, divider: str) -> bool:
    return not stem or (word + divider)[: len(stem + divider)] == stem + divider


def inner(kind: Kind, bound: Bound, chance: Random) -> Bound:
    """A bound of this kind inside this one, often with something in common."""
    match bound:
        case Flags(values) | Words(values):
            kept = frozenset(each for each in sorted(values) if chance.random() < 0.7)
            return type(bound)(cast("Any", kept or frozenset({min(values)})))
        case Stems(values, divider):
            further = {_further(kind, stem, divider, chance) for stem in sorted(values) if chance.random() < 0.8}
            if not further:
                return bound
            words = frozenset(further - {""})
            return Words(words) if words and chance.random() < 0.3 else _stems(further, divider)
        case Each(element, least, most):
            low, high = sorted((chance.randint(least, most), most))
            if element is None or high == 0:
                return bound
            of = kind.element if isinstance(kind, ListOf) else kind
            return Each(cast("ScalarBound", inner(of, element, chance)), low, high)
        case Range(low, high):
            least, most = sorted(chance.randint(low, high) for _ in range(2))
            return Range(1 if kind is Sort.FREE else least, most)
        case OneOf():
            raise TypeError("sets of integers are narrowed elsewhere")


def _further(kind: Kind, stem: str, divider: str, chance: Random) -> str:
    """The stem, or a word that goes on after it."""
    if chance.random() < 0.4:
        return stem
    if not stem:
        return _word(kind, chance)
    return f"{stem}{divider}{chance.choice(_COMPONENTS[:4])}"


def _beside(word: str) -> str:
    """Another word of the same kind, that does not go on after this one by a component."""
    return "https://other.example" if word.startswith("http") else f"{word}x"


def more(bound: Bound, chance: Random) -> Bound:
    """A bound with a value more than this one; one that has every value stays."""
    match bound:
        case Flags():
            return Flags(frozenset({False, True}))
        case Range(low, high):
            return Range(low, high + 1)
        case Words(values):
            word = chance.choice(sorted(values))
            return Words(values | {_beside(word)})
        case Stems(values, divider):
            if "" in values:
                return bound
            stem = chance.choice(sorted(values))
            return _stems({*values, _beside(stem) if divider else stem[:-1]}, divider)
        case Each(element, least, most):
            if element is not None and chance.random() < 0.5 and (wider := more(element, chance)) != element:
                return Each(cast("ScalarBound", wider), least, most)
            return Each(Words(frozenset({"/a"})) if element is None else element, least, most + 1)
        case OneOf():
            raise TypeError("integers are widened elsewhere")
