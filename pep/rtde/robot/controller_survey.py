"""Survey of a controller: arm, serial number, version, kinematics, tool, load and limits, as it tells them itself.

Nothing is sent but questions, and no program runs. What none of these ports tells is left out: safety planes, safety
inputs and the limits of the safety configuration, which stand on the pendant alone.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.base.errors import PepFault, RobotError
from pep.rtde.robot.connections import DASHBOARD, PRIMARY, RTDE
from pep.rtde.robot.dashboard import SAID_OF, TIMEOUT_S
from pep.rtde.robot.listener import packages, received
from pep.rtde.wire.messages import WireError, WireFault
from pep.rtde.wire.primary_frames import ROBOT_STATE, PrimaryFrameSplitter
from pep.rtde.wire.primary_state import Configuration, Kinematics
from pep.rtde.wire.subscription import Subscription

if TYPE_CHECKING:
    from io import BufferedIOBase

QUESTIONS: Final = ("get robot model", "get serial number", "PolyscopeVersion", "is in remote control")
OUTPUTS: Final = ("actual_q", "actual_TCP_pose", "tcp_offset", "payload", "payload_cog", "robot_mode", "safety_mode")
RATE_HZ: Final = 125.0  # every controller of ours has it
TOLD_S: Final = 3.0
"""Longest wait for one port; the primary one tells its state ten times a second."""
SHOWN: Final = 96
"""Characters of an answer that are kept."""
KINEMATICS, CONFIGURATION = 5, 6  # kinds of parts of the robot state on the primary port


@dataclass(frozen=True, slots=True)
class ControllerSurvey:
    """One controller's word on itself.

    Attributes:
        model: its answer to `get robot model`, such as `UR5`; the older series says the same.
        serial, polyscope: its answers, as they came.
        remote: true in remote control; None where it does not say.
        kinematics, configuration: of the primary port; None where this release does not have them in the known form.
        q_rad: actual joint angles.
        tool_pose: tool point in the base frame: m, rotation vector in rad.
        tcp_offset: tool point in the flange frame: likewise.
        payload_kg, payload_cog_m: load, and its centre in the flange frame.
        robot_mode, safety_mode: as the controller numbers them.
    """

    model: str
    serial: str
    polyscope: str
    remote: bool | None
    kinematics: Kinematics | None
    configuration: Configuration | None
    q_rad: tuple[float, ...]
    tool_pose: tuple[float, ...]
    tcp_offset: tuple[float, ...]
    payload_kg: float
    payload_cog_m: tuple[float, ...]
    robot_mode: int
    safety_mode: int

    @property
    def shipped(self) -> str | None:
        """Name of the shipped model whose controllers say so; None where there is none."""
        return next((name for name, said in SAID_OF.items() if said.decode() == self.model), None)


def survey_controller(host: str) -> ControllerSurvey:
    """The controller's word on itself.

    Args:
        host: of the controller.

    Raises:
        RobotError: `ROBOT_UNREACHABLE`: one of its ports does not answer, or not as a controller; the detail names it.
            `ROBOT_STALLED`: numbers that are not finite.
    """
    said = _asked(host)
    parts = _stated(host)
    now = _outputs(host)
    return ControllerSurvey(
        model=said["get robot model"],
        serial=said["get serial number"],
        polyscope=said["PolyscopeVersion"],
        remote={"true": True, "false": False}.get(said["is in remote control"]),
        kinematics=parts.get(KINEMATICS),
        configuration=parts.get(CONFIGURATION),
        q_rad=now["actual_q"],
        tool_pose=now["actual_TCP_pose"],
        tcp_offset=now["tcp_offset"],
        payload_kg=now["payload"],
        payload_cog_m=now["payload_cog"],
        robot_mode=now["robot_mode"],
        safety_mode=now["safety_mode"],
    )


def _asked(host: str) -> dict[str, str]:
    """Answers of the dashboard, by question."""
    try:
        with socket.create_connection((host, DASHBOARD), TIMEOUT_S) as link, link.makefile("rwb") as lines:
            _line(lines)
            found = {}
            for question in QUESTIONS:
                lines.write(question.encode() + b"\n")
                lines.flush()
                found[question] = _line(lines)
            return found
    except OSError as error:
        raise _unreachable(host, DASHBOARD, error) from error


def _line(lines: BufferedIOBase) -> str:
    told = lines.readline(512)
    if not told:
        raise ConnectionResetError("closed by the dashboard")
    return told.decode("ascii", "replace").strip()[:SHOWN]


def _stated(host: str) -> dict[int, Any]:
    """Kinematics and configuration out of the first robot state of the primary port, by their kinds."""
    until = time.monotonic() + TOLD_S
    try:
        with socket.create_connection((host, PRIMARY), TIMEOUT_S) as link:
            cutter = PrimaryFrameSplitter()
            while (left := until - time.monotonic()) > 0:
                link.settimeout(left)
                for kind, body in cutter.feed(received(link)):
                    if kind == ROBOT_STATE:
                        return parts_of(body)
        raise TimeoutError
    except (OSError, WireError) as error:
        raise _unreachable(host, PRIMARY, error) from error


def parts_of(body: bytes) -> dict[int, Any]:
    """Kinematics and configuration in the body of a robot state, by their kinds; of another size they are left out.

    Raises:
        WireError: parts that do not fill the body.
    """
    found: dict[int, Any] = {}
    forms: dict[int, type[Kinematics | Configuration]] = {KINEMATICS: Kinematics, CONFIGURATION: Configuration}
    while body:
        size = struct.unpack_from(">I", body)[0] if len(body) > 4 else 0
        if not 5 <= size <= len(body):
            raise WireError(WireFault.PAYLOAD, "a part of the robot state without its end")
        kind, part, body = body[4], body[5:size], body[size:]
        if kind in forms and len(part) == forms[kind].size():
            found[kind] = forms[kind].unpack(part)
    return found


def _outputs(host: str) -> dict[str, Any]:
    """One package of the outputs."""
    try:
        with socket.create_connection((host, RTDE), TIMEOUT_S) as link:
            link.settimeout(TOLD_S)
            values = next(packages(link, Subscription(OUTPUTS, RATE_HZ)))
    except (OSError, WireError) as error:
        raise _unreachable(host, RTDE, error) from error
    numbers = [x for value in values.values() for x in (value if isinstance(value, tuple) else (value,))]
    if not all(map(math.isfinite, numbers)):
        raise RobotError(PepFault.ROBOT_STALLED, f"{host}, port {RTDE}: numbers that are not finite")
    return values


def _unreachable(host: str, port: int, error: Exception) -> RobotError:
    return RobotError(PepFault.ROBOT_UNREACHABLE, f"{host}, port {port}: {type(error).__name__}")
