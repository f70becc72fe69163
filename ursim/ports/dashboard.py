"""The dashboard server (port 29999): one line in, one line out, and nothing outside a closed grammar."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from pep.rtde.script.urscript import ScriptError
from ursim.motion.robot import OperationalMode, RuntimeState
from ursim.ports.script_ports import MAX_PROGRAM, compile_text
from ursim.script.compiler import CompileError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pep.rtde.wire.messages import ControlVersion
    from ursim.ports.arm_kinds import ArmKind
    from ursim.ports.controller import Controller
    from ursim.ports.sockets import Connection

QUESTION: Final = "ztpm simulated"
ANSWER: Final = "ztpm simulated: "
"""Words that no robot knows: an answer to them shows that the controller is simulated."""
BANNER: Final = "Connected: Universal Robots Dashboard Server"
MAX_LINE: Final = 1024
SERIAL_NUMBER: Final = "20235300001"  # e-Series serials start with the year and are digits alone; ur_rtde checks that
SUPPORT_FILE: Final = f"ur_{SERIAL_NUMBER}_2022-04-01_00-00-00.zip"  # a name alone: nothing is written
TOO_SOON: Final = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
# Answer of a robot in local control, as reported in issue 181 of UR's ROS 2 driver.
NOT_REMOTE: Final = (
    "Command is not allowed due to safety reasons, "
    "please switch robot to Remote Control mode and reconnect to port 29999"
)
_ROLES: Final = ("none", "operator", "programmer", "locked", "restricted")

_STATE: Final = {
    RuntimeState.STOPPING: "STOPPED",
    RuntimeState.STOPPED: "STOPPED",
    RuntimeState.PLAYING: "PLAYING",
    RuntimeState.PAUSING: "PAUSED",
    RuntimeState.PAUSED: "PAUSED",
    RuntimeState.RESUMING: "PLAYING",
}


class Dashboard:
    """Answers one controller's dashboard clients.

    Args:
        controller: the controller that the commands act on.
        version: the PolyScope version; commands younger than it are not understood.
        shutdown: called after the answer to `shutdown` has been sent.
        kind: of the arm.
        programs: folder of saved programs, as PolyScope saves them: `NAME.urp`, with `NAME.script` beside it. What runs
            is the script.
    """

    def __init__(
        self,
        controller: Controller,
        version: ControlVersion,
        shutdown: Callable[[], None],
        kind: ArmKind,
        programs: Path | None = None,
    ) -> None:
        self._controller = controller
        self._programs = None if programs is None else programs.resolve()
        self._loaded = ""
        self._version = version
        self._shutdown = shutdown
        self._kind = kind
        self._role = "programmer"
        self._reports = 0
        self._rows = [
            (re.compile(pattern), answer) for since, pattern, answer in self._grammar() if since <= version.minor
        ]

    def serve(self, connection: Connection) -> None:
        """Talks to one client until it leaves, says `quit`, or sends a line that is too long."""
        connection.send(BANNER.encode() + b"\n")
        held = b""
        while received := connection.receive():
            *lines, held = (held + received).split(b"\n")
            for line in lines:
                if len(line) > MAX_LINE:
                    return
                text = line.decode("ascii", "replace").strip()
                connection.send(self.answer(text).encode() + b"\n")
                if text == "shutdown":
                    # After the answer: the process may be gone before the next line.
                    self._shutdown()
                if text == "quit":
                    return
            if len(held) > MAX_LINE:
                return

    def answer(self, line: str) -> str:
        """The reply to one command."""
        for pattern, answer in self._rows:
            found = pattern.fullmatch(line)
            if found is not None:
                return answer(*found.groups())
        shown = "".join(c if c.isprintable() and c.isascii() else "?" for c in line[:80])
        return f"could not understand: '{shown}'"

    # One row per command: PolyScope 5 minor version it came with, its whole grammar, its answer.
    def _grammar(self) -> list[tuple[int, str, Callable[..., str]]]:
        say = _say
        file = r"([A-Za-z0-9_./-]{1,200})"
        return [
            (0, "stop", self._stop),
            (0, "play", self._remotely(self._play)),
            (0, "pause", self._pause),
            (0, "quit", say("Disconnected")),
            (0, "shutdown", self._turn_off),
            (0, "running", lambda: f"Program running: {_flag(self._runtime is RuntimeState.PLAYING)}"),
            (0, "robotmode", lambda: f"Robotmode: {self._controller.robot.mode.name}"),
            (0, f"load {file}", self._remotely(self._load)),
            (0, f"load installation {file}", self._remotely(_no_file)),
            (0, "get loaded program", self._loaded_program),
            (0, r"popup (.{0,500})", lambda _text: "showing popup"),
            (0, "close popup", say("closing popup")),
            (0, r"addToLog (.{0,500})", lambda _text: "Added log message"),
            (0, "isProgramSaved", self._saved),
            (0, "programState", self._program_state),
            (0, "PolyscopeVersion", lambda: f"URSoftware {self._dotted} (Apr 01 2022)"),
            (0, "version", lambda: self._dotted),
            (8, "generate flight report (controller|software|system)", self._report),
            (8, f"generate support file {file}", lambda folder: f"Completed successfully: {folder}/{SUPPORT_FILE}"),
            (8, "saveLog", say("Log saved to disk")),
            (0, r"setUserRole (\w+)", self._set_role),
            (0, "getUserRole", self._get_role),
            (0, "set operational mode (manual|automatic)", self._set_mode),
            (0, "clear operational mode", self._clear_mode),
            (6, "get operational mode", lambda: self._controller.robot.operational.name),
            (0, "power on", self._remotely(self._power(self._controller.power_on, "Powering on"))),
            (0, "power off", self._power(self._controller.power_off, "Powering off")),
            (0, "brake release", self._remotely(self._power(self._controller.brake_release, "Brake releasing"))),
            (0, "safetymode", lambda: f"Safetymode: {self._controller.robot.safety.name}"),
            (4, "safetystatus", lambda: f"Safetystatus: {self._controller.robot.safety.name}"),
            (0, "unlock protective stop", self._remotely(self._unlock)),
            (0, "close safety popup", say("closing safety popup")),
            (1, "restart safety", self._remotely(self._restart_safety)),
            (6, "is in remote control", lambda: _flag(self._controller.obeys)),
            (6, "get serial number", say(SERIAL_NUMBER)),
            (6, "get robot model", say(self._kind.said)),
            (0, f"{QUESTION} ([0-9a-f]{{32}})", lambda nonce: f"{ANSWER}{nonce}"),  # no robot says this
        ]

    @property
    def _runtime(self) -> RuntimeState:
        return self._controller.robot.runtime

    @property
    def _name(self) -> str:
        return self._controller.program_name or "<unnamed>"

    @property
    def _dotted(self) -> str:
        v = self._version
        return f"{v.major}.{v.minor}.{v.bugfix}.{v.build}"

    def _saved(self) -> str:
        return f"{_flag(bool(self._controller.program_name))} {self._name}"  # there is nothing here to be saved

    def _program_state(self) -> str:
        return f"{_STATE[self._runtime]} {self._name}"

    def _get_role(self) -> str:
        return self._role.upper()

    def _remotely(self, answer: Callable[..., str]) -> Callable[..., str]:
        """Command that only remote control may give, since it makes the robot ready to move.

        Stops and questions are open to every client.
        """
        return lambda *found: answer(*found) if self._controller.obeys else NOT_REMOTE

    def _stop(self) -> str:
        self._controller.ask(self._controller.stop)
        return "Stopped"

    def _play(self) -> str:
        return "Starting program" if self._controller.ask(self._controller.play) else "Failed to execute: play"

    def _load(self, name: str) -> str:
        """Loads the script that was saved with a program; one that runs is stopped first."""
        if self._programs is None or (path := self._saved_at(self._programs, name)) is None:
            return f"File not found: {name}"
        script = path.with_suffix(".script")
        try:
            if script.stat().st_size > MAX_PROGRAM:
                return f"Error while loading program: {name}"
            compiled = compile_text(script.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, ScriptError, CompileError):
            return f"Error while loading program: {name}"

        def take() -> None:
            self._controller.stop()
            self._controller.loaded, self._controller.program_name = replace(compiled, name=path.name), path.name

        self._controller.ask(take)
        self._loaded = f"/programs/{path.relative_to(self._programs)}"
        return f"Loading program: {self._loaded}"

    @staticmethod
    def _saved_at(folder: Path, name: str) -> Path | None:
        """Path of a saved program by its name, or by its path on a controller; none outside the folder."""
        path = (folder / name.removeprefix("/programs/")).resolve()
        return path if path.is_relative_to(folder) and path.suffix == ".urp" and path.is_file() else None

    def _loaded_program(self) -> str:
        return f"Loaded program: {self._loaded}" if self._loaded else "No program loaded"

    def _pause(self) -> str:
        return "Pausing program" if self._controller.ask(self._controller.pause) else "Failed to execute: pause"

    def _turn_off(self) -> str:
        self._controller.ask(self._controller.power_off)
        return "Shutting down"

    def _power(self, act: Callable[[], None], said: str) -> Callable[[], str]:
        def answer() -> str:
            self._controller.ask(act)
            return said

        return answer

    def _unlock(self) -> str:
        if self._controller.ask(self._controller.unlock_protective_stop):
            return "Protective stop releasing"
        return TOO_SOON

    def _restart_safety(self) -> str:
        self._controller.ask(self._controller.restart_safety)
        return "Restarting safety"

    def _set_role(self, role: str) -> str:
        if role not in _ROLES:
            return f"Failed setting user role: {role}"
        self._role = role
        return f"Setting user role: {role}"

    def _set_mode(self, mode: str) -> str:
        wanted = OperationalMode[mode.upper()]
        self._controller.ask(lambda: self._controller.set_operational_mode(wanted))
        return f"Operational mode {wanted.name} is set"

    def _clear_mode(self) -> str:
        self._controller.ask(lambda: self._controller.set_operational_mode(OperationalMode.NONE))
        return "No longer controlling the operational mode. Current operational mode: 'NONE'."

    def _report(self, kind: str) -> str:
        del kind
        self._reports += 1
        return f"Flight Report generated with id: {self._reports}"


def _no_file(name: str) -> str:
    return f"File not found: {name}"  # this controller keeps no files


def _say(text: str) -> Callable[[], str]:
    return lambda: text


def _flag(value: bool) -> str:  # noqa: FBT001
    return "true" if value else "false"
