"""The primary, secondary and real-time ports: state goes out, programs come in, except at their read-only twins."""

from __future__ import annotations

import codecs
import re
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from pep.rtde.script.urscript import ProgramStream, ScriptError, parse
from pep.rtde.wire.primary_frames import READ_ONLY
from ursim.ports.controller import Refusal
from ursim.ports.primary_messages import (
    error_message,
    exception_message,
    key_message,
    realtime_message,
    state_message,
    version_message,
)
from ursim.script.compiler import CompileError, compile_program
from ursim.script.functions import FUNCTIONS

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.rtde.wire.messages import ControlVersion
    from ursim.motion.robot import OperationalMode
    from ursim.ports.arm_kinds import ArmKind
    from ursim.ports.controller import Controller, Event
    from ursim.ports.sockets import Connection, Port
    from ursim.script.compiler import Compiled

MAX_PROGRAM: Final = 512 * 1024  # characters; ur_rtde's script has 42 thousand, a waypoint about 100
OPERATIONAL_MODE: Final = 211  # code of the message that tells a change of it, the mode its argument
STATE_EVERY: Final = 50  # ticks: 10 Hz

_NO_TEXT: Final = re.compile("[\udc80-\udcff]")
"""Bytes that are no UTF-8, as `surrogateescape` keeps them."""
KEPT_PROGRAMS: Final = 8  # compiled texts remembered; ur_rtde sends the same 42 kB at every connection


@lru_cache(maxsize=KEPT_PROGRAMS)
def compile_text(text: str) -> Compiled:
    """The runnable form of a text, with the simulator's own built-ins.

    Raises:
        ScriptError: the text does not parse.
        CompileError: it cannot run.
    """
    return compile_program(parse(text), FUNCTIONS)


class ScriptServer:
    """Serves the three ports of one controller, 30001 to 30003, and their read-only twins, 30011 to 30013.

    Args:
        controller: the controller that programs run on.
        version: told in the greeting.
        kind: of the arm.
    """

    def __init__(self, controller: Controller, version: ControlVersion, kind: ArmKind) -> None:
        self._controller = controller
        self._version = version
        self._kind = kind
        self.telling: list[Port] = []  # primary: state and the programs' events
        self.stating: list[Port] = []  # secondary: state alone
        self.realtime: list[Port] = []
        controller.on_event = self._event
        controller.on_exception = self._exception
        controller.on_operational_mode = self._operational_mode
        self._commands: dict[str, Callable[[], object]] = {
            "stop program": controller.stop,
            "power on": controller.power_on,
            "power off": controller.power_off,
            "set robotmode run": controller.brake_release,
            "set unlock protective stop": controller.unlock_protective_stop,
        }

    def greet_and_serve(self, connection: Connection) -> None:
        """Talks to one client of 30001 or 30002."""
        self._greet(connection)
        self.serve(connection)

    def greet_and_refuse(self, connection: Connection) -> None:
        """Talks to one client of 30011; any message from it is answered with the code for that."""
        self._greet(connection)
        while connection.receive():
            connection.send(error_message(READ_ONLY))

    def greet_and_ignore(self, connection: Connection) -> None:
        """Talks to one client of 30012."""
        self._greet(connection)
        self.ignore(connection)

    def ignore(self, connection: Connection) -> None:
        """Hears a client out, and does nothing."""
        while connection.receive():
            pass

    def serve(self, connection: Connection) -> None:
        """Runs the programs of one client, until it leaves or sends a program without end."""
        stream = ProgramStream(MAX_PROGRAM)
        decoder = codecs.getincrementaldecoder("utf-8")("surrogateescape")
        try:
            while received := connection.receive():
                for program in stream.feed(decoder.decode(received)):
                    self._run(program)
        except ScriptError as error:
            self._exception(error.line, str(error))

    def publish(self) -> None:
        """Sends all that is due; called at the end of each tick."""
        robot = self._controller.robot
        if robot.step % STATE_EVERY == 0:
            watching = [c for port in (*self.telling, *self.stating) for c in port.connections()]
            if watching:
                frame = state_message(robot, self._kind)
                for connection in watching:
                    connection.send(frame)
        frame = b""
        for connection in (c for port in self.realtime for c in port.connections()):
            if connection.behind:  # ur_rtde never reads this port
                connection.flush()
                continue
            frame = frame or realtime_message(robot)
            connection.send(frame)

    def _run(self, program: str) -> None:
        command = self._commands.get(" ".join(program.split()))
        if command is not None:
            if self._controller.obeys:
                self._controller.ask(command)
            else:
                self._tell(error_message(READ_ONLY))
            return
        if (wrong := _NO_TEXT.search(program)) is not None:
            told = f"byte 0x{ord(wrong[0]) - 0xDC00:02x} is not UTF-8: save the script as UTF-8"
            self._exception(program.count("\n", 0, wrong.start()) + 1, told)
            return
        try:
            compiled = compile_text(program)
        except (ScriptError, CompileError) as error:
            self._exception(error.line, str(error))
            return
        match self._controller.ask(lambda: self._controller.load(compiled)):
            case Refusal.LOCAL:
                self._tell(error_message(READ_ONLY))
            case Refusal.NOT_READY as refusal:
                self._exception(0, refusal.value)
            case None:
                pass

    def _greet(self, connection: Connection) -> None:
        connection.send(version_message(self._version))
        connection.send(self._controller.ask(lambda: state_message(self._controller.robot, self._kind)))

    def _event(self, event: Event, name: str) -> None:
        self._tell(key_message(event.value, name))

    def _operational_mode(self, mode: OperationalMode) -> None:
        self._tell(error_message(OPERATIONAL_MODE, mode))

    def _exception(self, line: int, text: str) -> None:
        self._tell(exception_message(line, text))

    def _tell(self, message: bytes) -> None:
        for port in self.telling:
            for connection in port.connections():
                connection.send(message)
