"""`ztpm person`, `ztpm idp recover`: people, and the changes of them that take two.

Exit status: 0 done, 1 failure, 2 usage, 3 refused, 4 another person must confirm.
"""

from __future__ import annotations

import hashlib
import time
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from ztpm.cli.output import DEFER, console, fail, fail_at, instant, say_json
from ztpm.cli.provider.party_keys import raw_of
from ztpm.cli.provider.person import (
    CellDirectory,
    Issuer,
    Json,
    Reason,
    Signer,
    issuer_of,
    known_name,
    layout_of,
    open_key,
    refusals,
    signed,
)
from ztpm.cli.tables import show_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capabilities.keys.keys import PrivateKey
    from ztpm_idp.client import Operator

app = typer.Typer(no_args_is_help=True, help="People: who may do what. Two people change approvers and administrators.")

PersonName = Annotated[str, typer.Argument(metavar="PERSON", help="Id of the person.")]
ChangeId = Annotated[str, typer.Argument(metavar="CHANGE", help="As `ztpm person list` shows it.")]
PublicKey = Annotated[str, typer.Option("--public", help="Public key, as `ztpm person new-key` prints it.")]
ShownName = Annotated[str, typer.Option("--name", help="Name as shown to people (default: the id).")]


CODE_CHARACTERS = 8
"""Hex digits of the code that a terminal and a browser show of one key: two people compare no more."""


class Role(StrEnum):
    """The roles of people."""

    SPONSOR = "sponsor"
    APPROVER = "approver"
    ADMIN = "admin"
    AUDITOR = "auditor"


@app.command("new-key")
def new_key(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where the key is to lie; it must not exist.")],
    *,
    as_json: Json = False,
) -> None:
    """Make a key of one's own, encrypted; its public half is what an administrator registers."""
    from capabilities.keys import keys
    from ztpm.base import layout
    from ztpm.cli.provider.passphrase import ask_passphrase

    try:
        made = layout.new_key(file, ask_passphrase(new=True))
    except layout.LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")
    public = keys.b64u(keys.public_raw(made))
    if as_json:
        say_json({"ok": True, "key": str(file), "public": public})
    else:
        typer.echo(public)


@app.command("register")
@signed
def register(
    person: PersonName,
    *,
    public: PublicKey,
    role: Annotated[list[Role], typer.Option("--role", help="What the person may do; again for more.")],
    shown: ShownName = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register a sponsor or auditor, or propose an approver or administrator, whom another administrator confirms."""
    raw, roles = raw_of(public), [each.value for each in role]
    known_name(person)
    with _caller(signer) as caller:
        if set(roles) <= {Role.SPONSOR.value, Role.AUDITOR.value}:
            caller.register_person(person, shown or person, raw, roles)
            _say("Registered.", {"id": person}, as_json=as_json)
            return
        change = caller.propose_person(person, shown or person, raw, roles)
    _wait(change, as_json=as_json)


@app.command("key")
@signed
def add_key(
    *,
    public: PublicKey,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Propose a further key of one's own, as for a second machine. It gives no second vote."""
    raw = raw_of(public)
    with _caller(signer) as caller:
        change = caller.propose_key(raw)
    _wait(change, as_json=as_json)


@app.command("passkey")
@signed
def add_passkey(
    *,
    wait_s: Annotated[int, typer.Option("--wait", min=1, max=600, help="Seconds to wait for the browser.")] = 600,
    yes: Annotated[bool, typer.Option("--yes", help="Do not compare the code.")] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Make a passkey of one's own with a browser, and propose it. It gives no second vote."""
    from capabilities.keys.keys import unb64u

    with _caller(signer) as caller:
        begun = caller.begin_passkey()
        typer.echo(f"Open {begun['url']} where the passkey is to be.", err=True)
        key = ""
        for _ in range(wait_s):
            if key := caller.enrolled_passkey(begun["enrolment_id"]):
                break
            time.sleep(1)
        if not key:
            fail("ENROLMENT_UNKNOWN", "no browser has made a passkey in time")
        code = hashlib.sha256(unb64u(key)).hexdigest()[:CODE_CHARACTERS]
        typer.echo(f"A passkey was made. Its code is {code}.", err=True)
        if not yes and not typer.confirm("Does the browser show the same code?", default=False, err=True):
            fail("NOT_CONFIRMED", "nothing was proposed")
        change = caller.propose_passkey(begun["enrolment_id"], key)
    _wait(change, as_json=as_json)


@app.command("roles")
@signed
def roles(
    person: PersonName,
    *,
    role: Annotated[list[Role], typer.Option(help="One role that the person has from then on; may be repeated.")],
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Propose all the roles that a person has from then on. What stood on a role that is gone ends."""
    with _caller(signer) as caller:
        change = caller.propose_roles(person, [one.value for one in role])
    _wait(change, as_json=as_json)


@app.command("retire")
@signed
def retire(
    person: PersonName,
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Retire a person: it and all authority under it have ended, for ever.

    For a sponsor or oneself it happens at once; another administrator confirms the end of any other. People are not
    suspended: suspend their agents, or retire them.
    """
    from ztpm_idp.client import ClientError

    known_name(person)
    with _caller(signer) as caller:
        try:
            epoch = caller.disable_person(person, reason)
        except ClientError as error:
            if error.code != "TWO_PEOPLE_NEEDED":
                raise
            change = caller.propose_end(person, reason)
        else:
            _say(f"Ended, epoch {epoch}.", {"id": person, "epoch": epoch}, as_json=as_json)
            return
    _wait(change, as_json=as_json)


@app.command("confirm")
@signed
def confirm(
    change: ChangeId,
    *,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Confirm another administrator's change. Make sure first that the person is who it should be, and another."""
    with _caller(signer) as caller:
        state = caller.confirm_change(change)
    _answered(change, state, as_json=as_json)


@app.command("decline")
@signed
def decline(
    change: ChangeId,
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Decline a change, or take one's own back. Two administrators decline a recovery."""
    with _caller(signer) as caller:
        state = caller.decline_change(change, reason)
    _answered(change, state, as_json=as_json)


@app.command("list")
@signed
def list_(*, signer: Signer, as_json: Json = False) -> None:
    """List every person, and the changes that wait for another."""
    with _caller(signer) as caller:
        people, changes = caller.persons(), caller.changes()
    if as_json:
        say_json({"ok": True, "people": people, "changes": changes})
        return
    show_table(("person", "name", "roles", "status", "keys"), [
        (row["id"], row["name"], ", ".join(row["roles"]), row["status"], "\n".join(row["keys"])) for row in people
    ])  # fmt: skip
    if changes:
        console.print()
        show_table(("change", "what", "proposed by", "until"), [
            (row["change_id"], _told(row), row["by"], instant(row["until"])) for row in changes
        ])  # fmt: skip


@app.command("allowances")
@signed
def allowances(
    person: Annotated[str, typer.Argument(metavar="PERSON", help="Id of a sponsor (default: whose key signs).")] = "",
    *,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Show how much a sponsor has of each thing that is bounded, and may have."""
    who = person or signer.name
    known_name(who)
    with _caller(signer) as caller:
        rows = caller.allowances(who)
    if as_json:
        say_json({"ok": True, "sponsor": who, "allowances": rows})
        return
    show_table(("allowance", "used", "of"), [(row["name"], row["used"], row["most"]) for row in rows])


def recover(
    person: PersonName,
    *,
    public: PublicKey,
    shown: ShownName = "",
    directory: CellDirectory = None,
    issuer: Issuer = "",
    key: Annotated[Path | None, typer.Option("--key", help="The file of the root key, with --issuer.")] = None,
    as_json: Json = False,
) -> None:
    """Recover an administrator with the root key: a new person, or one whose keys are lost.

    Every administrator is told. It takes effect after 24 h with the person's first command, or as soon as two
    administrators confirm it; two may decline it. Then everything that people had left open ends.
    """
    from ztpm_idp.client import Operator

    raw = raw_of(public)
    known_name(person)
    if bool(issuer) != (key is not None) or (issuer and directory is not None):
        fail("WHICH_KEY", "give --data, or --issuer and --key together")
    root = _root_key(directory) if key is None else open_key(key)
    url = issuer or issuer_of(layout_of(directory))
    with refusals(), Operator("root", root, url) as caller:
        change = caller.recover(person, shown or person, raw)
    _wait(change, as_json=as_json)


def _root_key(directory: Path | None) -> PrivateKey:
    from capabilities.keys.windows import Role as KeyRole
    from capabilities.values.errors import BadKeyError
    from ztpm.base.layout import LayoutError
    from ztpm.cell import key_ring

    layout = layout_of(directory)
    try:
        signing = key_ring.read(layout).active(KeyRole.ROOT)
    except (BadKeyError, LayoutError) as error:
        fail("KEYS_UNREADABLE", f"{layout.key_ring}: {error}")
    except OSError as error:
        fail_at(layout.key_ring, error, "KEYS_UNREADABLE")
    return open_key(layout.idp_key(signing.id))


@contextmanager
def _caller(signer: Signer) -> Iterator[Operator]:
    """The person at work; a refusal ends the command."""
    person = signer.operator()
    with refusals(), person:
        yield person


def _say(sentence: str, told: dict[str, object], *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, **told})
    else:
        typer.echo(sentence)


def _wait(change: str, *, as_json: bool) -> NoReturn:
    """Ends the command: the change waits for another person."""
    _say(
        f"Proposed as {change}. Another administrator: ztpm person confirm {change}",
        {"change_id": change, "state": "open"},
        as_json=as_json,
    )
    raise typer.Exit(DEFER)


def _answered(change: str, state: str, *, as_json: bool) -> None:
    sentence = "It waits for one more administrator." if state == "open" else f"The change is {state}."
    _say(sentence, {"change_id": change, "state": state}, as_json=as_json)
    if state == "open":
        raise typer.Exit(DEFER)


def _told(row: dict[str, Any]) -> str:
    """One change in words."""
    person, key = row["person"], row["key"]
    match row["kind"]:
        case "person":
            return f"register {person} ({row['name']}) as {', '.join(row['roles'])}, key {key}"
        case "key":
            return f"{person} has a further {'passkey' if row.get('passkey') else 'key'}, {key}"
        case "roles":
            return f"{person} has the roles {', '.join(row['roles'])}, and no others"
        case "login":
            return f"{person} may log in as {row['login']}"
        case "end":
            return f"end {person}: {row['reason']}"
        case _:
            return f"the root key makes {person} ({row['name']}) an administrator, key {key}"
