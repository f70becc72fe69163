"""The circle that `movec` follows: where there is none, and where it leads. That it is followed is in `test_script_senders`."""

import pytest
from tests.ursim.cell import HOME, Bench
from ursim.motion.arc import MoveArc
from ursim.motion.arm import Arm
from ursim.motion.motion import MotionError
from ursim.motion.spatial import IDENTITY, to_vector

ARM = Arm.load()
FLANGE = ((0.0, 0.0, 0.0), IDENTITY)


def test_three_points_on_a_line_are_no_circle():
    (x, y, z), rotation = start = ARM.tool(HOME, FLANGE)
    for via, to in (((x, y, z + 0.01), (x, y, z + 0.02)), ((x, y, z), (x, y, z + 0.02)), ((x, y + 0.01, z), start[0])):
        with pytest.raises(MotionError):
            MoveArc(ARM, FLANGE, HOME, via, (to, rotation), speed_m_s=0.1, acceleration_m_s2=1.0, fixed=False)


def test_the_arc_is_where_the_move_leads():
    (x, y, z), rotation = ARM.tool(HOME, FLANGE)
    target = ((x + 0.02, y, z - 0.02), rotation)
    move = MoveArc(
        ARM, FLANGE, HOME, (x + 0.005, y, z - 0.015), target, speed_m_s=0.1, acceleration_m_s2=1.0, fixed=False
    )
    assert move.target == target
    bench = Bench()
    bench.robot.drive.take("me", move)
    assert bench.robot.waypoint == pytest.approx((*target[0], *to_vector(rotation)))
