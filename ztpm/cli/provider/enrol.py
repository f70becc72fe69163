"""`ztpm enrol`: one command for each party of a cell, by an administrator's key.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider.party_keys import PartyName, PartyPublic, key_for, raw_of
from ztpm.cli.provider.person import CellDirectory, Json, Signer, known_name, layout_of, place_of, refusals, signed
from ztpm.cli.provider.points import TRANSIT_MS, CalibrationFile, TransitMs, put_sensor

if TYPE_CHECKING:
    from ztpm_idp.client import Operator

app = typer.Typer(no_args_is_help=True, help="Parties of a cell: gateway, tool server and sensors are registered.")

CellUrl = Annotated[str, typer.Option("--audience", help="Canonical URL of the cell (default: of that in --data).")]


@app.command("gateway")
@signed
def gateway(
    part: PartyName, *, audience: CellUrl = "", public: PartyPublic = "", signer: Signer, as_json: Json = False
) -> None:
    """Register the gateway of a cell's robot.

    With the key that `ztpm init` made for it, or the one that is told.
    """
    person, raw, where = _party(part, public, signer)
    served = audience or _audience(signer)
    with refusals(), person:
        person.register_pep(part, raw, [served])
    _done(part, served, where, [], as_json=as_json)


@app.command("tools")
@signed
def tools(
    part: PartyName, *, audience: CellUrl = "", public: PartyPublic = "", signer: Signer, as_json: Json = False
) -> None:
    """Register a tool server of a cell, and the arm's tools as they are defined now.

    With the key that `ztpm init` made for it, or the one that is told. Tools that are registered stay as they are.
    """
    from pep.mcp.arm_server import tool_definitions

    person, raw, where = _party(part, public, signer)
    served = audience or _audience(signer)
    with refusals(), person:
        person.register_pep(part, raw, [served])
        known = {row.get("name") for row in person.tools() if row.get("audience") == served}
        made = [tool for tool in tool_definitions() if tool.name not in known]
        for tool in made:
            person.register_tool(
                audience=served,
                name=tool.name,
                definition_digest=tool.definition_digest,
                operation=tool.operation,
                base_tier=int(tool.base_tier),
            )
    _done(part, served, where, [tool.name for tool in made], as_json=as_json)


@app.command("sensor")
@signed
def sensor(
    part: PartyName,
    *,
    calibration: CalibrationFile,
    transit_ms: TransitMs = TRANSIT_MS,
    audience: CellUrl = "",
    public: PartyPublic = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register a sensor of a cell; its key is made in the directory, encrypted, unless its public half is told."""
    known_name(part)
    served = audience or _audience(signer)
    where = put_sensor(part, signer, audience=served, calibration=calibration, transit_ms=transit_ms, public=public)
    _done(part, served, where, [], as_json=as_json)


@app.command("certificate")
def certificate(
    machine: Annotated[str, typer.Argument(help="Name of its files: provider, gateway, tools or another one.")],
    *,
    host: Annotated[list[str], typer.Option(help="Address or name at which it is reached; again for more.")],
    out: Annotated[Path, typer.Option(help="Folder of MACHINE.pem and MACHINE.key; files that exist are left.")],
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Make a certificate of the cell's own authority, for a further machine or before the last one ends."""
    import time

    from ztpm.base.layout import LayoutError, write_private
    from ztpm.cell.authority import Issued, machine_certificate
    from ztpm.cli.provider.passphrase import ask_passphrase

    known_name(machine)
    layout = layout_of(directory)
    try:
        authority = Issued(layout.authority.read_bytes(), layout.authority_key.read_bytes())
    except OSError as error:
        fail_at(error.filename, error, "KEYS_UNREADABLE")
    try:
        issued = machine_certificate(authority, ask_passphrase(new=False), host, at=time.time())
    except ValueError:
        fail("PASSPHRASE_WRONG", f"it does not open {layout.authority_key}")
    files = (out / f"{machine}.pem", out / f"{machine}.key")
    try:
        for file, content in zip(files, (issued.certificate, issued.key), strict=True):
            write_private(file, content)
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    if as_json:
        say_json({"ok": True, "certificate": str(files[0]), "key": str(files[1])})
    else:
        typer.echo(f"{files[0]} and {files[1]}: put them in the place of the machine's own.")


def _party(part: str, public: str, signer: Signer) -> tuple[Operator, bytes, str]:
    """The administrator, the party's raw public key, and the file of its private half where that is made here."""
    known_name(part)
    person = signer.operator()
    made = "" if public else _made(part, signer)
    if made:
        return person, raw_of(made), ""
    return person, *key_for(signer, "pep", part, public)


def _made(part: str, signer: Signer) -> str:
    """Public key of a party that `ztpm init --robot` made; empty where it made none of that name."""
    directory, issuer, _ = place_of(signer.directory, signer.issuer, signer.key)
    if issuer:
        return ""
    path = layout_of(directory).controller
    try:
        told: Any = json.loads(path.read_bytes()) if path.exists() else {}
        return str(told.get("parts", {}).get(part, {}).get("public", ""))
    except (OSError, ValueError, AttributeError):
        fail("UNREADABLE", f"{path} is not as `ztpm init` wrote it")


def _audience(signer: Signer) -> str:
    """Audience of the cell in the directory, or the end of the command."""
    from ztpm.cell.setup import SetupError, read_addresses

    directory, issuer, _ = place_of(signer.directory, signer.issuer, signer.key)
    if issuer:
        fail("WHICH_AUDIENCE", "--audience")
    try:
        return read_addresses(layout_of(directory)).audience
    except SetupError as error:
        fail("CONFIG_INVALID", str(error))


def _done(part: str, audience: str, where: str, made: list[str], *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, "id": part, "audience": audience, "tools": made, **({"key": where} if where else {})})
        return
    typer.echo(f"{part} is registered for {audience}." + (f" Its key is {where}." if where else ""))
    if made:
        typer.echo(f"So are the tools {', '.join(made)}.")
