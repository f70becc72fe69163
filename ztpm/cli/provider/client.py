"""`ztpm client`: programs that speak plain OAuth: who they are, which scopes there are, what they were lent.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import console, fail, plain, say_json
from ztpm.cli.provider.person import Json, Reason, Signer, refusals, signed
from ztpm.cli.provider.token import read_as

app = typer.Typer(no_args_is_help=True, help="OAuth clients: who they are, their scopes, what people lent them.")


@app.command("register")
@signed
def register(
    client_id: Annotated[str, typer.Argument(metavar="CLIENT", help="Its id: lower-case ASCII.")],
    *,
    title: Annotated[str, typer.Option("--name", help="Its name, as people are shown it.")],
    redirect: Annotated[list[str] | None, typer.Option(help="A redirect URI, https or loopback.")] = None,
    public: Annotated[str, typer.Option(help="Its public key, for private_key_jwt (default: a public client).")] = "",
    sponsor: Annotated[str, typer.Option(help="Who answers for it (default: you).")] = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register an OAuth client, as administrator; it may do nothing until a person lends to it."""
    from capabilities.keys.keys import check_raw, unb64u
    from capabilities.values.errors import BadKeyError

    try:
        key = check_raw(unb64u(public)) if public else None
    except BadKeyError as error:
        fail(error.code.value, error.detail)
    person = signer.operator()
    with refusals(), person:
        person.register_client(client_id, title, redirects=redirect or (), key=key, sponsor=sponsor)
    if as_json:
        say_json({"ok": True, "client_id": client_id})
    else:
        typer.echo(f"Client {client_id} is registered.")


@app.command("list")
@signed
def list_(*, signer: Signer, as_json: Json = False) -> None:
    """List the registered clients."""
    person = signer.operator()
    with refusals(), person:
        rows = person.clients()
    headings = {
        "client_id": "client",
        "name": "name",
        "token_endpoint_auth_method": "authenticates",
        "redirect_uris": "",
    }
    _shown("clients", rows, headings, as_json=as_json)


@app.command("scope")
@signed
def scope(
    scope_name: Annotated[str, typer.Argument(metavar="SCOPE", help="Such as camera.read.")],
    limits: Annotated[
        Path, typer.Argument(metavar="LIMITS", help="JSON of its grants and ceiling.", exists=True, dir_okay=False)
    ],
    *,
    words: Annotated[str, typer.Option(help="What it allows, for the person who is asked.")],
    audience: Annotated[str, typer.Option(help="URL of the one tool server that it is for.")],
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Declare what an OAuth scope allows; clients ask people for it by its name."""
    from capabilities.values.scope_json import restriction_from_json

    stated = read_as(limits, restriction_from_json)
    if stated.grants is None or stated.ceiling is None:
        fail("STATEMENT_MALFORMED", "exactly grants and a ceiling")
    person = signer.operator()
    with refusals(), person:
        person.declare_scope(scope_name, words, audience, stated.grants, ceiling=stated.ceiling)
    if as_json:
        say_json({"ok": True, "scope": scope_name})
    else:
        typer.echo(f"Scope {scope_name} is declared for {audience}.")


@app.command("scopes")
@signed
def scopes(*, signer: Signer, as_json: Json = False) -> None:
    """List the declared scopes."""
    person = signer.operator()
    with refusals(), person:
        rows = person.scopes()
    headings = {"name": "scope", "audience": "server", "ceiling": "tier", "declared_by": "by", "words": "words"}
    _shown("scopes", rows, headings, as_json=as_json)


@app.command("end-scope")
@signed
def end_scope(
    scope_name: Annotated[str, typer.Argument(metavar="SCOPE", help="Its name.")],
    *,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Lend no more by a scope; what was lent goes on until it is taken back."""
    person = signer.operator()
    with refusals(), person:
        person.end_scope(scope_name)
    if as_json:
        say_json({"ok": True, "scope": scope_name})
    else:
        typer.echo(f"Scope {scope_name} has ended.")


@app.command("lent")
@signed
def lent(*, signer: Signer, as_json: Json = False) -> None:
    """List what you lent to clients on their pages; as administrator, what every person lent."""
    person = signer.operator()
    with refusals(), person:
        rows = person.lent_to_clients()
    told = [row | {"until": _clock(row.get("not_after"))} for row in rows]
    headings = {
        "id": "id",
        "state": "state",
        "client_id": "client",
        "sponsor": "sponsor",
        "scope": "scope",
        "until": "until",
    }
    _shown("lent", told, headings, as_json=as_json)


@app.command("take-back")
@signed
def take_back(
    family: Annotated[str, typer.Argument(metavar="ID", help="As `ztpm client lent` lists it: 32 hex digits.")],
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Take back what was lent to a client: its tokens are revoked, and it must ask again."""
    person = signer.operator()
    with refusals(), person:
        epoch = person.take_back(family, reason)
    if as_json:
        say_json({"ok": True, "epoch": epoch})
    else:
        typer.echo(f"Taken back, in epoch {epoch}.")


def _shown(what: str, rows: list[dict[str, Any]], headings: dict[str, str], *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, what: rows})
        return
    if not rows:
        typer.echo("Nothing.")
        return
    table = Table(box=None, pad_edge=False)
    for member, heading in headings.items():
        table.add_column(heading, no_wrap=member == "id", min_width=32 if member == "id" else None)
    for row in rows:
        cells = (row.get(member) for member in headings)
        said = (" ".join(map(str, cell)) if isinstance(cell, list) else str(cell) for cell in cells)
        table.add_row(*(Text(plain(cell)) for cell in said))
    console.print(table)


def _clock(at: object) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(at)) if isinstance(at, int) else "?"
