"""`ztpm rtde run` and `ztpm rtde connect`: a program without knowledge of leases, in one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ztpm.cell.setup import GATEWAY_ID
from ztpm.cli.agent import AgentName, key_of
from ztpm.cli.output import FAILURE, fail, fail_at, say_json
from ztpm.cli.person import CellDirectory, Json, layout_of
from ztpm.cli.token import TokenFile, read_token

if TYPE_CHECKING:
    from pathlib import Path

    from ztpm.program.program_lease import LeaseOutcome

Gateway = Annotated[str, typer.Option(help="URL of the gateway's door (default: of the cell's own gateway).")]
Audience = Annotated[str, typer.Option(help="Canonical URL of the cell, as the token names it (default: its own).")]
Pep = Annotated[str, typer.Option(help="Id of the gateway, as it is registered.")]
Address = Annotated[
    str, typer.Option(help="Address on this machine where the program finds the robot (default: a free loopback one).")
]


def run(
    agent: AgentName,
    command: Annotated[
        list[str],
        typer.Argument(
            metavar="-- PROGRAM...",
            help="What to run. It is told the robot's address in ZTPM_ROBOT, and wherever {robot} stands here.",
        ),
    ],
    *,
    token: TokenFile,
    gateway: Gateway = "",
    audience: Audience = "",
    pep: Pep = GATEWAY_ID,
    address: Address = "",
    directory: CellDirectory = None,
) -> None:
    """Run a program that moves the robot under an agent's lease. The lease ends with the program.

    The exit status is the program's own; 3 where the lease was refused, 1 where it ended before the program did and the
    program called that a success. Why the gateway refuses something is told on standard error.
    """
    from pep.rtde.lease.lease import LEASE_OVER

    ended = _lent(
        agent,
        command,
        token=token,
        gateway=(gateway, audience, pep),
        address=address,
        directory=directory,
        as_json=False,
    )
    if ended.cut_short:
        typer.echo(f"{LEASE_OVER}: {ended.early}", err=True)
        raise typer.Exit(ended.status or FAILURE)
    raise typer.Exit(ended.status)


def connect(
    agent: AgentName,
    *,
    token: TokenFile,
    gateway: Gateway = "",
    audience: Audience = "",
    pep: Pep = GATEWAY_ID,
    address: Address = "",
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Hold an agent's lease for a program that runs already; prints where that finds the robot.

    It ends with the program's connection, or with Ctrl-C. Why the gateway refuses something is told on standard error.
    """
    from pep.rtde.lease.lease import LEASE_OVER

    ended = _lent(
        agent, [], token=token, gateway=(gateway, audience, pep), address=address, directory=directory, as_json=as_json
    )
    if ended.cut_short:
        fail(LEASE_OVER, str(ended.early))


def _lent(
    agent: str,
    command: list[str],
    *,
    token: Path,
    gateway: tuple[str, str, str],
    address: str,
    directory: Path | None,
    as_json: bool,
) -> LeaseOutcome:
    import asyncio

    from ztpm.program.program_lease import LeaseError, begin_lease, free_address, lend, open_lease, place_of
    from ztpm.program.refusal_lines import RefusalLines, on_standard_error

    text = read_token(token)
    key = key_of(agent, directory=directory)
    door, audience, pep = gateway

    def begun(host: str) -> None:
        if as_json:
            say_json({"ready": True, "robot": host})
        elif not command:
            typer.echo(f"The robot is at {host}.")

    try:
        place = place_of(layout_of(directory), key, door=door, audience=audience, pep=pep)
        host = address or free_address()
        leased = open_lease(place.door, text, begin_lease(place, text, key))
        with RefusalLines(on_standard_error) as lines:
            return asyncio.run(lend(leased, host, command, begun=lambda: begun(host), told=lines.tell))
    except LeaseError as error:
        fail(error.code, error.detail)
    except OSError as error:
        fail_at("", error, "NOT_BEGUN")
