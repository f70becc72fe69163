"""`ztpm approvals`: asks of agents, and people's answers, each signed by the person's own key.

Exit status: 0 answered, 1 failure, 2 usage, 3 refused by the identity provider, 4 approved and still waiting for
another person.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table
from rich.text import Text

from capabilities.statements.claims import ID
from ztpm.cli.output import DEFER, console, fail, plain, say_json
from ztpm.cli.provider import envelopes
from ztpm.cli.provider.person import Json, Reason, Signer, refusals, refuse, signed
from ztpm.codes.unavailable import line_of
from ztpm_idp.domain.asking.asks import AskState

if TYPE_CHECKING:
    from collections.abc import Mapping

ID_COLUMNS = 32
"""An ask's or opening's id in hex digits."""
app = typer.Typer(no_args_is_help=True, help="Questions to people, and their answers.")

AskId = Annotated[str, typer.Argument(help="Id of the ask: 32 hex digits.")]
Uses = Annotated[int, typer.Option(min=1, max=100, help="How often it may be used.")]
Minutes = Annotated[int, typer.Option(min=0, max=60, help="How long it holds; adds to --seconds.")]
Seconds = Annotated[int, typer.Option(min=0, max=3600, help="How long it holds; adds to --minutes.")]
MOST_S: Final = 3_600
"""Longest life of an approval or opening, in seconds; the identity provider refuses more."""
APPROVAL_S: Final = 120
OPENING_S: Final = 600
"""Seconds where neither minutes nor seconds are given. DESIGN section 6; the client's own default."""


@app.command("list")
@signed
def list_(
    *,
    state: Annotated[AskState, typer.Option(help="How the asks stand.")] = AskState.OPEN,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """List the asks in a state."""
    person = signer.operator()
    with refusals():
        rows = person.approvals(state=state.value)
    if as_json:
        say_json({"ok": True, "approvals": rows})
        return
    if not rows:
        typer.echo(f"No ask is {state}.")
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("ask", "tier", "index", "agent", "asks for", "because", "until"):
        _heading(table, heading)
    for row in rows:
        cells = (
            row.get("ask_id"), row.get("tier"), _index(row.get("index_milli")), row.get("agent"),
            f"{row.get('object', '?')}.{row.get('operation', '?')}", ", ".join(map(str, row.get("reasons") or [])),
            _clock(row.get("expires_at")),
        )  # fmt: skip
        table.add_row(*(Text(plain(str(cell))) for cell in cells))
    console.print(table)


@app.command("watch")
@signed
def watch(
    *,
    every: Annotated[int, typer.Option("--every", min=1, max=60, help="Seconds between looks.")] = 2,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Tell each open ask once, as it comes, until Ctrl-C; with --json each as one line.

    While the identity provider does not answer, that is told once, and it goes on.
    """
    from ztpm_idp.client import ClientError

    person = signer.operator()
    told: set[object] = set()
    lost = False
    while True:
        try:
            rows = person.approvals(state=AskState.OPEN.value)
        except ClientError as error:
            if error.code != "UNREACHABLE":
                refuse(error)
            if not lost:
                typer.echo(line_of(error.code, error.detail), err=True)
            lost = True
        else:
            lost = False
            for row in rows:
                if row.get("ask_id") not in told:
                    _tell(row, signer.name, as_json=as_json)
            told = {row.get("ask_id") for row in rows}
        time.sleep(every)


def _tell(row: Mapping[str, Any], name: str, *, as_json: bool) -> None:
    if as_json:
        say_json(row)
        return
    wanted = f"{row.get('agent', '?')} asks for {row.get('object', '?')}.{row.get('operation', '?')}"
    impact = (
        f"tier {row.get('tier', '?')}, index {_index(row.get('index_milli'))}, until {_clock(row.get('expires_at'))}"
    )
    because = ", ".join(map(str, row.get("reasons") or []))
    typer.echo(plain(f"{wanted}: {impact} ({because})"))
    typer.echo(plain(f"  ztpm approvals show {row.get('ask_id', '?')} --as {name}"))


@app.command("show")
@signed
def show(
    ask_id: AskId,
    *,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Write the picture of the motion here, as one HTML file.")
    ] = None,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Show everything that an approval of this ask would bind; with --picture the motion, too.

    The picture is the one whose digest stands in the signed ask, or none is written.
    """
    _check_id(ask_id)
    person = signer.operator()
    with refusals():
        asked = person.approval(ask_id)
        drawn = "" if picture is None else person.picture(ask_id)
    asked = {**asked, **_said(asked)}
    if picture is not None:
        _draw(picture, drawn, asked)
    if as_json:
        say_json({"ok": True, **asked})
    else:
        _show(asked)


@app.command("approve")
@signed
def approve(
    ask_id: AskId,
    *,
    uses: Uses = 1,
    minutes: Minutes = 0,
    seconds: Seconds = 0,
    sees_clear: Annotated[
        bool, typer.Option("--sees-clear", help="You see with your own eyes that the cell is clear.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Approve exactly what is shown; the vote binds the digest of the very text that was shown."""
    _check_id(ask_id)
    lifetime_s = _lifetime_s(minutes, seconds, APPROVAL_S)
    person = signer.operator()
    with refusals():
        asked = person.approval(ask_id)
    if not as_json:
        _show(asked)
        typer.echo(f"\nApproves {uses} use{'' if uses == 1 else 's'} within {lifetime_s} s.")
    if not yes and not _confirmed(as_json=as_json):
        fail("NOT_CONFIRMED", "nothing was signed")
    with refusals():
        told = person.approve(
            ask_id, uses=uses, lifetime_s=lifetime_s, sees_clear=sees_clear, shown=str(asked["ask_digest"])
        )
    waiting = told.get("state") == "open"
    if as_json:
        say_json({"ok": True, **told, "ask_digest": asked["ask_digest"], "code": _said(asked)["code"]})
    else:
        typer.echo("Approved; another person must approve, too." if waiting else "Approved.")
    raise typer.Exit(DEFER if waiting else 0)


@app.command("deny")
@signed
def deny(
    ask_id: AskId,
    *,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Deny the ask, which ends it."""
    _check_id(ask_id)
    person = signer.operator()
    with refusals():
        told = person.deny(ask_id)
    _done(told, "Denied.", as_json=as_json)


@app.command("withdraw")
@signed
def withdraw(
    ask_id: AskId,
    *,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Take an approval of your own back."""
    _check_id(ask_id)
    person = signer.operator()
    with refusals():
        told = person.withdraw(ask_id)
    _done(told, "Withdrawn; what was used is used.", as_json=as_json)


@app.command("open")
@signed
def open_(
    *,
    agent: Annotated[str, typer.Option(help="The agent that may ask.")],
    operation: Annotated[str, typer.Option(help="For what, as move_joint.")],
    object_: Annotated[str, typer.Option("--object", help="On what.")] = "ur3e",
    audience: Annotated[str, typer.Option(help="Which tool server (default: the one of --data).")] = "",
    uses: Uses = 1,
    minutes: Minutes = 0,
    seconds: Seconds = 0,
    reason: Annotated[str, typer.Option("--reason", help="For the record: one word, as a ticket's number.")] = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Let an agent ask for a safety-critical (tier 4) act at all. This approves nothing."""
    lifetime_s = _lifetime_s(minutes, seconds, OPENING_S)
    if not audience and signer.issuer:
        fail("WHICH_AUDIENCE", "--issuer needs --audience, too")
    person = signer.operator()
    audience = audience or _audience(signer.directory)
    with refusals():
        opening_id = person.open_tier_4(
            audience=audience, agent=agent, object=object_, operation=operation, uses=uses, lifetime_s=lifetime_s,
            reason=reason,
        )  # fmt: skip
    sentence = f"Opened: {opening_id}. Two different people must still approve each act."
    _done({"opening_id": opening_id}, sentence, as_json=as_json)


@app.command("openings")
@signed
def openings(*, signer: Signer, as_json: Json = False) -> None:
    """List the openings that are not over."""
    person = signer.operator()
    with refusals():
        rows = person.openings()
    if as_json:
        say_json({"ok": True, "openings": rows})
        return
    if not rows:
        typer.echo("Nothing is open.")
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("opening", "opener", "agent", "for", "until"):
        _heading(table, heading)
    for row in rows:
        cells = (
            row.get("opening_id"), row.get("opener"), row.get("agent"),
            f"{row.get('object', '?')}.{row.get('operation', '?')}", _clock(row.get("not_after")),
        )  # fmt: skip
        table.add_row(*(Text(plain(str(cell))) for cell in cells))
    console.print(table)


@app.command("close")
@signed
def close(
    opening_id: Annotated[str, typer.Argument(help="Id of the opening: 32 hex digits.")],
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """End an opening before its time."""
    _check_id(opening_id)
    person = signer.operator()
    with refusals():
        person.close_opening(opening_id, reason)
    _done({"opening_id": opening_id}, "Closed.", as_json=as_json)


app.command("envelope")(envelopes.envelope)
app.command("envelopes")(envelopes.envelopes)
app.command("revoke")(envelopes.revoke)


def _check_id(given: str) -> None:
    if not ID.fullmatch(given):
        fail("ID_MALFORMED", "an id is 32 hex digits")


def _lifetime_s(minutes: int, seconds: int, otherwise_s: int) -> int:
    lifetime_s = 60 * minutes + seconds or otherwise_s
    if lifetime_s > MOST_S:
        fail("TOO_LONG", f"at most {MOST_S} s")
    return lifetime_s


def _confirmed(*, as_json: bool) -> bool:
    if as_json:
        fail("USAGE", "--json asks nobody: give --yes")
    return typer.confirm("Sign this?", default=False, err=True)


def _audience(directory: Any) -> str:
    from ztpm.cell.setup import SetupError, read_addresses
    from ztpm.cli.provider.person import layout_of

    try:
        return read_addresses(layout_of(directory)).audience
    except SetupError as error:
        fail("CONFIG_INVALID", str(error))


def _done(told: Mapping[str, Any], sentence: str, *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, **told})
    else:
        typer.echo(sentence)


def _show(asked: Mapping[str, Any]) -> None:
    """Every member of the ask's text, since the vote binds every one."""
    typer.echo(plain(_said(asked)["sentence"]))
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for member, value in asked["shown"].items():
        match member:
            case "values":
                lines = [f"{v['name']} = {json.dumps(v['value'])} {v.get('unit') or v['kind']}" for v in value]
            case "facts":
                lines = [_fact(each) for each in value]
            case "contributors":
                lines = [
                    f"{c['kind']} {c['object']} near {c['link']}, said by {c['source'] or 'no sensor'}: "
                    f"index {_index(c['index_milli'])}, "
                    f"clearance {c['clearance_um'] / 1000:.0f} mm, {c['speed_um_s'] / 1000:.0f} mm/s"
                    for c in value
                ]
            case "index_milli":
                lines = [_index(value)]
            case "asked_at" | "expires_at":
                lines = [_clock(value)]
            case _:
                lines = [" ".join(map(str, value)) if isinstance(value, list) else str(value)]
        table.add_row(member, Text("\n".join(map(plain, lines))))
    table.add_row("state", Text(plain(f"{asked['state']}, {len(asked['votes'])} votes")))
    table.add_row("binds", Text(plain(f"SHA-256 {asked['ask_digest']} of the ask's text")))
    table.add_row("code", Text(plain(f"{_said(asked)['code']}, as on the ask's page")))
    console.print(table)


def _said(asked: Mapping[str, Any]) -> dict[str, str]:
    """The sentence on what would happen, and the ask's code, as its page says both."""
    from capabilities.statements.people.ask_words import code_of, sentence_of_claims

    return {"sentence": sentence_of_claims(asked["shown"]), "code": code_of(str(asked["ask_digest"]))}


def _draw(file: Path, drawn: str, asked: Mapping[str, Any]) -> None:
    """Writes the picture; an act without motion has none."""
    from ztpm.picture.ask_picture import ask_picture

    if not drawn:
        fail("NO_PICTURE", "the ask names none")
    try:
        file.write_text(ask_picture(drawn, sentence=str(asked["sentence"]), code=str(asked["code"])), "utf-8")
    except OSError as error:
        fail("UNWRITABLE", f"{file}: {error.strerror}")


def _fact(fact: Mapping[str, Any]) -> str:
    value = "unknown" if fact["value"] is None else f"{fact['value']} {fact['unit']}"
    age = "" if fact["age_ms"] is None else f", {fact['age_ms']} ms old"
    return f"{fact['fact']} = {value}, {fact['state']}{age}{', raises the tier' if fact['raises'] else ''}"


def _index(milli: object) -> str:
    return f"{milli / 1000:.3f}" if type(milli) is int else "?"


def _clock(seconds: object) -> str:
    try:
        return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(seconds)) if type(seconds) is int else "?"
    except (OverflowError, ValueError, OSError):
        return "?"


def _heading(table: Table, heading: str) -> None:
    """Adds a column; a shortened id would be useless."""
    if heading in {"ask", "opening"}:
        table.add_column(heading, no_wrap=True, min_width=ID_COLUMNS)
    else:
        table.add_column(heading, overflow="fold")
