"""Store of spent budgets: one SQLite file, shared by all workers of an enforcement point, synced before each effect.

Windows slide. Time is cut into slots of at most a 64th of the window; a charge counts for the whole window after the
end of its slot. So between any two charges that count together in a window of that length, all of them were counted
when the last was made, and their sum is within the budget. Time never goes back here, even when clocks do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.journal.sqlite_file import SqliteFile

if TYPE_CHECKING:
    from collections.abc import Sequence

BUDGETS: Final = "budgets.sqlite"
"""Name of the file in the directory of a point's state."""
SLOTS: Final = 64
"""Slots of a window: what is charged is free again at most this part of the window late."""
_SCHEMA: Final = (
    """CREATE TABLE IF NOT EXISTS spent (account TEXT NOT NULL, slot INTEGER NOT NULL, amount INTEGER NOT NULL,
    until_ms INTEGER NOT NULL, PRIMARY KEY (account, slot)) STRICT, WITHOUT ROWID""",
    "CREATE INDEX IF NOT EXISTS spent_until ON spent (until_ms)",
    "CREATE TABLE IF NOT EXISTS clock (one INTEGER PRIMARY KEY CHECK (one = 1), at_ms INTEGER NOT NULL) STRICT",
)


@dataclass(frozen=True, slots=True)
class Charge:
    """Part of one budget that one act takes.

    Attributes:
        account: name of what is spent: holder, grant, measure, audience and window.
        amount: of the act, from 1.
        most: highest sum in any window.
        window_s: its length.
        hop: index of the hop that states the budget.
        parameter: the quantity that is counted; "" for acts.
    """

    account: str
    amount: int
    most: int
    window_s: int
    hop: int
    parameter: str


@dataclass(frozen=True, slots=True)
class Spending:
    """Charges of one act that were made, each with the slot that it is in."""

    slots: tuple[tuple[str, int, int], ...]


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Budget that an act would exceed.

    Attributes:
        charge: what it would have taken.
        left: what could be taken now.
        more_at_ms: when there will be enough, if nothing else is taken, ms since the epoch; None for never.
    """

    charge: Charge
    left: int
    more_at_ms: int | None


class BudgetStore(SqliteFile):
    """Spent budgets on one file, made when it is missing. Any thread, any number of processes of one machine.

    Args:
        path: of the file, on a local disk; its directory exists.

    Raises:
        PepError: `STATE_UNREADABLE` when it is no such file, or damaged: without it budgets would begin anew.
    """

    WHAT = "budgets"
    SCHEMA = _SCHEMA

    def charge(self, charges: Sequence[Charge], *, wall_ms: int) -> Spending | Shortfall:
        """All of the charges, durably, or none of them and the budget that they would exceed.

        Args:
            charges: of one act, each of another account.
            wall_ms: now, ms since the epoch; an earlier time than the latest here counts as that.

        Raises:
            JournalError: `JOURNAL_BROKEN` when they could not be made durable.
        """
        with self._transaction():
            now_ms = self._now(wall_ms)
            self._database.execute("INSERT OR REPLACE INTO clock VALUES (1, ?)", (now_ms,))
            short = self._shortfall(charges, now_ms)
            if short is not None:
                return short
            spent = [(each.account, now_ms // _slot_ms(each), each.amount, _until_ms(each, now_ms)) for each in charges]
            self._database.execute("DELETE FROM spent WHERE until_ms <= ?", (now_ms,))
            self._database.executemany(
                "INSERT INTO spent VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET amount = amount + excluded.amount",
                spent,
            )
        return Spending(tuple((account, slot, amount) for account, slot, amount, _ in spent))

    def look(self, charges: Sequence[Charge], *, wall_ms: int) -> Shortfall | None:
        """The budget that the charges would exceed now, or None; nothing is charged.

        Raises:
            JournalError: `JOURNAL_BROKEN` when it cannot be asked.
        """
        with self._transaction():
            return self._shortfall(charges, self._now(wall_ms))

    def give_back(self, spending: Spending) -> None:
        """Takes charges back, of an act that is known not to have begun.

        Raises:
            JournalError: `JOURNAL_BROKEN` when that could not be made durable; they stay spent.
        """
        with self._transaction():
            self._database.executemany(
                "UPDATE spent SET amount = amount - ? WHERE account = ? AND slot = ?",
                [(amount, account, slot) for account, slot, amount in spending.slots],
            )

    def _now(self, wall_ms: int) -> int:
        latest = self._database.execute("SELECT at_ms FROM clock").fetchone()
        return wall_ms if latest is None else max(wall_ms, int(latest[0]))

    def _shortfall(self, charges: Sequence[Charge], now_ms: int) -> Shortfall | None:
        """Of the budgets that are short, the one that has enough again last."""
        short = [found for each in charges if (found := self._short(each, now_ms)) is not None]
        return max(short, key=lambda found: (found.more_at_ms is None, found.more_at_ms or 0), default=None)

    def _short(self, charge: Charge, now_ms: int) -> Shortfall | None:
        counted = self._database.execute(
            "SELECT amount, until_ms FROM spent WHERE account = ? AND until_ms > ? ORDER BY slot",
            (charge.account, now_ms),
        ).fetchall()
        left = charge.most - sum(amount for amount, _ in counted)
        if charge.amount <= left:
            return None
        free, more_at_ms = left, None
        for amount, until_ms in counted:
            free += amount
            if charge.amount <= free:
                more_at_ms = int(until_ms)
                break
        return Shortfall(charge, max(left, 0), more_at_ms)


def _slot_ms(charge: Charge) -> int:
    return -(-charge.window_s * 1000 // SLOTS)


def _until_ms(charge: Charge, now_ms: int) -> int:
    """Time from which on a charge made now no longer counts: a window after the end of its slot."""
    return (now_ms // _slot_ms(charge) + 1) * _slot_ms(charge) + charge.window_s * 1000
