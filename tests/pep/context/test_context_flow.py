"""Labels of contexts: they only get worse, in any order, and nothing is forgotten for the better."""

from __future__ import annotations

import pytest
from capabilities.statements.context.admission import OTHERS, SIGNERS
from hypothesis import given
from hypothesis import strategies as st
from pep.context.flow import HOPS, KEPT_MS, READERS, Context, Flow, Full, Holder, own
from policies.words.labels import NOBODY, Integrity, Label, Source, joined
from tests.capabilities.world import NOW
from tests.pep.context.context_kit import CURATED, SENSED, UNVOUCHED, chain_to, replaced
from tests.pep.kit import ManualClock

from pep.context import flow as flow_module

HOLDER = Holder("0a" * 16, "robotic")
HERE = Context(HOLDER)
labels = st.builds(
    Label,
    sources=st.frozensets(st.sampled_from(Source), min_size=1),
    signers=st.frozensets(st.sampled_from(["alice", "dora", "camera-1", "robotic"])),
    integrity=st.sampled_from(Integrity),
    age_ms=st.integers(0, 10**9),
    tainted=st.booleans(),
)


def flow(**other):
    clock = ManualClock(NOW)
    return Flow(clock, **other), clock


def no_better(label: Label, than: Label) -> bool:
    return (
        label.integrity <= than.integrity
        and label.age_ms >= than.age_ms
        and label.tainted >= than.tainted
        and label.sources >= than.sources
        and label.signers >= than.signers
    )


def test_an_empty_context_says_its_holders_own_choice():
    here, _ = flow()
    assert here.label(HERE) == Label(frozenset({Source.AGENT}), frozenset({"robotic"}), Integrity.AGENT, 0)
    assert here.context(chain_to("robotic").leaf) == Context(Holder(chain_to("robotic").leaf.hop_id, "robotic"))


def test_what_comes_out_derives_from_everything_that_entered():
    here, clock = flow()
    here.enter(HERE, CURATED)
    clock.advance(500)
    here.enter(HERE, SENSED)
    clock.advance(250)
    found = here.label(HERE)
    assert found.sources == {Source.AGENT, Source.RETRIEVAL, Source.SENSOR}
    assert (found.signers, found.integrity, found.age_ms) == ({"robotic", "dora", "camera-1"}, Integrity.AGENT, 750)
    here.enter(HERE, UNVOUCHED)
    assert here.label(HERE).integrity is Integrity.NONE


def test_a_taint_stays():
    here, clock = flow()
    here.enter(HERE, replaced(CURATED, tainted=True))
    for _ in range(3):
        here.enter(HERE, CURATED)
        clock.advance(KEPT_MS // 2)
        here.keep(HERE)
    assert here.label(HERE).tainted


@given(st.lists(st.tuples(labels, st.integers(0, 10_000)), min_size=1, max_size=12))
def test_a_context_never_gets_better(entered):
    here, clock = flow()
    before = here.label(HERE)
    for label, wait_ms in entered:
        assert here.enter(HERE, label) is None
        now = here.label(HERE)
        assert no_better(now, before) and no_better(now, label)
        clock.advance(wait_ms)
        before = here.label(HERE)
        assert no_better(before, now) and before.age_ms == now.age_ms + wait_ms


@given(st.lists(labels, min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_the_order_does_not_matter(entered, random):
    here, _ = flow()
    there, _ = flow()
    shuffled = list(entered)
    random.shuffle(shuffled)
    for one, other in zip(entered, shuffled, strict=True):
        here.enter(HERE, one)
        there.enter(HERE, other)
    assert here.label(HERE) == there.label(HERE) == joined((own(HOLDER), *entered))


# --- a new token is no new memory ------------------------------------------------------------------------------------


def test_a_new_hop_of_an_agent_begins_with_what_it_knows():
    here, _ = flow()
    here.enter(HERE, replaced(CURATED, tainted=True))
    renewed, other = Context(Holder("0b" * 16, "robotic")), Context(Holder("0c" * 16, "vision"))
    assert here.label(renewed).tainted
    here.enter(renewed, SENSED)
    assert here.label(renewed).tainted and not here.label(other).tainted
    here.unsafe_forget("robotic")
    assert here.label(renewed) == own(renewed.holder)


def test_hops_that_run_beside_each_other_are_told_apart():
    here, _ = flow()
    one, other = Context(Holder("01" * 16, "robotic")), Context(Holder("02" * 16, "robotic"))
    here.enter(one, SENSED)
    here.enter(other, SENSED)
    here.enter(one, replaced(CURATED, tainted=True))
    assert here.label(one).tainted and not here.label(other).tainted


def test_what_is_told_apart_no_more_is_not_forgotten():
    here, _ = flow()
    here.enter(HERE, replaced(CURATED, tainted=True))
    here.unsafe_forget("vision")
    for n in range(HOPS):
        here.enter(Context(Holder(f"{n:032x}", "robotic")), SENSED)
    assert here.label(HERE).tainted
    assert here.label(Context(Holder("ff" * 16, "robotic"))).tainted


@given(st.lists(st.tuples(st.integers(0, 5), labels), max_size=20))
def test_with_little_memory_nothing_is_lost(entered):
    """An agent with two contexts told apart uses six: a new one begins with all that entered any."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(flow_module, "HOPS", 2)
        here, _ = flow()
        for n, label in entered:
            here.enter(Context(Holder(f"{n:032x}", "robotic")), label)
            assert no_better(here.label(Context(Holder(f"{n:032x}", "robotic"))), label)
        new = here.label(Context(Holder("ff" * 16, "robotic")))
        assert new == joined((own(HOLDER), *(label for _, label in entered)))
        assert all(len(memory.contexts) <= 2 for memory in here._memory.values())


def test_who_is_too_many_enters_nothing():
    here, clock = flow(agents=2)
    first, second, third = (Context(Holder(f"{n:032x}", f"agent-{n}")) for n in range(3))
    here.enter(first, CURATED)
    here.enter(second, CURATED)
    assert here.enter(third, CURATED) == Full("agents")
    assert here.fresh(third.holder) == Full("agents")
    clock.advance(KEPT_MS)
    assert here.enter(third, CURATED) == Full("agents")
    clock.advance(1)
    here.keep(second)
    assert here.enter(third, CURATED) is None
    assert here.label(second).integrity is Integrity.AGENT and Source.RETRIEVAL in here.label(second).sources


def test_many_signers_are_others():
    here, _ = flow()
    here.enter(HERE, replaced(CURATED, signers=frozenset(f"s{n:03}" for n in range(SIGNERS * 2))))
    found = here.label(HERE)
    assert len(found.signers) == SIGNERS and OTHERS in found.signers
    here.enter(HERE, SENSED)
    assert OTHERS in here.label(HERE).signers and len(here.label(HERE).signers) == SIGNERS


# --- readers ---------------------------------------------------------------------------------------------------------


def test_a_reader_keeps_its_reading_to_itself():
    here, _ = flow()
    here.enter(HERE, replaced(UNVOUCHED, tainted=True))
    reader = here.fresh(HOLDER)
    assert here.label(reader) == own(HOLDER)
    here.enter(reader, CURATED)
    assert not here.label(reader).tainted
    other = here.fresh(HOLDER)
    here.enter(other, replaced(CURATED, tainted=True))
    assert not here.label(reader).tainted
    assert here.close(reader).sources == {Source.AGENT, Source.RETRIEVAL}


def test_a_reader_does_not_touch_the_context_it_reads_for():
    here, _ = flow()
    reader = here.fresh(HOLDER)
    here.enter(reader, replaced(UNVOUCHED, tainted=True))
    assert here.label(HERE) == own(HOLDER)
    assert here.close(reader).tainted
    assert here.label(HERE) == own(HOLDER)


def test_a_closed_reader_is_worth_nothing():
    here, _ = flow()
    reader = here.fresh(HOLDER)
    here.close(reader)
    assert here.enter(reader, CURATED) == Full("a reader that is closed")
    for label in (here.label(reader), here.close(reader), here.label(Context(HOLDER, "made up"))):
        assert label.tainted and label.integrity is Integrity.NONE


def test_readers_are_bounded():
    here, _ = flow()
    readers = [here.fresh(HOLDER) for _ in range(READERS)]
    assert here.fresh(HOLDER) == Full("readers")
    here.close(readers[0])
    assert isinstance(here.fresh(HOLDER), Context)


def test_nothing_is_nobodys():
    assert joined(()) == NOBODY
