"""`ztpm mcp pin`: a person approves the tool definitions that a cell, or a server of one's own, serves now."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ztpm.cli.output import fail, say_json
from ztpm.cli.provider.person import Json, Signer, layout_of, refusals, signed

if TYPE_CHECKING:
    from pep.mcp.guard import AnyServer
    from pep.mcp.tool_digest import ToolPin

app = typer.Typer(no_args_is_help=True, help="The cell's MCP tools: serve them, and pin their definitions.")


@app.command("pin")
@signed
def pin(
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    server: Annotated[str, typer.Option("--server", help="MODULE:NAME of a tool server of your own.")] = "",
    guard: Annotated[Path | None, typer.Option("--guard", help="Its guard.toml, with --server.")] = None,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Show the tools whose definition is not the registered one, and register them as they are now."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError
    from pep.base.errors import PepError
    from ztpm.cell.enrolment import EnrolmentError, registered, tool_differences
    from ztpm.cell.setup import SetupError

    if bool(server) != (guard is not None):
        fail("USAGE", "give --server and --guard together")
    person = signer.operator()
    try:
        audience, trust_file, tools = _own_tools(server, guard) if guard else _cell_tools(signer.directory)
        trust = TrustBundle.from_json(trust_file.read_bytes())
        found = tool_differences(registered(person.issuer, audience, trust, auth=person.auth()), tools)
    except EnrolmentError as error:
        fail("REGISTRY_UNAVAILABLE", str(error))
    except PepError as error:
        fail(error.code, error.detail)
    except (SetupError, OSError, CapabilityError) as error:
        fail("CONFIG_INVALID", str(error))
    served = {tool.name: tool for tool in tools}
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


def _cell_tools(directory: Path | None) -> tuple[str, Path, tuple[ToolPin, ...]]:
    """Audience, trust bundle and tools of a cell."""
    from pep.mcp.arm_server import tool_definitions
    from ztpm.cell.setup import read_addresses

    layout = layout_of(directory)
    return read_addresses(layout).audience, layout.trust, tool_definitions()


def _own_tools(server: str, guard: Path) -> tuple[str, Path, tuple[ToolPin, ...]]:
    """Audience, trust bundle and tools of a person's own server; a name that is none ends the command."""
    from pep import GuardConfig, pins

    config = GuardConfig.read(guard)
    return config.audience, config.trust_file, pins(server_of(server), config)


def server_of(server: str) -> AnyServer:
    """The tool server of that MODULE:NAME; a name that is none ends the command."""
    module, _, name = server.partition(":")
    sys.path.insert(0, "")  # a server beside the person, as `uvicorn` finds it
    try:
        found: AnyServer = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        fail("UNREADABLE", f"{server}: {error}")
    finally:
        sys.path.remove("")
    return found
