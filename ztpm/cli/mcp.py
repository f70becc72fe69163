"""`ztpm mcp pin`: a person approves the tool definitions that a cell, or a server of one's own, serves now."""

from __future__ import annotations

import asyncio
import difflib
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capabilities.values.characters import shown
from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider.agent import AgentName
from ztpm.cli.provider.person import CellDirectory, Json, Signer, layout_of, refusals, signed
from ztpm.cli.rtde_run import LeaseSoftware, LeaseToken, Mandate, authority_of

if TYPE_CHECKING:
    from pep.mcp.guard import AnyServer
    from pep.mcp.tool_digest import ToolPin

app = typer.Typer(
    no_args_is_help=True, help="MCP tools: serve the cell's, propose mappings and scopes, pin definitions."
)


@app.command("pin")
@signed
def pin(
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    server: Annotated[str, typer.Option("--server", help="MODULE:NAME of a tool server of your own.")] = "",
    guard: Annotated[Path | None, typer.Option("--guard", help="Its guard.toml, with --server.")] = None,
    gateway: Annotated[Path | None, typer.Option("--gateway", help="The gateway.toml of a gateway.")] = None,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Show the tools whose definition is not the registered one, and register them as they are now."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError
    from pep.base.errors import PepError
    from ztpm.cell.enrolment import EnrolmentError, registered, tool_differences
    from ztpm.cell.setup import SetupError

    if bool(server) != (guard is not None) or (server and gateway):
        fail("USAGE", "give --server and --guard together, or --gateway alone")
    person = signer.operator()
    lock: LockFile | None = None
    try:
        if gateway is not None:
            lock, (audience, trust_file, tools) = _gateway_tools(gateway)
        else:
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
        if lock is not None:
            typer.echo(lock.difference, nl=False)
    changed = lock is not None and lock.changed
    if (fresh or changed) and not yes:
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
    if lock is not None and changed:
        try:
            lock.write()
        except OSError as error:  # what is registered stays so: the same command writes the rest
            fail_at(lock.path, error, "UNWRITABLE")
    if as_json:
        said: dict[str, object] = {"ok": True, "pinned": [tool.name for tool in fresh]}
        say_json(said if lock is None else {**said, "lock": str(lock.path), "changed": changed})
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


@app.command("connect")
def connect(
    agent: AgentName,
    url: Annotated[str, typer.Argument(metavar="URL", help="Of the server, as the token names it.")],
    *,
    token: LeaseToken = None,
    mandate: Mandate = "",
    software: LeaseSoftware = None,
    timeout_s: Annotated[
        float, typer.Option("--timeout", min=1, max=3600, help="Longest wait for an answer, in seconds.")
    ] = 600.0,
    directory: CellDirectory = None,
) -> None:
    """Serve a guarded server's tools over stdio, each request signed with an agent's key.

    For hosts that start servers by a command. Standard error says how the connection stands.
    """
    from pep.base.errors import PepError
    from pep.mcp.gateway.bridge import bridge
    from pep.point.config_text import check_url
    from ztpm_idp.client import ProofAuth

    def told(words: str) -> None:
        typer.echo(f"{url}: {words}", err=True)

    try:
        check_url("URL", url)
        key, text, tokens = authority_of(agent, token, mandate, software, directory=directory)
        auth = ProofAuth(key, text) if tokens is None else tokens.auth()
        asyncio.run(bridge(url, auth, timeout_s=timeout_s, told=told))
    except PepError as error:
        fail(error.code, error.detail)


class LockFile:
    """Lock file of a gateway, as it is and as it is to be.

    Args:
        path: of the file.
        text: of the definitions now.
    """

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self._text = text
        self._known = path.read_text("utf-8") if path.exists() else ""

    @property
    def changed(self) -> bool:
        """True where the file says something else."""
        return self._known != self._text

    @property
    def difference(self) -> str:
        """Lines that go and come, with characters that are not seen shown as their numbers."""
        lines = difflib.unified_diff(
            self._known.splitlines(),
            self._text.splitlines(),
            self.path.name,
            "as the servers are now",
            lineterm="",
            n=2,
        )
        return "".join(f"{shown(line)}\n" for line in lines)

    def write(self) -> None:
        """Replaces the file as a whole."""
        beside = self.path.with_suffix(".new")
        beside.write_text(self._text, "utf-8")
        beside.replace(self.path)


def _gateway_tools(path: Path) -> tuple[LockFile, tuple[str, Path, tuple[ToolPin, ...]]]:
    """Lock file of a gateway, and its audience, trust bundle and tools."""
    from pep.point.tool_gateway import reviewed
    from pep.point.tool_gateway_config import ToolGatewayConfig

    config = ToolGatewayConfig.read(path)
    typer.echo(f"Asking {len(config.upstreams)} servers for their definitions.", err=True)
    pins, lock = asyncio.run(reviewed(config))
    return LockFile(config.lock, lock.text()), (config.audience, config.trust_file, pins)


@app.command("gateway")
def gateway(
    *,
    config: Annotated[Path, typer.Option(help="Its gateway.toml.", exists=True, dir_okay=False)],
    as_json: Json = False,
) -> None:
    """Stand before MCP servers that nobody changed: their tools, for those whose token grants them.

    The passphrase of its key comes from ZTPM_PASSPHRASE.
    """
    from pep.base.errors import PepError
    from pep.point.tool_gateway import ToolGateway
    from pep.point.tool_gateway_config import ToolGatewayConfig

    def ready(served: ToolGateway) -> None:
        if as_json:
            say_json({"ready": True, "url": served.config.audience, "tools": served.tools, "withheld": served.faults()})
            return
        typer.echo(f"Serving {len(served.tools)} tools at {served.config.audience}: {', '.join(served.tools)}")
        for name, fault in sorted(served.faults().items()):
            typer.echo(f"withheld: {name}: {fault}")

    try:
        read = ToolGatewayConfig.read(config)
        if not as_json:
            typer.echo(f"Connecting to {len(read.upstreams)} servers.")
        ToolGateway(read, ready=ready).run()
    except PepError as error:
        fail(error.code, error.detail)


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
