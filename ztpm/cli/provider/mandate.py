"""`ztpm mandate`: a sponsor signs once, and for days an agent draws short tokens, with nobody asked.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import console, fail, plain, say_json
from ztpm.cli.provider.agent import AgentName, Software, agent_of
from ztpm.cli.provider.person import CellDirectory, Issuer, Json, KeyFile, Reason, Signer, refusals, signed
from ztpm.cli.provider.token import Out, Purpose, arm_scope, check_new, keep, read_as

DAY_S: Final = 86_400
DAYS: Final = 7
"""Longest life of a mandate, in days."""
EARLY_S: Final = 5
"""Seconds by which a window begins early: verifiers take no skew at its ends."""
app = typer.Typer(no_args_is_help=True, help="Mandates: authority for work that is longer than a token.")

MandateId = Annotated[str, typer.Argument(metavar="MANDATE", help="Id of the mandate: 32 hex digits.")]


@app.command("sign")
@signed
def sign(
    agent: AgentName,
    *,
    purpose: Purpose,
    scope: Annotated[
        Path | None, typer.Option(help="JSON of the whole scope (default: the arm, up to tier 3).", dir_okay=False)
    ] = None,
    days: Annotated[
        int | None,
        typer.Option(min=1, max=DAYS, help="How long from now (default: the scope's own window, else 7 days)."),
    ] = None,
    delegate: Annotated[list[str] | None, typer.Option(help="Whom it may lend to, with the default scope.")] = None,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Let an agent draw tokens for days; each is short, attested anew, and ends with the mandate."""
    from capabilities.values.errors import CapabilityError
    from capabilities.values.scope_json import scope_from_json

    now = int(time.time())
    if scope is None:
        promised = arm_scope(signer.directory, frozenset(delegate or ()), DAY_S * (days or DAYS))
    else:
        promised = read_as(scope, scope_from_json)
    if days is not None:
        promised = replace(promised, not_before=now - EARLY_S, not_after=now + DAY_S * days)
    person = signer.operator()
    try:
        with refusals(), person:
            mandate_id = person.sign_mandate(agent, promised, purpose=purpose)
    except CapabilityError as error:
        fail(error.code.value, error.detail)
    if as_json:
        say_json({"ok": True, "mandate_id": mandate_id, "not_after": promised.not_after})
    else:
        typer.echo(f"Mandate {mandate_id} for {agent}, until {_clock(promised.not_after)}.")


@app.command("list")
@signed
def list_(*, signer: Signer, as_json: Json = False) -> None:
    """List the mandates that you signed, the newest first; as administrator, everybody's."""
    person = signer.operator()
    with refusals(), person:
        rows = person.mandates()
    if as_json:
        say_json({"ok": True, "mandates": rows})
        return
    if not rows:
        typer.echo("No mandate.")
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("mandate", no_wrap=True, min_width=32)
    for heading in ("state", "agent", "sponsor", "until", "live"):
        table.add_column(heading)
    for row in rows:
        cells = (
            row.get("mandate_id"), row.get("state"), row.get("agent"), row.get("sponsor"), _clock(row.get("not_after")),
            row.get("live"),
        )  # fmt: skip
        table.add_row(*(Text(plain(str(cell))) for cell in cells))
    console.print(table)


@app.command("show")
@signed
def show(mandate_id: MandateId, *, signer: Signer, as_json: Json = False) -> None:
    """Show a mandate, its scope, and each token that was drawn from it."""
    person = signer.operator()
    with refusals(), person:
        told = person.mandate(mandate_id)
    if as_json:
        say_json({"ok": True, **told})
        return
    for name in ("mandate_id", "state", "sponsor", "agent", "purpose"):
        typer.echo(f"{name:>10}  {plain(str(told.get(name)))}")
    typer.echo(f"{'signed':>10}  {_clock(told.get('signed_at'))}, until {_clock(told.get('not_after'))}")
    console.print_json(json.dumps(told.get("scope")))
    draws: list[dict[str, Any]] = told.get("draws") or []
    typer.echo(f"Drawn: {len(draws) or 'nothing'}.")
    for each in draws:
        state = "live" if each.get("live") else "over"
        token = plain(str(each.get("token_id")))
        typer.echo(f"  {_clock(each.get('drawn_at'))}  {state}  token {token}, until {_clock(each.get('not_after'))}")


@app.command("revoke")
@signed
def revoke(mandate_id: MandateId, *, reason: Reason, signer: Signer, as_json: Json = False) -> None:
    """Revoke a mandate: nothing more is drawn, and what was drawn is dead within a second."""
    person = signer.operator()
    with refusals(), person:
        made = person.revocation("mandate", mandate_id, reason)
    if as_json:
        say_json({"ok": True, "mandate_id": mandate_id, "epoch": made.epoch, "known": made.known})
    else:
        typer.echo(f"Revoked, epoch {made.epoch}.")


@app.command("draw")
def draw(
    mandate_id: MandateId,
    agent: AgentName,
    *,
    software: Software,
    out: Out,
    minutes: Annotated[int, typer.Option(min=1, max=60, help="How long, at most.")] = 60,
    directory: CellDirectory = None,
    issuer: Issuer = "",
    key: KeyFile = None,
    as_json: Json = False,
) -> None:
    """Draw a token from a mandate, as the agent; a program of your own goes on drawing with `Agent.renewal`."""
    check_new(out)
    receiver = agent_of(agent, software, directory=directory, issuer=issuer, key=key)
    with refusals(), receiver:
        issued = receiver.draw(mandate_id, lifetime_s=60 * minutes)
    keep(issued, out, as_json=as_json)


def _clock(seconds: object) -> str:
    if not isinstance(seconds, int):
        return "?"
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(seconds))
