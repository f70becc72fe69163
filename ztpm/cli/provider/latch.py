"""`ztpm latch`: robots that a stop has latched, the way out that the physics proposes, and their clearing by people.

Exit status: 0 done, 1 failure, 2 usage, 3 refused by the identity provider, 4 cleared and still waiting for another
person.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from capabilities.statements.claims import ID
from ztpm.cli.output import DEFER, console, fail, instant, plain, say_json
from ztpm.cli.provider.person import Json, Signer, refusals, signed

if TYPE_CHECKING:
    from capabilities.statements.people.latch import Latch, Retreat
    from ztpm_idp.client.latches import ShownLatch

app = typer.Typer(no_args_is_help=True, help="Robots that were stopped, and wait for people to clear them.")
LatchId = Annotated[str, typer.Argument(help="Id of the latch: 32 hex digits.")]
WAITS: Final = "waits"
MICRO: Final = 1e-6


@app.command("list")
@signed
def list_(
    *,
    every: Annotated[bool, typer.Option("--all", help="Those that people have cleared, too.")] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """List the latches that wait for people, the newest first."""
    person = signer.operator()
    with refusals():
        rows = [row for row in person.latches() if every or row.get("state") == WAITS]
    if as_json:
        say_json({"ok": True, "latches": rows})
        return
    if not rows:
        typer.echo("No latch waits for people.")
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("latch", "robot", "cause", "people", "since", "state"):
        table.add_column(heading, no_wrap=heading == "latch", overflow="fold")
    for row in rows:
        cells = (row["latch_id"], row["robot"], row["cause"], row["approvers"], instant(row["at"]), row["state"])
        table.add_row(*(Text(plain(str(cell))) for cell in cells))
    console.print(table)


@app.command("show")
@signed
def show(latch_id: LatchId, *, signer: Signer, as_json: Json = False) -> None:
    """Show everything that a clearing of this latch would bind, and the way out that the physics proposes."""
    _check_id(latch_id)
    person = signer.operator()
    with refusals():
        found = person.latch(latch_id)
    if as_json:
        say_json({"ok": True, **_told(found)})
    else:
        _show(found)


@app.command("clear")
@signed
def clear(
    latch_id: LatchId,
    *,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Clear exactly the latch that is shown: the robot may be commanded again. Nothing moves by that."""
    _check_id(latch_id)
    person = signer.operator()
    with refusals():
        found = person.latch(latch_id)
    if not as_json:
        _show(found)
    if not yes:
        if as_json:
            fail("USAGE", "--json asks nobody: give --yes")
        if not typer.confirm("You have looked at the cell. Sign this?", default=False, err=True):
            fail("NOT_CONFIRMED", "nothing was signed")
    with refusals():
        state = person.clear_latch(found)
    waiting = state == WAITS
    if as_json:
        say_json({"ok": True, "latch_id": latch_id, "state": state, "latch_digest": found.digest})
    else:
        typer.echo("Signed; another person must clear it, too." if waiting else "Cleared.")
    raise typer.Exit(DEFER if waiting else 0)


def _check_id(given: str) -> None:
    if not ID.fullmatch(given):
        fail("ID_MALFORMED", "an id is 32 hex digits")


def _told(found: ShownLatch) -> dict[str, object]:
    from capabilities.statements.people import latch as latches

    return {
        **latches.claims(found.latch),
        "state": found.state,
        "latch_digest": found.digest,
        "clearings": list(found.clearings),
    }


def _show(found: ShownLatch) -> None:
    latch = found.latch
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    counting = [str(each.get("approver")) for each in found.clearings if each.get("counts")]
    rows = {
        "latch": latch.latch_id,
        "robot": f"{latch.robot} of {latch.audience}",
        "cause": f"{latch.cause} {latch.reason}".strip(),
        "tier": f"{int(latch.tier)} of the act that was stopped",
        "request": latch.request_id or "none",
        "since": instant(latch.at),
        "people": f"{latch.approvers} have to clear it; so far {', '.join(counting) or 'nobody'}",
        "way out": way_out(latch),
        "state": found.state,
        "binds": f"SHA-256 {found.digest} of the latch's text",
    }
    for name, value in rows.items():
        table.add_row(name, Text(plain(value)))
    console.print(table)


def way_out(latch: Latch) -> str:
    """The way out that the latch proposes, in words: which joints, how far, how fast, its tier."""
    if not latch.retreat:
        return f"none proposed: {latch.no_retreat}"
    way: Retreat = latch.retreat[0]
    turns = ", ".join(f"joint {turn.joint} by {_degrees(turn.by_urad):+.2f}°" for turn in way.turns)
    target = ", ".join(f"{angle * MICRO:.6f}" for angle in way.target_urad)
    return (
        f"move_joint: {turns} at {_degrees(way.speed_urad_s):.1f}°/s, tier {int(way.tier)}, "
        f"index {way.index_milli / 1_000:.3f} (q_rad {target}); a request of its own, decided afresh"
    )


def _degrees(micro: int) -> float:
    return math.degrees(micro * MICRO)
