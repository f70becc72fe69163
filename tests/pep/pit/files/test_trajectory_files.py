"""Trajectories as planners, spreadsheets and learning programs write them: read exactly, or refused with the place."""

import json
from pathlib import Path, PurePath

import jsonschema
import pytest
from docs import generate
from pep.pit.base.errors import PitError
from pep.pit.base.timed_points import POINTS_MOST
from pep.pit.files.plain_file import FILE_LIMIT_BYTES, value_of
from pep.pit.files.schemas import trajectory_schema
from pep.pit.files.trajectory_file import is_trajectory, trajectory_of, trajectory_of_csv
from tests.pep.pit.scenes import ROBOT


JOINTS = [joint.name for joint in ROBOT.model.joints]
EXAMPLES = Path(generate.__file__).parent / "examples"
FIRST, SECOND = (0.0, -1.6, 1.2, -1.2, -1.57, 0.0), (0.3, -1.5, 1.2, -1.2, -1.57, 0.1)
ROS = [f"{name}_joint" for name in JOINTS]
"""As the vendor's ROS description names them."""
SHUFFLED = [2, 1, 0, 3, 4, 5]
"""MoveIt sorts joints by name."""


def message(*, names=ROS, order=SHUFFLED, old=False, **changed):
    def time(seconds, part):
        return {"secs": seconds, "nsecs": part} if old else {"sec": seconds, "nanosec": part}

    points = [
        {"positions": [row[at] for at in order], "velocities": [0.0] * 6, "time_from_start": time(*when)}
        for row, when in ((FIRST, (0, 0)), (SECOND, (1, 500_000_000)))
    ]
    return {"joint_names": [names[at] for at in order], "points": points} | changed


def csv(rows=((0, FIRST), (1.5, SECOND)), header="time_s,q0,q1,q2,q3,q4,q5"):
    return "\n".join([header, *(",".join(map(str, (t, *row))) for t, row in rows)]) + "\n"


def read(value, name="plan.json"):
    raw = value if isinstance(value, bytes) else json.dumps(value).encode()
    return trajectory_of(value_of(raw, PurePath(name)), JOINTS)


def told(ask):
    with pytest.raises(PitError) as raised:
        ask()
    return raised.value.reason, raised.value.detail


# ---- what is read


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("names", [ROS, JOINTS])
@pytest.mark.parametrize("old", [False, True])
def test_a_message_of_moveit_is_in_the_arms_own_order(names, old, wrapped):
    stated = message(names=names, old=old)
    plan = {"joint_trajectory": stated, "multi_dof_joint_trajectory": {"joint_names": [], "points": []}}
    found = read(plan if wrapped else stated)
    assert (found.times_s, found.points) == ((0.0, 1.5), (FIRST, SECOND))
    assert found.speeds == ((0.0,) * 6,) * 2


def test_yaml_says_the_same_as_json():
    text = """
joint_names: [elbow_joint, shoulder_lift_joint, shoulder_pan_joint, wrist_1_joint, wrist_2_joint, wrist_3_joint]
points:
  - positions: [1.2, -1.6, 0, -1.2, -1.57, 0]
    velocities: [0, 0, 0, 0, 0, 0]
    time_from_start: {sec: 0, nanosec: 0}
  - positions: [1.2, -15e-1, .3, -1.2, -1.57, 0.1]
    velocities: [0, 0, 0, 0, 0, 0]
    time_from_start: {sec: 1, nanosec: 500000000}
"""
    assert read(text.encode(), "plan.yaml") == read(message())


def test_rows_of_a_csv_file_with_joints_by_number_or_name_and_with_speeds():
    plain = trajectory_of_csv(csv(), PurePath("a.csv"), JOINTS)
    assert (plain.times_s, plain.points, plain.speeds) == ((0.0, 1.5), (FIRST, SECOND), ())
    header = ",".join(["time_s", *reversed(ROS), *(f"{name}_velocity" for name in ROS)])
    rows = [(0, (*reversed(FIRST), *[0.0] * 6)), (1.5, (*reversed(SECOND), *[0.0] * 6))]
    named = trajectory_of_csv(csv(rows, header), PurePath("a.csv"), JOINTS)
    assert (named.points, named.speeds) == (plain.points, ((0.0,) * 6,) * 2)
    assert trajectory_of_csv("﻿".strip("﻿") + csv().replace("\n", "\r\n"), PurePath("a.csv"), JOINTS) == plain


def test_actions_of_a_lerobot_dataset_are_rows_at_its_rate():
    stated = {"fps": 30, "unit": "rad", "names": [f"{name}.pos" for name in JOINTS], "action": [FIRST, SECOND, SECOND]}
    found = read(stated)
    assert found.times_s == (0.0, 0.033333, 0.066667)  # in whole microseconds, as a request has them
    assert found.points == (FIRST, SECOND, SECOND)


def test_numbers_are_those_of_a_request():
    stated = message()
    stated["points"][1]["positions"][0] = 1.23456789
    assert read(stated).points[1][2] == 1.234568


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.trajectory.*")), ids=lambda each: each.name)
def test_the_examples_are_read(file):
    if file.suffix == ".csv":
        assert len(trajectory_of_csv(file.read_text(), file, JOINTS).points) > 2
        return
    value = value_of(file.read_bytes(), file)
    jsonschema.validate(value, trajectory_schema())
    assert is_trajectory(value)
    assert len(trajectory_of(value, JOINTS).points) > 2


def test_there_are_examples_of_each_kind():
    assert {file.suffix for file in EXAMPLES.glob("*.trajectory.*")} == {".csv", ".json", ".yaml"}


# ---- what is refused, and where


def point(number, **changed):
    stated = message()
    stated["points"][number] |= changed
    return stated


def later(stated, number, **time):
    stated["points"][number]["time_from_start"] = {"sec": 0, "nanosec": 0} | time
    return stated


LONG = {"names": JOINTS, "fps": 30, "unit": "rad", "action": [FIRST] * (POINTS_MOST + 1)}


@pytest.mark.parametrize(
    ("stated", "reason", "place"),
    [
        (message(points=[]), "PARAMETERS_WRONG", ""),
        (message(names=["pan", *ROS[1:]]), "PARAMETERS_WRONG", "joint_names"),
        (message(names=[ROS[1], *ROS[1:]]), "PARAMETERS_WRONG", "joint_names"),
        (message() | {"joint_names": ROS[:5]}, "PARAMETERS_WRONG", "joint_names"),
        (message() | {"joint_names": [*ROS, "finger_joint"]}, "PARAMETERS_WRONG", "joint_names"),
        (point(1, positions=[0.0] * 5), "PARAMETERS_WRONG", "trajectory.points.1.positions"),
        (point(1, positions=["0.1"] * 6), "PARAMETERS_WRONG", "trajectory.points.1.positions.0"),
        (point(1, velocities=[]), "PARAMETERS_WRONG", "point 1"),
        (point(0, velocities=[0.0] * 4), "PARAMETERS_WRONG", "point 0"),
        (point(1, effort=[1.0] * 6), "PARAMETERS_WRONG", "trajectory.points.1.effort"),
        (point(1, extra=1), "PARAMETERS_WRONG", "trajectory.points.1.extra"),
        (point(1, time_from_start={"sec": -1, "nanosec": 0}), "PARAMETERS_WRONG", "trajectory.points.1"),
        (later(message(), 1), "OUT_OF_RANGE", "point 1"),
        (later(message(), 0, sec=1), "OUT_OF_RANGE", "point 0"),
        (message(header={"stamp": {"sec": 5, "nanosec": 0}, "frame_id": ""}), "OUT_OF_RANGE", "header.stamp"),
        (
            {"joint_trajectory": message(), "multi_dof_joint_trajectory": {"joint_names": ["base"], "points": []}},
            "PARAMETERS_WRONG",
            "trajectory.multi_dof_joint_trajectory.joint_names",
        ),
        (LONG, "OUT_OF_RANGE", f"point {POINTS_MOST}"),
        (LONG | {"action": [FIRST, FIRST], "unit": "deg"}, "PARAMETERS_WRONG", "trajectory.unit"),
        (LONG | {"action": [FIRST, FIRST], "fps": 0}, "PARAMETERS_WRONG", "trajectory.fps"),
    ],
)
def test_a_message_that_is_refused(stated, reason, place):
    found, detail = told(lambda: read(stated))
    assert found == reason
    assert detail.startswith(place), detail


@pytest.mark.parametrize(
    ("text", "reason", "line"),
    [
        ("", "PARAMETERS_WRONG", 1),
        ("t,q0,q1,q2,q3,q4,q5\n", "PARAMETERS_WRONG", 1),
        ("time_s,q0,q1,q2,q3,q4\n", "PARAMETERS_WRONG", 1),
        ("time_s,q0,q1,q2,q3,q4,q4\n", "PARAMETERS_WRONG", 1),
        (csv(((0, FIRST), (1, SECOND[:5]))), "PARAMETERS_WRONG", 3),
        (csv(((0, FIRST), (1, ("nan", *SECOND[1:])))), "NOT_FINITE", 3),
        (csv(((0, FIRST), (1, ("1e999", *SECOND[1:])))), "NOT_FINITE", 3),
        (csv(((0, FIRST), (1, ("x", *SECOND[1:])))), "NOT_A_NUMBER", 3),
        (csv(((0, FIRST), (1, ("1_0", *SECOND[1:])))), "NOT_FINITE", 3),
        (csv(((0, ('"0', *FIRST[1:])),)), "BODY_MALFORMED", 2),
    ],
)
def test_rows_that_are_refused(text, reason, line):
    found, detail = told(lambda: trajectory_of_csv(text, PurePath("a.csv"), JOINTS))
    assert found == reason
    assert detail.startswith(f"a.csv, line {line}"), detail


@pytest.mark.parametrize("times", [(0, 0), (0, 1, 1), (0, 1, 0.5), (1, 2)])
def test_times_that_do_not_rise_from_0(times):
    rows = [(t, FIRST) for t in times]
    found, detail = told(lambda: trajectory_of_csv(csv(rows), PurePath("a.csv"), JOINTS))
    assert found == "OUT_OF_RANGE"
    assert detail.startswith(f"point {0 if times[0] else len(times) - 1}"), detail


def test_a_million_rows_are_refused_before_they_are_read():
    rows = csv([(0.01 * n, FIRST) for n in range(POINTS_MOST + 1)])
    assert told(lambda: trajectory_of_csv(rows, PurePath("a.csv"), JOINTS))[0] == "OUT_OF_RANGE"
    assert told(lambda: value_of(b"[" * (FILE_LIMIT_BYTES + 1), PurePath("a.yaml")))[0] == "BODY_TOO_LARGE"


@pytest.mark.parametrize(
    ("text", "reason", "line"),
    [
        ("a: &x [1]\nb: *x\n", "BODY_MALFORMED", 1),
        ("a: [1]\nb: *x\n", "BODY_MALFORMED", 2),
        ("a: !!python/object/apply:os.system ['true']\n", "BODY_MALFORMED", 1),
        ("a: !!float 1\n", "BODY_MALFORMED", 1),
        ("a: 1\nb: 2\na: 3\n", "BODY_MALFORMED", 3),
        ("a: 1\n<<: {b: 2}\n", "BODY_MALFORMED", 2),
        ("a: 1\n---\nb: 1\n", "BODY_MALFORMED", 2),
        ("? [1]\n: 2\n", "BODY_MALFORMED", 1),
        ("a: .nan\n", "NOT_FINITE", 1),
        ("a: [1, -.inf]\n", "NOT_FINITE", 1),
        ("a: [1\n", "BODY_MALFORMED", 2),
        ("a: " + "[" * 40 + "]" * 40 + "\n", "BODY_MALFORMED", 1),
        ("a: [" + "1," * 30_000 + "]\n", "BODY_TOO_LARGE", 1),
    ],
)
def test_yaml_with_more_than_plain_values_is_refused(text, reason, line):
    found, detail = told(lambda: value_of(text.encode(), PurePath("a.yaml")))
    assert (found, detail.startswith(f"a.yaml: line {line}:")) == (reason, True), detail


def test_quoted_and_unquoted_words_of_yaml():
    text = "a: '1'\nb: yes\nc: 2001-01-01\nd: null\ne: true\nf: 0x10\ng: -1e3\n"
    assert value_of(text.encode(), PurePath("a.yml")) == {
        "a": "1", "b": "yes", "c": "2001-01-01", "d": None, "e": True, "f": "0x10", "g": -1000.0,
    }  # fmt: skip
