"""Rows of a benchmark as tables for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence


def table(title: str, left: Sequence[str], right: Sequence[str] = (), rows: Iterable[Sequence[str]] = ()) -> Table:
    """Columns set to the left, then columns set to the right."""
    made = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in left:
        made.add_column(heading, overflow="fold")
    for heading in right:
        made.add_column(heading, justify="right")
    for row in rows:
        made.add_row(*row)
    return made


def pivot(title: str, left: Sequence[str], cells: Mapping[Any, str]) -> Table:
    """Table with a row for each first key and a column for each second one, in order of appearance.

    Args:
        title: of the table.
        left: headings of the parts of a first key.
        cells: texts by both keys; a pair that is not there is empty.
    """
    columns = list(dict.fromkeys(column for _, column in cells))
    keys = dict.fromkeys(key for key, _ in cells)
    return table(title, left, columns, ((*key, *(cells.get((key, column), "") for column in columns)) for key in keys))


def figure(p50_us: float | None, p99_us: float | None, why: str = "", overruns: int = 0) -> str:
    """A median and a 99th percentile, or why there are none."""
    if p50_us is None or p99_us is None:
        return why
    lost = f" [{overruns} gave up]" if overruns else ""
    return f"{p50_us:.0f} ({p99_us:.0f}){lost}"
