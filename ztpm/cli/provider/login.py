"""`ztpm login`, `ztpm person login`: a browser or a command line acts for a person for some hours.

Exit status: 0 done, 1 failure, 2 usage, 3 refused, 4 another person must confirm.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, NoReturn

import typer

from ztpm.cli.output import DEFER, fail, fail_at, instant, plain, say_json
from ztpm.cli.provider.person import (
    CellDirectory,
    Issuer,
    Json,
    Signer,
    known_name,
    operator,
    refusals,
    signed,
)

if TYPE_CHECKING:
    from ztpm_idp.client.device_login import Confirmed, DeviceLogin, Waiting

NAME_CHARACTERS: Final = 64
"""Longest name of a machine that is told."""

Provider = Annotated[str, typer.Option("--provider", help="Issuer of the login provider, as its tokens spell it.")]
Subject = Annotated[str, typer.Option("--subject", help="The person's `sub` there, as its tokens spell it.")]


def login(
    *,
    browser: Annotated[bool, typer.Option("--browser", help="Print a link that logs in a browser.")] = False,
    name: Annotated[str, typer.Option("--as", help="With --browser: whose key signs.")] = "",
    directory: CellDirectory = None,
    issuer: Issuer = "",
    key: Annotated[
        Path | None, typer.Option("--key", help="Where the new key is to lie; with --browser the operator key's file.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Log in this command line by a browser, or with --browser a browser by an operator key.

    Without --browser a fresh key is made at --key. The person confirms it on the provider's page, with the code shown
    here, and it signs for the person for at most 12 h: with --issuer, --key and --as, as any operator key does.
    It lends at most tier 3, takes back, and reads; it never votes or administers.
    """
    if browser:
        _link(name, directory, issuer, key, as_json=as_json)
        return
    if name or directory is not None or not issuer or key is None:
        fail("WHICH_KEY", "give --issuer, and with --key the place of the new key")
    _confirmed(issuer.rstrip("/"), key, as_json=as_json)


def _link(name: str, directory: Path | None, issuer: str, key: Path | None, *, as_json: bool) -> None:
    if not name:
        fail("WHICH_KEY", "give --as: whose key signs")
    person = operator(directory=directory, name=name, issuer=issuer, key=key)
    with refusals(), person:
        link = person.login_link()
    if as_json:
        say_json({"ok": True, "url": link})
        return
    typer.echo("Open this in the browser that is to be logged in, within two minutes; it is good once:", err=True)
    typer.echo(link)


def _confirmed(issuer: str, file: Path, *, as_json: bool) -> None:
    from capabilities.keys import keys
    from ztpm.base import layout
    from ztpm.cli.provider.passphrase import ask_passphrase
    from ztpm_idp.client.device_login import DeviceLogin

    try:
        made = layout.new_key(file, ask_passphrase(new=True))
    except layout.LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")
    confirmed: Confirmed | None = None
    try:
        with refusals(), DeviceLogin("", made, issuer) as asker:
            waiting = asker.ask(_machine())
            _show(waiting, keys.thumbprint(keys.public_raw(made)))
            confirmed = _wait(asker, waiting)
    finally:
        if confirmed is None:
            file.unlink(missing_ok=True)  # a key that signs for nobody is of no use
    told = {
        "ok": True,
        "person": confirmed.person,
        "roles": list(confirmed.roles),
        "expires_at": confirmed.expires_at,
        "key": str(file),
    }
    if as_json:
        say_json(told)
        return
    typer.echo(f"Logged in as {plain(confirmed.person)} until {instant(confirmed.expires_at)}.")
    typer.echo(f"Sign with: --issuer {issuer} --key {file} --as {plain(confirmed.person)}")


def _show(waiting: Waiting, thumbprint: str) -> None:
    """Tells the person where to go, on standard error: standard output has the outcome alone."""
    typer.echo(f"Open   {waiting.url}", err=True)
    typer.echo(f"Enter  {plain(waiting.user_code)}", err=True)
    typer.echo(f"Key    {thumbprint}   (the page shows the same)", err=True)


def _wait(asker: DeviceLogin, waiting: Waiting) -> Confirmed:
    """The confirmed key; a refusal ends the command."""
    interval_s = waiting.interval_s
    while True:
        time.sleep(interval_s)
        match asker.poll(waiting.device_code):
            case int(interval_s):
                continue
            case confirmed:
                return confirmed


def _machine() -> str:
    """This machine's name, of letters that no page need doubt."""
    import socket

    name = "".join(
        letter for letter in socket.gethostname() if letter.isascii() and (letter.isalnum() or letter in "-.")
    )
    return f"ztpm on {name[:NAME_CHARACTERS] or 'a machine without a name'}"


@signed
def propose(
    person: Annotated[str, typer.Argument(metavar="PERSON", help="Id of the person.")],
    *,
    provider: Provider,
    subject: Subject,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Propose that a person may log in with a login at another provider; another administrator confirms it."""
    known_name(person)
    with refusals(), signer.operator() as caller:
        change = caller.propose_login(person, provider, subject)
    _proposed(change, as_json=as_json)


@signed
def end(*, provider: Provider, subject: Subject, signer: Signer, as_json: Json = False) -> None:
    """End a login at another provider, at once, with every session and key that it began."""
    with refusals(), signer.operator() as caller:
        caller.end_login(provider, subject)
    if as_json:
        say_json({"ok": True, "issuer": provider, "subject": subject})
    else:
        typer.echo("Ended.")


def _proposed(change: str, *, as_json: bool) -> NoReturn:
    if as_json:
        say_json({"ok": True, "change_id": change, "state": "open"})
    else:
        typer.echo(f"Proposed as {change}. Another administrator: ztpm person confirm {change}")
    raise typer.Exit(DEFER)
