"""The cell as it is now, for people's eyes: the arm, who and what is seen, the motion under way.

Nothing is decided on it. It is made of what the watch goes by, and costs the gateway a fraction of a millisecond.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.perception.sensor_frames import Seen
from pep.pit.base.errors import PitError
from pep.pit.base.motion import BlendedPath, JointPath, JointTrajectory, LinePath, MoveJ, MoveL
from pep.pit.picture.picture import bodies_in, body_to_plain, parts_of, posture_to_plain
from pep.pit.picture.postures import posture_at, route_of
from pep.world.world import scene_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.ports import Clock
    from pep.perception.sensor_frames import Frames
    from pep.pit import CellParameters
    from pep.request.permit import Permit
    from pep.rtde.robot.state_receiver import StateReceiver
    from pep.world.held_object import CommittedGrip
    from pep.world.world import CellPhysics

OLD_MS: Final = 1_000
"""Age from which a package of the controller is no news of the arm."""
WAY_STEPS: Final = 16
"""Postures of a motion under way that are told, start and end included."""
AHEAD: Final = (MoveJ, MoveL, JointPath, LinePath, JointTrajectory, BlendedPath)
"""Motions whose whole way is known before they begin; a stream's is not."""


class LiveReport:
    """Reports of one gateway on its cell as it is now. From any thread, one report at a time.

    Args:
        holding: the arm, with what it holds.
        cell: parameters and surveyed things.
        frames: the believed perception.
        state: of the controller.
        physics: knows what was assessed.
        under_way: permit of the motion that is being followed; None while there is none.
        clock: the monotonic one counts.
    """

    def __init__(
        self,
        *,
        holding: CommittedGrip,
        cell: CellParameters,
        frames: Frames,
        state: StateReceiver,
        physics: CellPhysics,
        under_way: Callable[[], Permit | None],
        clock: Clock,
    ) -> None:
        self._holding = holding
        self._cell = cell
        self._frames = frames
        self._state = state
        self._physics = physics
        self._under_way = under_way
        self._clock = clock
        self._seen: tuple[object, list[dict[str, Any]]] = None, []

    def now(self) -> dict[str, Any]:
        """The arm and what is seen: "arm" (None where the controller is silent), "held", "bodies", "motion"."""
        package, permit = self._state.newest(), self._under_way()
        age_ms = self._clock.monotonic_ms() - package.arrived_ms
        robot = self._holding.robot
        arm = None
        if package.state is not None and age_ms <= OLD_MS:
            posture = posture_to_plain(posture_at(robot, package.state.q_rad))
            arm = {"ends": posture["ends"], "tcp": posture["tcp"], "moving": not package.state.still}
        return {
            "arm": arm,
            "held": robot.model_digest,
            "bodies": self._bodies(),
            "motion": "" if permit is None else permit.request_id,
        }

    def standing(self) -> dict[str, Any]:
        """What does not move, as a picture without postures: the arm's parts, surveyed things, zones, workspace."""
        robot, surveyed = self._holding.robot, self._cell.surveyed
        posture = posture_at(robot, [0.0] * len(robot.model.joints))
        area, kinds = surveyed.workspace, zip(parts_of(robot), posture.parts, strict=True)
        return {
            "held": robot.model_digest,
            "parts": [{"kind": kind, "name": part.name, "r": part.radius_m} for kind, part in kinds],
            "bodies": [body_to_plain(body) for body in bodies_in(surveyed, seen_s=0.0)],
            "workspace": None if area is None else [list(area.low_m), list(area.high_m)],
        }

    def way(self) -> dict[str, Any]:
        """The way of the motion under way, as postures; none where nothing moves or its way is not known before."""
        permit = self._under_way()
        if permit is None:
            return {"motion": "", "postures": []}
        motion, postures = self._physics.motion_of(permit.request_id), []
        if isinstance(motion, AHEAD):
            try:
                route = route_of(self._holding.robot, motion, self._cell, perception_age_s=0.0)
                times = np.linspace(0.0, route.duration_s, WAY_STEPS).tolist()
                postures = [posture_to_plain(each) for each in route.postures(times)]
            except PitError:
                postures = []  # what cannot be drawn is not
        return {"motion": permit.request_id, "postures": postures}

    def _bodies(self) -> list[dict[str, Any]]:
        """People and things that sensors see; computed anew where the view has changed."""
        view = self._frames.view()
        if not isinstance(view, Seen):
            return []
        content = view.content
        if content != self._seen[0]:
            try:
                bodies = bodies_in(scene_of(view, self._cell), seen_s=0.0)
            except PitError:
                bodies = ()
            self._seen = content, [{**body_to_plain(body), "told": body.source} for body in bodies if body.source]
        return self._seen[1]
