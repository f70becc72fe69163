"""`ztpm rtde run` and `ztpm rtde connect`: a program without knowledge of leases, in one."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ztpm.cell.setup import GATEWAY_ID
from ztpm.cli.output import FAILURE, fail, fail_at, say_json
from ztpm.cli.provider.agent import AgentName, agent_of, key_of
from ztpm.cli.provider.person import CellDirectory, Json, layout_of, refusals
from ztpm.cli.provider.token import read_token

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from ztpm.program.program_lease import LeaseOutcome
    from ztpm_idp.client import Renewal

LeaseToken = Annotated[
    Path | None, typer.Option("--token", help="File of the holder's token.", exists=True, dir_okay=False)
]
Mandate = Annotated[
    str, typer.Option(metavar="MANDATE", help="In place of --token: the mandate that tokens are drawn from meanwhile.")
]
LeaseSoftware = Annotated[
    Path | None,
    typer.Option("--software", help="With --mandate: the file that the agent runs.", exists=True, dir_okay=False),
]
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
    token: LeaseToken = None,
    mandate: Mandate = "",
    software: LeaseSoftware = None,
    gateway: Gateway = "",
    audience: Audience = "",
    pep: Pep = GATEWAY_ID,
    address: Address = "",
    directory: CellDirectory = None,
) -> None:
    """Run a program that moves the robot under an agent's lease. The lease ends with the program.

    With --mandate the lease is renewed while it lasts: the next token is drawn before the last ends.

    The exit status is the program's own; 3 where the lease was refused, 1 where it ended before the program did and the
    program called that a success. Why the gateway refuses something is told on standard error.
    """
    from pep.rtde.lease.lease import LEASE_OVER

    ended = _lent(
        agent,
        command,
        authority=(token, mandate, software),
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
    token: LeaseToken = None,
    mandate: Mandate = "",
    software: LeaseSoftware = None,
    gateway: Gateway = "",
    audience: Audience = "",
    pep: Pep = GATEWAY_ID,
    address: Address = "",
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Hold an agent's lease for a program that runs already; prints where that finds the robot.

    It ends with the program's connection, or with Ctrl-C; with --mandate it is renewed until then. Why the gateway
    refuses something is told on standard error.
    """
    from pep.rtde.lease.lease import LEASE_OVER

    ended = _lent(
        agent,
        [],
        authority=(token, mandate, software),
        gateway=(gateway, audience, pep),
        address=address,
        directory=directory,
        as_json=as_json,
    )
    if ended.cut_short:
        fail(LEASE_OVER, str(ended.early))


def _lent(
    agent: str,
    command: list[str],
    *,
    authority: tuple[Path | None, str, Path | None],
    gateway: tuple[str, str, str],
    address: str,
    directory: Path | None,
    as_json: bool,
) -> LeaseOutcome:
    import asyncio

    from pep.rtde.lease.lease import LEASE_OVER
    from ztpm.program.lease_renewal import LeaseRenewal
    from ztpm.program.program_lease import LeaseError, begin_lease, free_address, lend, open_lease, place_of
    from ztpm.program.refusal_lines import RefusalLines, on_standard_error

    key, text, tokens = authority_of(agent, *authority, directory=directory)
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
            kept = None if tokens is None else LeaseRenewal(leased, place.door, key, tokens, text, told=lines.tell).keep
            lending = partial(lend, leased, host, command, begun=lambda: begun(host), told=lines.tell, kept=kept)
            with asyncio.Runner() as runner:
                ended = runner.run(lending())
                if ended.early is not None and not command:
                    if ended.cut_short and ended.ports.staying:
                        lines.tell(f"{LEASE_OVER}: {ended.early}")
                    runner.run(ended.ports.all_left())
                return ended
    except LeaseError as error:
        fail(error.code, error.detail)
    except OSError as error:
        fail_at("", error, "NOT_BEGUN")


def authority_of(
    agent: str, token: Path | None, mandate: str, software: Path | None, *, directory: Path | None
) -> tuple[PrivateKey, str, Renewal | None]:
    """The agent's key, a token's text, and where the next ones come from; or the end of the command."""
    from ztpm_idp.client import Denied

    if token is not None and not mandate:
        return key_of(agent, directory=directory), read_token(token), None
    if token is not None or not mandate:
        raise typer.BadParameter("one of both is needed, and only one", param_hint="--token, --mandate")
    if software is None:
        raise typer.BadParameter("is needed with --mandate: what the agent runs is attested", param_hint="--software")
    holder = agent_of(agent, software, directory=directory)
    tokens = holder.renewal(mandate)
    try:
        with refusals():
            return holder.key, tokens.token(), tokens
    except Denied as error:
        fail(error.reason, error.remedy)
