"""Motions that a force or a hand leads: speeds of the joints, either way, and all that follows.

Nobody says where such a motion ends. What is said is how fast it may be, and that is watched: the arm is stopped where
it is faster. So physics asks about everywhere that the arm can be until then (PHY-61).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

import numpy as np

from capabilities.values.scope import Tier
from capabilities.values.units import Unit
from pep.pit.assessment.assess import assess
from pep.pit.base.errors import UnprovenError
from pep.pit.base.motion import ServoJ
from pep.pit.robot.inverse_kinematics import stance
from pep.pit.robot.twist import turned_by
from pep.pit.scene.contact_limits import LIMITS
from policies.evidence.evidence import Contribution, ImpactFault, ImpactReading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.pit.base.motion import Floats, Joints
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene

MICRO: Final = 1e6  # micro units of one
AGAIN_MS: Final = 100  # ours, as below
"""Ours: longest time until a led arm is judged again.

Its follower asks each 20 ms; one that is later is a stop.
"""
AGAIN_S: Final = AGAIN_MS / 1_000  # milliseconds of a second
MARGIN: Final = 1.25  # ours, as below
"""Ours: speeds that are certified, by those at which the arm is stopped.

The rest is what it may gain until the stop takes hold.
"""
BEND: Final = 0.03  # ours, as below
"""Ours: share of a line's fastest joint by which any joint may differ from the line's own speeds.

The joints' speeds along a line of the tool change on the way; one judgement is 3 mm after the other at 20 mm/s.
"""
NOISE_RAD_S: Final = 0.002  # ours, as below
"""Ours: speed of a joint that holds still, as a controller tells it, with room: twice the bound of standstill."""
SLACK_M_S: Final = 0.005  # ours, as below
"""Ours: as `NOISE_RAD_S`, of the tool point."""
SLACK_RAD_S: Final = 0.02  # ours, as below
"""Ours: likewise, of the tool's turning."""
REACH_M: Final = 0.25  # ours, as below
"""Ours: distance from the tool point to any part of the tool or of what it holds."""
FARTHEST_M: Final = 1.0
"""As `pep.base.operations.REACH_UM`: from the task frame, about which an axis may turn, to the tool point."""
ANY_DEPTH_M: Final = 1.0
ANY_SPEED_M_S: Final = 10.0  # no arm is faster
FASTEST_RAD_S: Final = 1.0
"""As `pep.base.stop_model.STREAM_SPEED_RAD_S`: a stop from it always ends inside the dead man's patience."""
LOOKAHEAD_S: Final = 0.03  # PHY-20, as below
"""PHY-20: lookahead within which a servo target makes for exactly the speeds that lead to it."""
TOUCHING_MILLI: Final = 2_000  # PHY-61
"""Index of a motion that is meant to press: what it touches feels the force."""
HAND_MILLI: Final = 3_000  # PHY-63
"""Index of a motion that people make, whom no view tells from those who only stand there."""
NEAR_MILLI: Final = 2_000  # PHY-5
"""Index from which a person is within the protective separation distance (PHY-5)."""
WEAKEST_N: Final = min(limit.force_n for limit in LIMITS.values())
"""Quasi-static force that every body region bears; at rest a force has no transient factor."""


@dataclass(frozen=True, slots=True)
class LedTool:
    """The tool, wherever forces let it go.

    Attributes:
        frame_m_rad: task frame in the base frame.
        speeds: highest along and about each of its axes, m/s and rad/s; 0 of an axis that is held.
        distance_m: of the tool point from where it began.
    """

    frame_m_rad: tuple[float, ...]
    speeds: tuple[float, ...]
    distance_m: float


@dataclass(frozen=True, slots=True)
class LedArm:
    """The arm, wherever a hand takes it.

    Attributes:
        tool_speed_m_s: highest of the tool point.
        joint_speed_rad_s: highest of each joint.
        distance_m: of the tool point from where it began.
    """

    tool_speed_m_s: float
    joint_speed_rad_s: float
    distance_m: float


class MeasuredJoints(Protocol):
    """Joints of an arm as they were measured."""

    @property
    def q_rad(self) -> Sequence[float]:
        """Angles, six."""
        ...

    @property
    def qd_rad_s(self) -> Sequence[float]:
        """Speeds, six."""
        ...


Led: TypeAlias = LedTool | LedArm
SLOWER: Final = (0.75, 0.5, 0.35, 0.2, 0.1)  # ours, as below
"""Ours: shares of the speeds that are tried for a denial's answer, what would be permitted."""


def slower(led: Led, share: float) -> Led:
    """The same motion at a share of its speeds."""
    if isinstance(led, LedTool):
        return replace(led, speeds=tuple(share * each for each in led.speeds))
    return replace(led, joint_speed_rad_s=share * led.joint_speed_rad_s)


def fastest_of(led: Led) -> int:
    """Its highest speed: um/s of an axis of the tool, or urad/s where only joints or turns have one."""
    speeds = led.speeds if isinstance(led, LedTool) else (led.joint_speed_rad_s,)
    along = max(speeds[:3]) if isinstance(led, LedTool) else 0.0
    return math.floor(MICRO * (along or max(speeds)))


@dataclass(frozen=True, slots=True, eq=False)
class JointRates:
    """Speeds at which a led arm is let go on, near the joint angles that they were computed at.

    Each joint's speed is a common share, -1 to 1, of `along`, and differs from it by at most `beside`.

    Attributes:
        q, position, jacobian: the arm there: angles (6,), tool point (3,), and its velocity by joint speeds (6, 6).
        along, beside: (6,), rad/s.
        tool_speed_m_s, turn_rad_s: highest of the tool point, and of the tool's turning.
        distance_m: of the tool point from where it began.
    """

    q: Floats
    position: Floats
    jacobian: Floats
    along: Floats
    beside: Floats
    tool_speed_m_s: float
    turn_rad_s: float
    distance_m: float

    @classmethod
    def of(cls, led: Led, robot: Robot, q_rad: Sequence[float]) -> JointRates:
        """Rates near these joint angles, six.

        Raises:
            UnprovenError: `singular`, a joint would have to be faster than is let go on.
        """
        here = stance(robot, np.asarray(q_rad, dtype=float))
        at = here.q, here.position, here.jacobian
        still = np.zeros(len(here.q))
        if isinstance(led, LedArm):
            return cls(*at, still, still + led.joint_speed_rad_s, led.tool_speed_m_s, math.inf, led.distance_m)
        turned, speeds = turned_by(np.array(led.frame_m_rad[3:])), np.array(led.speeds)
        lever = float(np.linalg.norm(here.position - np.array(led.frame_m_rad[:3])))
        turning = float(np.linalg.norm(speeds[3:])) * lever  # about the frame's origin, which may be elsewhere
        tool_speed = float(np.linalg.norm(speeds[:3])) + turning
        twists = np.zeros((6, 6))  # columns
        twists[:3, :3], twists[3:, 3:] = turned * speeds[:3], turned * speeds[3:]
        try:
            rates = np.linalg.solve(here.jacobian, twists)
            carried = np.abs(np.linalg.solve(here.jacobian, np.eye(6)[:, :3])).sum(axis=1) * turning  # six joints
        except np.linalg.LinAlgError:
            raise UnprovenError("singular") from None
        if np.count_nonzero(speeds) == 1 and not turning:
            along = rates.sum(axis=1)
            beside = still + BEND * float(np.abs(along).max()) + NOISE_RAD_S
        else:
            along, beside = still, (np.abs(rates).sum(axis=1) + carried) * (1 + BEND) + NOISE_RAD_S
        if not float((np.abs(along) + beside).max()) * MARGIN <= FASTEST_RAD_S:
            raise UnprovenError("singular")
        return cls(*at, along, beside, tool_speed, float(np.linalg.norm(speeds[3:])), led.distance_m)

    def exceeded(self, state: MeasuredJoints, begun: Floats, *, stop_s: float) -> str:
        """Quantity that is above its bound in this state, as a word; "" for none.

        Args:
            state: measured now.
            begun: tool point (3,) at which the motion began, m.
            stop_s: time in which a stop takes hold.
        """
        qd = np.asarray(state.qd_rad_s, dtype=float)
        square = float(self.along @ self.along)
        share = min(1.0, max(-1.0, float(qd @ self.along) / square)) if square else 0.0
        if not bool((np.abs(qd - share * self.along) <= self.beside).all()):
            return "joint speed"
        twist = self.jacobian @ qd
        speed = float(np.linalg.norm(twist[:3]))
        if not speed <= self.tool_speed_m_s + SLACK_M_S:
            return "tool speed"
        if not float(np.linalg.norm(twist[3:])) <= self.turn_rad_s + SLACK_RAD_S:
            return "tool turning"
        point = self.position + self.jacobian[:3] @ (np.asarray(state.q_rad) - self.q)
        if not float(np.linalg.norm(point - begun)) + speed * stop_s <= self.distance_m:
            return "distance"
        return ""

    def tool_speed(self, found_m_s: float) -> float:
        """Highest speed of the tool point, m/s: as certified, or as it is watched, whichever is less."""
        return min(found_m_s, MARGIN * (self.tool_speed_m_s + SLACK_M_S))

    def envelope(self, cell: CellParameters) -> ServoJ:
        """Servo target whose envelope (PHY-20) has everywhere that the arm may be until it is judged again and stands.

        A line is begun as far behind the arm as it may come: it goes either way.

        Args:
            cell: its stop model.
        """
        along, beside = MARGIN * self.along, MARGIN * self.beside
        fastest = float((np.abs(along) + beside).max())
        reaction_s = cell.watch_age_limit_s + cell.reaction_s
        for_s = reaction_s + AGAIN_S + cell.stop_delay_s + 0.5 * fastest / cell.stop_deceleration_rad_s2
        behind_s = for_s if self.along.any() else 0.0
        start = self.q - behind_s * along
        return ServoJ(
            _joints(start),
            _joints(along + beside),
            _joints(start + LOOKAHEAD_S * (along - beside)),
            AGAIN_S + behind_s,
            LOOKAHEAD_S,
        )


def led_scene(scene: Scene | None) -> Scene | None:
    """The view without people, who lead the arm by hand (PHY-63)."""
    return None if scene is None else replace(scene, people=())


def led_cell(cell: CellParameters, led: Led | None) -> CellParameters:
    """The cell's numbers, for a motion that is led.

    What a force presses on holds the arm up, so how deep an envelope goes into it says nothing. How fast the tool is,
    the watch knows better than the envelope: where that is gentle (PHY-12), it is gentle. A hand needs no reaction to a
    view: nobody in it counts, and nothing else moves.

    Args:
        cell: of the signed file and the configuration.
        led: the motion, as fast as it may be; None for any other.
    """
    match led:
        case LedTool() if MARGIN * surface_speed_m_s(led) <= cell.contact_speed_m_s:
            return replace(cell, contact_depth_m=ANY_DEPTH_M, contact_speed_m_s=ANY_SPEED_M_S)
        case LedArm():
            return replace(cell, watch_age_limit_s=0.0, reaction_s=0.0)
        case _:
            return cell


def surface_speed_m_s(led: LedTool) -> float:
    """Highest speed of any part of the tool and what it holds, as the watch lets it be."""
    return (
        math.hypot(*led.speeds[:3])
        + SLACK_M_S
        + REACH_M * (math.hypot(*led.speeds[3:]) + SLACK_RAD_S)
        + FARTHEST_M * math.hypot(*led.speeds[3:])
    )


def led_age(age_s: float | None, cell: CellParameters, led: Led | None) -> float | None:
    """Age of a view to reckon with: of one that is fresh none, where a hand leads the arm."""
    fresh = age_s is not None and age_s <= cell.perception_age_limit_s
    return 0.0 if isinstance(led, LedArm) and fresh else age_s


def floor_milli(led: Led) -> int:
    """Least index of a led motion, in thousandths."""
    return TOUCHING_MILLI if isinstance(led, LedTool) else HAND_MILLI


def with_force(reading: ImpactReading, led: Led, rates: JointRates, *, force_n: float) -> ImpactReading:
    """Reading with what a force or a hand adds to the motion's own (PHY-62). It never lowers the index.

    Args:
        reading: of the envelope.
        led: the motion.
        rates: of it.
        force_n: that it presses with.
    """
    found = [_added("by_force" if isinstance(led, LedTool) else "by_hand", floor_milli(led))]
    near = any(each.kind == "person" and each.index_milli > NEAR_MILLI for each in reading.contributions)
    if near and force_n > 0:
        pressed = TOUCHING_MILLI + math.ceil(1_000 * force_n / WEAKEST_N)  # PHY-61: thousandths
        found.append(_added("clamped_person", min(pressed, int(max(Tier)) * 1_000)))  # thousandths
    index = max(reading.index_milli, *(each.index_milli for each in found))
    ranked = sorted((*reading.contributions, *found), key=lambda each: -each.index_milli)
    return replace(
        reading,
        index_milli=index,
        tier=max(reading.tier, Tier(math.ceil(index / 1_000))),  # thousandths
        contributions=tuple(ranked),
        tcp_speed_um_s=math.ceil(MICRO * rates.tool_speed(reading.tcp_speed_um_s / MICRO)),
    )


def _added(kind: str, index_milli: int) -> Contribution:
    return Contribution(kind, index_milli, "", "", 0, 0, 0)


def _joints(numbers: Floats) -> Joints:
    a, b, c, d, e, f = numbers.tolist()
    return a, b, c, d, e, f


@dataclass(frozen=True, slots=True)
class LedView:
    """The world in which a motion is to be led.

    Attributes:
        scene, age_s: the view, both None when there is none.
        cell: its parameters.
        touch: objects that the token grants to touch.
    """

    scene: Scene | None
    age_s: float | None
    cell: CellParameters
    touch: frozenset[str]

    def reading(
        self, led: Led, robot: Robot, q_rad: Sequence[float], *, force_n: float, seed: bytes
    ) -> ImpactReading | ImpactFault:
        """Impact of a motion that is led from these joint angles, with the highest speed that people could permit.

        Args:
            led: the motion.
            robot: the arm.
            q_rad: where it stands, six.
            force_n: that it presses with.
            seed: digest of the request.

        Raises:
            UnprovenError: as `JointRates.of`.
        """
        found = self._once(led, robot, q_rad, force_n=force_n, seed=seed)
        if isinstance(found, ImpactFault) or _may_be(found):
            return found
        for share in SLOWER:
            tried = slower(led, share)
            instead = self._once(tried, robot, q_rad, force_n=force_n, seed=seed)
            if not isinstance(instead, ImpactFault) and _may_be(instead):
                return replace(found, lower_tier_speed=fastest_of(tried))
        return found

    def _once(
        self, led: Led, robot: Robot, q_rad: Sequence[float], *, force_n: float, seed: bytes
    ) -> ImpactReading | ImpactFault:
        cell = led_cell(self.cell, led)
        rates = JointRates.of(led, robot, q_rad)
        assessed = assess(
            robot,
            led_scene(self.scene) if isinstance(led, LedArm) else self.scene,
            rates.envelope(cell),
            cell,
            perception_age_s=led_age(self.age_s, cell, led),
            touch=self.touch,
            seed=seed,
        )
        if isinstance(assessed, ImpactFault):
            return assessed
        start = tuple(round(angle * Unit.MICRORADIAN.per_si) for angle in q_rad)
        return with_force(replace(assessed.reading(), start_urad=start), led, rates, force_n=force_n)


def _may_be(reading: ImpactReading) -> bool:
    """True where people may permit it without an opening."""
    return not reading.violations and reading.tier <= Tier.HIGH_CONSEQUENCE
