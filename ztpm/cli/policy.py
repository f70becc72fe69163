"""`ztpm policy check`: is a policy set well formed, and what does it rest on?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from ztpm.cli.output import console, fail, say_json
from ztpm.cli.proof import prove

app = typer.Typer(no_args_is_help=True, help="Policy sets.")
app.command("prove")(prove)


@app.callback()
def policies_() -> None:
    """Policy sets."""


@app.command("check")
def check(
    source: Annotated[str, typer.Argument(help="A shipped set's name or a TOML file.")] = "paper-default",
    *,
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """Load a policy set strictly; list its parameters, and which of the 25 primitives decide in this version."""
    import policies
    from policies.errors import PolicyError

    path = Path(source)
    try:
        loaded = policies.load(path.read_text("utf-8")) if path.suffix == ".toml" else policies.load_shipped(source)
    except PolicyError as error:
        fail(str(error.code), str(error), as_json=as_json)
    except (OSError, UnicodeDecodeError) as error:
        fail("UNREADABLE", f"{source}: {error}", as_json=as_json)
    rows = [
        {
            "id": row.id,
            "name": row.name,
            "points": sorted(str(point) for point in row.points),
            "decides": row.decides is not None,
        }
        for row in policies.CATALOG
    ]
    parameters = [
        {"name": row.name, "value": getattr(loaded.parameters, row.name), "unit": row.unit, "meaning": row.meaning}
        for row in policies.PARAMETERS.values()
    ]
    if as_json:
        say_json(
            {
                "ok": True, "name": loaded.name, "version": loaded.version, "digest": loaded.digest,
                "policies": [policy.id for policy in loaded.policies], "parameters": parameters, "primitives": rows,
            }
        )  # fmt: skip
        return
    console.print(f"{loaded.name} {loaded.version}: {len(loaded.policies)} policies, digest {loaded.digest}")
    stated = Table(box=None, pad_edge=False)
    for heading in ("parameter", "value", "unit", "meaning"):
        stated.add_column(heading, justify="right" if heading == "value" else "left")
    for parameter in parameters:
        stated.add_row(*(str(cell) for cell in parameter.values()))
    console.print(stated)
    table = Table(box=None, pad_edge=False)
    for heading in ("primitive", "name", "points", "in this version"):
        table.add_column(heading)
    for row in policies.CATALOG:
        state = "decides" if row.decides is not None else "[dim]not yet (refused in a policy)[/]"
        table.add_row(row.id, row.name, " ".join(sorted(str(point) for point in row.points)), state)
    console.print(table)
