"""Commands of a program, with limits of force mode that are no higher than its grant ([LSD-19])."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.base.operations import FORCE_MODE
from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import decode, encode
from pep.rtde.command.led_limits import lowered
from pep.rtde.command.register_image import RegisterImage
from pep.rtde.line.command_registers import LeasedCommands
from pep.rtde.line.effects import INFORMATION, Tell
from pep.rtde.wire.client_texts import told
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from capabilities.values.scope import Grant
    from pep.base.operation_row import Operation
    from pep.rtde.line.effects import CommandQuestion
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import WritableVariables

_FORCE_MODE_ID = 6


class ProgramCommands(LeasedCommands):
    """Commands of a program's control connection.

    Args:
        profile, claimed, stop_deceleration_rad_s2: as of `LeasedCommands`.
        granted: grant of an operation by the lease's token, as it stands now; None where there is none.
    """

    def __init__(
        self,
        profile: WritableVariables,
        claimed: Collection[str],
        *,
        stop_deceleration_rad_s2: float,
        granted: Callable[[Operation], Grant | None],
    ) -> None:
        super().__init__(profile, claimed, stop_deceleration_rad_s2=stop_deceleration_rad_s2)
        self._granted = granted
        self._told_lower = ""

    def defer(self, question: CommandQuestion, told: str) -> None:
        """Tells that a command waits, as `LeasedCommands.defer` does; force mode waits, too.

        Its program goes on meanwhile, but nothing has begun: what it commands next takes the place of what waits.
        """
        if question is self._held and isinstance(question.command, v.ForceMode):
            self._acts.append(Tell(told, INFORMATION))
        else:
            super().defer(question, told)

    def _merged(self, values: Mapping[str, Value]) -> RegisterImage:
        """Image of all that the client has written, with limits of force mode as they may be."""
        after = super()._merged(values)
        if after.whole(0) != _FORCE_MODE_ID:
            return after
        asked = decode(after)
        if isinstance(asked, v.ForceMode):
            command, what = lowered(asked, self._granted(FORCE_MODE))
            merged = after.merge(encode(command, self.offset))
            assert isinstance(merged, RegisterImage)  # the very registers that it was read from
            after = merged
            if what not in ("", self._told_lower):
                self._told_lower = what
                self._acts.append(Tell(told(Reason.LIMITS_LOWERED, f"forceMode: {what}"), INFORMATION))
        return after
