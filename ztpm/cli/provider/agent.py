"""`ztpm agent`: agents, their keys in the directory of a cell or provider, or on machines of their own.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider.party_keys import PartyPublic, key_for, rotation_of
from ztpm.cli.provider.person import (
    CellDirectory,
    Issuer,
    Json,
    KeyFile,
    Reason,
    Signer,
    issuer_of,
    known_name,
    layout_of,
    open_key,
    place_of,
    refusals,
    signed,
)
from ztpm.cli.tables import show_table

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
@signed
def register(
    agent: AgentName,
    *,
    software: Software,
    role: Annotated[str, typer.Option(help="What it is for, as planner.")],
    model: Annotated[str, typer.Option(help="The language model behind it.")] = "none",
    sponsor: Annotated[str, typer.Option(help="Who answers for it (default: --as).")] = "",
    workload: Annotated[str, typer.Option(help="The platform's name of it, a SPIFFE ID.")] = "",
    public: PartyPublic = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register an agent under a sponsor.

    Its key is made in the directory, encrypted, unless it lies there or its public half is told.
    """
    known_name(agent)
    person = signer.operator()
    raw, where = key_for(signer, "agent", agent, public)
    with refusals(), person:
        person.register_agent(
            agent, raw, software_digest=_measured(software).hex(), model=model, role=role, sponsor=sponsor or None,
            workload=workload,
        )  # fmt: skip
    if as_json:
        say_json({"ok": True, "id": agent, "status": "registered", **({"key": where} if where else {})})
    else:
        key = f"Registered; its key is {where}." if where else "Registered."
        typer.echo(f"{key} It may act once it is attested.")


@app.command("attest")
def attest(
    agent: AgentName,
    *,
    software: Software,
    directory: CellDirectory = None,
    issuer: Issuer = "",
    key: KeyFile = None,
    as_json: Json = False,
) -> None:
    """Attest an agent with its own key: it is active from then on, if it runs what is registered."""
    with refusals(), agent_of(agent, software, directory=directory, issuer=issuer, key=key) as itself:
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
    show_table(("agent", "status", "sponsor", "role", "trust", "behaviour", "key"), [
        (row.get("id"), _status(row), row.get("sponsor"), row.get("role"), _trust(row), _behaviour(row), row.get("key"))
        for row in rows
    ])  # fmt: skip


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


app.command("rotate")(rotation_of("agent"))


def agent_of(agent: str, software: Path, *, directory: Path | None, issuer: str = "", key: Path | None = None) -> Agent:
    """Agent with its key and its software's measurement, or the end of the command.

    Args:
        agent: id of the agent.
        software: file that it runs.
        directory: of the cell or provider, with the agent's key.
        issuer: the identity provider, with `key`, instead of `directory`.
        key: file of the agent's key.
    """
    from ztpm_idp.client import Agent

    directory, issuer, key = place_of(directory, issuer, key)
    if key is not None:
        known_name(agent)
        return Agent(agent, open_key(key), issuer, _measured(software))
    own = key_of(agent, directory=directory)
    return Agent(agent, own, issuer_of(layout_of(directory)), _measured(software))


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
