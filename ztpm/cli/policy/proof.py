"""`ztpm policy prove`: claims about a policy set, proven for every request and all evidence."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from ztpm.cli.output import FAILURE, console, fail, plain, say_json
from ztpm.cli.policy.policy_set import about, open_set
from ztpm.cli.policy.surroundings import Surroundings, harmless_of, plain_advice, tell
from ztpm.cli.provider.person import Json

if TYPE_CHECKING:
    from policies.proof import Result


def prove(
    file: Annotated[Path | None, typer.Argument(help="A TOML file with a policy set.")] = None,
    *,
    shipped: Annotated[str | None, typer.Option("--set", help="A shipped set's name, in place of a file.")] = None,
    harmless: Annotated[
        str | None,
        typer.Option(
            help="Operations that move nothing; every other one is taken to move something. Left out, they are"
            " read_state and stop; of a declared tool server, its operations that change nothing."
        ),
    ] = None,
    surroundings: Surroundings,
    as_json: Json = False,
) -> None:
    """Prove the claims about a policy set with z3, or show a request that breaks one.

    The exit status is 0 when all are proven.
    """
    from policies import proof

    if file is not None and shipped is not None:
        fail("USAGE", "a file or --set, not both")
    names = _harmless(harmless, surroundings)
    # with its directory a file of any name is taken for one
    source = shipped or "paper-default" if file is None else str(file.absolute())
    loaded = open_set(source).policies
    warnings = surroundings.misnamed(loaded)
    results = proof.prove(loaded, harmless=names, clock=time.perf_counter)
    proven = all(result.standing is proof.Standing.PROVEN for result in results)
    if as_json:
        said = [proof.result_to_plain(result) for result in results]
        about_it = {"harmless": sorted(names), "claims": said, "warnings": plain_advice(warnings)}
        say_json({"ok": proven, **about(loaded), **about_it})
    else:
        tell(warnings)
        _tell(results, f"{loaded.name} {loaded.version}, digest {loaded.digest}")
    raise typer.Exit(0 if proven else FAILURE)


def _harmless(stated: str | None, surroundings: Surroundings) -> frozenset[str]:
    """Operations that move nothing; one that is declared to change something ends the command."""
    from policies import proof

    declared = surroundings.declared()
    if stated is None:
        return proof.HARMLESS if declared is None else harmless_of(declared)
    names = frozenset(name.strip() for name in stated.split(",")) - {""}
    changing = frozenset(row.name for row in declared or ()) - harmless_of(declared or ())
    for name in sorted(names & changing):
        fail("USAGE", f"{name} is declared to change something, and is not harmless")
    return names


def _tell(results: tuple[Result, ...], title: str) -> None:
    from policies import proof

    console.print(plain(title))
    table = Table(box=None, pad_edge=False)
    for heading in ("claim", "", "verdict", "s"):
        table.add_column(heading, justify="right" if heading == "s" else "left")
    for result in results:
        verdict = f"{result.standing}{' (of nothing: the set permits no such act)' if result.about_nothing else ''}"
        table.add_row(result.claim.id, result.claim.says, verdict, f"{result.seconds:.2f}")
    console.print(table)
    for result in results:
        for number, line in enumerate(proof.lines(result)):
            console.print(f"{result.claim.id if number == 0 else '  '}  {plain(line)}", markup=False)
    softens = {"P5": "when the tier rises", "P8": "with stricter numbers"}
    for result in results:
        if result.assumed:
            named = ", ".join(result.assumed)
            console.print(
                f"{result.claim.id} takes for granted that these do not soften {softens[result.claim.id]}: {named}"
            )
    if any(result.standing is proof.Standing.SKIPPED for result in results):
        console.print("z3 is not installed: pip install 'ztpm[prove]'", markup=False)
