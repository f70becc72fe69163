"""`ztpm policy`: sets of policies, for their authors and auditors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import FAILURE, console, fail, plain, say_json
from ztpm.cli.person import CellDirectory, Issuer, Json, KeyFile, operator, refusals
from ztpm.cli.policy.comparison import diff, simulate
from ztpm.cli.policy.explanation import explain
from ztpm.cli.policy.policy_set import about, open_set
from ztpm.cli.policy.proof import prove

if TYPE_CHECKING:
    from policies.explain.advice import Advice, Known, Registered

ENDED: Final = "revoked"
"""State of an agent that may never act again."""
app = typer.Typer(no_args_is_help=True, help="Policy sets: check, explain, compare, simulate and prove them.")
app.command("explain")(explain)
app.command("diff")(diff)
app.command("simulate")(simulate)
app.command("prove")(prove)


@app.command("check")
def check(
    source: Annotated[str, typer.Argument(help="A shipped set's name or a TOML file.")] = "paper-default",
    *,
    strict: Annotated[bool, typer.Option("--strict", help="Warnings are failures.")] = False,
    registry: Annotated[
        bool, typer.Option("--registry", help="Also ask the identity provider whom the set names; needs --as.")
    ] = False,
    name: Annotated[str, typer.Option("--as", help="Whose key signs.")] = "",
    directory: CellDirectory = None,
    issuer: Issuer = "",
    key: KeyFile = None,
    as_json: Json = False,
) -> None:
    """Load a policy set strictly; list its parameters, its primitives, and its probable mistakes."""
    import policies
    from policies.decision.combine import checks
    from policies.explain.advice import advise

    opened = open_set(source)
    loaded = opened.policies
    registered = None
    if registry:
        registered = _registered(directory=directory, name=name, issuer=issuer, key=key)
    elif name or directory is not None or issuer or key is not None:
        fail("USAGE", "--as, --data, --issuer and --key belong to --registry")
    warnings = advise(loaded, stated=opened.stated, known=operations(), registered=registered)
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
                "ok": not failed, **about(loaded),
                "policies": [policy.id for policy in loaded.policies], "parameters": parameters, "primitives": rows,
                "warnings": [{"code": str(w.code), "where": w.where, "detail": w.sentence} for w in warnings],
            }
        )  # fmt: skip
    else:
        title = f"{loaded.name} {loaded.version}: {len(loaded.policies)} policies, digest {loaded.digest}"
        console.print(Text(plain(title)))
        console.print(_table(("parameter", "value", "unit", "", "meaning"), [
            (str(p["name"]), str(p["value"]), str(p["unit"]), "" if p["stated"] else "default", str(p["meaning"]))
            for p in parameters
        ]))  # fmt: skip
        console.print(_table(("primitive", "name", "points", "asked by"), [
            (row.id, row.name, " ".join(sorted(map(str, row.points))), " ".join(asked[row.id]) or "nobody")
            for row in policies.CATALOG
        ]))  # fmt: skip
        _tell(warnings)
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


def _registered(*, directory: Path | None, name: str, issuer: str, key: Path | None) -> Registered:
    """Parties that the identity provider knows and that have not ended."""
    from policies.explain.advice import Registered

    if not name:
        fail("USAGE", "--registry needs --as, too: the identity provider answers a person")
    person = operator(directory=directory, name=name, issuer=issuer, key=key)
    with refusals(), person:
        agents = [row for row in person.agents() if row["status"] != ENDED]
    return Registered(frozenset(row["id"] for row in agents), frozenset(row["sponsor"] for row in agents))


def operations() -> tuple[Known, ...]:
    """Every operation that this version knows: those of the robot, those of admission, and delegating."""
    from pep.base.operation_row import OperationKind
    from pep.base.operations import OPERATIONS
    from pep.context.admission import OBJECT, OPERATION_OF
    from policies import Point
    from policies.evidence.content_readings import ItemKind
    from policies.explain.advice import Known

    acting, sending = frozenset({Point.TOOL, Point.ACTUATION}), frozenset({Point.ACTUATION})
    where = {ItemKind.INSTRUCTION: Point.OPERATOR, ItemKind.MESSAGE: Point.AGENT}
    return (
        *(
            Known(
                each.object,
                each.name,
                sending if each.arguments is None else acting,
                moves=each.kind in (OperationKind.MOTION, OperationKind.SWITCH),
            )
            for each in OPERATIONS
        ),
        *(Known(OBJECT, name, frozenset({where.get(kind, Point.CONTEXT)})) for kind, name in OPERATION_OF.items()),
        Known("", "delegate", frozenset({Point.AGENT})),
    )


def _table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for row in rows:
        table.add_row(*(Text(plain(cell)) for cell in row))
    return table


def _tell(warnings: tuple[Advice, ...]) -> None:
    if not warnings:
        console.print("[green]no warnings[/]")
    for warning in warnings:
        told = Text(str(warning.code), style="yellow")
        console.print(told.append(plain(f" {warning.where}: {warning.sentence}"), style="default"))
