"""Store of tasks: deferred calls that their callers look after, kept over restarts, bounded in number and time.

A kept call lends nothing: it is decided anew, for the caller who looks, before anything happens. Of one task at most
one look may act: `begin` takes it from all others, in every process, before the act.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from pep.journal.sqlite_file import SqliteFile

TASKS: Final = "tasks.sqlite"
"""Name of the file in the directory of a point's state."""
OF_A_CALLER: Final = 16
"""Ours: tasks of one caller that are kept at once."""
OF_ALL: Final = 512
"""Ours: tasks of all callers; as many deferrals as people could answer, twice."""
ANSWER_BYTES: Final = 1 << 18
"""Ours: longest answer that is kept; a longer one is told once."""


class TaskState(StrEnum):
    """State of a task."""

    WAITING = "waiting"
    """For people."""
    ACTING = "acting"
    """A look has taken it; where no process is at it any more, what it did is not known."""
    RELAYED = "relayed"
    """It is another server's, which has its state."""
    ENDED = "ended"
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class KeptTask:
    """One task.

    Attributes:
        task_id: 32 random hex digits.
        caller: digest of the agents and the person to whom it belongs.
        ask_id: the question to people for which it waits; of a relayed one, server and id there.
        call: parameters of the call as JSON, empty once it is over; of a relayed one, the decision.
        made_ms, changed_ms, ends_ms: wall times in ms since the epoch; from `ends_ms` on it is forgotten.
        state: see there.
        answer: JSON of the end, in the form of its shell; empty before.
    """

    task_id: str
    caller: str
    ask_id: str
    call: str
    made_ms: int
    changed_ms: int
    ends_ms: int
    state: TaskState = TaskState.WAITING
    answer: str = ""


_COLUMNS: Final = "task_id, caller, ask_id, call, made_ms, changed_ms, ends_ms, state, answer"


class TaskStore(SqliteFile):
    """Tasks on one file, made when it is missing. Any thread, any number of processes of one machine.

    Args:
        path: of the file, on a local disk; its directory exists.

    Raises:
        PepError: `STATE_UNREADABLE` when it is no such file, or damaged.
    """

    WHAT = "tasks"
    SCHEMA = (
        """CREATE TABLE IF NOT EXISTS tasks (task_id TEXT PRIMARY KEY, caller TEXT NOT NULL, ask_id TEXT NOT NULL,
        call TEXT NOT NULL, made_ms INTEGER NOT NULL, changed_ms INTEGER NOT NULL, ends_ms INTEGER NOT NULL,
        state TEXT NOT NULL, answer TEXT NOT NULL) STRICT, WITHOUT ROWID""",
        "CREATE INDEX IF NOT EXISTS tasks_caller ON tasks (caller)",
    )

    def keep(
        self,
        *,
        caller: str,
        ask_id: str,
        call: str,
        at_ms: int,
        ends_ms: int,
        state: TaskState = TaskState.WAITING,
    ) -> KeptTask | None:
        """The task, durable; the same one for the same question of the same caller; None where there is no room.

        Args:
            caller: as in `KeptTask`.
            ask_id: likewise.
            call: likewise.
            at_ms: now, ms since the epoch.
            ends_ms: as in `KeptTask`.
            state: waiting, or relayed.

        Raises:
            JournalError: it could not be made durable.
        """
        with self._transaction():
            self._database.execute("DELETE FROM tasks WHERE ends_ms <= ?", (at_ms,))
            same = "caller = ? AND ask_id = ? AND state = 'waiting'"
            known = self._database.execute(f"SELECT {_COLUMNS} FROM tasks WHERE {same}", (caller, ask_id)).fetchone()  # noqa: S608
            if known is not None:
                return _task(known)
            if not self._has_room("caller = ?", (caller,), OF_A_CALLER) or not self._has_room("TRUE", (), OF_ALL):
                return None
            task = KeptTask(secrets.token_hex(16), caller, ask_id, call, at_ms, at_ms, ends_ms, state)
            values = (task.task_id, caller, ask_id, call, at_ms, at_ms, ends_ms, str(task.state), task.answer)
            self._database.execute(f"INSERT INTO tasks ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", values)  # noqa: S608
            return task

    def _has_room(self, whose: str, values: tuple[str, ...], most: int) -> bool:
        """True where one more may be kept; the oldest one that is over gives way."""
        count = self._database.execute(f"SELECT count(*) FROM tasks WHERE {whose}", values).fetchone()[0]  # noqa: S608
        if count < most:
            return True
        over = f"{whose} AND state IN ('ended', 'cancelled')"
        oldest = f"SELECT task_id FROM tasks WHERE {over} ORDER BY changed_ms LIMIT 1"  # noqa: S608
        gone = self._database.execute(f"DELETE FROM tasks WHERE task_id IN ({oldest})", values)  # noqa: S608
        return gone.rowcount == 1

    def find(self, task_id: str, *, caller: str, at_ms: int) -> KeptTask | None:
        """The caller's task of that id, or None: another's is as unknown as none.

        Raises:
            JournalError: the file cannot be read.
        """
        with self._transaction():
            row = self._database.execute(
                f"SELECT {_COLUMNS} FROM tasks WHERE task_id = ? AND caller = ? AND ends_ms > ?",  # noqa: S608
                (task_id, caller, at_ms),
            ).fetchone()
        return None if row is None else _task(row)

    def begin(self, task_id: str, *, at_ms: int) -> bool:
        """True for the one look that may act now; durable before this returns.

        Raises:
            JournalError: it could not be made durable; nobody may act.
        """
        with self._transaction():
            done = self._database.execute(
                "UPDATE tasks SET state = 'acting', changed_ms = ? WHERE task_id = ? AND state = 'waiting'",
                (at_ms, task_id),
            )
            return done.rowcount == 1

    def wait_on(self, task_id: str, *, ask_id: str, at_ms: int) -> None:
        """Waits again, after a look that did nothing, for that question.

        Raises:
            JournalError: it could not be made durable.
        """
        with self._transaction():
            self._database.execute(
                "UPDATE tasks SET state = 'waiting', ask_id = ?, changed_ms = ? WHERE task_id = ? AND state = 'acting'",
                (ask_id, at_ms, task_id),
            )

    def end(self, task_id: str, *, state: TaskState, answer: str, at_ms: int) -> None:
        """Ends a task that is not over; its call is forgotten.

        Raises:
            JournalError: it could not be made durable.
        """
        with self._transaction():
            self._database.execute(
                "UPDATE tasks SET state = ?, answer = ?, call = '', changed_ms = ? "
                "WHERE task_id = ? AND state IN ('waiting', 'acting')",
                (str(state), answer, at_ms, task_id),
            )

    def cancel(self, task_id: str, *, at_ms: int) -> bool:
        """True where a waiting task is cancelled from now on: no look acts any more.

        Raises:
            JournalError: it could not be made durable.
        """
        with self._transaction():
            done = self._database.execute(
                "UPDATE tasks SET state = 'cancelled', call = '', changed_ms = ? "
                "WHERE task_id = ? AND state = 'waiting'",
                (at_ms, task_id),
            )
            return done.rowcount == 1


def _task(row: tuple[str, str, str, str, int, int, int, str, str]) -> KeptTask:
    return KeptTask(*row[:7], TaskState(row[7]), row[8])
