"""`ztpm rtde run` and `ztpm rtde connect`: a program that knows nothing of leases, in one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ztpm.cell.setup import GATEWAY_ID
from ztpm.cli.agent import AgentName, key_of
from ztpm.cli.delegation import TokenFile, read_token
from ztpm.cli.output import DENY, FAILURE, USAGE, fail, say_json
from ztpm.cli.person import Data, Json, issuer_of, layout_of

if TYPE_CHECKING:
    from pathlib import Path

    from ztpm.program.program_lease import Ended

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
    data: Data = None,
) -> None:
    """Run a program that moves the robot under an agent's lease. The lease ends with the program.

    The exit status is the program's own; 3 where the lease was refused, 1 where it ended before the program did and the
    program called that a success. Why the gateway refuses something is told on standard error.
    """
    from pep.rtde.lease.lease import LEASE_OVER

    ended = _lent(
        agent, command, token=token, gateway=(gateway, audience, pep), address=address, data=data, as_json=False
    )
    if _cut_short(ended):
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
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Hold an agent's lease for a program that runs already; prints where that finds the robot.

    It ends with the program's connection, or with Ctrl-C. Why the gateway refuses something is told on standard error.
    """
    from pep.rtde.lease.lease import LEASE_OVER

    ended = _lent(agent, [], token=token, gateway=(gateway, audience, pep), address=address, data=data, as_json=as_json)
    if _cut_short(ended):
        fail(LEASE_OVER, str(ended.early), as_json=as_json)


def _lent(
    agent: str,
    command: list[str],
    *,
    token: Path,
    gateway: tuple[str, str, str],
    address: str,
    data: Path | None,
    as_json: bool,
) -> Ended:
    import asyncio
    import secrets

    from pep.rtde.robot.connections import PORTS
    from ztpm.base.loopback import free_host, is_free
    from ztpm.program.program_lease import LeaseError, lend, open_lease
    from ztpm.program.refusal_lines import ToldLines, on_standard_error

    text = read_token(token, as_json=as_json)
    key = key_of(agent, data=data, as_json=as_json)
    door, audience = _places(*gateway[:2], data=data, as_json=as_json)
    expected = _key_of(audience, gateway[2], data=data, as_json=as_json)

    def begun(host: str) -> None:
        if as_json:
            say_json({"ready": True, "robot": host})
        elif not command:
            typer.echo(f"The robot is at {host}.")

    try:
        host = address or free_host(secrets.token_bytes(16), lambda host: all(is_free(host, port) for port in PORTS))
        leased = open_lease(door, audience, text, key, gateway_key=expected)
        with ToldLines(on_standard_error) as lines:
            return asyncio.run(lend(leased, host, command, begun=lambda: begun(host), told=lines.tell))
    except LeaseError as error:
        fail(error.code, error.detail, as_json=as_json, status=DENY if error.refused else FAILURE)
    except OSError as error:
        fail("NOT_BEGUN", str(error), as_json=as_json)


def _cut_short(ended: Ended) -> bool:
    """Whether the lease was ended by somebody else than the program, which ends its connections before it ends."""
    from pep.rtde.lease.lease import Ending

    return ended.early not in {None, Ending.LEFT}


def _places(door: str, audience: str, *, data: Path | None, as_json: bool) -> tuple[str, str]:
    """URL of the door, and of the cell, or the command ends."""
    from ztpm.cell.setup import SetupError, read_addresses

    if door and audience:
        return door, audience
    try:
        addresses = read_addresses(layout_of(data, as_json=as_json))
    except SetupError as error:
        fail("CONFIG_INVALID", str(error), as_json=as_json, status=USAGE)
    return door or addresses.door, audience or addresses.audience


def _key_of(audience: str, pep: str, *, data: Path | None, as_json: bool) -> bytes:
    """Raw public key of the robot's enforcement point, or the command ends."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError
    from ztpm.cell.enrolment import EnrolmentError, registered

    layout = layout_of(data, as_json=as_json)
    try:
        trust = TrustBundle.from_json(layout.trust.read_bytes())
        serving = registered(issuer_of(layout, as_json=as_json), audience, trust).peps
    except EnrolmentError as error:
        fail("REGISTRY_UNAVAILABLE", str(error), as_json=as_json)
    except (OSError, CapabilityError) as error:
        fail("NOT_A_CELL", f"{layout.trust}: {type(error).__name__}", as_json=as_json, status=USAGE)
    found = next((entry.key for entry in serving if entry.id == pep), None)
    if found is None:
        known = ", ".join(entry.id for entry in serving) or "nobody"
        fail("GATEWAY_UNKNOWN", f"registered for {audience}: {known}", as_json=as_json, status=USAGE)
    return found
