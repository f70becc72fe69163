"""`ztpm stop`, and `ztpm latch`: robots that a stop has latched, the proposed way out, and their clearing by people.

Exit status: 0 done, 1 failure, 2 usage, 3 refused (a stop has begun all the same), 4 cleared and still waiting for
another person.
"""

from __future__ import annotations

import math
import secrets
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import DEFER, DONE, console, fail, fail_at, instant, plain, say_json
from ztpm.cli.provider.person import (
    KEY_VARIABLE,
    CellDirectory,
    Json,
    Signer,
    known_name,
    layout_of,
    open_key,
    refusals,
    signed,
)

if TYPE_CHECKING:
    from capabilities.statements.people.latch import Latch, Retreat
    from ztpm.base.layout import Layout
    from ztpm.base.stop_call import StopAddress
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


def stop(
    *,
    directory: CellDirectory = None,
    person: Annotated[
        str, typer.Option("--as", help="Whose key signs that the robot waits for people afterwards.", envvar="ZTPM_AS")
    ] = "",
    key: Annotated[
        Path | None, typer.Option("--key", help="The key's file, where the cell has none.", envvar=KEY_VARIABLE)
    ] = None,
    reason: Annotated[str, typer.Option("--reason", help="Why, in the signed word and the ledger.")] = "",
    as_json: Json = False,
) -> None:
    """Stop the arm at once, without a key; with --as nothing moves it until people clear it.

    The arm is being stopped before a passphrase is asked for.
    """
    from ztpm.base.event_log import EventLog
    from ztpm.base.stop_call import DASHBOARD, StopAddress, stop_arm
    from ztpm.status.texts import TEXTS

    layout, words = layout_of(directory), TEXTS["stop"]
    try:
        address = StopAddress.of(layout.gateway_config)
    except OSError as error:
        fail_at(layout.gateway_config, error, "UNREADABLE")
    except ValueError as error:
        fail("CONFIG_INVALID", f"{layout.gateway_config}: {error}")
    done = stop_arm(address)
    if done is None:
        fail("STOP_FAILED", f"nothing answers at {address.url}, nor at the dashboard of {address.robot_host}")
    DONE.set({"stopped": True, "by": done["by"]})
    if done["by"] == DASHBOARD:
        log = EventLog(layout.log, wall_s=time.time, say=lambda _: None)
        log.note("arm-stopped", "stopped by `ztpm stop` through the dashboard: the gateway did not answer")
    if not as_json:
        lease = words["lease"].format(lease=plain(done["lease"])) if done["lease"] else ""
        typer.echo(f"{words['dashboard' if done['by'] == DASHBOARD else 'begun']}{lease}")
    if person:
        done = _latched_by(person, key, reason, layout, address) | {"by": done["by"], "lease": done["lease"]}
    if as_json:
        say_json({"ok": True, **{name: done[name] for name in ("stopped", "by", "lease", "person", "latch")}})
    elif done["person"]:
        clears = f"ztpm latch clear {done['latch']['latch_id']} --data {layout.root} --as NAME"
        typer.echo(f"The robot is latched by {plain(done['person'])}. Once somebody has looked at the cell: {clears}")
    elif (done["latch"] or {}).get("latched"):
        typer.echo("The robot is latched; `ztpm latch list` shows by what.")
    elif done["by"] == DASHBOARD:
        typer.echo("Nothing is latched: a silent gateway latches nothing.")
    else:
        typer.echo("Nothing is latched: who may move it moves it again. `ztpm stop --as NAME` latches it.")


def _latched_by(person: str, key: Path | None, reason: str, layout: Layout, address: StopAddress) -> dict[str, Any]:
    """The gateway's answer to this person's word on the stop, which has begun; the command ends where it fails."""
    from capabilities.statements.people import stop as stops
    from capabilities.values.errors import StatementError
    from pep.base.operations import ROBOT
    from ztpm.base.stop_call import WORD_S, ask_gateway

    known_name(person)
    path = key or layout.operator_key(person)
    if not path.exists():
        fail("OPERATOR_UNKNOWN", f"{path} is missing")
    own, at = open_key(path), int(time.time())
    made = stops.Stop(
        stop_id=secrets.token_hex(16),
        issuer=address.issuer,
        audience=address.audience,
        robot=ROBOT,
        person=person,
        reason=reason,
        not_after=at + stops.LIFETIME_S,
        at=at,
    )
    try:
        word = stops.sign(made, own)
    except StatementError as error:
        fail("USAGE", f"--reason: {error.detail}")
    said = ask_gateway(address, word, timeout_s=WORD_S)
    if said is None:
        fail("GATEWAY_UNREACHABLE", f"nothing answers at {address.url}, so nothing is latched")
    if said["fault"]:
        fail(str(said["fault"]), f"the word of {person} latches nothing; that of an approver does, signed just now")
    return said


def _check_id(given: str) -> None:
    from capabilities.statements.claims import ID

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
        **({"stopped by": latch.person} if latch.person else {}),
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
