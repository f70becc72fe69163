"""Chapter on a program that moves the robot by itself, without tools, under the same authority."""

from __future__ import annotations

import os
import secrets
import socket
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Final

from pep.rtde.lease.lease import ID_BYTES
from pep.rtde.robot.connections import RTDE, SECONDARY
from ztpm.demo.program import Program
from ztpm.demo.run import Expect, StepObservation, Story
from ztpm.demo.story.moving import UNDER_WAY_RAD, at_left, figures
from ztpm.stage.lending import LIFETIME_S, sweep_scope
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import ACCELERATION_RAD_S2, LEFT, RIGHT, SPEED_RAD_S, WAIT_S, StageError, until
from ztpm.stage.stopping import read_stop

if TYPE_CHECKING:
    from ztpm.stage.stage import Stage

PROGRAMS: Final = Story("programs come")
AGENT: Final = "programmer"
IN_USE: Final = "already in use"
"""Words of ur_rtde about a controller whose registers are taken."""
NOBODY: Final = 65_534
"""The user id that owns nothing on Linux."""
ATTEMPTS: Final = f"""
import encodings.idna, os, socket, sys
os.setuid({NOBODY})
link = socket.create_connection((sys.argv[1], {RTDE}), 5)
link.settimeout(5)
try:
    link.sendall(bytes.fromhex("0005560002"))
    sys.exit(len(link.recv(64)))
except ConnectionError:
    sys.exit(0)
"""
"""Program of another user that asks a leased robot's RTDE port for a protocol.

Its exit status is the number of bytes received.
"""
STATES: Final = 5
"""States of the secondary port that the controller sends in half a second.

By then a program would move it.
"""


def behind_the_gateway(stage: Stage) -> None:
    """Puts the arm at the left end of the sweep, with an agent's authority for a program."""
    if AGENT in stage.agents:
        return
    at_left(stage)
    agent = stage.new_agent(AGENT, sponsor="alice", role="programmer")
    agent.attest()
    scope = sweep_scope(
        stage.cell.addresses.audience, delegates=frozenset(), now=int(time.time()), lifetime_s=LIFETIME_S
    )
    stage.tokens[AGENT] = stage.person("alice").issue(agent, scope, purpose="demonstration").token


@PROGRAMS.step(
    "rtde-raw-denied",
    Expect("DENY", "IN_USE", recorded=False, attack=True),
    needs=("revoke-in-motion",),
    prepare=behind_the_gateway,
)
def _raw(stage: Stage) -> StepObservation:
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    host = stage.cell.addresses.gateway_host
    receive = RTDEReceiveInterface(host)
    seen = receive.getActualQ()
    receive.disconnect()
    try:
        RTDEControlInterface(host)
        said = "a control interface"
    except RuntimeError as error:
        said = str(error)
    with socket.create_connection((host, SECONDARY), timeout=WAIT_S) as script:
        script.sendall(b"movej([0.6,-1.62,1.25,-1.2,-1.57,0.0], a=1.4, v=1.05)\n")
        for _ in range(STATES):
            script.recv(65_536)
    told = "without a lease the robot's state is there, ur_rtde's control is 'already in use', a script is not heard"
    return StepObservation(told, "DENY", "IN_USE", ok=IN_USE in said and len(seen) == len(LEFT))


def _ends(link: socket.socket) -> bool:
    """True where the other end closes the connection."""
    until_s = time.monotonic() + WAIT_S
    while time.monotonic() < until_s:
        try:
            if not link.recv(65_536):
                return True
        except ConnectionError:
            return True
    return False


@PROGRAMS.step(
    "rtde-leased-moves",
    Expect("PERMIT", "PERMITTED", moves=True, ledger="pep-record"),
    needs=("rtde-raw-denied",),
    prepare=behind_the_gateway,
)
def _leased(stage: Stage) -> StepObservation:
    with Program(stage, AGENT, to=RIGHT, speed=SPEED_RAD_S, acceleration=ACCELERATION_RAD_S2) as program:
        program.said()
        program.go()
        said, status = program.said(), program.status()
    until(lambda: _recorded(stage, "lease-ended"), "the end of the lease on record")
    told = "an unmodified ur_rtde program under `ztpm rtde run` moved the arm, decided command by command"
    return StepObservation(told, "PERMIT", "PERMITTED", ok=(said, status) == ("moved", 0))


def _recorded(stage: Stage, kind: str) -> bool:
    return any(row["kind"] == kind for row in stage.journal())


@PROGRAMS.step(
    "rtde-hijack-refused",
    Expect("DENY", "LEASE_HELD", attack=True),
    needs=("rtde-raw-denied",),
    prepare=behind_the_gateway,
)
def _hijacked(stage: Stage) -> StepObservation:
    addresses = stage.cell.addresses
    with Program(stage, AGENT, to=stage.rounded_joints, speed=SPEED_RAD_S, acceleration=ACCELERATION_RAD_S2) as holder:
        other_user = _attempts(holder.said())
        with Program(stage, AGENT, to=LEFT, speed=SPEED_RAD_S, acceleration=ACCELERATION_RAD_S2) as second:
            refused = second.status()
        with socket.create_connection((addresses.gateway_host, addresses.carriage_port), timeout=WAIT_S) as link:
            link.sendall(secrets.token_bytes(ID_BYTES))
            guessed = _ends(link)
    told = "while a program holds the lease, a second one is told LEASE_HELD, a guessed lease is hung up on"
    told += ", and another user's process at the program's own address too" if os.geteuid() == 0 else ""
    return StepObservation(told, "DENY", "LEASE_HELD", ok=(refused, guessed, other_user) == (3, True, 0))


def _attempts(host: str) -> int:
    """Number of bytes that a process of another user receives there; 0 where only one user can be tried."""
    if os.geteuid() != 0:
        return 0
    attempt = subprocess.run([sys.executable, "-c", ATTEMPTS, host], check=False, timeout=WAIT_S)  # noqa: S603 - our own
    return attempt.returncode


@PROGRAMS.step(
    "gateway-killed-stops",
    Expect("PERMIT", "PERMITTED", moves=True),
    needs=("rtde-raw-denied",),
    prepare=behind_the_gateway,
)
def _killed(stage: Stage) -> StepObservation:
    eyes = StateRecorder(stage.cell.addresses.host)
    try:
        began_s, start = time.monotonic(), eyes.now().q_rad
        away = LEFT if abs(start[0] - RIGHT[0]) < abs(start[0] - LEFT[0]) else RIGHT
        with Program(stage, AGENT, to=away, speed=SPEED_RAD_S, acceleration=ACCELERATION_RAD_S2) as program:
            program.said()
            program.go()
            until(lambda: abs(eyes.now().q_rad[0] - start[0]) >= UNDER_WAY_RAD, "the arm under way")
            t0 = time.monotonic()
            stage.cell.gateway.kill()
            until(lambda: eyes.now().still, "standstill")
        stop = read_stop(eyes.since(began_s), at_s=t0, acceleration_rad_s2=ACCELERATION_RAD_S2)
    finally:
        eyes.close()
    if stop is None:
        raise StageError("no stop was seen")
    told = f"the gateway was killed while its program moved the arm: {figures(stop)}"
    return StepObservation(told, "PERMIT", "PERMITTED", ok=stop.within_model and stop.within_bar, stop=stop)
