"""The store failing once, at each of its calls, under each command (`make store-errors`).

A statement or commit fails before it is done, or a commit after it: the disk is full or the database locked, which
are one kind of error to us, or the connection is lost. The answer is a clear 503, nothing is half done, and the same request once more is taken, or told
that it was done.
"""

from __future__ import annotations

import argparse
import logging
import sqlite3
import sys
from collections import Counter
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import sqlalchemy as sa
from tests.ztpm_idp.hostile.api import counted
from tests.ztpm_idp.hostile.matrix import PageTrial, Trial, pages, rows
from tests.ztpm_idp.hostile.scene import GRANTS, Scene
from tests.ztpm_idp.store.campaign.scene import contradictions
from tests.ztpm_idp.world import World
from ztpm_idp.store.schema import metadata

from ztpm_idp.client import ClientError

if TYPE_CHECKING:
    from collections.abc import Callable

FAULTS = {
    "full or locked": lambda: sa.exc.OperationalError("", None, sqlite3.OperationalError("database or disk is full")),
    "connection lost": lambda: ConnectionResetError(104, "Connection reset by peer"),
}
AFTER = "after commit"
KINDS = (*FAULTS, AFTER)
_ARMED: ContextVar[Fault | None] = ContextVar("armed", default=None)


@dataclass
class Fault:
    """One call of the store that fails, within one request.

    Attributes:
        kind: of `KINDS`.
        left: calls before it.
        struck: it has happened.
    """

    kind: str
    left: int
    struck: bool = False

    def call(self, *, committed: bool = False) -> None:
        """One call: a statement or commit that begins, or a commit that is done."""
        if self.struck or committed != (self.kind == AFTER):
            return
        if self.left == 0:
            self.struck = True
            raise FAULTS.get(self.kind, FAULTS["connection lost"])()
        self.left -= 1


@contextmanager
def failing(engine: sa.Engine):
    """The engine fails where a request has armed a fault, and nowhere else."""

    def before(*_):
        if (fault := _ARMED.get()) is not None:
            fault.call()

    commit = engine.dialect.do_commit

    def committing(connection):
        before()
        commit(connection)
        if (fault := _ARMED.get()) is not None:
            fault.call(committed=True)

    sa.event.listen(engine, "before_cursor_execute", before)
    engine.dialect.do_commit = committing
    try:
        yield
    finally:
        sa.event.remove(engine, "before_cursor_execute", before)
        engine.dialect.do_commit = commit


@contextmanager
def armed(fault: Fault | None):
    """Requests of this thread to a failing engine's provider meet the fault meanwhile."""
    before = _ARMED.set(fault)
    try:
        yield
    finally:
        _ARMED.reset(before)


def commits(world: World, send: Callable[[], object]) -> int:
    """Number of commits that a request comes to."""
    many = 1_000
    uncounted = Fault(AFTER, many)
    with failing(world.provider.store._engine.sync_engine), armed(uncounted):
        send()
    return many - uncounted.left


@dataclass
class Found:
    """Figures of a run."""

    struck: Counter = field(default_factory=Counter)
    again: Counter = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


def commands() -> list[str]:
    """Routes that change the state, pages' forms among them; and each grant of the token endpoint."""
    return [at for at in (*rows(), *pages()) if at.startswith("POST ") and at not in UNCHANGING] + list(GRANTS)


UNCHANGING = {
    "POST /oauth/introspect", "POST /oauth/token", "POST /oauth/revoke", "POST /restoring/resume", "POST /login/passkey",
    "POST /login/providers/{name}", "POST /passkeys/enrolments", "POST /passkeys/enrolments/{enrolment_id}/credential",
    "POST /approvals/{ask_id}/passkey-votes", "POST /changes/passkey", "POST /login/devices/poll",
    "POST /latches/{latch_id}/passkey-clearings", "POST /console/revocations", "POST /console/acts",
    "POST /approvals/page/devices", "POST /approvals/page/devices/end",
}  # fmt: skip
"""Routes whose request in the scene comes to no commit: they read, or are refused there."""


def strike(scene: Scene, at: str, kind: str, place: int, found: Found) -> bool:
    """The request of a route with one call failing, and once more without; False where it has no such call."""
    fault = Fault(kind, place)
    sender = Sender(scene, at)
    before = counted(scene.world)
    first = sender.send(fault)
    if not fault.struck:
        return False
    found.struck[kind] += 1
    where = f"{at}, {kind} at call {place}"
    if any(code in first for code in FULL):
        raise FullError
    changed = counted(scene.world) != before
    if first not in UNAVAILABLE:
        # A store that fails beside the command, or while it looks for what it need not find, changes no answer.
        if not first.startswith(("2", "303")) or not changed:
            found.wrong.append(f"{where}: {first}")
        return True
    if changed and kind != AFTER:
        found.wrong.append(f"{where}: half done")
    if not sender.trial.answer.header("retry-after").isdecimal():
        found.wrong.append(f"{where}: no word on when to try again")
    again = sender.send(None)
    if any(code in again for code in FULL):
        raise FullError
    found.again[again] += 1
    if not (again.startswith(("2", "303")) or (kind == AFTER and again in DONE)):
        found.wrong.append(f"{where}: once more: {again}")
    return True


class FullError(Exception):
    """The scene's store holds as many things of a kind as may be."""


FULL = ("REGISTRY_FULL", "TOO_MANY_", "_SPENT", "MANDATE_TOKENS_LIVE")
"""Parts of codes by which a store says so."""
UNAVAILABLE = {"503 STORE_UNAVAILABLE", "503 temporarily_unavailable"}
DONE = {
    "409 ALREADY_REGISTERED", "409 KEY_IN_USE", "409 VOTED_BEFORE", "409 CHANGE_OVER", "409 NOTHING_TO_RESTORE", "409 LOGIN_OVER",
    "403 ATTESTATION_INVALID", "404 SCOPE_UNKNOWN", "404 NOT_FOUND", "400 invalid_grant", "409 CONFLICT", "404 OPENING_UNKNOWN", "400", "403 LOGIN_UNKNOWN",
}  # fmt: skip
"""Answers to a request that was done already, though its first answer did not come."""


class Sender:
    """Sender of the request of one route: the same each time, but for its proof."""

    def __init__(self, scene: Scene, at: str) -> None:
        self.scene, self.world = scene, scene.world
        self.page = at in pages()
        if self.page:
            self.trial = PageTrial(scene, pages()[at])
            self.token = self.trial.token(scene.browser)
        else:
            self.trial = Trial(scene, {"at": at, "right": "nobody"} if at in GRANTS else rows()[at])

    def send(self, fault: Fault | None) -> str:
        """The answer, with a fault armed for this request alone."""
        with armed(fault):
            if self.page:
                return self.trial.send(self.scene.browser.cookies, self.token)
            return self.trial.signed(self.trial.right)


def whole(world: World) -> list[str]:
    """Contradictions within the store."""
    return contradictions(
        {table.name: [tuple(row.values()) for row in world.rows(table.name)] for table in metadata.sorted_tables}
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgres"])
    parser.add_argument("--only", nargs="+", default=["/"], help="parts of the names of the commands to try")
    asked = parser.parse_args()
    tried = [at for at in commands() if any(part in at for part in asked.only)]
    logging.getLogger("ztpm_idp").setLevel(logging.CRITICAL)  # it names each failure
    clean = True
    for database in asked.databases:
        found, worlds = Found(), 0
        left = [(at, kind) for at in tried for kind in KINDS]
        place = 0
        while left:
            worlds, begun = worlds + 1, (len(left), place)
            with TemporaryDirectory() as folder, World(Path(folder), database=database) as world:
                scene = Scene(world)
                with failing(world.provider.store._engine.sync_engine), suppress(ClientError, FullError):
                    while left:
                        struck = strike(scene, *left[0], place, found)
                        if not struck and not place:
                            found.wrong.append(f"{' '.join(left[0])}: no call of the store is its own")
                        place = place + 1 if struck else 0
                        if not place:
                            sys.stderr.write(
                                f"{database}: {' '.join(left[0])}, {found.struck.total()} calls, {len(found.wrong)} wrong\n"
                            )
                            left = left[1:]
                found.wrong += [f"{left[:1]}: {one}" for one in whole(world)]
            if begun == (len(left), place):
                raise AssertionError(left[0])  # a new store is full at once
        clean = clean and not found.wrong
        sys.stdout.write("".join(f"{line}\n" for line in found.wrong))
        told = ", ".join(f"{count} {kind}" for kind, count in found.struck.items())
        sys.stdout.write(
            f"{database}: {len(tried)} commands in {worlds} stores, {found.struck.total()} calls that failed ({told}); {len(found.wrong)} wrong\n"
        )
    return 0 if clean else 1


if __name__ == "__main__":
    sys.exit(main())
