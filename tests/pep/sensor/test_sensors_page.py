"""The page on sensors is executed; its codes and numbers are those of the code."""

import asyncio
import re
from pathlib import Path

import numpy as np
import pytest
from pep.perception.sensor_frames import FrameFault
from pep.perception.stream_check import StreamFault
from pep.sensor import keypoints
from pep.sensor.sensor_error import SensorFault
from tests.house.pages import BLOCK, rows
from tests.pep.sensor.test_keypoints import STANDING
from tests.pep.sensor.test_own_sensor import hearing, made

PAGE = (Path(__file__).parents[3] / "docs" / "sensors.md").read_text("utf-8")
FIVE_LINES, *ADAPTERS = (text for kind, text in BLOCK.findall(PAGE) if kind == "python")
CODE = re.compile(r"`([A-Z_]+)`")


def pinhole():
    """A camera at (2, 0, 0) that looks back along -x, and what it gives of a person who stands."""
    pose = [[0, 0, -1, 2.5], [1, 0, 0, 0], [0, -1, 0, 0.2], [0, 0, 0, 1]]
    found, depth = [], np.zeros((960, 1280))
    for name in keypoints.COCO_17:
        x, y, z = STANDING[name]
        away = 2.5 - x
        u, v = 640 + 500 * y / away, 480 + 500 * (0.2 - z) / away
        depth[int(v)][int(u)] = away
        found.append((u, v, 0.9))
    return {
        "camera_in_base": pose,
        "intrinsics": [[500, 0, 640], [0, 500, 480], [0, 0, 1]],
        "depth": depth,
        "keypoints": found,
        "bits": [0],
        "cloud": np.array([[0.0, 0.1, 1.9]]),
        "centers": np.array([[0.5, 0.5, 0.5]]),
        "sizes": np.array([0.1]),
    }


def test_every_adapter_of_the_page_is_believed():
    async def scenario():
        async with hearing() as (point, place), made(place, keep_s=0) as sensor:
            names, told = {"sensor": sensor, **pinhole()}, []
            see = sensor.see
            sensor.see = lambda *given, **named: told.append(see(*given, **named))
            for block in ADAPTERS:
                exec(compile(block, "docs/sensors.md", "exec"), names)  # noqa: S102 - the page itself
            await point.heard(told[-1].sequence)
            return told

    told = asyncio.run(scenario())
    assert [shown.gateways for shown in told] == [1] * 5
    assert [len(shown.people) for shown in told] == [1, 1, 1, 0, 0]
    assert told[0].unseen == {} and told[2].people == ("front",)


def test_the_five_lines_are_five():
    lines = [line for line in FIVE_LINES.splitlines() if line.strip()]
    assert len(lines) == 5


def test_the_pages_codes_are_all_codes():
    refused = {word for row in rows(PAGE, "code", "for example", "next step") for word in CODE.findall(row[0])}
    assert refused == set(SensorFault)
    found = {word for row in rows(PAGE, "code", "found when") for word in CODE.findall(row[0])}
    assert set(StreamFault) <= found <= {*StreamFault, *FrameFault}


@pytest.mark.parametrize(
    ("row", "numbers"),
    [
        ("the face", [keypoints.NECK_M]),
        ("one shoulder, one hip", [keypoints.SHOULDER_M, keypoints.HIP_M]),
        ("the hips", [keypoints.LEAN_M, keypoints.TRUNK_M]),
        ("a leg", [keypoints.STEP_M]),
        ("a knee", [keypoints.THIGH_M, keypoints.SHIN_M]),
    ],
)
def test_the_pages_lengths_are_those_of_the_code(row, numbers):
    (assumed,) = [each[1] for each in rows(PAGE, "not seen", "assumed", "source") if each[0] == row]
    assert [float(word) for word in re.findall(r"(\d\.\d+) m", assumed)] == numbers
