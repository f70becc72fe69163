"""Proofs are used once, over callers at the same time, and the store never forgets early."""

import threading

import pytest
from pep.base.errors import PepFault, ReplayStoreError
from pep.journal.replay_cache import ReplayCache, proof_name
from tests.pep.kit import ManualClock

KEY = b"k" * 32


@pytest.mark.clause("TOK-10")
def test_once_for_each_key_and_id():
    store = ReplayCache(ManualClock())
    uses = [store.first_use(jti, key=key, expires_ms=2_000_000) for jti in "ab" for key in (KEY, b"l" * 32)]
    assert uses == [True] * 4
    assert store.first_use("a", key=KEY, expires_ms=2_000_000) is False


def test_exactly_one_winner_at_the_same_time():
    store, start, won = ReplayCache(ManualClock()), threading.Barrier(64), []

    def use(round_number):
        start.wait()
        if store.first_use(f"jti-{round_number}", key=KEY, expires_ms=2_000_000):
            won.append(round_number)

    for round_number in range(20):
        threads = [threading.Thread(target=use, args=(round_number,)) for _ in range(64)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert won == list(range(20))


def test_a_full_store_denies_and_forgets_only_what_has_expired():
    clock = ManualClock()
    store = ReplayCache(clock, capacity=2)
    store.first_use("a", key=KEY, expires_ms=clock.mono + 10)
    store.first_use("b", key=KEY, expires_ms=clock.mono + 20)
    with pytest.raises(ReplayStoreError) as raised:
        store.first_use("c", key=KEY, expires_ms=clock.mono + 30)
    assert raised.value.code is PepFault.REPLAY_STORE_FULL
    assert store.first_use("a", key=KEY, expires_ms=clock.mono + 10) is False
    clock.advance(11)
    assert store.first_use("c", key=KEY, expires_ms=clock.mono + 30)
    assert store.first_use("b", key=KEY, expires_ms=clock.mono + 30) is False


def test_what_the_journal_remembers_counts_as_used():
    clock = ManualClock()
    store = ReplayCache(clock)
    store.remember(proof_name(KEY, "a"), expires_ms=clock.mono + 1_000)
    assert store.first_use("a", key=KEY, expires_ms=clock.mono + 1_000) is False


def test_a_name_tells_keys_of_both_lengths_apart():
    """A byte of a key is never taken for the first letter of an id."""
    assert proof_name(b"\2" * 32 + b"j", "ti-0123456789abcdef") != proof_name(b"\2" * 32, "jti-0123456789abcdef")
