"""Telling of the demo at three widths: each row once and whole, a claim from the steps' own figures."""

import io

import pytest
from rich.console import Console
from ztpm.cli.demo import _Shown
from ztpm.demo.run import MOVED_RAD, StepReport
from ztpm.demo.story import CHAPTERS, STORY
from ztpm.demo.telling import NEXT, Telling, figures

WIDTHS = [80, 120, 200]
SAID = (
    "braking 13 ms later, standing 82 ms after that, 21 mrad of braking (the model allows 46); authority_lost REVOKED"
)


def report(step, number, **other):
    expect = step.expect
    told = {
        "told": f"{SAID} at number-{number}", "decision": expect.decision, "reason": expect.reason or "NONE", "tier": expect.tier,
        "latency_ms": float(number) if expect.decision == "DENY" else 0.0, "moved_rad": 0.5 if expect.moves else 0.0,
        "recorded": expect.recorded, "attack": expect.attack, "stop_ms": None, "ok": True,
    }  # fmt: skip
    return StepReport(id=step.id, **{**told, **other})


def whole(**changed):
    """Reports of all steps; those named are otherwise."""
    return [report(step, number, **changed.get(step.id, {})) for number, step in enumerate(STORY.steps)]


def printed(width, told, seconds=61.25):
    console = Console(file=io.StringIO(), width=width, soft_wrap=True, highlight=False)
    lines = Telling(console, CHAPTERS)
    for step in told:
        lines.announce(step.id)
        lines.tell(step)
    lines.end(figures(told, seconds, moved_rad=MOVED_RAD))
    return console.file.getvalue()


@pytest.mark.parametrize("width", WIDTHS)
def test_each_row_is_printed_once_and_whole_below_its_chapter(width):
    text = printed(width, whole())
    assert max(map(len, text.splitlines())) <= width
    words = text.split()
    for number, step in enumerate(STORY.steps):
        assert words.count(step.id) == 1
        assert words.count(f"number-{number}") == 1
    places = [text.index(f"{number}  {chapter.title.capitalize()}\n") for number, chapter in enumerate(CHAPTERS, 1)]
    assert places == sorted(places)
    for place, chapter in zip(places, CHAPTERS, strict=True):
        assert place < text.index(chapter.steps[0].id)
    assert all(command in text for command, _ in NEXT)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_row_takes_one_line_where_there_is_room_and_two_where_not(width):
    step = report(STORY.steps[0], 0, told="short")
    rows = [line for line in printed(width, [step]).splitlines() if step.id in line or "short" in line]
    assert len(rows) == (1 if width > 80 else 2)


def test_the_claim_is_made_of_the_steps_figures():
    stops = {"human-enters-stops": {"stop_ms": 95.0}, "revoke-in-motion": {"stop_ms": 141.4}}
    sums = figures(whole(**stops), 61.25, moved_rad=MOVED_RAD)
    attacks = [number for number, step in enumerate(STORY.steps) if step.expect.attack]
    denied = sorted(number for number, step in enumerate(STORY.steps) if step.expect.decision == "DENY")
    assert (sums.attacks, sums.refused) == (len(attacks), len(attacks))
    assert sums.refusal_ms_median == denied[len(denied) // 2]
    assert (sums.stops, sums.stop_ms_slowest) == (2, 141.4)
    assert (sums.motions, sums.unrecorded) == (sum(step.expect.moves for step in STORY.steps), 0)
    text = printed(80, whole(**stops))
    for words in (
        f"{len(attacks)} attacks refused",
        "slowest, from its cause to standstill: 141 ms",
        "43 of 43 steps as told, in 61 s",
    ):
        assert words in text
    assert "nothing moved without a record" in text


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"stolen-refused": {"ok": False, "decision": "PERMIT", "moved_rad": 1.2, "recorded": True}},
            "attacks refused",
        ),
        ({"stolen-refused": {"ok": False, "moved_rad": 1.2}}, "1 without a record"),
        ({"move-empty": {"ok": False, "recorded": False}}, "1 without a record"),
    ],
)
def test_a_broken_story_claims_less(changed, words):
    told = whole(**changed)
    sums = figures(told, 1.0, moved_rad=MOVED_RAD)
    assert (sums.ok, sums.as_told) == (False, 42)
    assert sums.refused == sums.attacks - ("stolen-refused" in changed)
    text = printed(120, told)
    assert words in text
    assert "42 of 43 steps" in text
    assert "✗" in text
    assert ("nothing moved without a record" in text) == (not sums.unrecorded)


def test_a_childs_preparation_stands_behind_the_running_step_until_it_is_over():
    with Console(file=io.StringIO(), width=80, force_terminal=True).status("They start") as status:
        shown = _Shown(status)
        shown.tell("compiling 3 of 26")
        seen = [status.status]
        shown.over()
        seen.append(status.status)
        shown.begin("restart-keeps (38 of 43)")
        shown.tell("starting the gateway, 3 s")
        seen.append(status.status)
        shown.over()
        seen.append(status.status)
    assert seen == [
        "They start: compiling 3 of 26",
        "They start",
        "restart-keeps (38 of 43): starting the gateway, 3 s",
        "restart-keeps (38 of 43)",
    ]
