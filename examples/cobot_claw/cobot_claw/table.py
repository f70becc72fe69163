"""The table as it truly is: things on it, in the fingers, and handed to a person."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any, Final

from cobot_claw.reach import tool_at
from pep.base.errors import RobotError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.rtde.robot.gripper import RobotiqGripper

PART_WIDTH_M: Final = 0.05
PART_KG: Final = 0.4
PART: Final[dict[str, Any]] = {
    "id": "part-1",
    "kind": "rigid",
    "shape": {"type": "box", "center_m": [-0.3, -0.05, 0.02], "half_m": [PART_WIDTH_M / 2] * 3},
}
"""A cube of 50 mm in front of the arm."""
BETWEEN_M: Final = 0.03
"""A thing whose middle is so near to the middle of the fingers is between them."""
PERIOD_S: Final = 0.1
GRIPPED_LOOKS: Final = 6
"""Looks after which a thing between closed fingers moves with them: the gripper has reported by then."""


class Table:
    """Things on the table; a thread follows them through the fingers.

    Args:
        tell: tells the camera's world.
        joints: the arm's angles now, rad.
        gripper: of the controller.
    """

    def __init__(
        self, *, tell: Callable[[object], None], joints: Callable[[], tuple[float, ...]], gripper: RobotiqGripper
    ) -> None:
        self._tell = tell
        self._joints = joints
        self._gripper = gripper
        self._lock = threading.Lock()
        self._things: dict[str, dict[str, Any]] = {}
        self._held = ""
        self._looks = 0
        self.handed: list[str] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="table", daemon=True)

    def lay(self, *things: dict[str, Any], people: tuple[dict[str, Any], ...] = ()) -> None:
        """Exactly these things stand there, and these people.

        Args:
            things: as the sensor is told them (ursim/sensor/sensor.py), boxes all.
            people: likewise.
        """
        with self._lock:
            self._things, self._held = {thing["id"]: thing for thing in things}, ""
            self._tell({"people": list(people), "objects": list(things)})

    def start(self) -> None:
        """The fingers are followed from now on."""
        self._thread.start()

    def stop(self) -> None:
        """Nothing is followed any more."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def _follow(self) -> None:
        while not self._ended.wait(PERIOD_S):
            try:
                holds = self._gripper.holds()
                with self._lock:
                    self._look(holds=holds)
            except (RobotError, OSError):  # the controller or the camera has ended; somebody else tells that
                continue

    def _look(self, *, holds: bool) -> None:
        self._looks = self._looks + 1 if holds else 0
        if self._looks == GRIPPED_LOOKS and not self._held:
            middle = tool_at(self._joints())
            near = [
                name
                for name, thing in self._things.items()
                if math.dist(thing["shape"]["center_m"], middle) <= BETWEEN_M
            ]
            if near:
                self._held = near[0]
                self._tell({"hold": {"id": self._held}})
        elif self._held and not holds:
            # the fingers are open: a person has it
            self.handed.append(self._held)
            del self._things[self._held]
            self._held = ""
            self._tell({"people": [], "objects": list(self._things.values())})
