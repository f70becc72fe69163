"""Every recorded decision is taken again: what differs is shown whole, and is meant or a fault.

When it is meant: `python -m tests.vectors.decisions.generate`, and say so with the change.
"""

import collections
import json

import pytest
from tests.vectors.decisions import corpus

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("recorded decisions")]  # taken again once, by one worker


@pytest.fixture(scope="module")
def replayed():
    return list(corpus.decisions())


def test_every_recorded_decision_is_taken_again(replayed):
    found = [
        corpus.Difference(number, name, document, was, now)
        for number, name, document, was, now in replayed
        if corpus.answer(now) != was
    ]
    classes = collections.Counter((d.was.effect, d.was.reason, str(d.now.effect), str(d.now.reason)) for d in found)
    assert not found, f"{len(found)} of {len(replayed)} differ: {classes.most_common(10)}\n{found[0]}"


def test_they_are_many_and_of_every_kind(replayed):
    assert len(replayed) >= 20_000
    effects = collections.Counter(was.effect for *_, was, _ in replayed)
    assert set(effects) == {"PERMIT", "DENY", "DEFER"}
    assert min(effects.values()) >= 1_000
    assert len({was.reason for *_, was, _ in replayed}) >= 70
    assert {was.tier for *_, was, _ in replayed} == {None, 0, 1, 2, 3, 4}


def test_they_are_small():
    assert sum(path.stat().st_size for path in (corpus.CASES, corpus.SETS, corpus.ANSWERS)) <= 2_000_000


def test_a_difference_is_readable(replayed):
    number, name, document, was, now = replayed[0]
    shown = str(corpus.Difference(number, name, document, was, now))
    assert was.reason in shown
    assert json.dumps(document["request"]["operation"]) in shown


def test_an_answer_is_of_everything_but_the_words_for_people(replayed):
    from dataclasses import replace

    from policies.evidence.model import Finding

    now = next(now for *_, now in replayed if now.findings)
    recorded = corpus.answer(now)
    first = now.findings[0]
    reworded = Finding(first.primitive, first.reason, {**first.detail, "remedy": "Think again."})
    assert corpus.answer(replace(now, findings=(reworded, *now.findings[1:]))) == recorded
    for change in (
        {"findings": (Finding(first.primitive, first.reason, {**first.detail, "more": 1}), *now.findings[1:])},
        {"obligations": ()},
        {"lifetime_ms": now.lifetime_ms + 1},
        {"primitive": "TEA-9"},
        {"tier": None if now.tier is not None else 1},
    ):
        assert corpus.answer(replace(now, **change)) != recorded, change


def test_the_example_is_the_ordinary_case():
    from tests.vectors.decisions.generate import EXAMPLE, example

    assert json.loads(EXAMPLE.read_text("ascii")) == example()
