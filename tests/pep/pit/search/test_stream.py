"""Motion of an arm with a stream; tests/pep/rtde/motion/test_jog.py shows that the envelope bounds it."""

import pytest
from pep.pit.search.speed_envelope import moves_with, stream_envelope

from pep.pit import CellParameters, SpeedJ

HOME = (0.0, -1.5, 1.5, 0.0, 0.5, 0.0)
STREAM = SpeedJ(HOME, (0.4, 0.0, 0.0, 0.0, 0.0, -0.2), 2.0, 0.5)
STILL = (0.0,) * 6


@pytest.mark.parametrize(
    ("qd", "does"),
    [
        (STREAM.qd_rad_s, True),
        ((0.2, 0.0, 0.0, 0.0, 0.0, -0.1), True),
        (STILL, True),
        ((0.419, 0.0, 0.0, 0.0, 0.0, -0.2), True),
        ((0.421, 0.0, 0.0, 0.0, 0.0, -0.2), False),
        ((-0.021, 0.0, 0.0, 0.0, 0.0, 0.0), False),
        ((0.4, 0.0, 0.0, 0.0, 0.0, 0.0), False),  # one joint goes ahead: off the line
        ((0.0, 0.0, 0.0, 0.0, 0.0, -0.2), False),
        ((0.4, 0.03, 0.0, 0.0, 0.0, -0.2), False),
        ((0.4, float("nan"), 0.0, 0.0, 0.0, -0.2), False),
        ((float("nan"), 0.0, 0.0, 0.0, 0.0, -0.2), False),
    ],
)
def test_an_arm_moves_with_a_stream_at_a_share_of_all_its_speeds(qd, does):
    assert moves_with(STREAM, qd) is does


def test_with_a_stream_of_nothing_only_a_resting_arm_moves():
    nothing = SpeedJ(HOME, STILL, 2.0, 0.5)
    assert moves_with(nothing, STILL)
    assert not moves_with(nothing, (0.03, 0.0, 0.0, 0.0, 0.0, 0.0))
    move = stream_envelope(nothing, CellParameters(), under_way=False)
    assert (move.start, move.target) == (HOME, HOME)


def test_the_envelope_reckons_with_the_cells_own_stop_delay():
    reach = [
        stream_envelope(STREAM, CellParameters(stop_delay_s=delay), under_way=False).target[0] for delay in (0.06, 0.1)
    ]
    assert reach[1] - reach[0] == pytest.approx(0.4 * 0.04)
