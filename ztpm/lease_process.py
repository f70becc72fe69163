"""Motion lease of a robot for the time of a block: `with ztpm.leased(agent, token) as host:`.

A process of its own carries the lease, as `ztpm rtde connect` does: the constructors of ur_rtde hold Python's
interpreter while they wait for the robot's ports, so those ports cannot be served by the program's own process. The two
speak over the child's standard input and output, a JSON object a line:

    program > {"door", "token", "pending": {...}, "host"}   once; the end of input ends the lease
    child   > {"ready": true}                               the ports are there
    child   > {"code", "detail", "refused"}                 there is no lease
    child   > {"told"}                                      why the gateway has refused something

The agent's key stays in the program: the child gets a signed request for one session (`Pending`). It ends with the
block, with an exception that leaves it, and with the program, however that dies: its standard input ends then.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import threading
import traceback
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

from capabilities.keys.keys import b64u, unb64u
from capabilities.proof.session_opening import PendingSession
from pep.base.key_file import read_key
from pep.rtde.lease.lease import LEASE_OVER
from ztpm.base.layout import Layout
from ztpm.cell.setup import GATEWAY_ID
from ztpm.program.program_lease import LeaseError, begin_lease, free_address, lend, open_lease, place_of
from ztpm.program.refusal_lines import NAME, RefusalLines, on_standard_error
from ztpm.program.startup.patient_calls import forget, make_patient_when_imported
from ztpm_idp.client import Agent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

DIRECTORY: Final = Path(".ztpm")
"""As for `--data` of the command line."""
ENDS_S: Final = 10.0
"""Longest wait for the child's end, which takes some milliseconds."""
UNREAD_BYTES: Final = 4096
PREFIX: Final = f"{NAME}: "
TEXTS: Final = frozenset({"audience", "proof", "token"})
"""Members of `Pending` that are text; the others are bytes, in base64url on their way."""


@contextlib.contextmanager
def leased(
    agent: Agent | str,
    token: str,
    *,
    data: Path | str = DIRECTORY,
    gateway: str = "",
    audience: str = "",
    pep: str = GATEWAY_ID,
    address: str = "",
    told: Callable[[str], None] = lambda text: on_standard_error(PREFIX + text),
) -> Iterator[str]:
    """A block in which the agent has the robot's motion lease; the value is the robot's address for ur_rtde.

    The lease ends with the block. It ends earlier when its token does, when the program closes its control connection,
    or when the gateway says so; then each command fails at once, and `told` is given `LEASE_OVER` and why. Connections
    that only show the robot's state stay until the program closes them, with the last one.

    Args:
        agent: the token's holder, or its name: then its key is read from the cell's directory, with the passphrase in
            `ZTPM_PASSPHRASE`.
        token: its text.
        data: the cell's directory.
        gateway: URL of the gateway's door, in place of the cell's own.
        audience: canonical URL of the cell, as the token names it, in place of its own.
        pep: id of the gateway, as it is registered.
        address: on this machine, where the robot is to be found; a free loopback one by default.
        told: is given each reason for which the gateway has refused something, a line of text, on a thread of its own.
            Standard error by default.

    Raises:
        LeaseError: there is no lease: it is refused, or the gateway cannot be found, reached or believed.
        ConfigError: `CONFIG_INVALID`: the key of a named agent cannot be read.
        OSError: no address is free.
    """
    layout = Layout(Path(data).resolve())
    key = agent.key if isinstance(agent, Agent) else read_key(layout.agent_key(agent), name=agent)
    place = place_of(layout, key, door=gateway, audience=audience, pep=pep)
    host = address or free_address()
    pending = {
        name: value if name in TEXTS else b64u(value) for name, value in asdict(begin_lease(place, token, key)).items()
    }
    asked = {"door": place.door, "token": token, "pending": pending, "host": host}
    child = subprocess.Popen(  # noqa: S603 - our own interpreter and our own module
        [sys.executable, "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is the program's: the lease ends when its block does
    )
    assert child.stdin is not None
    assert child.stdout is not None
    hearing = threading.Thread(target=_hear, args=(child.stdout, told), name="leased", daemon=True)
    try:
        with contextlib.suppress(BrokenPipeError):  # why it has ended already is asked below
            child.stdin.write(json.dumps(asked).encode() + b"\n")
            child.stdin.flush()
        _begun(child.stdout)
        hearing.start()
        make_patient_when_imported(host)
        yield host
    finally:
        forget(host)
        with contextlib.suppress(BrokenPipeError):
            child.stdin.close()
        if hearing.ident is not None:
            hearing.join(ENDS_S)  # until the lease is given back
            if hearing.is_alive():
                child.kill()
                hearing.join()
        child.stdout.close()
        # It stays while the program has connections of ur_rtde's: these do not survive its end.
        threading.Thread(target=child.wait, name="leased", daemon=True).start()


def _begun(said: IO[bytes]) -> None:
    """Waits until the child serves the ports.

    Raises:
        LeaseError: it does not.
    """
    line = said.readline()
    answer: dict[str, Any] = json.loads(line) if line else {"code": "NOT_BEGUN", "detail": "", "refused": False}
    if "ready" not in answer:
        raise LeaseError(answer["code"], answer["detail"], refused=answer["refused"])


def _hear(said: IO[bytes], told: Callable[[str], None]) -> None:
    """Passes the child's messages on until it has ended.

    A callback that breaks is shown, and given the next one.
    """
    for line in said:
        try:
            told(json.loads(line)["told"])
        except Exception:  # noqa: BLE001 - it is the program's own
            traceback.print_exc()


# ---- the child


def _say(**members: object) -> None:
    sys.stdout.write(json.dumps(members) + "\n")
    sys.stdout.flush()


def _say_no_more() -> None:
    """Ends the output: the lease is given back."""
    sys.stdout.flush()
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())


def _give_up_with_input(give_up: Callable[[], None]) -> None:
    """Gives the lease up when the parent closes the input, or is gone.

    Unbuffered: a thread that waits inside of a buffered reader can crash the interpreter's exit.
    """
    while os.read(sys.stdin.fileno(), UNREAD_BYTES):
        pass
    with contextlib.suppress(RuntimeError):  # the event loop has ended: so has the lease
        give_up()


def main() -> None:
    """Carries one lease. Exit code 1 when there was none."""
    asked = json.loads(sys.stdin.buffer.readline())
    pending: dict[str, Any] = {
        name: value if name in TEXTS else unb64u(value) for name, value in asked["pending"].items()
    }
    try:
        lease = open_lease(asked["door"], asked["token"], PendingSession(**pending))
        with asyncio.Runner() as runner:
            given_up = asyncio.Event()
            give_up = partial(runner.get_loop().call_soon_threadsafe, given_up.set)
            threading.Thread(target=_give_up_with_input, args=(give_up,), name="input", daemon=True).start()
            with RefusalLines(lambda line: _say(told=line.removeprefix(PREFIX))) as lines:
                ended = runner.run(
                    lend(
                        lease,
                        asked["host"],
                        [],
                        begun=lambda: _say(ready=True),
                        told=lines.tell,
                        given_up=given_up,
                    ),
                )
                if ended.cut_short:
                    lines.tell(f"{LEASE_OVER}: {ended.early}")
            _say_no_more()
            runner.run(ended.ports.all_left())
    except LeaseError as error:
        _say(code=error.code, detail=error.detail, refused=error.refused)
        sys.exit(1)
    except OSError as error:
        _say(code="NOT_BEGUN", detail=str(error), refused=False)
        sys.exit(1)


if __name__ == "__main__":
    main()
