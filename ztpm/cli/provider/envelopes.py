"""`ztpm approvals envelope`, `envelopes` and `revoke`: approvals beforehand, each around an ask that was read.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

from typing import Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from capabilities.statements.claims import ID
from ztpm.cli.output import console, fail, instant, plain, say_json
from ztpm.cli.provider.person import Json, Reason, Signer, refusals, signed

MINUTES: Final = 10
USES: Final = 10
"""Longest life in minutes and most uses of an envelope (docs/spec.md, [ENV-1])."""

Room = Annotated[
    list[str],
    typer.Option("--room", metavar="NAME=UNITS", help="How far a parameter may be from the ask's, in its own unit."),
]


@signed
def envelope(
    ask_id: Annotated[str, typer.Argument(help="Id of the ask around which it lies: 32 hex digits.")],
    *,
    uses: Annotated[int, typer.Option(min=1, max=USES, help="How many acts.")] = 1,
    minutes: Annotated[int, typer.Option(min=1, max=MINUTES, help="For how long.")] = MINUTES,
    index: Annotated[float, typer.Option(min=0, max=3, help="Highest index.")],
    speed_mm_s: Annotated[int, typer.Option(min=0, max=250, help="Highest speed of the tool, mm/s.")],
    room: Room = [],  # noqa: B006 - Typer reads the default, and nobody changes it
    start_mrad: Annotated[int, typer.Option(min=0, help="How far each joint may start from the ask's, mrad.")] = 2,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Approve beforehand what is like an ask: its agent and act, inside these bounds, with nothing new in view."""
    from capabilities.values.errors import StatementError
    from ztpm_idp.client.envelopes import Bounds

    if not ID.fullmatch(ask_id):
        fail("ID_MALFORMED", "an id is 32 hex digits")
    bounds = Bounds(
        index_milli=round(index * 1_000),
        speed_um_s=speed_mm_s * 1_000,
        uses=uses,
        lifetime_s=minutes * 60,
        room=_rooms(room),
        start_room_urad=start_mrad * 1_000,
    )
    person = signer.operator()
    with refusals():
        try:
            made = person.envelope_around(ask_id, bounds)
        except ValueError as error:
            fail("USAGE", str(error))
    if not as_json:
        typer.echo(f"{plain(made.agent)} for {plain(made.sponsor)}: {plain(made.object)}.{plain(made.operation)}")
        for side in (*made.box, *made.start_urad):
            typer.echo(f"  {plain(side.name)}: {side.low} to {side.high}")
        for seen in made.seen:
            typer.echo(f"  in view: {plain(seen.kind)} {plain(seen.object)}")
        typer.echo(
            f"  tier {int(made.tier)}, index at most {made.index_milli / 1_000:.3f}, tool at most {speed_mm_s} mm/s"
        )
        typer.echo(f"Approves {uses} act{'' if uses == 1 else 's'} inside of that until {instant(made.not_after)}.")
    if not yes:
        if as_json:
            fail("USAGE", "--json asks nobody: give --yes")
        if not typer.confirm("Sign this?", default=False, err=True):
            fail("NOT_CONFIRMED", "nothing was signed")
    with refusals():
        try:
            envelope_id = person.sign_envelope(made)
        except StatementError as error:
            fail("USAGE", error.detail)
    _said({"envelope_id": envelope_id}, f"Signed: {envelope_id}.", as_json=as_json)


@signed
def envelopes(*, signer: Signer, as_json: Json = False) -> None:
    """List the envelopes that are not over."""
    person = signer.operator()
    with refusals():
        rows = person.envelopes()
    if as_json:
        say_json({"ok": True, "envelopes": rows})
        return
    if not rows:
        typer.echo("Nothing is approved beforehand.")
        return
    table = Table("envelope", "approver", "agent", "until", box=None, pad_edge=False)
    for row in rows:
        cells = (row["envelope_id"], row["approver"], row["agent"], instant(row["not_after"]))
        table.add_row(*(Text(plain(str(cell))) for cell in cells))
    console.print(table)


@signed
def revoke(
    envelope_id: Annotated[str, typer.Argument(help="Id of the envelope: 32 hex digits.")],
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Revoke an envelope: from the next word of the identity provider on, nothing is inside of it."""
    if not ID.fullmatch(envelope_id):
        fail("ID_MALFORMED", "an id is 32 hex digits")
    person = signer.operator()
    with refusals():
        person.revoke_envelope(envelope_id, reason)
    _said({"envelope_id": envelope_id}, "Revoked.", as_json=as_json)


def _rooms(given: list[str]) -> dict[str, int]:
    rooms = {}
    for word in given:
        name, _, units = word.partition("=")
        if not name or not units.isascii() or not units.isdecimal():
            fail("USAGE", "--room NAME=UNITS, with a whole number of the parameter's own unit")
        rooms[name] = int(units)
    return rooms


def _said(told: dict[str, str], sentence: str, *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, **told})
    else:
        typer.echo(sentence)
