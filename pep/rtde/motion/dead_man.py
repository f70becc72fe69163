"""What tells the controller that the process that moves its arm is still there."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from pep.base.errors import PepFault, RobotError
from pep.base.stop_model import KICK_S

if TYPE_CHECKING:
    from pep.rtde.motion.permitted_control import PermittedControl


class DeadMan:
    """From its making to its end the controller ends the arm's program when this process is gone, or frozen.

    Args:
        control: of the arm.

    Raises:
        RobotError: `ROBOT_UNREACHABLE` when the controller does not take its watchdog.
    """

    def __init__(self, control: PermittedControl) -> None:
        if not control.expect():
            raise RobotError(PepFault.ROBOT_UNREACHABLE, "the controller does not watch")
        self._control = control
        self._over = threading.Event()
        self._kicking = threading.Thread(target=self._kick, name="dead man", daemon=True)
        self._kicking.start()

    def close(self) -> None:
        """Nothing is said any more. The controller ends the program soon, if nobody else does."""
        self._over.set()
        self._kicking.join(timeout=KICK_S)  # a call into a controller that is gone may not come back

    def _kick(self) -> None:
        while not self._over.wait(KICK_S):
            try:
                self._control.kick()
            except Exception:  # noqa: BLE001, S112 - whoever is not heard is dealt with by the controller
                continue
