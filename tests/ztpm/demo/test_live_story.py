"""The story on a page: each step as it is played, then as it went, newest first."""

from dataclasses import replace

import pytest
from tests.ztpm.status.test_status import PICTURE
from typer.testing import CliRunner
from ztpm.demo.live_story import LiveStory
from ztpm.demo.run import StepReport
from ztpm.status.page import parts_of, render

from ztpm.cli import app


def report(step, *, ok=True, told="the arm moved"):
    return StepReport(
        step, told, "PERMIT", "PERMITTED", 2, 41.0, 0.6, recorded=True, attack=False, stop_ms=None, ok=ok
    )  # fmt: skip


def test_a_step_has_no_outcome_while_it_is_played_and_the_newest_is_first():
    story = LiveStory()
    story.begin("first")
    story.end(report("first"))
    story.begin("second")
    assert [(told.step, told.ok) for told in story.steps] == [("first", True), ("second", None)]
    shown = parts_of(replace(PICTURE, story=story.steps))["story"]
    assert shown.index("second") < shown.index("first")
    assert "as told" in shown and "the arm moved" in shown
    story.end(report("second", ok=False, told="<b>it did not</b>"))
    shown = parts_of(replace(PICTURE, story=story.steps))["story"]
    assert "not as told" in shown and "<b>it did not" not in shown


def test_a_page_without_a_story_has_no_part_for_one():
    assert 'id="part-story"' not in render(PICTURE)
    assert 'id="part-story"' in render(replace(PICTURE, story=()))


@pytest.mark.parametrize("options", [["--web", "--json"], ["--seconds", "5"], ["--web", "--seconds", "-1"]])
def test_what_does_not_belong_together_is_refused_before_anything_starts(options):
    assert CliRunner().invoke(app, ["demo", *options]).exit_code == 2
