"""What a motion asks of the arm itself, as ratios to configured limits: speeds, momentum, torque, payload.

Speeds and momentum are proven bounds over the path. Torque is sampled at some of its places from the robot's rigid-body
model, for every acceleration that the profile may have there; it has no proof, and the robot's own torque monitoring
stays in force. `Demands` asks it of a straight joint path, `pep.pit.search.course_limits` of a course.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import repeat
from typing import TYPE_CHECKING

import numpy as np

from pep.pit.base.motion import profile_of
from pep.pit.base.tier import ratio_index
from pep.pit.scene.contact_limits import payload_kg
from pep.pit.search.speed_bisection import highest_speed
from pep.pit.search.surface_speeds import Intervals
from pep.pit.search.torques import Torques, carried_kg

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pep.pit.base.motion import Floats, Profile, Run
    from pep.pit.path.straight_path import Path
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.search.surface_speeds import Speeds

TOOL, ELBOW, MOMENTUM = range(3)


@dataclass(frozen=True, slots=True)
class Ratio:
    """One quantity against its limit.

    Attributes:
        name: of the quantity; the `kind` of its contribution.
        ratio: quantity by limit.
    """

    name: str
    ratio: float

    @property
    def index(self) -> float:
        """The index of this ratio."""
        return ratio_index(self.ratio)


@lru_cache(maxsize=64)  # one robot of a cell, with what it holds in a day
def speed_shares(robot: Robot, cell: CellParameters) -> Floats:
    """Per quantity (speed of tool, elbow, momentum) and body, the part of its limit that 1 m/s takes, (3, bodies)."""
    tcp = robot.body_index("tcp")
    masses = {f"com_{j.name}": j.mass_kg for j in robot.model.joints} | {"com_tool": robot.tool.mass_kg}
    if robot.held is not None:
        masses["com_payload"] = robot.model.payload_limit_kg if robot.held.mass_kg is None else robot.held.mass_kg
    shares = np.zeros((3, len(robot.bodies)))
    shares[TOOL, tcp] = 1 / cell.tcp_speed_limit_m_s
    shares[ELBOW, robot.body_index("elbow_point")] = 1 / cell.elbow_speed_limit_m_s
    shares[MOMENTUM] = [masses.get(body.name, 0.0) for body in robot.bodies]
    shares[MOMENTUM, tcp] += carried_kg(robot, cell)
    shares[MOMENTUM] /= cell.momentum_limit_kg_m_s
    shares.setflags(write=False)
    return shares


def body_ratios(
    robot: Robot, cell: CellParameters, speeds_m_s: Floats, *, tool_speed_m_s: float, torque: Callable[[], float]
) -> Iterator[Ratio]:
    """What any motion asks of the arm's bodies, whatever its path: one after the other, as they are asked for.

    Args:
        robot: the arm.
        cell: its limits.
        speeds_m_s: proven bound on the surface speed of every body, (bodies,).
        tool_speed_m_s: of the tool point, held against its limit.
        torque: computes the worst by limit.
    """
    _, elbow, momentum = (speed_shares(robot, cell) @ speeds_m_s).tolist()
    yield Ratio("tcp_speed", tool_speed_m_s / cell.tcp_speed_limit_m_s)
    yield Ratio("elbow_speed", elbow)
    yield Ratio("momentum", momentum)
    yield Ratio("torque", torque())
    yield Ratio("payload", carried_ratio(robot, cell))


def carried_ratio(robot: Robot, cell: CellParameters) -> float:
    """Mass of the tool and of all that is carried, by what the robot may carry."""
    return (robot.tool.mass_kg + payload_kg(robot, cell)) / robot.model.payload_limit_kg


class Demands:
    """What a move demands: the parts that do not depend on its timing, computed once, then ratios for any profile."""

    def __init__(self, path: Path, cell: CellParameters) -> None:
        """Torque and speed terms at the path's nodes."""
        self._robot, self._cell = path.robot, cell
        self._intervals = Intervals(path, speed_shares(path.robot, cell))
        self._ways = np.abs(path.delta).tolist()
        self._limits = path.robot.speed_limits_rad_s.tolist()
        q = path.start + self._intervals.node_s[:, None] * path.delta
        self._torques = Torques(path.robot, cell, q, np.repeat(path.delta[None], len(q), axis=0), np.zeros_like(q))

    def speeds(self, profile: Profile) -> Speeds:
        """Proven bounds on the surface speed of every body, and the intervals on which they are proven."""
        return self._intervals.speeds(profile)

    def surface_speed_m_s(self, profile: Profile) -> Floats:
        """Proven bound on the surface speed of every body of the robot over the whole path, shape (bodies,)."""
        return self.speeds(profile).most_m_s

    def ratios(self, profile: Profile) -> tuple[Ratio, ...]:
        """Every quantity of this move under this profile against its limit."""
        return tuple(self._each(profile))

    def at_most(self, profile: Profile, index: float) -> bool:
        """Whether no ratio has a higher index; the dearest are only asked for where the others have none."""
        return all(ratio.index <= index for ratio in self._each(profile))

    def fastest(self, move: Run, index: float, *, slowest: float, check_time: Callable[[], None]) -> float | None:
        """The highest commanded speed, to a step of the bisection, at which no ratio's index is above `index`.

        Args:
            move: at the commanded speed, at which some ratio's is.
            index: what none may exceed.
            slowest: a slower one is of no use, rad/s.
            check_time: raises when the answer would come too late.
        """

        def falls(speed: float) -> bool:
            check_time()
            profile = profile_of(move, speed)
            return profile is not None and self.at_most(profile, index)

        return highest_speed(falls, slowest=slowest, fastest=move.speed_rad_s)

    def _each(self, profile: Profile) -> Iterator[Ratio]:
        robot = self._robot
        shares = [way / profile.way_rad for way in self._ways]
        asked = max(map(_by_limit, shares, repeat(profile.speed_rad_s), self._limits))
        joint = max(map(_by_limit, shares, repeat(profile.peak_rad_s), self._limits))
        # A short move never reaches a forbidden speed, but asking for one is asking to break the limit.
        yield Ratio("joint_speed", asked if asked > 1 else joint)
        yield Ratio("acceleration", profile.acceleration_rad_s2 / robot.model.acceleration_limit_rad_s2)
        speeds = self.surface_speed_m_s(profile)
        tool = float(speeds[robot.body_index("tcp")])
        yield from body_ratios(robot, self._cell, speeds, tool_speed_m_s=tool, torque=lambda: self._torque(profile))

    def _torque(self, profile: Profile) -> float:
        return self._torques.ratio(
            self._intervals.rates(profile),
            forward=profile.acceleration_rad_s2 / profile.way_rad,
            backward=profile.braking_rad_s2 / profile.way_rad,
        )


def _by_limit(share: float, speed: float, limit: float) -> float:
    return share * speed / limit
