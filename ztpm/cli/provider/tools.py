"""`ztpm tool`: tools that an administrator has reviewed, and their standing.

A tool has no key, so nothing of it is rotated: a new definition is registered once it is reviewed.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider.person import Json, Reason, Signer, refusals, signed
from ztpm.cli.tables import show_table

if TYPE_CHECKING:
    from typing import Literal

app = typer.Typer(no_args_is_help=True, help="Tools: the definitions that were reviewed, and their base tiers.")

ToolName = Annotated[str, typer.Argument(metavar="TOOL", help="Its name, as `tools/list` has it.")]
Audience = Annotated[str, typer.Option("--audience", help="Canonical URL of the server that has it.")]
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


@app.command("register")
@signed
def register(
    tool: ToolName,
    *,
    audience: Audience,
    tier: Annotated[int, typer.Option(min=0, max=4, help="Base tier of its operation.")],
    operation: Annotated[str, typer.Option(help="Its operation, as grants name it (default: its name).")] = "",
    definition: Annotated[
        Path | None,
        typer.Option(help="JSON of its definition, as `tools/list` returns it.", exists=True, dir_okay=False),
    ] = None,
    digest: Annotated[str, typer.Option(help="SHA-256 of its definition, instead: as `ztpm mcp pin` shows it.")] = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register a tool's definition that you have reviewed, or replace an earlier one. A suspension ends with it."""
    if bool(digest) == (definition is not None):
        fail("USAGE", "give --definition or --digest")
    reviewed = digest or digest_of(definition, tool)
    if not _DIGEST.fullmatch(reviewed):
        fail("USAGE", "--digest: 64 lower-case hex digits")
    person = signer.operator()
    with refusals(), person:
        person.register_tool(
            audience=audience, name=tool, definition_digest=reviewed, operation=operation or tool, base_tier=tier
        )
    if as_json:
        say_json({"ok": True, "audience": audience, "name": tool, "definition_digest": reviewed})
    else:
        typer.echo(f"Registered, definition {reviewed}.")


@app.command("list")
@signed
def list_(*, signer: Signer, as_json: Json = False) -> None:
    """List every tool with its standing, its operation and its base tier."""
    person = signer.operator()
    with refusals(), person:
        rows = person.tools()
    if as_json:
        say_json({"ok": True, "tools": rows})
        return
    show_table(("tool", "audience", "status", "operation", "tier", "definition"), [
        (row.get("name"), row.get("audience"), row.get("status"), row.get("operation"), row.get("base_tier"),
         str(row.get("definition_digest"))[:12]) for row in rows
    ])  # fmt: skip


@app.command("suspend")
@signed
def suspend(tool: ToolName, *, audience: Audience, reason: Reason, signer: Signer, as_json: Json = False) -> None:
    """Suspend a tool until it is restored: enforcement points refuse it as one that nobody reviewed."""
    _change("suspend", tool, audience, reason, signer, as_json=as_json)


@app.command("restore")
@signed
def restore(tool: ToolName, *, audience: Audience, reason: Reason, signer: Signer, as_json: Json = False) -> None:
    """Restore a tool that was suspended."""
    _change("restore", tool, audience, reason, signer, as_json=as_json)


@app.command("retire")
@signed
def retire(tool: ToolName, *, audience: Audience, reason: Reason, signer: Signer, as_json: Json = False) -> None:
    """Retire a tool: it is in no registry until it is registered again."""
    _change("retire", tool, audience, reason, signer, as_json=as_json)


_DONE: Final = {"suspend": "suspended", "restore": "restored", "retire": "retired"}


def _change(
    act: Literal["suspend", "restore", "retire"],
    tool: str,
    audience: str,
    reason: str,
    signer: Signer,
    *,
    as_json: bool,
) -> None:
    person = signer.operator()
    with refusals(), person:
        person.change_tool(act, audience, tool, reason)
    if as_json:
        say_json({"ok": True, "audience": audience, "name": tool, "status": _DONE[act]})
    else:
        typer.echo(f"{_DONE[act].capitalize()}.")


def digest_of(definition: Path | None, tool: str) -> str:
    """SHA-256 (hex) of the definition in a file, which must be that tool's; or the command ends."""
    if definition is None:
        return ""
    from pydantic import ValidationError

    from pep.mcp.tool_digest import definition_digest

    try:
        from mcp_types import Tool
    except ImportError:
        fail("UNUSABLE", "--definition: the MCP SDK is not installed (ztpm[pep]); --digest needs none")
    try:
        stated = Tool.model_validate(json.loads(definition.read_text("utf-8-sig")))
    except OSError as error:
        fail_at(definition, error, "UNREADABLE")
    except (ValueError, ValidationError):
        fail("UNREADABLE", f"{definition}: not the definition of a tool")
    if stated.name != tool:
        fail("UNREADABLE", f"{definition}: it defines another tool")
    return definition_digest(stated)
