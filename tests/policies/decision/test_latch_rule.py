"""Stops that latch the robot, as a policy set states them: closed words, and a base loses none."""

import pytest
from capabilities.statements.people.latch import LatchCause

from policies import PolicyError, PolicyFault, load, load_shipped
from policies.explain.differences import of_sets

pytestmark = pytest.mark.clause("LSD-21")

HEAD = 'name = "plant"\nversion = 3\nextends = "tools"\n'
NAMED = frozenset(LatchCause) - {LatchCause.UNREADABLE}


def of(text: str) -> frozenset[LatchCause]:
    return load(HEAD + text).latch


def test_nothing_latches_where_nothing_is_said():
    assert of("") == of('latch = "none"\n') == frozenset()
    assert load(HEAD).digest == load(HEAD + 'latch = "none"\n').digest


def test_a_person_clears_after_every_stop_or_after_those_that_are_named():
    assert of('latch = "person"\n') == NAMED
    assert of('latch = "person"\nlatch_on = ["watch", "safety-stop"]\n') == {LatchCause.WATCH, LatchCause.SAFETY_STOP}


def test_the_digest_and_the_differences_show_it():
    one, other = load(HEAD), load(HEAD + 'latch = "person"\nlatch_on = ["watch"]\n')
    assert one.digest != other.digest
    (part,) = of_sets(one, other).parameters
    assert (part.part, part.was, part.now) == ("latch", "none", "watch")


def test_what_a_base_latches_stays_latched():
    base = HEAD + 'latch = "person"\nlatch_on = ["watch"]\n'
    above = 'name = "shift"\nversion = 1\nextends = "plant.toml"\nlatch = {}\n'

    def read(name: str, place: str) -> tuple[str, str]:
        return base, name

    assert load(above.format('"none"'), read=read).latch == {LatchCause.WATCH}
    more = above.format('"person"') + 'latch_on = ["authority"]\n'
    assert load(more, read=read).latch == {LatchCause.WATCH, LatchCause.AUTHORITY}


@pytest.mark.parametrize(
    ("text", "code", "where"),
    [
        ('latch = "operator"\n', PolicyFault.UNKNOWN_VALUE, "latch"),
        ("latch = true\n", PolicyFault.WRONG_TYPE, "latch"),
        ('latch_on = ["watch"]\n', PolicyFault.MISSING_KEY, "latch"),
        ('latch = "none"\nlatch_on = ["watch"]\n', PolicyFault.MISSING_KEY, "latch"),
        ('latch = "person"\nlatch_on = []\n', PolicyFault.EMPTY, "latch_on"),
        ('latch = "person"\nlatch_on = ["stop"]\n', PolicyFault.UNKNOWN_VALUE, "latch_on[0]"),
        ('latch = "person"\nlatch_on = ["unreadable"]\n', PolicyFault.UNKNOWN_VALUE, "latch_on"),
        ('latch = "person"\nlatch_on = ["watch", "watch"]\n', PolicyFault.DUPLICATE_VALUE, "latch_on[1]"),
    ],
)
def test_a_rule_of_another_form_is_refused_with_its_place(text, code, where):
    with pytest.raises(PolicyError) as raised:
        load(HEAD + text)
    assert (raised.value.code, raised.value.where) == (code, where)


def test_no_shipped_set_latches():
    assert not any(load_shipped(name).latch for name in ("paper-default", "strict", "tools"))
