"""Subscription to the controller: its software, packages of chosen outputs, and inputs of ours.

Bytes alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.rtde.wire.codec import Framer, Recipe, decode_answer, encode_request
from pep.rtde.wire.messages import (
    AskControlVersion,
    ControlVersion,
    InputsAnswer,
    OutputsAnswer,
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
from pep.rtde.wire.variables import OUTPUTS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.messages import Request


class Subscription:
    """One connection. Send `begin`, and then the answer to each piece of the controller's bytes.

    Args:
        names: of the outputs.
        rate_hz: frequency of the packages.
        inputs: variables that we write; none, to listen alone.

    Attributes:
        version: of the controller's software, once it was told.
    """

    def __init__(self, names: tuple[str, ...], rate_hz: float, *, inputs: tuple[str, ...] = ()) -> None:
        self._names = names
        self._types = tuple(OUTPUTS[name] for name in names)
        self._framer = Framer()
        self._protocol = 1
        writing: list[Request] = [SetupInputs(inputs)] if inputs else []
        self._next: list[Request] = [AskControlVersion(), *writing, SetupOutputs(names, rate_hz), Start()]
        self._asked: Request = RequestProtocol(2)
        self._recipe: Recipe | None = None
        self._number: int | None = None
        self._inputs: tuple[int, Recipe] | None = None
        self.version: ControlVersion | None = None

    def begin(self) -> bytes:
        """First bytes to send."""
        return encode_request(self._asked, 1)

    def write(self, values: Mapping[str, Value]) -> bytes:
        """Bytes that set all our inputs, once packages come."""
        assert self._inputs is not None
        number, recipe = self._inputs
        return encode_request(Values(number, recipe.pack(values)), self._protocol)

    def feed(self, received: bytes) -> tuple[bytes, list[dict[str, Value]]]:
        """Bytes to send now, and the packages that have come.

        Raises:
            WireError: see `pep.rtde.wire.codec`; a refusal, an output that does not exist, or another answer than asked
                for.
        """
        said, packages = b"", []
        for frame in self._framer.feed(received):
            answer = decode_answer(frame, self._protocol)
            match self._asked, answer:
                case _, RtdeMessage():
                    continue
                case Start(), Values(number, packed):
                    # A package of another recipe is none of ours.
                    if self._recipe is not None and number == self._number:
                        packages.append(self._recipe.unpack(packed))
                    continue
                case RequestProtocol(), ProtocolAnswer(True):
                    self._protocol = 2
                case AskControlVersion(), ControlVersion():
                    self.version = answer
                case SetupInputs(inputs), InputsAnswer(types, granted) if granted:
                    self._inputs = granted, Recipe(inputs, types)
                case SetupOutputs(), OutputsAnswer(types, number):
                    if types != self._types:
                        raise WireError(WireFault.TYPE_NAME, "outputs of other types than documented")
                    self._recipe, self._number = Recipe(self._names, types), number
                case Start(), StartAnswer(True):
                    pass
                case _:
                    raise WireError(WireFault.KIND, "another answer than asked for")
            if self._next:
                self._asked = self._next.pop(0)
                said += encode_request(self._asked, self._protocol)
        return said, packages
