"""The cell as it is now, for people's eyes: the arm, who and what is seen, the motion under way.

Nothing is decided on it. It is made of what the watch goes by, and costs the gateway a fraction of a millisecond.
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.perception.sensor_frames import Seen
from pep.pit.base.errors import PitError
from pep.pit.base.motion import BlendedPath, JointPath, JointTrajectory, LinePath, MoveJ, MoveL
from pep.pit.picture.picture import bodies_in, body_to_plain, parts_of, posture_to_plain
from pep.pit.picture.postures import posture_at, route_of
from pep.world.world import scene_of

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from pep.request.permit import Permit
    from ztpm.point.robot_point import RobotPoint

OLD_MS: Final = 1_000
"""Age from which a package of the controller is no news of the arm."""
WAY_STEPS: Final = 16
"""Postures of a motion under way that are told, start and end included."""
AHEAD: Final = (MoveJ, MoveL, JointPath, LinePath, JointTrajectory, BlendedPath)
"""Motions whose whole way is known before they begin; a stream's is not."""


class LiveReport:
    """Reports of one gateway on its cell as it is now. From any thread, one report at a time.

    Args:
        point: the gateway's parts.
        under_way: permit of the motion that is being followed; None while there is none.
    """

    def __init__(self, point: RobotPoint, under_way: Callable[[], Permit | None]) -> None:
        self._point = point
        self._under_way = under_way
        self._seen: tuple[object, list[dict[str, Any]]] = None, []

    @property
    def answers(self) -> dict[str, Callable[[], Awaitable[dict[str, object]]]]:
        """The reports by name, each made in a worker thread."""
        told = {"live": self.now, "standing": self.standing, "way": self.way}
        return {name: partial(asyncio.to_thread, make) for name, make in told.items()}

    def now(self) -> dict[str, Any]:
        """The arm and what is seen: "arm" (None where the controller is silent), "held", "bodies", "motion"."""
        package, permit = self._point.state.newest(), self._under_way()
        age_ms = self._point.clock.monotonic_ms() - package.arrived_ms
        robot = self._point.holding.robot
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
        """The standing rest, as a picture without postures: the arm's parts, surveyed things, zones, workspace."""
        robot, surveyed = self._point.holding.robot, self._point.cell.surveyed
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
        motion, postures = self._point.physics.motion_of(permit.request_id), []
        if isinstance(motion, AHEAD):
            try:
                route = route_of(self._point.holding.robot, motion, self._point.cell, perception_age_s=0.0)
                times = np.linspace(0.0, route.duration_s, WAY_STEPS).tolist()
                postures = [posture_to_plain(each) for each in route.postures(times)]
            except PitError:
                postures = []  # what cannot be drawn is not
        return {"motion": permit.request_id, "postures": postures}

    def _bodies(self) -> list[dict[str, Any]]:
        """People and things that sensors see; computed anew where the view has changed."""
        view = self._point.frames.view()
        if not isinstance(view, Seen):
            return []
        content = view.content
        if content != self._seen[0]:
            try:
                bodies = bodies_in(scene_of(view, self._point.cell), seen_s=0.0)
            except PitError:
                bodies = ()
            self._seen = content, [{**body_to_plain(body), "told": body.source} for body in bodies if body.source]
        return self._seen[1]
