"""Equal lines of a log are told once a minute, however many strangers cause."""

import pytest
import io
import logging

from ztpm.edge.rare_log import KINDS, OnceAMinute


def told(lines, *, step_s):
    """Lines that are written when each comes so many seconds after the one before."""
    at, out = [1_000.0], io.StringIO()
    handler, log = logging.StreamHandler(out), logging.Logger("one")
    handler.addFilter(OnceAMinute(lambda: at[0]))
    log.addHandler(handler)
    for line in lines:
        log.warning("said: %s", line)
        at[0] += step_s
    return out.getvalue().splitlines()


def test_a_flood_of_equal_lines_is_one_line_a_minute_with_its_number():
    assert told(["x"] * 7_681, step_s=1 / 64) == [
        "said: x", "said: x (and 3839 more like it)", "said: x (and 3839 more like it)",
    ]  # fmt: skip


@pytest.mark.long
def test_different_lines_are_told_and_a_flood_of_them_is_not():
    assert told(["x", "y", "x"], step_s=0) == ["said: x", "said: y"]
    assert len(told(map(str, range(100_000)), step_s=0.001)) < 4 * KINDS


def test_a_line_that_comes_seldom_is_told_each_time():
    assert told(["x", "x"], step_s=61) == ["said: x", "said: x"]
