"""One arm's own kinematics: read strictly, laid over the model, refused when no arm is like that."""

from tests.shared_data import SHARED
import math
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from pep.pit.proof.proof_document import document
from pep.pit.robot.calibration import OFFSET_LIMIT_M, REMEDY, TIP_LIMIT_M, TURN_LIMIT_RAD, Calibration, calibrated
from pep.pit.robot.kinematics import layout, link_frames
from tests.pep.pit.scenes import CELL, NOTHING, ROBOT, SEED, sweep, with_person

from pep.pit import ModelError, Robot, assess
from pep.pit.checker import Verified, verify

VENDOR = SHARED / "ur3e" / "default_kinematics.yaml"

# Exports of real UR3e, from public repositories; each is named by its own checksum.
ARMS = {
    "calib_13312600673477018527": """
0 0 0.1517904865811983 -0 0 1.639714426737715e-08
-0.0001126135223856559 0 0 1.571031394331694 0 6.42918886669332e-06
-0.2436795097513105 0 0 3.13902504807799 3.140803674653592 -3.141585104151357
-0.2132666614736044 0.0008865010248520851 0.1308674104461727 3.134818717570139 3.141465302621489 3.141582863560339
-2.467626505825984e-07 -0.08526520777962734 -8.715206871095288e-05 1.57181845575734 0 5.426595611951469e-06
-0.0001438684107144593 0.09208416701742521 -0.0001732833644956137 1.568914535759933 3.141592653589793 3.141592183791033
""",
    "calib_10817087306801238825": """
0 0 0.15195934352736501 -0 0 -2.4423885142772425e-07
-0.00012838021460923898 0 0 1.5693603871645228 0 -2.625777488773906e-07
-0.2440734170945362 0 0 0.001563853615413867 0.0028609240507776437 -3.7477495161265791e-06
-0.21335675588695061 -7.5750641088628064e-05 0.13145766498403941 0.00057623595180657748 0.0015264323581925393 -1.5579752734388003e-06
7.7352219036348291e-05 -0.085364629961427116 -2.6460042941462039e-05 1.5711062917312644 0 -1.0038411693559479e-07
-0.00016828902152395765 0.09223064519846684 -0.00012714946282382867 1.5694177244659293 3.1415926535897931 -3.1415926157350684
""",
    "calib_17008457374574081678": """
0 0 0.1519822787547985 -0 0 1.176557886811702e-07
-0.0002243537186244792 0 0 1.570707878064493 0 -1.338211307570004e-06
-0.2435934669712539 0 0 0.0002390260166172327 0.0005017687440046104 5.730097185048492e-06
-0.2133511183537782 0.0007983839857597235 0.1306734167993368 3.135482963714211 3.141171788552023 3.141584309185717
0.0001159196965713822 -0.08535409543341353 2.674630009999679e-05 1.570482969842442 0 -3.645075177804991e-08
-0.0001452816800246179 0.09216146694740841 -5.031191540757315e-05 1.5702504163176 3.141592653589793 -3.141592128975011
""",
    "calib_6234699742970392905": """
0 0 0.15201860713006091 -0 0 1.0463748781504301e-07
-0.00012095106569443626 0 0 1.5700477568451794 0 -4.1956781169361071e-06
-0.24381064699487773 0 0 0.00069601231680915679 0.0012429435099094157 -4.4513701910114445e-06
-0.21329455418658677 -0.00031338026741426774 0.1312807864552995 0.0023870947199425203 0.00077054963478904526 3.0311622496730444e-06
0.00010510498315702839 -0.085229922273429307 -4.2132872669117588e-05 1.5712906704257856 0 1.4986045786431759e-07
-0.00012592566234845572 0.092225916535005656 -0.00021038522700388205 1.5685151365397945 3.1415926535897931 3.1415925731878387
""",
}
NOMINAL = """
0 0 0.15185 0 0 0
0 0 0 1.5707963267948966 0 0
-0.24355 0 0 0 0 0
-0.2132 0 0.13105 0 0 0
0 -0.08535 0 1.5707963267948966 0 0
0 0.0921 0 1.5707963267948966 3.141592653589793 3.141592653589793
"""
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
MEMBERS = ("x", "y", "z", "roll", "pitch", "yaw")


def spelled(numbers, signature="calib_1"):
    """The file that the vendor's tool writes for six rows of numbers."""
    lines = ["kinematics:"]
    for link, row in zip(LINKS, numbers.strip().splitlines(), strict=True):
        lines.append(f"  {link}:")
        lines += [f"    {member}: {number}" for member, number in zip(MEMBERS, row.split(), strict=True)]
    return "\n".join([*lines, f"  hash: {signature}", ""])


def robot_of(text, tool="robotiq_2f85"):
    return Robot.load("ur3e", tool=tool, calibration=Calibration.from_yaml(text))


def by_hand(text, q):
    """The flange by the file's numbers alone: no model, no kinematics of ours."""
    pose = np.eye(4)
    rows = [float(line.split(":")[1]) for line in text.splitlines() if line.startswith("    ")]
    for k, angle in enumerate(q):
        x, y, z, roll, pitch, yaw = rows[6 * k : 6 * k + 6]
        step = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(roll, pitch, yaw), np.array([x, y, z])).homogeneous
        turn = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(0, 0, angle), np.zeros(3)).homogeneous
        pose = pose @ step @ turn
    return pose


@pytest.mark.parametrize("signature", ARMS)
def test_an_arm_stands_where_its_own_file_says(signature):
    """Kernel and pinocchio follow the file; the tool point is millimetres from nominal, and no farther than the bound."""
    text = spelled(ARMS[signature], signature)
    robot = robot_of(text)
    data = robot.pinocchio.createData()
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (300, 6))
    rotation, origin = link_frames(robot, q)
    nominal_rotation, nominal_origin = link_frames(ROBOT, q)
    tip = np.array(robot.tool.tcp_m)
    apart = np.linalg.norm(
        rotation[:, 6] @ tip + origin[:, 6] - nominal_rotation[:, 6] @ tip - nominal_origin[:, 6], axis=1
    )
    for row in range(len(q)):
        pose = by_hand(text, q[row])
        assert np.abs(rotation[row, 6] - pose[:3, :3]).max() <= 1e-12
        assert np.abs(origin[row, 6] - pose[:3, 3]).max() <= 1e-12
        pinocchio.framesForwardKinematics(robot.pinocchio, data, q[row])
        assert np.abs(data.oMf[robot.pinocchio.getFrameId("flange")].homogeneous - pose).max() <= 1e-12
    assert 0.002 <= apart.max() <= TIP_LIMIT_M


def test_what_is_derived_follows():
    """Reach stays a bound on this arm; digests differ from nominal, between arms, and with the tool."""
    one, other = (robot_of(spelled(ARMS[s])) for s in list(ARMS)[:2])
    assert not np.allclose(one.reach, ROBOT.reach, atol=1e-6)
    q = np.random.default_rng(2).uniform(-math.pi, math.pi, (1500, 6))
    rotation, origin = link_frames(one, q)
    plan = layout(one)
    ends = np.einsum("nbij,bej->nbei", rotation[:, plan.link], plan.ends) + origin[:, plan.link, None]
    for k in range(1, 7):
        lever = np.linalg.norm(np.cross(ends - origin[:, k, None, None], rotation[:, k, None, None, :, 2]), axis=-1)
        moved = plan.moved_by[:, k - 1] > 0
        assert (lever.max(axis=(0, 2))[moved] <= one.reach[moved, k - 1] + 1e-12).all()
    first = next(iter(ARMS))
    hand_e = robot_of(spelled(ARMS[first], first), "robotiq_hande")
    assert len({r.model_digest for r in (ROBOT, one, other, hand_e)}) == 4
    assert [source.kind for source in one.model.derived_from] == ["calibration"]
    assert one.model.derived_from[0].sha256 != other.model.derived_from[0].sha256


def test_the_checksum_is_in_the_digest():
    """The same numbers under another checksum are another file."""
    rows = ARMS["calib_6234699742970392905"]
    assert robot_of(spelled(rows, "calib_1")).model_digest != robot_of(spelled(rows, "calib_2")).model_digest


def test_a_calibrated_arm_is_assessed():
    """An answer, and not a disagreement of the engines: both know this arm's kinematics."""
    signature = "calib_13312600673477018527"
    own = robot_of(spelled(ARMS[signature], signature))
    found, nominal = (
        assess(robot, with_person(), sweep(), CELL, perception_age_s=0.1, touch=NOTHING, seed=SEED)
        for robot in (own, ROBOT)
    )
    assert (found.tier, found.violations) == (nominal.tier, ())
    assert found.model_digest == own.model_digest != nominal.model_digest
    asked = {"perception_age_s": 0.1, "touch": NOTHING}
    proof = document(found, robot=own, scene=with_person(), motion=sweep(), cell=CELL, **asked)
    assert isinstance(verify(proof), Verified)
    assert 0 < abs(found.clearance_m - nominal.clearance_m) <= TIP_LIMIT_M


@pytest.mark.skipif(not VENDOR.is_file(), reason="vendor files are not beside the checkout (../shared/data/ur3e)")
@pytest.mark.shared
def test_the_vendors_default_file_is_the_nominal_arm():
    calibration = Calibration.from_yaml(VENDOR.read_text())
    robot = Robot.load("ur3e", calibration=calibration)
    assert calibration.signature == "calib_16756443741236045476"
    q = np.random.default_rng(3).uniform(-math.pi, math.pi, (50, 6))
    assert np.abs(link_frames(robot, q)[1] - link_frames(ROBOT, q)[1]).max() <= 1e-9


def changed(joint, column, by):
    rows = [line.split() for line in NOMINAL.strip().splitlines()]
    rows[joint][column] = repr(float(rows[joint][column]) + by)
    return "\n".join(" ".join(row) for row in rows)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize(
    ("column", "limit"),
    [(0, OFFSET_LIMIT_M), (1, OFFSET_LIMIT_M), (2, OFFSET_LIMIT_M), (3, TURN_LIMIT_RAD), (5, TURN_LIMIT_RAD)],
)
def test_each_entry_has_its_bound(joint, column, limit):
    """Alone, an offset may go to its bound; a turn is also bound by its effect on the tool point."""
    with pytest.raises(ModelError) as caught:
        robot_of(spelled(changed(joint, column, 1.01 * limit)))
    assert caught.value.reason == "PHYSICS_FAULT"
    share = 0.99 if limit == OFFSET_LIMIT_M or joint >= 2 else 0.5
    assert robot_of(spelled(changed(joint, column, share * limit))).model.derived_from


def test_the_tool_point_has_its_bound():
    """Each joint within its own bound, and the arm as a whole too far off."""
    rows = [line.split() for line in NOMINAL.strip().splitlines()]
    for row in rows:
        row[0] = repr(float(row[0]) + 0.95 * OFFSET_LIMIT_M)
        row[5] = repr(float(row[5]) + 0.3 * TURN_LIMIT_RAD)
    text = spelled("\n".join(" ".join(row) for row in rows))
    with pytest.raises(ModelError):
        robot_of(text)


def test_another_robot_is_refused():
    """The wrist of a UR3 of the generation before stands 19 mm elsewhere."""
    with pytest.raises(ModelError):
        robot_of(spelled(changed(3, 2, 0.11235 - 0.13105)))


def test_a_flipped_frame_is_refused():
    """Elbow and wrist turned by half a turn each, as some exports state them: the angles then mean another pose."""
    with pytest.raises(ModelError):
        robot_of(spelled(changed(2, 5, math.pi)))


def test_a_calibration_that_is_metres_off_names_its_remedy():
    """Millimetres for metres: the file of another program."""
    with pytest.raises(ModelError) as caught:
        robot_of(spelled(changed(2, 0, 3.0)))
    assert caught.value.reason == "PHYSICS_FAULT" and str(caught.value).endswith(REMEDY)


def test_nobody_calibrates_twice():
    calibration = Calibration.from_yaml(spelled(NOMINAL))
    once = calibrated(ROBOT.model, calibration)
    with pytest.raises(ModelError):
        calibrated(once, calibration)
    with pytest.raises(ModelError):
        calibrated(ROBOT.model, replace(calibration, joints=calibration.joints[:5]))


GOOD = spelled(NOMINAL)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "kinematics",
        "[" * 16_000,
        "{" * 16_000,
        GOOD + "\n" * 20_000,
        GOOD.replace("kinematics:", "kinematic:"),
        GOOD.replace("  hash: calib_1\n", ""),
        GOOD.replace("hash: calib_1", "hash: 1"),
        GOOD.replace("hash: calib_1", "hash: calib_" + "1" * 21),
        GOOD.replace("hash: calib_1", "hash: [calib_1]"),
        GOOD.replace("  hash: calib_1", "  hash: calib_1\n  hash: calib_1"),
        GOOD.replace("hash: calib_1", "hash: calib_1\n  more: 1"),
        GOOD + "more: 1\n",
        GOOD + "---\nkinematics: {}\n",
        GOOD.replace("  forearm:", "  lower_arm:"),
        GOOD.replace("  forearm:", "  shoulder:"),
        GOOD.replace("  forearm:", "  forearm: &a"),
        GOOD.replace("  forearm:", "  forearm: !!map"),
        GOOD.replace("x: -0.24355", "x: !!float -0.24355"),
        GOOD.replace("x: -0.24355", "x: *a"),
        GOOD.replace("x: -0.24355", "x: [-0.24355]"),
        GOOD.replace("x: -0.24355", "x: .nan"),
        GOOD.replace("x: -0.24355", "x: nan"),
        GOOD.replace("x: -0.24355", "x: -.inf"),
        GOOD.replace("x: -0.24355", "x: 1e999"),
        GOOD.replace("x: -0.24355", "x: -0_0.24355"),
        GOOD.replace("x: -0.24355", "x: 0x1"),
        GOOD.replace("x: -0.24355", "x:"),
        GOOD.replace("x: -0.24355", "y: -0.24355"),
        GOOD.replace("    x: -0.24355\n", ""),
        GOOD.replace("x: -0.24355", "x: -0.24355\n    x: -0.24355"),
        GOOD.replace("x: -0.24355", "w: -0.24355"),
        GOOD.replace("x: -0.24355", "x: -٠.24355"),
        "!!python/object/apply:os.system [id]",
        GOOD.replace("  forearm:", "\tforearm:"),
        "\x00",
        "\ud800",
    ],
)  # fmt: skip
def test_a_file_of_another_form_is_refused(text):
    assert text != GOOD
    with pytest.raises(ModelError) as caught:
        Calibration.from_yaml(text)
    assert caught.value.reason == "PHYSICS_FAULT"


def test_the_form_itself_is_read():
    assert Calibration.from_yaml(GOOD).joints[2].offset_m == (-0.24355, 0.0, 0.0)
    assert Calibration.from_yaml("# exported\n---\n" + GOOD + "...\n").signature == "calib_1"
