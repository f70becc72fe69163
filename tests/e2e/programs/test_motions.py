"""Motions of an unmodified ur_rtde program that name poses, paths with blends, or end in a contact; real processes all."""

import textwrap

import pytest
from pep.base.operations import MOVE_LINEAR, MOVE_UNTIL_CONTACT, MOVE_WAYPOINTS, SERVO_LINEAR
from tests.e2e.test_gateway import House, Run, until
from ztpm.stage.stage import LEFT
from ztpm.stage.samples import StateRecorder

pytestmark = [pytest.mark.e2e, pytest.mark.campaign, pytest.mark.timeout(120)]


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("motions"))
    house.agent("mover", MOVE_LINEAR, MOVE_UNTIL_CONTACT, MOVE_WAYPOINTS, SERVO_LINEAR)
    yield house
    house.stage.close()
    house.cell.stop()


@pytest.fixture
def eyes(house):
    with StateRecorder(house.cell.addresses.host) as eyes:
        yield eyes
        until(lambda: eyes.now().still, "standstill")


BEGIN = f"""
assert moves(control.moveJ, {list(LEFT)}, 0.8, 1.4)
q = receive.getActualQ()
"""
"""Each program begins where the arm stood first, wherever another has left it."""


def said(house, text):
    """Lines that a program has said, once it has ended well, and what standard error told."""
    with Run(house, BEGIN + textwrap.dedent(text)) as program:
        status, lines, errors = program.ended()
    assert status == 0, errors
    return [line for line in lines if line.startswith(("True", "False"))], errors


@pytest.mark.clause("LSD-14")
def test_a_pose_is_reached_by_joints_and_joint_angles_by_a_line(house, eyes):
    lines, errors = said(house, """
        pose = receive.getActualTCPPose()
        above = [*pose[:2], pose[2] + 0.03, *pose[3:]]
        say(moves(control.moveJ_IK, above, 0.4, 1.2), abs(receive.getActualTCPPose()[2] - above[2]) < 1e-3)
        say(moves(control.moveL_FK, q, 0.05, 0.3), max(abs(a - b) for a, b in zip(receive.getActualQ(), q)) < 2e-3)
        say(control.moveJ_IK([2.0, *pose[1:]], 0.4, 1.2))
    """)  # fmt: skip
    assert lines == ["True True", "True True", "False"], errors
    assert "UNPROVEN" in errors
    operations = [body["request"]["operation"] for body in house.journal("decision")]
    assert {"move_joint", "move_linear"} <= set(operations)


@pytest.mark.clause("LSD-15")
def test_a_stream_of_poses_is_followed(house, eyes):
    lines, errors = said(house, """
        import math
        x, y, z, *turn = receive.getActualTCPPose()
        least = most = z
        for step in range(250):
            begin = control.initPeriod()
            ahead = 0.02 * (1 - math.cos(step / 250 * 2 * math.pi))
            say(False) if not control.servoL([x, y, z + ahead, *turn], 0, 0, 0.008, 0.1, 300) else None
            most = max(most, receive.getActualTCPPose()[2])
            control.waitPeriod(begin)
        control.servoStop()
        say(most - z > 0.02)
    """)  # fmt: skip
    assert lines == ["True"], errors


@pytest.mark.clause("LSD-16")
def test_a_path_of_joint_moves_and_lines_with_blends_is_followed_to_its_end_and_back(house, eyes):
    lines, errors = said(house, """
        from rtde_control import Path, PathEntry
        x, y, z, *turn = receive.getActualTCPPose()
        J, L, P = (getattr(PathEntry, f"Move{kind}") for kind in "JLP")
        joints, pose = PathEntry.PositionJoints, PathEntry.PositionTcpPose
        path = Path()
        path.addEntry(PathEntry(L, pose, [x, y, z + 0.06, *turn, 0.1, 0.5, 0.01]))
        path.addEntry(PathEntry(L, pose, [x, y + 0.06, z + 0.06, *turn, 0.1, 0.5, 0.01]))
        path.addEntry(PathEntry(P, pose, [x, y + 0.06, z, *turn, 0.08, 0.5, 0.0]))
        path.addEntry(PathEntry(J, joints, [*q, 0.3, 1.0, 0.0]))
        say(control.movePath(path), max(abs(a - b) for a, b in zip(receive.getActualQ(), q)) < 2e-3)
        say(moves(control.moveJ, [q[0] + 0.02, *q[1:]], 0.4, 1.2))
    """)  # fmt: skip
    assert lines == ["True True", "True"], errors
    outcomes = [body["result"]["outcome"] for body in house.journal("outcome")]
    assert outcomes[-2] == "reached"


@pytest.mark.clause("LSD-17")
def test_a_tool_goes_until_it_touches_something(house, eyes):
    robot = house.cell.children["robot"]
    text = """
        say("here", control.moveUntilContact([0, 0, 0.03, 0, 0, 0]))
        say(moves(control.moveJ, receive.getActualQ(), 0.4, 1.2))
    """
    with Run(house, BEGIN + "say('here')" + textwrap.dedent(text)) as program:
        while program.line() != "here":
            pass
        until(lambda: not eyes.now().still, "the arm moves")
        robot.tell({"fault": "touch"})
        status, lines, errors = program.ended()
    robot.tell({"fault": "release_touch"})
    assert (status, lines) == (0, ["here True", "True"]), errors
    ends = [body["result"]["outcome"] for body in house.journal("outcome") if "outcome" in body["result"]]
    assert ends[-2] == "reached"


@pytest.mark.clause("LSD-17")
def test_without_a_contact_it_is_stopped_where_it_was_assessed_to(house, eyes):
    lines, errors = said(house, """
        begin = receive.getActualTCPPose()[1]
        say(control.moveUntilContact([0, 0.05, 0, 0, 0, 0]))
        time.sleep(0.3)
        say(0.01 < receive.getActualTCPPose()[1] - begin < 0.3)
    """)  # fmt: skip
    assert lines == ["False", "True"], errors
    assert "VERDICT_EXPIRED" in errors
