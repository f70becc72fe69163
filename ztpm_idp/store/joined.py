"""Joined reads: several selects that PostgreSQL answers as one statement, in one trip and of one instant."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa

from ztpm_idp.store.database import postgres, postgres_trips

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

BATCH: Final = 128
"""Values of each list in one statement, where every value is a variable: far from any database's limit on them."""


@dataclass(frozen=True, slots=True)
class Portion:
    """One select of several.

    Attributes:
        select: with parameters of names that no other part has with other values.
        lists: names of its lists: without a value in any of them it finds nothing; none: it needs none.
    """

    select: sa.Select[Any]
    lists: tuple[str, ...]


class Joined:
    """Selects that are read together; of each, its rows in its order, by name and by place.

    Attributes:
        parts: the selects.
    """

    def __init__(self, *parts: Portion) -> None:
        self.parts = parts
        self._rows: list[Any] = [
            namedtuple("Row", part.select.selected_columns.keys(), rename=True)  # noqa: PYI024 - the names are those of columns
            for part in parts
        ]
        self._joined = sa.union_all(*(_numbered(place, part.select) for place, part in enumerate(parts)))
        self._text, self._places, self._fixed = "", tuple[str, ...](), dict[str, Any]()

    async def read(self, connection: AsyncConnection, values: Mapping[str, Any]) -> Sequence[Sequence[Any]]:
        """Rows of each part.

        Args:
            connection: within the transaction.
            values: of the parameters of all parts.
        """
        if connection.dialect.name != postgres.DIALECT:
            return [await _alone(connection, part, values) for part in self.parts]
        if not self._text:
            made: Any = self._joined.compile(dialect=connection.dialect)
            self._text, self._places, self._fixed = made.string, made.positiontup, made.params
        given = {**self._fixed, **values}
        found: list[list[Any]] = [[] for _ in self.parts]
        for place, record in await postgres_trips.fetch(
            connection, self._text, *(given[name] for name in self._places)
        ):
            found[place].append(self._rows[place]._make(record))
        return found


async def _alone(connection: AsyncConnection, part: Portion, values: Mapping[str, Any]) -> Sequence[Any]:
    """Rows of one part, of as many values at a time as any database takes."""
    if not part.lists:
        rows: Sequence[Any] = (await connection.execute(part.select, values)).all()
        return rows
    found = list[Any]()
    for at in range(0, max(len(values[name]) for name in part.lists), BATCH):
        some = {name: values[name][at : at + BATCH] for name in part.lists}
        found += (await connection.execute(part.select, {**values, **some})).all()
    return found


def _numbered(place: int, select: sa.Select[Any]) -> sa.Select[Any]:
    """The rows of a select, each as a record, with the part's place before it.

    Records the driver knows: of an array of them it would ask the server on every connection.
    """
    number: sa.ColumnElement[Any] = sa.literal_column(str(place))
    record = sa.func.row(*select.selected_columns)
    return select.with_only_columns(number, record, maintain_column_froms=True)
