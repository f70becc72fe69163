"""Labels only get worse."""

from itertools import permutations

from policies.words.labels import NOBODY, Integrity, Label, Source, aged, joined, tainted

TOLD = Label(frozenset({Source.OPERATOR}), frozenset({"alice"}), Integrity.PRINCIPAL, 1_000)
READ = Label(frozenset({Source.RETRIEVAL}), frozenset({"curator-1"}), Integrity.CURATED, 3_000, tainted=True)
SAID = Label(frozenset({Source.AGENT, Source.MEMORY}), frozenset(), Integrity.AGENT, 0)


def test_what_is_made_of_several_has_the_worst_of_each():
    whole = Label(
        frozenset({Source.OPERATOR, Source.RETRIEVAL, Source.AGENT, Source.MEMORY}),
        frozenset({"alice", "curator-1"}),
        Integrity.AGENT,
        3_000,
        tainted=True,
    )
    for parts in permutations((TOLD, READ, SAID)):
        assert joined(iter(parts)) == whole


def test_what_is_made_of_one_is_as_it_was():
    for label in (TOLD, READ, SAID, NOBODY):
        assert joined([label]) == label


def test_what_is_made_of_nothing_is_vouched_for_by_nobody():
    assert joined(()) == NOBODY == Label(frozenset({Source.TEXT}), frozenset(), Integrity.NONE, 0, tainted=False)


def test_a_text_that_nobody_vouches_for_leaves_nobody_vouching():
    for label in (TOLD, READ, SAID):
        assert joined((label, NOBODY)).integrity is Integrity.NONE


def test_time_only_ages():
    assert aged(READ, 500) == Label(READ.sources, READ.signers, READ.integrity, 3_500, tainted=True)
    assert aged(TOLD, 1).age_ms == 1_001
    for wait in (0, -1, -5_000):
        assert aged(READ, wait) == READ


def test_a_taint_stays_and_changes_nothing_else():
    assert tainted(TOLD) == Label(TOLD.sources, TOLD.signers, TOLD.integrity, 1_000, tainted=True)
    assert tainted(READ) == READ
    assert aged(tainted(TOLD), 1).tainted


def test_each_kind_of_voucher_is_believed_for_more_than_the_one_before():
    order = [
        Integrity.NONE,
        Integrity.AGENT,
        Integrity.RECORDED,
        Integrity.CURATED,
        Integrity.SENSED,
        Integrity.PRINCIPAL,
    ]
    assert list(map(int, order)) == [0, 1, 2, 3, 4, 5] == list(map(int, Integrity))
