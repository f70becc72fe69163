"""Settings of a leased program beside its commands: outputs, the speed slider and free registers.

Each is judged, and written by itself: a package of ours never repeats an earlier setting. The slider may be lowered by
every program that may write it. ur_rtde does not wait for any of this, so a refusal is a text message alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.rtde.command.command_values import SetExternalWrench
from pep.rtde.command.io_commands import MASKS, IoCommand, SetSpeedSlider, decode_io, encode_io, sets
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.effects import (
    ERROR,
    INFORMATION,
    PATIENCE_MS,
    Act,
    AskJudge,
    CommandQuestion,
    Note,
    Tell,
    Withdraw,
    Write,
)
from pep.rtde.wire.client_texts import said
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import WritableVariables

WAITING: Final = 8
"""Most outputs that wait for their decisions."""


class LeasedOutputs:
    """Outputs of one IO connection.

    Args:
        profile: variables that it may write.
        claimed: the variables that it has from the controller.
    """

    def __init__(self, profile: WritableVariables, claimed: Collection[str]) -> None:
        self._claimed = frozenset(claimed)
        self._client = self._sent = RegisterImage.blank(profile)
        self._acts: list[Act] = []
        self._held: dict[CommandQuestion, int] = {}

    def take(self) -> list[Act]:
        """Acts since the last call, in order."""
        acts, self._acts = self._acts, []
        return acts

    def package(self, values: Mapping[str, Value], *, slider: float, at_ms: int) -> None:
        """Takes in the variables that the program wrote.

        Args:
            values: by name.
            slider: position of the controller's speed slider; NaN when that is not known.
            at_ms: monotonic time.
        """
        after = self._client.merge(values)
        if isinstance(after, InputRefusal):  # a recipe is of the profile's variables, and types are the wire's
            raise TypeError(after.place)
        self._client = after
        commands = decode_io(after, values)
        if isinstance(commands, InputRefusal):
            self._refuse(commands, "output")
            return
        for command in commands:
            if any(question.command == command for question in self._held):
                continue  # it is being decided
            self._supersede(command)
            if isinstance(command, SetExternalWrench) or not self._claimed.issuperset(self._written(command)):
                self._refuse(InputRefusal(Reason.NOT_GRANTED, "its registers were not set up"), type(command).__name__)
            elif isinstance(command, SetSpeedSlider) and command.fraction == slider:
                pass  # it stands there; written again it could raise a slider that is just being lowered
            elif isinstance(command, SetSpeedSlider) and command.fraction < slider:
                self._write(command)
            elif len(self._held) >= WAITING:
                self._refuse(InputRefusal(Reason.BUSY, "so many wait already"), type(command).__name__)
            else:
                question = CommandQuestion(command)
                self._held[question] = at_ms
                self._acts.append(AskJudge(question))

    def _supersede(self, command: IoCommand) -> None:
        """Withdraws waiting commands that would set the same."""
        for question in [q for q in self._held if isinstance(q.command, IoCommand) and sets(q.command) & sets(command)]:
            del self._held[question]
            self._acts.append(Withdraw(question))

    def forward(self, question: CommandQuestion) -> bool:
        """Writes a permitted command; true where it was written."""
        if self._held.pop(question, None) is None:
            return False
        assert isinstance(question.command, IoCommand)
        self._write(question.command)
        return True

    def deny(self, question: CommandQuestion, reason: Reason, told: str) -> None:
        """Tells the program of the denial."""
        if self._held.pop(question, None) is not None:
            self._tell(reason, told)

    def defer(self, question: CommandQuestion, told: str) -> None:
        """Tells the program that the output is not set yet."""
        if question in self._held:
            self._acts.append(Tell(told, INFORMATION))

    def look(self, *, at_ms: int) -> None:
        """Denies commands that have waited for too long."""
        for question in [q for q, since_ms in self._held.items() if at_ms - since_ms > PATIENCE_MS]:
            del self._held[question]
            self._acts.append(Withdraw(question))
            self._tell(Reason.APPROVAL_TIMEOUT, "nobody decided in time")

    def leave(self, ending: LeaseEnding = LeaseEnding.LEFT) -> None:  # noqa: ARG002 - as of commands
        """Withdraws all: the program has gone, or its lease is over."""
        self._acts += map(Withdraw, self._held)
        self._held.clear()

    def _written(self, command: IoCommand) -> dict[str, Value]:
        return encode_io(command, self._sent.profile.offset)

    def _write(self, command: IoCommand) -> None:
        values = {**dict.fromkeys(MASKS, 0), **self._written(command)}
        after = self._sent.merge(values)
        assert isinstance(after, RegisterImage)
        self._sent = after
        self._acts.append(Write({name: value for name, value in after.values.items() if name in self._claimed}))

    def _refuse(self, refused: InputRefusal, what: str) -> None:
        """Records and tells a refusal of the line's own."""
        self._acts.append(Note(refused, what))
        self._tell(refused.reason, f"{what}: {refused.place}")

    def _tell(self, reason: Reason, told: str) -> None:
        self._acts.append(Tell(said(reason, told), ERROR))
