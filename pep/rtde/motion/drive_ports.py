"""What the drive needs of others: fingers, a watch, and somebody who brings news sooner while something moves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.request.permit import Permit
    from pep.rtde.robot.gripper import GripResult
    from pep.watch.governor import Governor
    from pep.watch.watch import Watch


class Gripper(Protocol):
    """What the drive needs of a gripper."""

    def move(self, *, width_um: int, speed_um_s: int, force_mn: int, stopped: Callable[[], bool]) -> GripResult:
        """The fingers have moved; from when `stopped` says so, they do not move."""
        ...

    def activate(self, *, stopped: Callable[[], bool]) -> GripResult:
        """The gripper is ready; from when `stopped` says so, the fingers do not move."""
        ...

    def halt(self) -> None:
        """The fingers stop where they are."""
        ...


class Hurry(Protocol):
    """Whoever brings what the watch goes by, and can bring it sooner."""

    def __call__(self, *, moving: bool) -> None:
        """Something moves from now on, or nothing does. Does not wait."""
        ...


class GovernedWatchStarter(Protocol):
    """Begins the watch over what a permit allows."""

    def __call__(self, permit: Permit, *, governor: Governor | None = None) -> Watch:
        """The watch; with a governor the motion may be slowed down."""
        ...
