"""Tables of commands: foreign text made safe, rows that wrap rather than vanish."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from ztpm.cli.output import beside, console, plain

if TYPE_CHECKING:
    from collections.abc import Iterable


def show_table(headings: tuple[str, ...], rows: Iterable[tuple[object, ...]], *, aside: bool = False) -> None:
    """Prints rows under headings; a cell may have several lines. No row at all is told in words.

    Args:
        headings: of the columns.
        rows: of the table, each as long.
        aside: on standard error, beside a document on standard output.
    """
    to = beside() if aside else console
    table = Table(box=None, pad_edge=False)
    for place, heading in enumerate(headings):
        # The first column is what commands take: it is never cut.
        table.add_column(heading, overflow="fold", no_wrap=not place)
    for row in rows:
        table.add_row(*(Text("\n".join(map(plain, str(cell).split("\n")))) for cell in row))
    if table.row_count:
        to.print(table)
    else:
        to.print("None is registered.")
