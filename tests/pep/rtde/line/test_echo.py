"""The controller's word on its command register is never taken for newer than it is."""

from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.rtde.line.register_echo import MOST, QUIET, RegisterEcho

pytestmark = pytest.mark.clause("RTDE-13")

IDS = st.sampled_from((0, 0, 1, 11, 28))


@given(
    st.lists(st.lists(IDS, max_size=3), min_size=1, max_size=40),
    st.integers(0, 6),
    st.integers(0, 6),
    st.integers(0, 60),
)
def test_the_newest_is_there_when_it_is_said_to_be(cycles, there, back, rest):
    """Writes are so many cycles on their way, and what is said of them so many on its own."""
    echo, register, written = RegisterEcho(), (0, 0), 0  # what it holds, and the number of the write that brought it
    going, coming, newest = deque([]), deque([]), [0]
    for cycle, ids in enumerate([*cycles, *[[]] * rest]):
        for command in ids:
            written += command != newest[-1]
            newest.append(command)
            echo.wrote(command)
            going.append((cycle + there, command, written))
        while going and going[0][0] <= cycle:
            register = going.popleft()[1:]
        coming.append((cycle + back, *register))
        while coming and coming[0][0] <= cycle:
            _, command, number = coming.popleft()
            echo.told(command)
            assert not echo.newest or number == written
    if rest > QUIET + there + back:
        assert echo.newest


def test_what_was_overwritten_is_not_waited_for_for_ever():
    echo = RegisterEcho()
    echo.wrote(28)
    echo.wrote(0)
    for _ in range(QUIET):
        echo.told(0)
        assert not echo.newest
    echo.told(0)
    assert echo.newest


def test_more_than_can_be_followed_is_believed_only_after_a_while():
    echo = RegisterEcho()
    for _ in range(10 * MOST):
        echo.wrote(28)
        echo.wrote(0)
    for _ in range(QUIET):
        for command in (28, 0):
            echo.told(command)
            assert not echo.newest
    for _ in range(QUIET):
        echo.told(0)
    assert echo.newest
    echo.wrote(1)
    echo.told(1)
    assert echo.newest
