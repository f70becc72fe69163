"""Program in a motion lease: opens the lease, carries it, and brings the robot's ports to the program."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import secrets
import signal
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import httpx2

from capabilities.keys.trust import TrustBundle
from capabilities.proof import session_opening as session
from capabilities.proof.key_agreement import KEY_BYTES, NONCE_BYTES
from capabilities.values import strict_json
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import CapabilityError, Fault
from pep.base.clock import SystemClock
from pep.base.thread_priority import goes_first
from pep.rtde.lease.lease import ID_BYTES, LeaseEnding
from pep.rtde.lease.lease_endpoint import LOSSLESS
from pep.rtde.robot.connections import LEASED_PORTS
from policies.words.reason_table import REASONS, Reason
from ztpm.base.loopback import free_host, is_free
from ztpm.base.parent_watch import ends_with_parent
from ztpm.cell.enrolment import EnrolmentError, registered
from ztpm.cell.setup import GATEWAY_ID, SetupError, read_addresses
from ztpm.program.program_ports import ProgramPorts
from ztpm_idp.client import ProofAuth, direct_http

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping, Sequence

    from capabilities.keys.keys import PrivateKey
    from capabilities.proof.session_frames import Session
    from capabilities.proof.session_opening import PendingSession
    from ztpm.base.layout import Layout

VARIABLE: Final = "ZTPM_ROBOT"
"""Environment variable with the robot's address for a program."""
PLACE: Final = "{robot}"
"""Stands for the address in a program's command."""
PYTHON_PATH: Final = "PYTHONPATH"
STARTUP: Final = Path(__file__).parent / "startup"
"""Found first by a program in Python: its calls wait for the end of a refusal (`startup.patient_calls`)."""
TIMEOUT_S: Final = 10.0
JTI_BYTES: Final = 16
ANSWER_BYTES: Final = 4_096
KILLED: Final = 128
"""Offset that a shell adds to the number of the signal that ended a program."""
_ID: Final = re.compile(f"[0-9a-f]{{{2 * ID_BYTES}}}")


class LeaseError(Exception):
    """There is no lease.

    Attributes:
        code: the gateway's reason, or our own.
        detail: a sentence.
        refused: whether the gateway said so; else it could not be asked, or was not believed.
    """

    def __init__(self, code: str, detail: str, *, refused: bool) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail
        self.refused = refused


@dataclass(frozen=True, slots=True)
class OpenedLease:
    """A lease that is open and not carried yet.

    Attributes:
        id: names it to the gateway, and is a secret.
        session: the holder's end.
        gateway: host and port where it is to be carried.
    """

    id: bytes
    session: Session
    gateway: tuple[str, int]


@dataclass(frozen=True, slots=True)
class Place:
    """Gateway of one robot, as its holder has to know it.

    Attributes:
        door: canonical URL of the door for leases.
        audience: canonical URL of the cell, as the token names it.
        gateway_key: raw public key of the robot's enforcement point, from the registry.
    """

    door: str
    audience: str
    gateway_key: bytes


def place_of(layout: Layout, key: PrivateKey, *, door: str = "", audience: str = "", pep: str = GATEWAY_ID) -> Place:
    """Place of a cell's lease.

    Args:
        layout: of the cell; its trust bundle names the identity provider.
        key: of the agent, which the identity provider tells who the gateway is.
        door: URL of the gateway's door, in place of the cell's own gateway.
        audience: canonical URL of the cell, in place of its own.
        pep: id of the gateway, as it is registered.

    Raises:
        LeaseError: `NOT_A_CELL`, `CONFIG_INVALID`, `REGISTRY_UNAVAILABLE`, `GATEWAY_UNKNOWN`.
    """
    try:
        trust = TrustBundle.from_json(layout.trust.read_bytes())
        if not (door and audience):
            addresses = read_addresses(layout)
            door, audience = door or addresses.door, audience or addresses.audience
        serving = registered(trust.issuer, audience, trust, auth=ProofAuth(key)).peps
    except (OSError, CapabilityError) as error:
        raise LeaseError("NOT_A_CELL", f"{layout.trust}: {type(error).__name__}", refused=False) from error
    except SetupError as error:
        raise LeaseError("CONFIG_INVALID", str(error), refused=False) from error
    except EnrolmentError as error:
        raise LeaseError("REGISTRY_UNAVAILABLE", str(error), refused=False) from error
    found = next((entry.key for entry in serving if entry.id == pep), None)
    if found is None:
        known = ", ".join(entry.id for entry in serving) or "nobody"
        raise LeaseError("GATEWAY_UNKNOWN", f"registered for {audience}: {known}", refused=False)
    return Place(door, audience, found)


def free_address() -> str:
    """A loopback address on which every port of a controller is free.

    Raises:
        OSError: none was found.
    """
    return free_host(secrets.token_bytes(16), lambda host: all(is_free(host, port) for port in LEASED_PORTS))


def begin_lease(place: Place, token: str, key: PrivateKey) -> PendingSession:
    """Signed request for the lease. Its sender needs the holder's key no more.

    Args:
        place: the gateway.
        token: its text.
        key: of the token's leaf hop.
    """
    return session.begin(
        key=key,
        url=place.door,
        audience=place.audience,
        token=token,
        verifier_key=place.gateway_key,
        private=secrets.token_bytes(KEY_BYTES),
        nonce=secrets.token_bytes(NONCE_BYTES),
        at=int(time.time()),
        jti=secrets.token_urlsafe(JTI_BYTES),
    )


def open_lease(door: str, token: str, pending: PendingSession) -> OpenedLease:
    """The motion lease of one robot, if nobody else has it.

    Args:
        door: canonical URL of the gateway's door.
        token: its text.
        pending: begun with it a moment ago.

    Raises:
        LeaseError: it is refused, or the gateway cannot be reached or believed.
    """
    headers = {"Authorization": f"DPoP {token}", "DPoP": pending.proof, "Content-Type": "application/json"}
    try:
        with direct_http.client(TIMEOUT_S) as http:
            answer = http.post(door, content=pending.body, headers=headers, follow_redirects=False)
    except httpx2.HTTPError as error:
        raise LeaseError("GATEWAY_UNREACHABLE", f"{door}: {type(error).__name__}", refused=False) from error
    said = members_of(answer.content)
    if answer.status_code != 201:
        raise LeaseError(*refusal_of(said.get("reason"), f"{door} answers {answer.status_code}"), refused=True)
    lease_id, text, port = said.get("lease"), said.get("session"), said.get("port")
    if not (isinstance(lease_id, str) and isinstance(text, str) and type(port) is int and _ID.fullmatch(lease_id)):
        raise LeaseError("GATEWAY_NOT_BELIEVED", "its answer has another form", refused=False)
    opened = session.conclude(pending, text.encode(), at=time.time(), most_missing=LOSSLESS, caps=CAPS)
    if isinstance(opened, Fault):
        raise LeaseError("GATEWAY_NOT_BELIEVED", f"{opened.clause} {opened.detail}".strip(), refused=False)
    return OpenedLease(bytes.fromhex(lease_id), opened, (urlsplit(door).hostname or "", port))


@dataclass(frozen=True, slots=True)
class LeaseOutcome:
    """End of a lease.

    Attributes:
        early: reason for an end before the lease was given back, else None.
        status: the program's exit status, as a shell tells it; 0 where there was no program.
        ports: where a program that goes on may still have connections; on the same event loop.
    """

    early: LeaseEnding | None
    status: int
    ports: ProgramPorts = field(compare=False, repr=False)

    @property
    def cut_short(self) -> bool:
        """True where another than the program ended the lease; a program closes its connections before it ends."""
        return self.early not in {None, LeaseEnding.LEFT}


async def lend(
    leased: OpenedLease,
    host: str,
    command: Sequence[str],
    *,
    begun: Callable[[], None],
    told: Callable[[str], None],
    kept: Callable[[], Coroutine[None, None, None]] | None = None,
    given_up: asyncio.Event | None = None,
) -> LeaseOutcome:
    """Serves the robot's ports at `host` until the lease or the program is over.

    A program is told where in `VARIABLE`, and wherever `PLACE` stands in its command; SIGTERM and SIGINT are passed on
    to it. Where the lease ends before the program, each command of the program fails, and it is left to notice
    ([LSD-12]); a lease whose program has ended is given back. The program does not outlive this process.

    Args:
        leased: just opened.
        host: an address on this machine.
        command: the program and its arguments; none, to serve until a signal or `given_up`.
        begun: called once the ports are there.
        told: is given each reason for which the gateway has refused something, a line of text. Must not wait: the lease
            does meanwhile.
        kept: renews the lease while it lasts (`ztpm.program.lease_renewal`); None where its token is the only one.
        given_up: set once the lease is to be given back; unheeded once that is over.

    Raises:
        OSError: the gateway cannot be reached, the address cannot be had, or the program cannot be started.
    """
    loop = asyncio.get_running_loop()
    over: asyncio.Future[LeaseEnding] = loop.create_future()
    ports = ProgramPorts(
        leased.session, leased.id, clock=SystemClock(), user=os.getuid(), ended=over.set_result, told=told
    )
    stopped = given_up or asyncio.Event()
    program: asyncio.subprocess.Process | None = None
    keeping: asyncio.Task[None] | None = None

    def passed_on(number: signal.Signals) -> None:
        stopped.set()
        if program is not None:
            with contextlib.suppress(ProcessLookupError):
                program.send_signal(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, passed_on, number)
    try:
        await ports.begin(gateway=leased.gateway, host=host)
        keeping = None if kept is None else asyncio.create_task(kept())
        goes_first()  # not the program: it is an ordinary one unless it says otherwise itself
        if command:
            program = await asyncio.create_subprocess_exec(
                *(part.replace(PLACE, host) for part in command),
                env=_place(os.environ, host),
                preexec_fn=ends_with_parent(),
            )
        begun()
        if program is None:
            waiting = asyncio.create_task(stopped.wait())
            await asyncio.wait((waiting, over), return_when=asyncio.FIRST_COMPLETED)
            waiting.cancel()
        else:
            await program.wait()
        early = over.result() if over.done() else None
    finally:
        if keeping is not None:
            keeping.cancel()
        ports.close()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
    status = 0 if program is None or program.returncode is None else program.returncode
    return LeaseOutcome(early, status if status >= 0 else KILLED - status, ports)


def _place(environment: Mapping[str, str], host: str) -> dict[str, str]:
    """Environment of a program that finds the robot at `host`."""
    searched = (str(STARTUP), environment.get(PYTHON_PATH, ""))
    return {**environment, VARIABLE: host, PYTHON_PATH: os.pathsep.join(filter(None, searched))}


def refusal_of(reason: object, otherwise: str) -> tuple[str, str]:
    """Code and detail of a refusal: the text of a known reason, else `otherwise`."""
    if isinstance(reason, str) and reason in Reason.__members__:
        row = REASONS[Reason(reason)]
        return reason, f"{row.text} {row.remedy}"
    return "GATEWAY_FAILED", otherwise


def members_of(content: bytes) -> dict[str, object]:
    """The members of an answer; none where it is no JSON object."""
    try:
        said = strict_json.read(content, limit_bytes=ANSWER_BYTES, limit_depth=1)
    except strict_json.JsonError:
        return {}
    return said if isinstance(said, dict) else {}
