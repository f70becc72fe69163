"""Tables of TOML, read strictly: an unknown, missing or bad member is refused with code and place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values.characters import shown
from capabilities.values.invisible import INVISIBLE
from policies.words.errors import PolicyError, PolicyFault

if TYPE_CHECKING:
    import re
    from collections.abc import Callable, Mapping

MEMBER_LIMIT: Final = 256
"""Members of any list."""
NAME_LIMIT: Final = 128
"""Characters of a name."""
ANY: Final = "any"
V = TypeVar("V", bound=StrEnum)


@dataclass(frozen=True, slots=True)
class Table:
    """A TOML table with its place, read strictly."""

    content: Mapping[str, object]
    where: str

    def place(self, key: str) -> str:
        """Place of a member."""
        return f"{self.where}.{key}" if self.where else key

    def expect(self, *required: str, optional: tuple[str, ...] = ()) -> None:
        """Exactly these keys."""
        for key in self.content:
            if key not in required and key not in optional:
                raise PolicyError(PolicyFault.UNKNOWN_KEY, self.place(key))
        for key in required:
            if key not in self.content:
                raise PolicyError(PolicyFault.MISSING_KEY, self.place(key))

    def text(self, key: str) -> str:
        """A text."""
        return text_of(self.content[key], self.place(key))

    def list(self, key: str) -> list[object]:
        """A list that is not empty."""
        return list_of(self.content[key], self.place(key))

    def table(self, key: str) -> Table:
        """A table in it."""
        return table_of(self.content[key], self.place(key))

    def integer(self, key: str, low: int, high: int) -> int:
        """An integer from `low` to `high`, both included."""
        value, where = self.content[key], self.place(key)
        if isinstance(value, float) and not math.isfinite(value):
            raise PolicyError(PolicyFault.NOT_FINITE, where)
        if isinstance(value, bool) or not isinstance(value, int):
            raise PolicyError(PolicyFault.WRONG_TYPE, where, "an integer is wanted")
        if not low <= value <= high:
            raise PolicyError(PolicyFault.OUT_OF_RANGE, where, f"{low} to {high}")
        return value

    def names(self, key: str, form: re.Pattern[str]) -> frozenset[str] | None:
        """A set of names of a form, or None for the word `any`."""
        return None if self.content[key] == ANY else self.exactly(key, form)

    def exactly(self, key: str, form: re.Pattern[str]) -> frozenset[str]:
        """A set of names of a form."""
        return frozenset(distinct(self.content[key], self.place(key), lambda value, at: name_of(value, at, form)))

    def words(self, key: str, kind: type[V]) -> frozenset[V]:
        """A set of members of a closed enum."""
        return frozenset(distinct(self.content[key], self.place(key), lambda value, where: word_of(value, where, kind)))


def text_of(value: object, where: str) -> str:
    """A printable text of 1 to 128 characters."""
    if not isinstance(value, str):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a text is wanted")
    if not 0 < len(value) <= NAME_LIMIT or not value.isprintable() or not INVISIBLE.isdisjoint(value):
        raise PolicyError(PolicyFault.OUT_OF_RANGE, where, f"1 to {NAME_LIMIT} printable characters")
    return value


def name_of(value: object, where: str, form: re.Pattern[str]) -> str:
    """A name of a form."""
    name = text_of(value, where)
    if name == ANY:
        raise PolicyError(PolicyFault.NAME_MALFORMED, where, f'"{ANY}" stands alone, in no list')
    if form.fullmatch(name) is None:
        raise PolicyError(PolicyFault.NAME_MALFORMED, where, f"{shown(name)} is not of the form {form.pattern}")
    return name


def list_of(value: object, where: str) -> list[object]:
    """A list of 1 to 256 members."""
    if not isinstance(value, list):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a list is wanted")
    if not value:
        raise PolicyError(PolicyFault.EMPTY, where)
    if len(value) > MEMBER_LIMIT:
        raise PolicyError(PolicyFault.TOO_LARGE, where, f"over {MEMBER_LIMIT} members")
    return value


def table_of(value: object, where: str) -> Table:
    """A table with its place."""
    if not isinstance(value, dict):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a table is wanted")
    return Table(value, where)


def word_of(value: object, where: str, kind: type[V]) -> V:
    """A member of a closed enum."""
    word = text_of(value, where)
    if word not in {str(member) for member in kind}:
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, where, f"one of {', '.join(kind)}")
    return kind(word)


M = TypeVar("M")


def distinct(value: object, where: str, read: Callable[[object, str], M]) -> list[M]:
    """A list's members, none twice."""
    members: list[M] = []
    for i, entry in enumerate(list_of(value, where)):
        member = read(entry, f"{where}[{i}]")
        if member in members:
            raise PolicyError(PolicyFault.DUPLICATE_VALUE, f"{where}[{i}]")
        members.append(member)
    return members
