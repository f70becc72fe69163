"""`ztpm policy`: sets of policies, for their authors and auditors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import FAILURE, console, plain, say_json
from ztpm.cli.policy.comparison import diff, simulate
from ztpm.cli.policy.explanation import explain
from ztpm.cli.policy.policy_set import about, open_set
from ztpm.cli.policy.proof import prove
from ztpm.cli.policy.surroundings import Surroundings, operations, plain_advice, surrounded, tell
from ztpm.cli.provider.person import Json

if TYPE_CHECKING:
    from policies import PolicySet

app = typer.Typer(no_args_is_help=True, help="Policy sets: check, explain, compare, simulate and prove them.")
app.command("explain")(surrounded(explain))
app.command("diff")(diff)
app.command("simulate")(simulate)
app.command("prove")(surrounded(prove))


@app.command("check")
@surrounded
def check(
    source: Annotated[str, typer.Argument(help="A shipped set's name or a TOML file.")] = "paper-default",
    *,
    strict: Annotated[bool, typer.Option("--strict", help="Warnings are failures.")] = False,
    surroundings: Surroundings,
    as_json: Json = False,
) -> None:
    """Load a policy set strictly; list its parameters, its primitives, and its probable mistakes."""
    import policies
    from policies.decision.combine import checks
    from policies.explain.advice import advise

    opened = open_set(source)
    loaded = opened.policies
    known, registered = operations(surroundings.declared()), surroundings.registered()
    warnings = advise(loaded, stated=opened.stated, known=known, registered=registered)
    asked: dict[str, list[str]] = {row.id: [] for row in policies.CATALOG}
    for policy in loaded.policies:
        for primitive in sorted({primitive.id for primitive, _ in checks(policy.predicate)}):
            asked[primitive].append(policy.id)
    rows = [
        {
            "id": row.id,
            "name": row.name,
            "points": sorted(str(point) for point in row.points),
            "asked_by": asked[row.id],
        }
        for row in policies.CATALOG
    ]
    parameters = [
        {
            "name": row.name,
            "value": getattr(loaded.parameters, row.name),
            "unit": row.unit,
            "stated": row.name in opened.stated,
            "meaning": row.meaning,
        }
        for row in policies.PARAMETERS.values()
    ]
    failed = strict and bool(warnings)
    if as_json:
        say_json(
            {
                "ok": not failed, **about(loaded), "extends": _extends(loaded),
                "policies": [policy.id for policy in loaded.policies], "parameters": parameters, "primitives": rows,
                "latch": sorted(loaded.latch),
                "warnings": plain_advice(warnings),
            }
        )  # fmt: skip
    else:
        title = f"{loaded.name} {loaded.version}: {len(loaded.policies)} policies, digest {loaded.digest}"
        console.print(Text(plain(title)))
        if (base := _extends(loaded)) is not None:
            kept = ", ".join(base["kept"]) or "none"
            console.print(Text(plain(f"extends {base['name']} {base['version']}, and keeps whole: {kept}")))
        console.print(Text(f"a person clears the robot after: {', '.join(sorted(loaded.latch)) or 'no stop'}"))
        console.print(_table(("parameter", "value", "unit", "", "meaning"), [
            (str(p["name"]), str(p["value"]), str(p["unit"]), "" if p["stated"] else "default", str(p["meaning"]))
            for p in parameters
        ]))  # fmt: skip
        console.print(_table(("primitive", "name", "points", "asked by"), [
            (row.id, row.name, " ".join(sorted(map(str, row.points))), " ".join(asked[row.id]) or "nobody")
            for row in policies.CATALOG
        ]))  # fmt: skip
        if not warnings:
            console.print("[green]no warnings[/]")
        tell(warnings)
    if failed:
        raise typer.Exit(FAILURE)


@app.command("schema")
def schema(
    *, example: Annotated[bool, typer.Option("--example", help="A case to start from instead, permitted.")] = False
) -> None:
    """Print the JSON schema of a case: the request and evidence that `explain --request` takes."""
    import json
    from importlib import resources

    from policies.evidence.case_schema import schema as made

    if example:
        typer.echo(resources.files("policies").joinpath("cases", "ordinary.json").read_text(encoding="utf-8"), nl=False)
    else:
        typer.echo(json.dumps(made(), indent=2))


def _extends(policies: PolicySet) -> dict[str, Any] | None:
    """The set that is extended, with the ids of its policies that deny as before; None for none."""
    floor = policies.floor
    if floor is None:
        return None
    return {"name": floor.name, "version": floor.version, "kept": [policy.id for policy in floor.policies]}


def _table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for row in rows:
        table.add_row(*(Text(plain(cell)) for cell in row))
    return table
