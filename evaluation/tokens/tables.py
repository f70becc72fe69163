"""A run as tables for a terminal."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from rich.table import Table

from evaluation.tokens.cell import Kind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from evaluation.tokens.bench import Result, Row

_ORDER = list(map(str, Kind))


def tables(result: Result) -> Iterator[Table]:
    """One table of durations for each scope, one of what each row checks, one of sizes."""
    measured = [row for row in result.rows if row.scope is not None]
    for scope in dict.fromkeys(row.scope for row in measured):
        yield _durations(str(scope), [row for row in measured if row.scope == scope])
    yield _checks(measured)
    yield _sizes(result)


def _durations(scope: str, rows: list[Row]) -> Table:
    depths = sorted({row.depth for row in rows if row.depth is not None})
    table = Table(title=f"{scope} scope: median, µs (99th percentile)", title_justify="left", box=None, pad_edge=False)
    for heading in ("what", "proof", "peer"):
        table.add_column(heading)
    for depth in depths:
        table.add_column(f"depth {depth}", justify="right")

    def key(row: Row) -> tuple[int, bool, str]:
        return _ORDER.index(str(row.kind)), bool(row.proof), row.peer

    for (kind, proof, peer), same in groupby(sorted(rows, key=key), key=key):
        by_depth = {row.depth: row for row in same}
        figures = [_figure(by_depth.get(depth)) for depth in depths]
        table.add_row(_ORDER[kind], "yes" if proof else "no", peer, *figures)
    return table


def _figure(row: Row | None) -> str:
    if row is None:
        return ""
    if row.p50_us is None or row.p99_us is None:
        return row.why
    lost = f" [{row.overruns} gave up]" if row.overruns else ""
    return f"{row.p50_us:.0f} ({row.p99_us:.0f}){lost}"


def _checks(rows: list[Row]) -> Table:
    table = Table(title="what a decision rests on", title_justify="left", box=None, pad_edge=False)
    for heading in ("peer", "what", "proof", "checks"):
        table.add_column(heading, overflow="fold")
    said = {(row.peer, str(row.kind), bool(row.proof)): row.checks for row in rows if row.checks}
    for (peer, kind, proof), checks in sorted(said.items()):
        table.add_row(peer, kind, "yes" if proof else "no", checks)
    return table


def _sizes(result: Result) -> Table:
    depths = sorted({size.depth for size in result.sizes})
    table = Table(title="token bytes, before base64", title_justify="left", box=None, pad_edge=False)
    for heading in ("scope", "peer"):
        table.add_column(heading)
    for depth in depths:
        table.add_column(f"depth {depth}", justify="right")
    by = {(size.scope, size.peer, size.depth): size.bytes for size in result.sizes}
    for scope, peer in dict.fromkeys((size.scope, size.peer) for size in result.sizes):
        figures = [by.get((scope, peer, depth)) for depth in depths]
        table.add_row(scope, peer, *("-" if figure is None else f"{figure:,}" for figure in figures))
    return table
