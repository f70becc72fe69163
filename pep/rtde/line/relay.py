"""Relay of one client's RTDE connection to the controller: both ends are read, and written anew.

A client without a lease gets outputs, at the frequency it asks for, one for one; the inputs it asks for are answered as
taken, as by a controller whose inputs another client owns. Bytes in, bytes out; bytes outside the protocol raise
`WireError`, and the connection ends.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

from pep.rtde.wire.codec import MAX_FRAME, Framer, Recipe, decode_answer, decode_request, encode_answer, encode_request
from pep.rtde.wire.messages import (
    AskControlVersion,
    ControlVersion,
    InputsAnswer,
    OutputsAnswer,
    Pause,
    PauseAnswer,
    ProtocolAnswer,
    RequestProtocol,
    RtdeMessage,
    SetupInputs,
    SetupOutputs,
    Start,
    StartAnswer,
    Values,
    WireError,
    WireFault,
)
from pep.rtde.wire.variables import INPUTS, VariableType

if TYPE_CHECKING:
    from pep.rtde.wire.codec import RtdeFrame
    from pep.rtde.wire.messages import Answer, Request

SetUpAnswer: TypeAlias = ProtocolAnswer | ControlVersion | OutputsAnswer | InputsAnswer | StartAnswer | PauseAnswer
UNANSWERED: Final = 8
"""Most requests that wait for their answers.

No client library sends a second one before the first is answered.
"""
AT_ONCE: Final = 64
"""Requests in one piece from a client without a lease, at most.

No library sends two before an answer, and each takes time.
"""
RECIPES: Final = 255


@dataclass(frozen=True, slots=True)
class OutgoingFrames:
    """Frames to be sent now, whole."""

    to_robot: bytes = b""
    to_client: bytes = b""


@dataclass(frozen=True, slots=True)
class OwnInputs:
    """Inputs that the gateway asks the controller for by itself, among the requests that wait for their answers."""

    names: tuple[str, ...]


class Relay:
    """Both ends of a connection; the treatment of inputs is a subclass's."""

    def __init__(self) -> None:
        self._from_client, self._from_robot = Framer(), Framer(MAX_FRAME)
        self._protocol = 1
        self._waiting: deque[Request | Answer | OwnInputs] = deque()
        self._outputs: dict[int | None, Recipe] = {}
        self._set_up = self._started = False
        self._to_robot, self._to_client = bytearray(), bytearray()

    def _hear(self, received: bytes, *, most: int | None = None) -> None:
        frames = self._from_client.feed(received)
        if most is not None and len(frames) > most:
            raise WireError(WireFault.PAYLOAD, "more at once than a client says")
        for frame in frames:
            request = decode_request(frame, self._protocol)
            if isinstance(request, Values):
                self._written(request)
            elif (own := self._judged(request)) is None:
                self._ask(request)
            elif self._waiting:
                self._wait(own)
            else:
                self._to_client += encode_answer(own, self._protocol)

    def _hear_robot(self, received: bytes) -> None:
        for frame in self._from_robot.feed(received):
            self._to_client += self._passed(frame)
            while self._waiting and isinstance(self._waiting[0], InputsAnswer):
                self._to_client += encode_answer(self._waiting.popleft(), self._protocol)  # type: ignore[arg-type]

    def _said(self) -> OutgoingFrames:
        said = OutgoingFrames(bytes(self._to_robot), bytes(self._to_client))
        self._to_robot.clear()
        self._to_client.clear()
        return said

    def _ask(self, request: Request) -> None:
        """Asks the controller, and expects its answer."""
        self._wait(request)
        self._to_robot += encode_request(request, self._protocol)

    def _wait(self, what: Request | Answer | OwnInputs) -> None:
        if len(self._waiting) >= UNANSWERED:
            raise WireError(WireFault.PAYLOAD, "requests that nobody waits for")
        self._waiting.append(what)

    def _written(self, values: Values) -> None:
        """Takes in the client's inputs."""
        raise NotImplementedError

    def _inputs(self, names: tuple[str, ...]) -> InputsAnswer | None:
        """Answer to a client that asks for inputs; None when the controller gives it."""
        raise NotImplementedError

    def _had(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        """Takes in the controller's answer to a client's request for inputs, and passes it on."""
        raise NotImplementedError

    def _granted(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        """Takes in the controller's answer to a request of ours."""
        raise NotImplementedError

    def _shown(self, values: Values) -> Values:
        """Package of outputs as the client sees it."""
        return values

    def _judged(self, request: Request) -> InputsAnswer | None:
        """Answer that the controller is not asked for; None for a request that goes on to it."""
        match request:
            case RequestProtocol():
                if self._set_up or self._waiting:
                    raise WireError(WireFault.PAYLOAD, "a protocol version in the middle")
            case SetupInputs(names):
                self._set_up = True
                return self._inputs(names)
            case SetupOutputs():
                if self._started or any(isinstance(waits, Start) for waits in self._waiting):
                    raise WireError(WireFault.KIND, "outputs set up while they are sent")
                self._set_up = True
                if len(self._outputs) >= RECIPES:
                    raise WireError(WireFault.FIELD_LIST, "more recipes than there are numbers")
            case Start() | Pause():
                self._set_up = True
            case AskControlVersion():
                pass
            case Values() | RtdeMessage():
                raise WireError(WireFault.KIND, "what no client library says")
            case _:
                assert_never(request)
        return None

    def _passed(self, frame: RtdeFrame) -> bytes:
        """Bytes for the client in place of a frame."""
        answer = decode_answer(frame, self._protocol)
        match answer:
            case Values(number, packed):
                recipe = self._outputs.get(number)
                if recipe is None or len(packed) != recipe.size:
                    raise WireError(WireFault.PAYLOAD, "values of no recipe")
                shown = self._shown(answer)
                return frame.encode() if shown is answer else encode_answer(shown, self._protocol)
            case RtdeMessage():
                # Before the stream begins a client takes any next frame for its answer.
                return encode_answer(answer, self._protocol) if self._started else b""
            case _:
                return self._taken(answer)

    def _taken(self, answer: SetUpAnswer) -> bytes:
        request = self._waiting.popleft() if self._waiting else None
        match request, answer:
            case RequestProtocol(version), ProtocolAnswer(accepted):
                said = encode_answer(answer, self._protocol)
                if accepted:
                    self._protocol = version
                return said
            case SetupOutputs(names), OutputsAnswer(types, number):
                if not {VariableType.NOT_FOUND, VariableType.IN_USE}.intersection(types):
                    self._outputs[number] = Recipe(names, types)
            case SetupInputs(names), InputsAnswer():
                self._had(names, answer)
            case OwnInputs(names), InputsAnswer():
                self._granted(names, answer)
                return b""
            case Start(), StartAnswer(accepted):
                self._started = accepted
            case Pause(), PauseAnswer(accepted):
                self._started = self._started and not accepted
            case AskControlVersion(), ControlVersion():
                pass
            case _:
                raise WireError(WireFault.KIND, "an answer that nobody asked for")
        return encode_answer(answer, self._protocol)


def belongs_to_others(names: tuple[str, ...]) -> InputsAnswer:
    """Answer to a client whose inputs belong to others."""
    return InputsAnswer(tuple(VariableType.IN_USE if name in INPUTS else VariableType.NOT_FOUND for name in names), 0)


class StateRelay(Relay):
    """Relay without a lease."""

    def asked(self, received: bytes) -> OutgoingFrames:
        """Takes bytes of the client.

        Raises:
            WireError: see `pep.rtde.wire.codec`; too many requests at once, a protocol version in the middle, or
                values.
        """
        self._hear(received, most=AT_ONCE)
        return self._said()

    def answered(self, received: bytes) -> OutgoingFrames:
        """Takes bytes of the controller.

        Raises:
            WireError: see `pep.rtde.wire.codec`; an answer that nobody asked for.
        """
        self._hear_robot(received)
        return self._said()

    def _written(self, values: Values) -> None:
        del values
        raise WireError(WireFault.KIND, "values of inputs that were not had")

    def _inputs(self, names: tuple[str, ...]) -> InputsAnswer:
        return belongs_to_others(names)
