"""The story as a moving picture: each line once, in its time, and nothing that a picture should not do."""

import re
import xml.etree.ElementTree as Xml

import pytest
from tests.ztpm.demo.test_telling import whole
from ztpm.demo.recording import LASTS_S, ROW, ROWS, STANDS_S, Recording
from ztpm.demo.run import MOVED_RAD
from ztpm.demo.story import CHAPTERS
from ztpm.demo.telling import Telling, figures

pytestmark = pytest.mark.clause(reason="what is seen, not what is decided")

NAME = "{http://www.w3.org/2000/svg}"


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def recorded(told):
    """Picture of these steps, one every three seconds."""
    clock = Clock()
    recording = Recording(clock)
    lines = Telling(recording.console, CHAPTERS)
    for step in told:
        clock.now_s += 3.0
        lines.announce(step.id)
        lines.tell(step)
        recording.look()
    lines.end(figures(told, 61.0, moved_rad=MOVED_RAD))
    return recording.svg()


def texts(svg):
    return ["".join(row.itertext()) for row in Xml.fromstring(svg).iter(f"{NAME}text")]


def test_each_step_is_there_once_and_in_its_colour():
    svg = recorded(whole())
    shown = texts(svg)
    for step in whole():
        assert sum(f" {step.id} " in line for line in shown) >= 1
    denied = next(each for each in Xml.fromstring(svg).iter(f"{NAME}tspan") if (each.text or "").strip() == "DENY")
    assert denied.get("fill") == "#f07178"


def test_lines_come_in_their_time_and_the_last_stands():
    svg = recorded(whole())
    frames = [(float(at), float(up)) for at, up in re.findall(r"([\d.]+)% \{ transform: translateY\((-?\d+)px\)", svg)]
    assert frames[0][0] == 0.0
    assert frames[-1][0] == pytest.approx(100 * LASTS_S / (LASTS_S + STANDS_S), abs=0.01)
    assert [up for _, up in frames] == sorted((up for _, up in frames), reverse=True)
    steps = [at for at, _ in frames]
    assert steps[2] - steps[1] == pytest.approx(steps[20] - steps[19], abs=0.02)  # one every three seconds
    assert frames[-1][1] == (ROWS - len(texts(svg))) * ROW


def test_it_fetches_nothing_runs_nothing_and_says_its_end_without_motion():
    svg = recorded(whole())
    assert not re.search(r"<script|href|url\((?!#window\))|@import|<image|<foreignObject", svg)
    assert "@media not (prefers-reduced-motion: reduce)" in svg


def test_no_word_of_a_step_is_markup():
    first = whole()[0]
    svg = recorded(
        [type(first)(**{**{name: getattr(first, name) for name in first.__slots__}, "told": '</text><script>"&'})]
    )
    assert any('</text><script>"&' in line for line in texts(svg))
