"""Digital outputs of the controller behind permits: switched once, and told as done only when the robot has it."""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final

from pep.base.errors import ActuationRefusedError, PepFault, RobotError
from pep.base.operations import SET_DIGITAL_OUTPUT
from pep.base.request_digest import digest_of
from pep.rtde.command.io_commands import Bank, SetDigitalOutputs
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.request.permit import Permit
    from pep.rtde.command.io_commands import IoCommand
    from pep.rtde.robot.state_receiver import StateReceiver

SEEN_S: Final = 0.5
"""Longest wait for the output to be seen; it takes two packages of the controller."""


class DigitalOutputs:
    """The standard digital outputs. On one event loop.

    Args:
        switch: writes one; whether it was written.
        state: of the same controller.
        audience: canonical URL of the server whose permits count here.
        stopped_ms: monotonic time of the newest stop, or None; a stop voids what was permitted before it.
    """

    def __init__(
        self,
        switch: Callable[[IoCommand], bool],
        state: StateReceiver,
        *,
        audience: str,
        stopped_ms: Callable[[], int | None],
    ) -> None:
        self._switch = switch
        self._state = state
        self._audience = audience
        self._stopped_ms = stopped_ms
        self._looks = ThreadPoolExecutor(1, "outputs")

    async def set(self, pin: int, value: bool, permit: Permit) -> None:  # noqa: FBT001
        """The robot has this value at this output.

        Args:
            pin: 0 to 7.
            value: on or off.
            permit: of exactly this.

        Raises:
            ActuationRefusedError: nothing was sent.
            RobotError: `OUTPUT_UNCONFIRMED` when it was sent and the robot does not show it.
        """
        permit.spend(
            digest=digest_of(SET_DIGITAL_OUTPUT, (pin, int(value)), audience=self._audience),
            stopped_ms=self._stopped_ms(),
        )
        if not self._switch(SetDigitalOutputs(Bank.STANDARD, 1 << pin, int(value) << pin)):
            raise ActuationRefusedError(Reason.EFFECT_FAILED, "the controller did not take it")
        await asyncio.get_running_loop().run_in_executor(self._looks, self._see, pin, value)

    def close(self) -> None:
        """Nobody looks any more."""
        self._looks.shutdown(wait=True, cancel_futures=True)

    def _see(self, pin: int, value: bool) -> None:  # noqa: FBT001
        deadline_s = time.monotonic() + SEEN_S
        while time.monotonic() < deadline_s:
            if self._state.next().output_bits >> pin & 1 == value:
                return
        raise RobotError(PepFault.OUTPUT_UNCONFIRMED, f"output {pin}")
