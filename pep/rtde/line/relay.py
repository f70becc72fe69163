"""One client's RTDE connection between the client and the controller: both ends are read, and said anew.

Whoever has no lease gets outputs, at the frequency it asks for, one for one; the inputs it asks for belong to somebody
else, as a controller says of those that another client owns. Bytes in, bytes out; what is outside the protocol raises
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
"""Requests that may wait for their answers. No client library sends a second one before the first is answered."""
AT_ONCE: Final = 64
"""Requests in one piece from a client without a lease: no library says two before it has heard, and each takes time."""
RECIPES: Final = 255


@dataclass(frozen=True, slots=True)
class OutgoingFrames:
    """What is to be sent now, each in whole frames."""

    to_robot: bytes = b""
    to_client: bytes = b""


@dataclass(frozen=True, slots=True)
class OwnInputs:
    """Inputs that the gateway asks the controller for by itself, among the requests that wait for their answers."""

    names: tuple[str, ...]


class Relay:
    """Both ends of a connection; what becomes of inputs is for a subclass to say."""

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
        """The controller is asked, and its answer expected."""
        self._wait(request)
        self._to_robot += encode_request(request, self._protocol)

    def _wait(self, what: Request | Answer | OwnInputs) -> None:
        if len(self._waiting) >= UNANSWERED:
            raise WireError(WireFault.PAYLOAD, "requests that nobody waits for")
        self._waiting.append(what)

    def _written(self, values: Values) -> None:
        """The client wrote inputs."""
        raise NotImplementedError

    def _inputs(self, names: tuple[str, ...]) -> InputsAnswer | None:
        """The answer to a client that wants inputs; None when the controller gives it."""
        raise NotImplementedError

    def _had(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        """The controller's answer to a client that wanted inputs; the client is told it."""
        raise NotImplementedError

    def _granted(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        """The controller's answer to us."""
        raise NotImplementedError

    def _shown(self, values: Values) -> Values:
        """What the client sees of a package of outputs."""
        return values

    def _judged(self, request: Request) -> InputsAnswer | None:
        """The answer that the controller is not asked for; None for a request that goes on to it."""
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
        """What the client is told of a frame."""
        answer = decode_answer(frame, self._protocol)
        match answer:
            case Values(number, packed):
                recipe = self._outputs.get(number)
                if recipe is None or len(packed) != recipe.size:
                    raise WireError(WireFault.PAYLOAD, "values of no recipe")
                shown = self._shown(answer)
                return frame.encode() if shown is answer else encode_answer(shown, self._protocol)
            case RtdeMessage():
                # Before the stream begins a client takes the next frame for its answer, whatever it is.
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
    """What a client is told of inputs that it does not get."""
    return InputsAnswer(tuple(VariableType.IN_USE if name in INPUTS else VariableType.NOT_FOUND for name in names), 0)


class StateRelay(Relay):
    """A connection without a lease."""

    def asked(self, received: bytes) -> OutgoingFrames:
        """The client sent these bytes.

        Raises:
            WireError: see `pep.rtde.wire.codec`; too many requests at once, a protocol version in the middle, or
                values.
        """
        self._hear(received, most=AT_ONCE)
        return self._said()

    def answered(self, received: bytes) -> OutgoingFrames:
        """The controller sent these bytes.

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
