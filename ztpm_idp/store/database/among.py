"""Condition that a column has one of the values of a list, by one statement for lists of every length.

On PostgreSQL the list is one parameter. A parameter for each value would be another text for each length, which the
server reads and plans anew, and which each connection remembers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement

if TYPE_CHECKING:
    from sqlalchemy.sql.compiler import SQLCompiler


class among(FunctionElement[bool]):  # noqa: N801  it reads as a function of SQL
    """True where `column` is one of the values of the list that is given under `name` with each execution."""

    name = "among"
    type = sa.Boolean()
    inherit_cache = True

    def __init__(self, column: sa.ColumnElement[Any], name: str) -> None:
        super().__init__(column, sa.bindparam(name, type_=_unbounded(column.type), expanding=True))


@compiles(among)
def _each(element: among, compiler: SQLCompiler, **kw: Any) -> str:
    column, values = element.clauses
    return str(compiler.process(column.in_(values), **kw))


@compiles(among, "postgresql")
def _list(element: among, compiler: SQLCompiler, **kw: Any) -> str:
    column, values = element.clauses
    one = sa.bindparam(values.key, type_=sa.ARRAY(values.type))
    return str(compiler.process(column == sa.any_(one), **kw))


def _unbounded(kind: sa.types.TypeEngine[Any]) -> sa.types.TypeEngine[Any]:
    """The type without its length: a cast to it would cut longer texts to what they are not."""
    match kind:
        case sa.String():
            return sa.Text()
        case sa.LargeBinary():
            return sa.LargeBinary()
        case _:
            return kind
