"""Last state of the robot on one RTDE connection of a program whose lease is over.

ur_rtde takes the end of a connection for a failure, also while it closes its own ones. Its receive interface complains
on standard error. Its IO interface, which waits for an answer when it leaves, ends the whole program. A program whose
control interface was in a call has ended by SIGSEGV. So a connection stays. Its last package is repeated there, and
says that no program runs and no controller is known; by that each command fails at once. Pure: bytes in, bytes out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.rtde.line.relay import Relay
from pep.rtde.line.rtde_line import STOPPED
from pep.rtde.wire.codec import Framer, decode_request, encode_answer
from pep.rtde.wire.messages import Pause, PauseAnswer, Values, WireError

if TYPE_CHECKING:
    from pep.rtde.wire.messages import InputsAnswer

NO_CONTROLLER: Final = (-1).to_bytes(4, "big", signed=True)
"""`robot_mode` while nothing is known of the robot."""
_SAYS: Final = (("runtime_state", STOPPED), ("robot_mode", NO_CONTROLLER))


class LastState(Relay):
    """Both ends of a connection that is carried elsewhere, as far as its last package needs them."""

    def __init__(self) -> None:
        super().__init__()
        self._newest: dict[int | None, Values] = {}
        self._inputs_had = False
        self._leaving = Framer()
        self._known = True

    @property
    def stays(self) -> bool:
        """True where it is a connection of RTDE that has been set up."""
        return self._known and self._set_up

    @property
    def commands(self) -> bool:
        """True where commands go: it has inputs beside its outputs, as ur_rtde's control interface."""
        return self._inputs_had and bool(self._outputs)

    def said(self, content: bytes) -> None:
        """Takes in bytes of the client."""
        self._take(content, of_client=True)

    def answered(self, content: bytes) -> None:
        """Takes in bytes of the robot."""
        self._take(content, of_client=False)

    def repeated(self) -> bytes:
        """Its last packages, in which no program runs; none where it never had any."""
        said = bytearray()
        for number, values in self._newest.items():
            packed = bytearray(values.packed)
            for name, value in _SAYS:
                place = self._outputs[number].place(name)
                if place is not None:
                    packed[place : place + len(value)] = value
            said += encode_answer(Values(number, bytes(packed)), self._protocol)
        return bytes(said)

    def farewell(self, content: bytes) -> bytes:
        """Answer to a client that leaves and waits for that; nothing to anything else."""
        try:
            leaves = any(
                isinstance(decode_request(frame, self._protocol), Pause) for frame in self._leaving.feed(content)
            )
        except WireError:
            return b""
        return encode_answer(PauseAnswer(accepted=True), self._protocol) if leaves else b""

    # ---- inside

    def _take(self, content: bytes, *, of_client: bool) -> None:
        if not self._known:
            return
        try:
            (self._hear if of_client else self._hear_robot)(content)
            self._said()
        except WireError:
            self._known = False  # nobody but its two ends can say what comes next
            self._newest.clear()

    def _written(self, values: Values) -> None:
        """Takes in nothing: what the client writes goes to the gateway."""

    def _inputs(self, names: tuple[str, ...]) -> None:
        """Leaves the answer to the gateway."""

    def _had(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        del names
        self._inputs_had = self._inputs_had or bool(answer.recipe)

    def _shown(self, values: Values) -> Values:
        self._newest[values.recipe] = values
        return values
