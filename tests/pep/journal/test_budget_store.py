"""Store of spent budgets: never more than the budget in any window, over threads, processes, crashes and clocks."""

from __future__ import annotations

import os
import random
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.base.errors import JournalError, PepError, PepFault
from pep.journal.budget_store import SLOTS, BudgetStore, Charge, Shortfall, Spending

TOP = Path(__file__).parents[3]
T0 = 1_800_000_000_000


def act(account="a", *, amount=1, most=3, window_s=60, hop=0):
    return Charge(account, amount, most, window_s, hop, "")


@pytest.fixture
def store(tmp_path):
    made = BudgetStore(tmp_path / "budgets.sqlite")
    yield made
    made.close()


@pytest.mark.clause("BDG-2", "BDG-5")
def test_a_budget_is_spent_and_comes_back_when_its_window_is_over(store):
    for n in range(3):
        assert isinstance(store.charge([act()], wall_ms=T0 + n * 1_000), Spending)
    short = store.charge([act()], wall_ms=T0 + 3_000)
    assert (short.charge, short.left) == (act(), 0)
    assert T0 + 60_000 < short.more_at_ms <= T0 + 60_000 + 60_000 / SLOTS + 1
    assert store.look([act()], wall_ms=short.more_at_ms - 1) == short
    assert store.look([act()], wall_ms=short.more_at_ms) is None
    assert isinstance(store.charge([act()], wall_ms=short.more_at_ms), Spending)


@pytest.mark.clause("BDG-5")
def test_what_is_left_and_when_there_is_enough_are_told(store):
    store.charge([act(amount=4, most=10)], wall_ms=T0)
    store.charge([act(amount=5, most=10)], wall_ms=T0 + 30_000)
    few, many = (store.charge([act(amount=n, most=10)], wall_ms=T0 + 31_000) for n in (2, 7))
    assert (few.left, many.left) == (1, 1)
    assert few.more_at_ms < T0 + 62_000 < T0 + 90_000 < many.more_at_ms
    assert store.charge([act(amount=11, most=10)], wall_ms=T0).more_at_ms is None


@pytest.mark.clause("BDG-1")
def test_every_budget_is_charged_or_none(store):
    both = [act("parent"), act("child", most=1, hop=1)]
    assert isinstance(store.charge(both, wall_ms=T0), Spending)
    for _ in range(5):
        assert store.charge(both, wall_ms=T0).charge.hop == 1
    assert store.charge([act("parent", amount=3)], wall_ms=T0).left == 2
    never = [act("parent", amount=3), act("child", amount=2, most=1, hop=1)]
    assert store.charge(never, wall_ms=T0).charge.hop == 1, "the one that never has enough is told"


@pytest.mark.clause("BDG-3")
def test_what_is_given_back_is_there_again_and_nothing_else(store):
    store.charge([act()], wall_ms=T0)
    made = store.charge([act(amount=2)], wall_ms=T0)
    assert isinstance(store.charge([act()], wall_ms=T0), Shortfall)
    store.give_back(made)
    assert store.charge([act(amount=3)], wall_ms=T0).left == 2
    # what is over has no row any more, and giving it back gives nothing
    late = T0 + 200_000
    store.charge([act()], wall_ms=late)
    store.give_back(made)
    assert store.charge([act(amount=3)], wall_ms=late).left == 2


@pytest.mark.clause("BDG-4")
def test_a_clock_that_is_set_back_gives_nothing(store, tmp_path):
    for _ in range(3):
        store.charge([act()], wall_ms=T0)
    for back_ms in (1, 61_000, 10**9):
        assert isinstance(store.charge([act()], wall_ms=T0 - back_ms), Shortfall)
    store.close()
    again = BudgetStore(tmp_path / "budgets.sqlite")
    assert isinstance(again.charge([act()], wall_ms=T0 - 61_000), Shortfall)
    # and what is charged meanwhile counts from the latest time
    assert isinstance(again.charge([act("b", most=1)], wall_ms=T0 - 61_000), Spending)
    assert isinstance(again.charge([act("b", most=1)], wall_ms=T0 + 59_999), Shortfall)
    again.close()


@pytest.mark.clause("BDG-2")
@given(st.integers(1, 2**32))
def test_no_window_ever_has_more_than_the_budget(seed):
    """Charges at random times, clocks that jump back, some given back: each window is added up by hand."""
    chance = random.Random(seed)
    most, window_s = chance.randint(1, 9), chance.choice((1, 2, 7, 100))
    store, now, held, latest = in_memory(), T0, [], 0
    for _ in range(60):
        now += chance.choice((0, 1, window_s * 1000 // 7, window_s * 500, window_s * 1000, -window_s * 3_000))
        latest = max(latest, now)
        amount = chance.randint(1, most)
        made = store.charge([act(amount=amount, most=most, window_s=window_s)], wall_ms=now)
        if isinstance(made, Spending):
            if chance.random() < 0.1:
                store.give_back(made)
            else:
                held.append((latest, amount))
        for at, _ in held:
            assert sum(n for t, n in held if at <= t < at + window_s * 1000) <= most
    assert held
    store.close()


def in_memory():
    """The same store over a database without a disk."""
    made = BudgetStore.__new__(BudgetStore)
    made._begin(sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False))
    return made


CHILD = """
import sys
from pathlib import Path
from pep.journal.budget_store import BudgetStore, Charge, Spending
store = BudgetStore(Path(sys.argv[1]))
print("ready", flush=True)
sys.stdin.readline()
charges = [Charge("parent", 1, 100, 3600, 0, ""), Charge(sys.argv[2], 1, 70, 3600, 1, "")]
print(sum(isinstance(store.charge(charges, wall_ms=int(sys.argv[3])), Spending) for _ in range(90)), flush=True)
"""


@pytest.mark.clause("BDG-1", "BDG-6")
def test_processes_at_one_store_never_overspend(tmp_path):
    """Three processes open a new store at once; each wants 90 of 100 that they share, and may have 70."""
    path = tmp_path / "budgets.sqlite"
    children = [
        subprocess.Popen(
            [sys.executable, "-c", CHILD, str(path), f"child-{n}", str(T0 - n * 10_000)],
            cwd=TOP, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for n in range(3)
    ]  # fmt: skip
    assert [child.stdout.readline() for child in children] == ["ready\n"] * 3
    for child in children:
        child.stdin.write("go\n")
        child.stdin.flush()
    told = [child.communicate(timeout=60) for child in children]
    spent = [int(out) for out, _ in told]
    assert sum(spent) == 100, told
    assert max(spent) <= 70


KILLED = """
import os, sys
from pathlib import Path
from pep.journal.budget_store import BudgetStore, Charge
store = BudgetStore(Path(sys.argv[1]))
store.charge([Charge("a", 1, 3, 60, 0, "")], wall_ms=int(sys.argv[2]))
os.kill(os.getpid(), 9)
"""


@pytest.mark.clause("BDG-3")
def test_what_was_charged_before_a_crash_is_spent(tmp_path):
    path = tmp_path / "budgets.sqlite"
    ran = subprocess.run([sys.executable, "-c", KILLED, str(path), str(T0)], cwd=TOP, timeout=60, check=False)
    assert ran.returncode == -9
    store = BudgetStore(path)
    assert store.charge([act(amount=3)], wall_ms=T0).left == 2
    store.close()


@pytest.mark.clause("BDG-6")
def test_a_store_that_is_none_is_refused(tmp_path):
    path = tmp_path / "budgets.sqlite"
    path.write_bytes(b"no database" * 500)
    with pytest.raises(PepError) as caught:
        BudgetStore(path)
    assert caught.value.code is PepFault.STATE_UNREADABLE
    with pytest.raises(PepError):
        BudgetStore(tmp_path / "nowhere" / "budgets.sqlite")


@pytest.mark.clause("BDG-1")
def test_a_charge_that_is_not_durable_is_none(store, tmp_path, monkeypatch):
    other = sqlite3.connect(tmp_path / "budgets.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    store._database.execute("PRAGMA busy_timeout = 1")
    with pytest.raises(JournalError):
        store.charge([act()], wall_ms=T0)
    other.execute("ROLLBACK")
    assert isinstance(store.charge([act(amount=3)], wall_ms=T0), Spending)
    other.execute("DROP TABLE clock")
    other.close()
    with pytest.raises(JournalError):
        store.charge([act("b")], wall_ms=T0)
    assert store._database.in_transaction is False


def test_the_file_is_its_owners_alone(store, tmp_path):
    assert os.stat(tmp_path / "budgets.sqlite").st_mode & 0o777 == 0o600


def test_what_is_over_is_forgotten(store):
    for n in range(200):
        store.charge([act(f"account-{n}")], wall_ms=T0 + n * 1_000)
    assert store._database.execute("SELECT count(*) FROM spent").fetchone()[0] < 64
