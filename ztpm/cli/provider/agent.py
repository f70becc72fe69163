"""`ztpm agent`: agents of a cell, their keys in its directory.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import console, fail, fail_at, plain, say_json
from ztpm.cli.provider.person import (
    As,
    CellDirectory,
    Json,
    Reason,
    Signer,
    issuer_of,
    known_name,
    layout_of,
    open_key,
    operator,
    refusals,
    signed,
)

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from ztpm_idp.client import Agent

app = typer.Typer(no_args_is_help=True, help="Agents: who they are, what they run, whether they may act.")

AgentName = Annotated[str, typer.Argument(metavar="AGENT", help="Id of the agent.")]
Software = Annotated[
    Path,
    typer.Option(
        "--software", help="The file that it runs; its SHA-256 is what is attested.", exists=True, dir_okay=False
    ),
]


@app.command("register")
def register(
    agent: AgentName,
    *,
    software: Software,
    role: Annotated[str, typer.Option(help="What it is for, as planner.")],
    model: Annotated[str, typer.Option(help="The language model behind it.")] = "none",
    sponsor: Annotated[str, typer.Option(help="Who answers for it (default: --as).")] = "",
    name: As,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Register an agent under a sponsor; its key is made in the cell's directory, encrypted, unless it is there."""
    from capabilities.keys import keys
    from ztpm.base.layout import LayoutError, new_key
    from ztpm.cli.provider.passphrase import ask_passphrase

    known_name(agent)
    person = operator(directory=directory, name=name, issuer="", key=None)
    layout = layout_of(directory)
    path = layout.agent_key(agent)
    try:
        key = open_key(path) if path.exists() else new_key(path, ask_passphrase(new=False))
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(path, error, "UNWRITABLE")
    with refusals(), person:
        person.register_agent(
            agent, keys.public_raw(key), software_digest=_measured(software).hex(), model=model,
            role=role, sponsor=sponsor or None,
        )  # fmt: skip
    if as_json:
        say_json({"ok": True, "id": agent, "status": "registered", "key": str(path)})
    else:
        typer.echo(f"Registered; its key is {path}. It may act once it is attested.")


@app.command("attest")
def attest(agent: AgentName, *, software: Software, directory: CellDirectory = None, as_json: Json = False) -> None:
    """Attest an agent with its own key: it is active from then on, if it runs what is registered."""
    with refusals(), agent_of(agent, software, directory=directory) as itself:
        itself.attest()
    if as_json:
        say_json({"ok": True, "id": agent, "status": "active"})
    else:
        typer.echo("Attested.")


@app.command("list")
@signed
def list_(*, signer: Signer, as_json: Json = False) -> None:
    """List every agent with its sponsor, state, trust and behaviour."""
    person = signer.operator()
    with refusals(), person:
        rows = person.agents()
    if as_json:
        say_json({"ok": True, "agents": rows})
        return
    if not rows:
        typer.echo("None is registered.")
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("agent", "status", "sponsor", "role", "trust", "behaviour", "key"):
        table.add_column(heading)
    for row in rows:
        known = (row.get("id"), _status(row), row.get("sponsor"), row.get("role"))
        cells = (*known, _trust(row), _behaviour(row), row.get("key"))
        table.add_row(*(Text(plain(str(cell))) for cell in cells))
    console.print(table)


@app.command("retire")
@signed
def retire(
    agent: AgentName,
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Retire an agent and all authority below it, for ever. Nothing takes it back: register a new agent instead."""
    known_name(agent)
    person = signer.operator()
    with refusals(), person:
        epoch = person.retire_agent(agent, reason)
    if as_json:
        say_json({"ok": True, "id": agent, "epoch": epoch})
    else:
        typer.echo(f"Retired, epoch {epoch}.")


@app.command("suspend")
@signed
def suspend(
    agent: AgentName,
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Suspend an agent and all authority through it, until it is restored."""
    known_name(agent)
    person = signer.operator()
    with refusals(), person:
        person.suspend_agent(agent, reason)
    if as_json:
        say_json({"ok": True, "id": agent, "status": "suspended"})
    else:
        typer.echo("Suspended.")


@app.command("restore")
@signed
def restore(
    agent: AgentName,
    *,
    reason: Reason,
    relearn: Annotated[
        bool, typer.Option("--relearn", help="Its work has changed: learn anew what is usual for it.")
    ] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Restore an agent that was suspended, or held back since its behaviour deviated: it may act again as before."""
    known_name(agent)
    person = signer.operator()
    with refusals(), person:
        person.restore_agent(agent, reason, relearn=relearn)
    if as_json:
        say_json({"ok": True, "id": agent, "status": "restored"})
    else:
        typer.echo("Restored.")


def agent_of(agent: str, software: Path, *, directory: Path | None) -> Agent:
    """Agent with its key from the cell's directory and its software's measurement, or the end of the command."""
    from ztpm_idp.client import Agent

    key = key_of(agent, directory=directory)
    issuer = issuer_of(layout_of(directory))
    return Agent(agent, key, issuer, _measured(software))


def key_of(agent: str, *, directory: Path | None) -> PrivateKey:
    """The agent's key, from the cell's directory, or the command ends."""
    known_name(agent)
    path = layout_of(directory).agent_key(agent)
    if not path.exists():
        fail("AGENT_UNKNOWN", f"{path} is missing")
    return open_key(path)


def _measured(software: Path) -> bytes:
    try:
        with software.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        fail_at(software, error, "UNREADABLE")


def _status(row: dict[str, Any]) -> str:
    return f"{row.get('status')}, held" if row.get("held") is True else str(row.get("status"))


def _trust(row: dict[str, Any]) -> str:
    """Stated trust, with the trust of each delegator that reports have left."""
    permille, by = row.get("trust_permille"), row.get("trust_by")
    stated = f"{permille / 10:.1f} %" if isinstance(permille, int) else "not stated"
    told = by.items() if isinstance(by, dict) else ()
    return ", ".join((stated, *(f"{score / 10:.1f} % by {who}" for who, score in told if isinstance(score, int))))


def _behaviour(row: dict[str, Any]) -> str:
    match row.get("conduct"):
        case {"deviations": list(deviations), "contracted": bool(contracted), "samples": int(samples)}:
            odd = ", ".join(str(one["feature"]) for one in deviations if isinstance(one, dict) and "feature" in one)
            held = "contracted" if contracted else "deviates" if odd else f"as usual, {samples} acts known"
            return f"{held}: {odd}" if odd else held
        case _:
            return "nothing reported"
