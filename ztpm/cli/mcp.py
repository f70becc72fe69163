"""`ztpm mcp pin`: a person approves the tool definitions that a cell serves now."""

from __future__ import annotations

from typing import Annotated

import typer

from ztpm.cli.output import fail, say_json
from ztpm.cli.person import As, CellDirectory, Json, issuer_of, layout_of, operator, refusals

app = typer.Typer(no_args_is_help=True, help="The cell's MCP tools: serve them, and pin their definitions.")


@app.command("pin")
def pin(
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    name: As,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Show the tools whose definition is not the registered one, and register them as they are now."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError
    from pep.mcp.arm_server import tool_definitions
    from ztpm.cell.enrolment import EnrolmentError, registered, tool_differences
    from ztpm.cell.setup import SetupError, read_addresses

    layout = layout_of(directory)
    person = operator(directory=directory, name=name, issuer="", key=None)
    try:
        audience = read_addresses(layout).audience
        trust = TrustBundle.from_json(layout.trust.read_bytes())
        found = tool_differences(registered(issuer_of(layout), audience, trust, auth=person.auth()))
    except EnrolmentError as error:
        fail("REGISTRY_UNAVAILABLE", str(error))
    except (SetupError, OSError, CapabilityError) as error:
        fail("CONFIG_INVALID", str(error))
    served = {tool.name: tool for tool in tool_definitions()}
    fresh = [served[differing.name] for differing in found if differing.name in served]
    if not as_json:
        for differing in found:
            now = f"; now {served[differing.name].definition_digest}" if differing.name in served else ""
            typer.echo(f"{differing}{now}")
    if fresh and not yes:
        if as_json:
            fail("USAGE", "--json asks nobody: give --yes")
        if not typer.confirm("Register them as they are now?", default=False, err=True):
            fail("NOT_CONFIRMED", "nothing was registered")
    with refusals(), person:
        for tool in fresh:
            person.register_tool(
                audience=audience, name=tool.name, definition_digest=tool.definition_digest, operation=tool.operation,
                base_tier=int(tool.base_tier),
            )  # fmt: skip
    if as_json:
        say_json({"ok": True, "pinned": [tool.name for tool in fresh]})
    else:
        typer.echo(f"{len(fresh)} registered." if fresh else "Every tool is registered as it is served.")
