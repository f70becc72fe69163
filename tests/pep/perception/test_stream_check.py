"""A stream of frames by an injected clock: exactly the faults that it has, and none for a good one."""

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.ports import RegisteredSensor
from pep.perception.stream_check import StreamCheck
from pep.sensor.frame_writer import FrameWriter
from tests.pep.kit import CALIBRATION, ManualClock

from capabilities.keys import keys
from capabilities.statements.observation import ObservedPerson
from pep.sensor import person_at

KEY = keys.generate()
PERIOD_MS = 33


def person(x_m, name="bob"):
    return ObservedPerson(name, person_at(x_m, 0.0, floor_z_m=-0.8).regions)


def heard(gaps, *, people=lambda _: (person(1.0),), age_ms=5, lost=(), ahead_ms=0):
    """Report on frames that arrive after these gaps (ms), each captured `age_ms` before."""
    clock = ManualClock()
    registered = RegisteredSensor("camera-1", keys.public_raw(KEY), CALIBRATION, 20)
    check = StreamCheck(registered, clock=clock, caps=CAPS)
    writer = FrameWriter(KEY, name="camera-1", calibration=CALIBRATION)
    for number, gap in enumerate((0, *gaps)):
        clock.advance(gap)
        captured_s = clock.wall_s() - (age_ms - ahead_ms) / 1000
        text = writer.frame(people(number), (), captured_s=captured_s, complete=True)
        if number not in lost:
            check.admit(text.encode())
    return check.report(stated_hz=30)


def codes(report):
    return [str(finding.code) for finding in report.findings]


def test_a_good_stream_has_no_fault():
    report = heard([PERIOD_MS] * 60, people=lambda n: (person(1.0 + 0.04 * n),))  # who walks at 1.2 m/s
    assert codes(report) == []
    assert (report.frames, report.rejected, report.rate_hz, report.gap_ms, report.longest_ms) == (61, 0, 30.3, 33, 33)
    assert (report.people, report.objects, report.ids) == (1, 0, 1) and 4 <= report.age_ms <= 6


@pytest.mark.parametrize(
    ("stream", "wanted"),
    [
        ({"gaps": [2 * PERIOD_MS] * 30}, ["FRAMES_SLOW"]),
        ({"gaps": [20, 20, 60, 20, 40] * 12}, ["FRAMES_JITTER"]),
        ({"gaps": [32, 35, 33, 30, 36] * 12}, []),
        ({"gaps": [*[32] * 59, 131]}, ["FRAMES_GAPS"]),
        ({"gaps": [*[32] * 59, 130]}, []),
        ({"gaps": [30] * 60, "lost": (7, 8)}, ["FRAMES_LOST"]),
        ({"gaps": [PERIOD_MS] * 60, "age_ms": 21}, ["FRAMES_LATE"]),
        ({"gaps": [PERIOD_MS] * 60, "age_ms": 0, "ahead_ms": 25}, ["FRAMES_LATE"]),
        ({"gaps": [PERIOD_MS] * 60, "people": lambda n: (person(3.0 if n == 9 else 1.0),)}, ["PEOPLE_JUMP"]),
        ({"gaps": [PERIOD_MS] * 60, "people": lambda n: (person(1.0, f"p{n}"),)}, ["IDS_CHANGE"]),
        ({"gaps": []}, ["FRAMES_NONE"]),
    ],
)
def test_each_fault_is_found_alone(stream, wanted):
    assert codes(heard(**stream)) == wanted
