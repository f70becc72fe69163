"""`ztpm policy diff` and `simulate`: differences of two sets, and decisions of the past under another one."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import USAGE, console, fail, fail_at, plain, say_json
from ztpm.cli.policy.explanation import JournalFile
from ztpm.cli.policy.policy_set import about, open_set
from ztpm.cli.provider.person import Json

if TYPE_CHECKING:
    from collections.abc import Callable

    from policies.explain.differences import ComparedCase, Comparison, SetChange
    from ztpm.cli.policy.replay import Replayed

RECORDED: Final = "sets/cases.ndjson.xz"
"""The recorded cases, a file of the package `policies`."""

CorpusFile = Annotated[
    Path | None,
    typer.Option(
        "--corpus", help="Cases (`ztpm policy schema`), one a line; .xz is unpacked.", exists=True, dir_okay=False
    ),
]


def diff(
    one: Annotated[str, typer.Argument(help="A shipped set's name or a TOML file.")],
    other: Annotated[str, typer.Argument(help="Likewise; the newer one.")],
    *,
    corpus: CorpusFile = None,
    journal: JournalFile = None,
    as_json: Json = False,
) -> None:
    """Show the differences of two sets, and the decisions of recorded cases or a journal that differ."""
    from policies.explain.differences import of_decisions, of_sets
    from ztpm.cli.policy.replay import Replayed, written_cases

    if corpus is not None and journal is not None:
        fail("USAGE", "--corpus or --journal, not both")
    old, new = open_set(one).policies, open_set(other).policies
    change = of_sets(old, new)
    drawn = Replayed()
    with resources.as_file(resources.files("policies").joinpath(RECORDED)) as recorded:
        over = journal or corpus or recorded
        cases = written_cases(over) if journal is None else (_afresh(case) for case in drawn.cases(journal))
        found = _compared(lambda: of_decisions(cases, old, new), over)
    if as_json:
        told = {"old": about(old), "new": about(new), **_change(change), **_comparison(found), **_left_out(drawn)}
        say_json({"ok": True, **told, "over": str(over)})
        return
    _tell_change(change)
    _tell(found, drawn)
    _tell_unseen(change)


def simulate(
    source: Annotated[str, typer.Argument(help="A shipped set's name or a TOML file.")],
    *,
    journal: JournalFile = None,
    since: Annotated[str, typer.Option(help="Only decisions since then: ISO 8601, in UTC unless it says so.")] = "",
    as_json: Json = False,
) -> None:
    """Decide a recorded journal or ledger again under this set, and show the decisions that differ."""
    from policies.explain.differences import of_decisions
    from ztpm.cli.policy.replay import Replayed

    if journal is None:
        fail("USAGE", "--journal FILE is wanted")
    since_ms = _since(since)
    policies = open_set(source).policies
    drawn = Replayed()
    found = _compared(lambda: of_decisions(drawn.cases(journal, since_ms=since_ms), None, policies), journal)
    if as_json:
        say_json({"ok": True, "set": about(policies), **_comparison(found), **_left_out(drawn)})
        return
    _tell(found, drawn)


def _afresh(case: ComparedCase) -> ComparedCase:
    """A case of a journal for two sets, neither of which decided it."""
    return replace(case, was=None)


def _compared(compare: Callable[[], Comparison], path: Path | None) -> Comparison:
    from ztpm.cli.policy.replay import ReplayError

    try:
        return compare()
    except ReplayError as error:
        fail(error.code, f"{path}: {error}", status=USAGE)
    except OSError as error:
        fail_at(path, error, "UNREADABLE")


def _since(text: str) -> int:
    if not text:
        return 0
    try:
        at = dt.datetime.fromisoformat(text)
    except ValueError:
        fail("USAGE", f"--since {text!r} is no ISO 8601 time")
    return int((at if at.tzinfo else at.replace(tzinfo=dt.UTC)).timestamp() * 1000)


# --- as JSON ---------------------------------------------------------------------------------------------------------


def _change(change: SetChange) -> dict[str, object]:
    from policies.explain.differences import unseen

    return {
        "parameters": [{"name": p.part, "was": p.was, "now": p.now} for p in change.parameters],
        "policies": [
            {
                "id": p.id, "change": str(p.change),
                "parts": [{"part": part.part, "was": part.was, "now": part.now} for part in p.parts],
            }
            for p in change.policies
        ],
        "not_shown_by_cases": list(unseen(change)),
    }  # fmt: skip


def _comparison(found: Comparison) -> dict[str, object]:
    """Each class with its first case whole, as `explain --request` takes it."""
    from policies.evidence.case_json import to_plain

    return {
        "direction": str(found.direction),
        "cases": found.cases,
        "changed": sum(m.count for m in found.moved),
        "moved": [
            {
                "was": {"effect": str(m.was.effect), "reason": m.was.reason},
                "now": {"effect": str(m.now.effect), "reason": m.now.reason},
                "count": m.count, "examples": list(m.examples), "first": to_plain(m.first.request, m.first.evidence),
            }
            for m in found.moved
        ],
        "kept": [{"effect": str(v.effect), "reason": v.reason, "count": n} for v, n in found.kept],
    }  # fmt: skip


def _left_out(drawn: Replayed) -> dict[str, object]:
    return {"of_the_gate": drawn.own, "not_replayable": drawn.unread}


# --- for people ------------------------------------------------------------------------------------------------------


def _tell_change(change: SetChange) -> None:
    if change.same:
        console.print("the sets say the same")
    for parameter in change.parameters:
        console.print(Text(f"parameter {parameter.part}: {parameter.was} -> {parameter.now}"))
    for policy in change.policies:
        console.print(Text(plain(f"policy {policy.id} {policy.change}")))
        for part in policy.parts:
            console.print(Text(plain(f"  {part.part}: {part.was}")))
            console.print(Text(plain(f"  {'now':>{len(part.part)}}: {part.now}")))


def _tell(found: Comparison, drawn: Replayed) -> None:
    moved = sum(m.count for m in found.moved)
    console.print(Text(f"{found.direction}: {moved} of {found.cases} decisions differ", style="bold"))
    table = Table(box=None, pad_edge=False)
    for heading in ("count", "was", "would be", "for example"):
        table.add_column(heading, justify="right" if heading == "count" else "left")
    for m in found.moved:
        table.add_row(
            str(m.count), f"{m.was.effect} {m.was.reason}", f"{m.now.effect} {m.now.reason}", Text(plain(m.examples[0]))
        )
    if found.moved:
        console.print(table)
    for reason, count in sorted(drawn.own.items()):
        console.print(Text(plain(f"{count} denied by the gate itself with {reason}: no policy changes that")))
    for code, count in sorted(drawn.unread.items()):
        console.print(Text(plain(f"{count} cannot be decided again: {code}")))


def _tell_unseen(change: SetChange) -> None:
    from policies.explain.differences import unseen

    for name in unseen(change):
        console.print(Text(f"{name} acts before or after a decision: recorded cases do not show what it changes"))
