"""Stems and words: the bounds of texts, paths and URLs as sets of strings.

A stem stands for itself and all that goes on after it, so that two of them have either nothing in common or one lies
below the other. The sets are closed under meet for that reason alone, and `a/b` is below `a` while `ab` is not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias, assert_never

from capabilities.values.scope import Stems, Words

if TYPE_CHECKING:
    from collections.abc import Iterable

WordBound: TypeAlias = Words | Stems


def begins(stem: str, word: str, divider: str) -> bool:
    """True where the word is the stem or goes on after it; all words go on after the empty stem."""
    return not stem or word == stem or word.startswith(stem + divider)


def permits(bound: WordBound, word: str) -> bool:
    """True exactly for the words inside `bound`."""
    match bound:
        case Words(values):
            return word in values
        case Stems(values, divider):
            return any(begins(stem, word, divider) for stem in values)
        case _:
            assert_never(bound)


def canonical(bound: WordBound) -> WordBound | None:
    """The one form of the same words, without stems that go on after others; None without a word."""
    match bound:
        case Words(values):
            return bound if values else None
        case Stems(values, divider):
            highest = frozenset(
                stem for stem in values if not any(begins(other, stem, divider) for other in values if other != stem)
            )
            return Stems(highest, divider) if highest else None
        case _:
            assert_never(bound)


def meet(a: WordBound, b: WordBound) -> WordBound | None:
    """The words inside both in their one form, or None when there is none. Commutative and associative."""
    if isinstance(a, Words):
        return canonical(Words(_inside(a.values, b)))
    if isinstance(b, Words):
        return canonical(Words(_inside(b.values, a)))
    if a.divider != b.divider:
        return None
    return canonical(Stems(_inside(a.values, b) | _inside(b.values, a), a.divider))


def _inside(values: Iterable[str], bound: WordBound) -> frozenset[str]:
    return frozenset(value for value in values if permits(bound, value))


def within(child: WordBound, parent: WordBound) -> bool:
    """True when every word inside `child` is inside `parent`."""
    match child, parent:
        case Stems(values, divider), Stems() if divider == parent.divider:
            # A stem is inside itself, and all that goes on after it goes on after what it goes on after.
            return all(permits(parent, stem) for stem in values)
        case Stems(values), _:
            return not values  # more words than any set has
        case Words(values), _:
            return all(permits(parent, word) for word in values)


def nearest(bound: WordBound, word: str) -> str | None:
    """The word itself where it is inside; else the member or stem that shares its longest beginning.

    Of several the lowest in the order of code points; None where not a character is shared.
    """
    if permits(bound, word):
        return word
    found = min(bound.values, key=lambda value: (-_shared(value, word), value), default="")
    return found if _shared(found, word) else None


def _shared(one: str, other: str) -> int:
    """Number of characters at the beginning of both."""
    return next(
        (place for place, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other))
    )
