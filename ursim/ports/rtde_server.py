"""The RTDE server (port 30004): set-up, ownership of inputs, and a package every time one is due."""

from __future__ import annotations

import math
import struct
import threading
from typing import TYPE_CHECKING, Final, assert_never

from pep.rtde.wire.codec import HEADER, Framer, Recipe, decode_request, encode_answer
from pep.rtde.wire.messages import (
    AskControlVersion,
    ControlVersion,
    FrameKind,
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
)
from pep.rtde.wire.variables import INPUTS, OUTPUTS, OUTPUTS_SINCE, WIDTH, VariableType

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.rtde.wire.messages import Answer, Request
    from ursim.ports.controller import Controller
    from ursim.ports.sockets import Connection

RATE_HZ: Final = 500.0
MAX_RECIPES: Final = 255  # a recipe id is one byte, and 0 means refused


class _Refusal(Exception):  # noqa: N818  the reason a client is disconnected
    pass


class _Stream:
    """The outputs one client wants: packed once a due tick."""

    def __init__(self, names: tuple[str, ...], recipe: Recipe, number: int | None, frequency_hz: float) -> None:
        self._names = names
        self._wide = [kind in WIDTH for kind in recipe.types]
        self._recipe = recipe
        self._lead = b"" if number is None else bytes([number])
        self._head = struct.pack(">HB", HEADER + len(self._lead) + recipe.size, FrameKind.VALUES) + self._lead
        self._per_tick = min(frequency_hz, RATE_HZ) / RATE_HZ if frequency_hz > 0.0 else 1.0  # ur_rtde asks -1: all
        self._first: int | None = None
        self._sent = -1

    def due(self, step: int) -> bool:
        """True where a package belongs to this step; exact on average for rates that do not divide 500."""
        if self._first is None:
            self._first = step
        slot = math.floor((step - self._first) * self._per_tick + 1e-9)
        fresh, self._sent = slot != self._sent, slot
        return fresh

    def frame(self, controller: Controller) -> bytes:
        """The package of this tick."""
        read = controller.robot.read
        flat: list[object] = []
        for name, wide in zip(self._names, self._wide, strict=True):
            value = read(name)
            if wide:
                flat += value  # type: ignore[arg-type]  # a vector variable holds a tuple
            else:
                flat.append(value)
        return self._head + self._recipe.pack_flat(flat)


class _Owner:
    """Owner of an input."""


class _Client(_Owner):
    """Set-up of one connection."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.protocol = 1
        self.prepared: _Stream | None = None
        self.started: _Stream | None = None
        self.inputs: list[Recipe] = []


class RtdeServer:
    """Serves RTDE clients of one controller.

    Args:
        controller: the controller whose variables they read and write.
        version: the answer to `v`.
    """

    def __init__(self, controller: Controller, version: ControlVersion) -> None:
        self._controller = controller
        self._version = version
        self._owners: dict[str, _Owner] = {}
        self._field_bus = _Owner()
        self._clients: set[_Client] = set()
        self._lock = threading.Lock()
        self._streaming: tuple[_Client, ...] = ()
        self.ignored = 0  # data packages that fitted no recipe; ur_rtde sends such, so they end nothing

    def serve(self, connection: Connection) -> None:
        """Talks to one client until it leaves or breaks the protocol; then its inputs are free again."""
        client = _Client(connection)
        framer = Framer()
        with self._lock:
            self._clients.add(client)
        try:
            while received := connection.receive():
                for frame in framer.feed(received):
                    self._answer(client, decode_request(frame, client.protocol))
        except (WireError, _Refusal) as error:
            connection.send(encode_answer(RtdeMessage(str(error)[:200], "RTDE", 1), client.protocol))
        finally:
            self._leave(client)

    def occupy(self, names: Iterable[str]) -> None:
        """Gives these inputs to a field bus, from now on, and to no other client."""
        with self._lock:
            self._owners |= dict.fromkeys(names, self._field_bus)

    def vacate(self) -> None:
        """The field bus gives its inputs up."""
        with self._lock:
            self._owners = {name: owner for name, owner in self._owners.items() if owner is not self._field_bus}

    def publish(self) -> None:
        """Sends every package that is due; called at the end of each tick."""
        step = self._controller.robot.step
        for client in self._streaming:
            stream = client.started
            if stream is not None and stream.due(step) and not client.connection.starved:
                client.connection.send(stream.frame(self._controller))
            else:
                client.connection.flush()

    # -- requests, in the client's own thread

    def _answer(self, client: _Client, request: Request) -> None:
        match request:
            case Values(recipe, packed):
                self._write(client, recipe or 0, packed)
            case RtdeMessage():
                pass
            case RequestProtocol(version):
                accepted = version in (1, 2)
                if accepted and (client.prepared or client.inputs):
                    raise _Refusal("the protocol cannot change after set-up")
                self._send(client, ProtocolAnswer(accepted))
                client.protocol = version if accepted else client.protocol
            case AskControlVersion():
                self._send(client, self._version)
            case SetupOutputs():
                self._send(client, self._prepare(client, request))
            case SetupInputs(names):
                self._send(client, self._claim(client, names))
            case Start():
                self._send(client, StartAnswer(client.prepared is not None))
                client.started = client.prepared
                self._restream()
            case Pause():
                client.started = None
                self._restream()
                self._send(client, PauseAnswer(accepted=True))
            case _:
                assert_never(request)

    def _send(self, client: _Client, answer: Answer) -> None:
        client.connection.send(encode_answer(answer, client.protocol))

    def _prepare(self, client: _Client, request: SetupOutputs) -> OutputsAnswer:
        if client.started is not None:
            raise _Refusal("outputs cannot be set up while they stream")
        types = tuple(self._output_type(name) for name in request.names)
        number = None if client.protocol == 1 else 1
        client.prepared = None
        if VariableType.NOT_FOUND not in types:
            frequency = RATE_HZ if request.frequency_hz is None else request.frequency_hz
            client.prepared = _Stream(request.names, Recipe(request.names, types), number, frequency)
        return OutputsAnswer(types, number)

    def _output_type(self, name: str) -> VariableType:
        if OUTPUTS_SINCE.get(name, 0) > self._version.minor:
            return VariableType.NOT_FOUND
        return OUTPUTS.get(name, VariableType.NOT_FOUND)

    def _claim(self, client: _Client, names: tuple[str, ...]) -> InputsAnswer:
        if len(set(names)) != len(names):
            raise _Refusal("an input stands twice in one recipe")
        if len(client.inputs) >= MAX_RECIPES:
            raise _Refusal("too many input recipes")
        with self._lock:
            types = tuple(self._input_type(client, name) for name in names)
            if VariableType.NOT_FOUND in types or VariableType.IN_USE in types:
                return InputsAnswer(types, 0)
            for name in names:
                self._owners[name] = client
        client.inputs.append(Recipe(names, types))
        return InputsAnswer(types, len(client.inputs))

    def _input_type(self, client: _Client, name: str) -> VariableType:
        if name not in INPUTS:
            return VariableType.NOT_FOUND
        return INPUTS[name] if self._owners.get(name, client) is client else VariableType.IN_USE

    def _write(self, client: _Client, number: int, packed: bytes) -> None:
        recipe = client.inputs[number - 1] if 1 <= number <= len(client.inputs) else None
        if recipe is None or recipe.size != len(packed):
            self.ignored += 1
            return
        self._controller.write(recipe.unpack(packed))

    def _restream(self) -> None:
        with self._lock:
            self._streaming = tuple(client for client in self._clients if client.started is not None)

    def _leave(self, client: _Client) -> None:
        client.connection.close()
        client.started = None
        with self._lock:
            self._clients.discard(client)
            self._owners = {name: owner for name, owner in self._owners.items() if owner is not client}
        self._restream()
