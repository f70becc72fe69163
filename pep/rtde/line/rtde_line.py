"""RTDE connection of a program with the lease: bytes of either side in, bytes and acts out.

Outputs pass as they are, one for one; what the program sets up as inputs it has from the controller, as far as it is
ur_rtde's. But not one of its packages goes further: once its recipes are set up, one of our own of the same variables
is added, and all that is ever written is written through that.

    program  I I ... I S      controller  I I ... I I' S      I' is ours, and its answer is ours alone

A refused command is answered so that ur_rtde sees it fail at once: the program has ended, says `runtime_state`, until
the client clears the command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.rtde.command.register_image import RegisterImage
from pep.rtde.line.effects import ERROR, Act, Refresh, Tell, Write
from pep.rtde.line.output_registers import LeasedOutputs
from pep.rtde.line.program_commands import ProgramCommands
from pep.rtde.line.relay import OutgoingFrames, OwnInputs, Relay, belongs_to_others
from pep.rtde.line.script_terms import DONE, brake_registers
from pep.rtde.line.stream_update import Following
from pep.rtde.wire.client_texts import fitted
from pep.rtde.wire.codec import Recipe, encode_answer, encode_request
from pep.rtde.wire.messages import OutputsAnswer, RtdeMessage, SetupInputs, Start, Values, WireError, WireFault
from pep.rtde.wire.recipes import EXTERNAL_WRENCH, OFFSETS, Ignored, InputRecipes, WritableVariables
from pep.rtde.wire.refusal import InputRefusal

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.values.scope import Grant
    from pep.base.operation_row import Operation
    from pep.rtde.line.command_registers import LeasedCommands
    from pep.rtde.line.relay import SetUpAnswer
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.messages import InputsAnswer, Request

STOPPED: Final = (1).to_bytes(4, "big")
_DONE: Final = DONE.to_bytes(4, "big")
"""`runtime_state` of no program."""
RUNNING_BIT: Final = 2
"""Bit of `robot_status_bits`: a program runs."""
SOURCE: Final = "ZTPM"
_PROFILES: Final = tuple(
    (WritableVariables.of(offset, control=control, io=not control), control)
    for control in (True, False)
    for offset in OFFSETS
)


class LeasedLine(Relay):
    """One connection.

    Args:
        claim: whether this line may be the one that commands; asked once, when it wants to.
        stop_deceleration_rad_s2: of the cell's stop model.
        granted: grant of an operation by the lease's token; None where there is none.
    """

    def __init__(
        self,
        claim: Callable[[], bool],
        *,
        stop_deceleration_rad_s2: float,
        granted: Callable[[Operation], Grant | None] = lambda _: None,
    ) -> None:
        super().__init__()
        self._granted_by = granted
        self._claim = claim
        self._deceleration = stop_deceleration_rad_s2
        self._inputs_had: InputRecipes | None = None
        self._profile: WritableVariables | None = None
        self._controls = False
        self._own: tuple[int, Recipe] | None = None
        self._unwritten: list[dict[str, Value]] = []
        self._sealed = False
        self._packages: list[Values] = []
        self._newest: dict[int | None, Values] = {}
        self._places: dict[int | None, tuple[int | None, int | None, int | None]] = {}
        self._last_written: bytes | None = None
        self._last_had: Values | None = None
        self._following: Following | None = None
        self._rest: list[Act] = []
        self.commands: LeasedCommands | None = None
        self.outputs: LeasedOutputs | None = None
        self.running = False
        """True while its control script runs.

        A commanding line sees no other program, and this one not too early.
        """

    @property
    def parts(self) -> tuple[LeasedCommands | LeasedOutputs, ...]:
        """Reader of its packages: commands or outputs, or none while it has written nothing."""
        part = self.commands or self.outputs
        return () if part is None else (part,)

    # ---- bytes

    def said(self, received: bytes, *, slider: float, at_ms: int) -> OutgoingFrames:
        """Takes bytes of the client.

        Args:
            received: by the client.
            slider: position of the controller's speed slider; NaN when that is not known.
            at_ms: monotonic time.

        Raises:
            WireError: as `StateRelay.asked`; a package of no recipe, or set-up after the first package.
        """
        said = self._next(received, at_ms)
        if said is not None:
            return said
        self._hear(received)
        packages, self._packages = self._packages, []
        for package in packages:
            assert self._inputs_had is not None
            self._following = None
            match self._inputs_had.read(package):
                case Ignored():
                    pass
                case InputRefusal() as refused:
                    raise WireError(WireFault.PAYLOAD, refused.place)
                case values:
                    self._last_had = package
                    self._package(values, slider, at_ms)
        return self.settle()

    def answered(self, received: bytes) -> OutgoingFrames:
        """Takes bytes of the controller.

        Raises:
            WireError: as `StateRelay.answered`; inputs that the client has and we do not.
        """
        self._hear_robot(received)
        return self.settle()

    def settle(self) -> OutgoingFrames:
        """Frames to be sent now after all input; the other acts are in `take`."""
        for part in self.parts:
            for act in part.take():
                match act:
                    case Write(values):
                        self._write(dict(values))
                    case Tell(text, level):
                        self._tell(text, level)
                    case Refresh():
                        self.refresh()
                    case _:
                        self._rest.append(act)
        self._follow()
        return self._said()

    def take(self) -> list[Act]:
        """Remaining acts."""
        rest, self._rest = self._rest, []
        return rest

    def rewrite(self) -> None:
        """Writes the last values again: the watchdog hears it, and nothing changes."""
        if self._last_written is not None:
            self._to_robot += self._last_written

    def refresh(self) -> None:
        """Shows the newest truthful package of each recipe again."""
        for values in self._newest.values():
            self._to_client += encode_answer(self._shown(values), self._protocol)

    def tell(self, text: str) -> None:
        """Tells the program in a text message, and its operator beside that."""
        self._tell(text, ERROR)

    # ---- inside

    def _follow(self) -> None:
        """Begins to follow the written value, where others may follow it."""
        commands, package, frame = self.commands, self._last_had, self._last_written
        if self._following is not None or commands is None or commands.stands is None:
            return
        if package is None or frame is None or self._own is None or self._inputs_had is None:
            return
        recipe = self._inputs_had.recipe(package)
        if recipe is not None:
            self._following = Following.of(
                package, recipe, frame=frame, own=self._own[1], command=commands.stands, offset=commands.offset
            )

    def _next(self, received: bytes, at_ms: int) -> OutgoingFrames | None:
        """Judges the next value of the standing command and writes it; None where it is anything else."""
        following, commands = self._following, self.commands
        if following is None or commands is None or commands.stands is None or self._from_client.pending:
            return None
        six = following.read(received)
        if six is None:
            return None
        if not commands.follow(six, at_ms=at_ms):
            return self.settle()
        self._sends(following.written(received))
        return self._said()

    def _package(self, values: dict[str, Value], slider: float, at_ms: int) -> None:
        if self.commands is not None:
            self.commands.package(values, at_ms=at_ms)
        elif self.outputs is not None:
            self.outputs.package(values, slider=slider, at_ms=at_ms)

    def _judged(self, request: Request) -> InputsAnswer | None:
        if isinstance(request, Start):
            self._seal()
        return super()._judged(request)

    def _inputs(self, names: tuple[str, ...]) -> InputsAnswer | None:
        if self._sealed:
            raise WireError(WireFault.KIND, "inputs after the first package")
        if self._inputs_had is None:
            fitting = next(((p, control) for p, control in _PROFILES if p.names.issuperset(names)), None)
            if fitting is None or (fitting[1] and not self._claim()):
                return belongs_to_others(names)
            self._profile, self._controls = fitting
            self._inputs_had = InputRecipes(self._profile)
        if self._inputs_had.refusal(names) is not None:
            return belongs_to_others(names)
        return None

    def _had(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        assert self._inputs_had is not None
        if answer.recipe:
            self._inputs_had.set_up(names)

    def _taken(self, answer: SetUpAnswer) -> bytes:
        if isinstance(answer, OutputsAnswer):
            # The number may have been another recipe's, of another form.
            self._newest.pop(answer.recipe, None)
            self._places.pop(answer.recipe, None)
        return super()._taken(answer)

    def _granted(self, names: tuple[str, ...], answer: InputsAnswer) -> None:
        if not answer.recipe:
            raise WireError(WireFault.PAYLOAD, "inputs that the client has and we do not")
        self._own = (answer.recipe, Recipe(names, answer.types))
        unwritten, self._unwritten = self._unwritten, []
        for values in unwritten:
            self._write(values)

    def _seal(self) -> None:
        """Adds our recipe after the client's last one."""
        if self._sealed or self._inputs_had is None:
            return
        self._sealed = True
        # What an external sensor says is nothing that a program is believed.
        names = tuple(name for name in self._inputs_had.names if name != EXTERNAL_WRENCH)
        if not names:
            return
        assert self._profile is not None
        if self._controls:
            # Our stops and our watchdog are not less than that because a client has left their registers to others.
            names = tuple(dict.fromkeys((*brake_registers(self._profile.offset), *names)))
            self.commands = ProgramCommands(
                self._profile, names, stop_deceleration_rad_s2=self._deceleration, granted=self._granted_by
            )
            # What an earlier client left in the registers is over.
            blank = RegisterImage.blank(self._profile).values
            self._unwritten.append({name: blank[name] for name in names})
        else:
            self.outputs = LeasedOutputs(self._profile, names)
        self._wait(OwnInputs(names))
        self._to_robot += encode_request(SetupInputs(names), self._protocol)

    def _written(self, values: Values) -> None:
        self._seal()
        if self._inputs_had is None:
            raise WireError(WireFault.KIND, "values of inputs that were not had")
        self._packages.append(values)

    def _write(self, values: dict[str, Value]) -> None:
        if self._own is None:
            self._unwritten.append(values)
            return
        number, recipe = self._own
        self._sends(encode_request(Values(number, recipe.pack(values)), self._protocol))

    def _sends(self, frame: bytes) -> None:
        self._last_written = frame
        self._to_robot += frame

    def _tell(self, text: str, level: int) -> None:
        text = fitted(text)
        if self._started:  # before that a client takes any next frame for its answer
            self._to_client += encode_answer(RtdeMessage(text, SOURCE, level), self._protocol)
        self._rest.append(Tell(text, level))

    def _shown(self, values: Values) -> Values:
        self._newest[values.recipe] = values
        if self.commands is None or (self.running and not self.commands.denied):
            return values
        if values.recipe not in self._places:
            recipe = self._outputs[values.recipe]
            told = f"output_int_register_{self.commands.offset}"
            self._places[values.recipe] = tuple(map(recipe.place, ("runtime_state", "robot_status_bits", told)))  # type: ignore[assignment]  # three
        runtime, status, state = self._places[values.recipe]
        packed = bytearray(values.packed)
        if runtime is not None:
            packed[runtime : runtime + len(STOPPED)] = STOPPED
        if status is not None and not self.running:
            packed[status + 3] &= ~RUNNING_BIT
        if state is not None and self.commands.script_over and not self.running:
            packed[state : state + len(_DONE)] = _DONE
        return Values(values.recipe, bytes(packed))
