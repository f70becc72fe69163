"""Copies of the store, made while it serves, and put back with every revocation that is known elsewhere.

A copy that is put back begins a new line of revocations in the state of being restored, before it stands in the
store's place; what it waits for there is the domain's (`ztpm_idp.domain.restoring`).
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import sqlite3
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

import sqlalchemy as sa

from capabilities.statements import mark as mark_statement
from capabilities.statements import revocation
from capabilities.statements.statement_form import signer_thumbprint
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError, StatementError
from ztpm_idp import ledger_file
from ztpm_idp.domain.commands import Lost, RestoreStore, TakeBack, TakeMark
from ztpm_idp.domain.events import LineBegun, RevocationKind, Revoked, StoreRestored
from ztpm_idp.domain.parties import RegisteredPep
from ztpm_idp.domain.restoring import unheard
from ztpm_idp.domain.state import Wanted
from ztpm_idp.provider.problems import Problem
from ztpm_idp.provider.provider import Provider
from ztpm_idp.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from capabilities.keys.trust import TrustBundle
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.settings import Settings

ACTOR: Final = "restore"
"""Actor in the ledger for acts of a restore that nobody did over the wire."""
PAGE: Final = 1_000
"""Revocations that are taken back in one transaction."""
_LOGS: Final = ("-wal", "-shm")
"""Ends of the names of the files that SQLite keeps beside a database in use."""
_NAMES: Final = ("agent", "holder", "delegate", "delegator")
"""Members of a ledger entry's body that name an agent."""

_SUSPENSIONS: Final = {
    "agent-suspended": ("agent", True),
    "suspension-ended": ("agent", False),
    "pep-suspended": ("id", True),
    "pep-restored": ("id", False),
    "sensor-suspended": ("id", True),
    "sensor-restored": ("id", False),
}
"""Kinds of ledger entries on suspensions: the member that names the party, and whether it is suspended from then on."""


class RestoreError(Exception):
    """A copy that cannot be made or put back; the store is as it was.

    Attributes:
        code: its cause.
        sentence: place and cause, for a person.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(f"{code}: {sentence}")
        self.code = code
        self.sentence = sentence


@dataclass(frozen=True, slots=True)
class StoppedProvider:
    """Identity provider whose store is put back.

    Attributes:
        settings, keys, policies: as for `create_app`.
        now: wall clock, seconds since the epoch.
    """

    settings: Settings
    keys: IdpKeys
    policies: PolicySet
    now: Callable[[], float]


@dataclass(frozen=True, slots=True)
class Restored:
    """Store in its place, which waits.

    Attributes:
        line: that it began.
        taken_back: number of revocations.
        waits_for: enforcement points that were not heard.
        held: number of agents for which an administrator must vouch.
        kept: the file that was in its place, or None.
        before: what could be read of the ledger there: "whole", "in part", "nothing".
    """

    line: int
    taken_back: int
    waits_for: tuple[str, ...]
    held: int
    kept: Path | None
    before: str


@dataclass(slots=True)
class _Told:
    """Contents of ledgers: the highest line, revocations, and by entry the parties that it names.

    `suspensions` holds by entry its time, its party, and whether that was suspended or is so no longer.
    """

    line: int = 0
    lost: list[Lost] = field(default_factory=list)
    named: dict[str, frozenset[str]] = field(default_factory=dict)
    suspensions: dict[str, tuple[tuple[int, int], str, bool]] = field(default_factory=dict)
    sources: list[str] = field(default_factory=list)

    def take(self, line: bytes) -> None:
        """One more entry, of a ledger that was verified or is ours."""
        entry = json.loads(line)
        kind, body = entry["kind"], entry["body"]
        if kind == "revoked":
            subject = RevocationKind(body["kind"])
            revocation.check_id(subject, body["id"])
            self.lost.append(Lost(subject, body["id"], str(body["reason"])))
        elif kind in {"store-restored", "line-begun"}:
            self.line = max(self.line, int(body["line"]))
        names = {body[name] for name in _NAMES if isinstance(body.get(name), str)}
        names |= {body["id"]} if kind == "agent-registered" else set()
        digest = hashlib.sha256(line).hexdigest()
        if names:
            self.named[digest] = frozenset(names)
        if kind in _SUSPENSIONS:
            member, suspends = _SUSPENSIONS[kind]
            when = int(entry["at_ms"]), int(entry["seq"])
            self.suspensions[digest] = when, str(body[member]), suspends

    def suspended(self, entries: set[str]) -> frozenset[str]:
        """Parties that the newest of these entries about them suspends."""
        told = sorted(each for entry, each in self.suspensions.items() if entry in entries)
        newest = {party: suspends for _, party, suspends in told}
        return frozenset(party for party, suspends in newest.items() if suspends)


# --- making a copy ---------------------------------------------------------------------------------------------------


def backup(database_url: str, destination: Path) -> int:
    """A consistent copy of the store, one file of mode 0600, while the service runs; its size in bytes.

    Raises:
        RestoreError: `EXISTS`, `NOT_SQLITE`, `UNREADABLE`, `UNWRITABLE`, `COPY_UNUSABLE`.
    """
    _copy(_file_of(database_url), destination)
    return destination.stat().st_size


def _file_of(database_url: str) -> Path:
    url = sa.make_url(database_url)
    if url.get_backend_name() != "sqlite" or not url.database:
        raise RestoreError(
            "NOT_SQLITE", f"{url.get_backend_name()} is copied with pg_dump and put back with pg_restore"
        )
    return Path(url.database)


def _opened(file: Path) -> sqlite3.Connection:
    """A connection to a database that is there, which answers at once or not at all."""
    return sqlite3.connect(f"file:{quote(str(file))}?mode=rw", uri=True, timeout=0, isolation_level=None)


def _copy(source: Path, destination: Path) -> None:
    """The whole of one database in a new file, synced."""
    try:
        os.close(os.open(destination, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    except FileExistsError:
        raise RestoreError("EXISTS", str(destination)) from None
    except OSError as error:
        raise RestoreError("UNWRITABLE", f"{destination}: {error.strerror}") from error
    try:
        with closing(_opened(source)) as base, closing(_opened(destination)) as copy:
            base.backup(copy)
            _one_file(copy)
            _check_whole(copy, source)
        _sync(destination)
    except BaseException as error:
        _remove(destination)
        if isinstance(error, sqlite3.Error):
            code = "UNREADABLE" if isinstance(error, sqlite3.OperationalError) else "COPY_UNUSABLE"
            raise RestoreError(code, f"{source}: {error}") from error
        raise


def _check_whole(copy: sqlite3.Connection, source: Path) -> None:
    if copy.execute("PRAGMA quick_check").fetchall() != [("ok",)]:
        raise RestoreError("COPY_UNUSABLE", f"{source} is damaged")
    if copy.execute("SELECT count(*) FROM sqlite_master WHERE name = 'ledger'").fetchone() != (1,):
        raise RestoreError("COPY_UNUSABLE", f"{source} is no store of an identity provider")


def _remove(file: Path) -> None:
    """Neither the database nor a log of it is there."""
    for name in ("", *_LOGS, "-journal"):
        file.with_name(file.name + name).unlink(missing_ok=True)


def _one_file(base: sqlite3.Connection) -> None:
    """All of the database is in its one file, which no other process has open.

    Raises:
        sqlite3.OperationalError: another process has it open.
    """
    base.execute("PRAGMA journal_mode = DELETE").fetchone()


def _sync(file: Path) -> None:
    """The file and its name are on disk."""
    for place, flags in ((file, os.O_RDWR), (file.parent, os.O_RDONLY | os.O_DIRECTORY)):
        descriptor = os.open(place, flags)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# --- putting a copy back ---------------------------------------------------------------------------------------------


def restore(
    deployment: StoppedProvider, copy: Path | None, *, ledgers: Sequence[Path] = (), marks: Sequence[Path] = ()
) -> Restored:
    """The copy is in the store's place, in a new line, and waits; the service must not be running.

    Args:
        deployment: whose store it is.
        copy: of the store; None: the file in its place is one already, copied there by hand.
        ledgers: exported ledgers, whole or in part.
        marks: of enforcement points, a part in each line.

    Raises:
        RestoreError: nothing is changed. `STORE_IN_USE` while the service runs; a ledger or mark that does not
            verify; as `backup`.
        StoreUnavailableError: the copy cannot be opened as a store.
    """
    place = _file_of(deployment.settings.database_url)
    told = _Told()
    for ledger in ledgers:
        _read_ledger(ledger, deployment.keys.trust(issuer=deployment.settings.issuer, root_key_id=0), told)
    staged = place.with_name(f"{place.name}.restoring")
    _remove(staged)  # of an attempt that was killed
    texts = [(file, text) for file in marks for text in _texts(file)]
    with _alone(place) as base:
        before = _read_before(base, told)
        _copy(place if copy is None else copy, staged)
        try:
            done = asyncio.run(_begun(deployment, staged, told, texts))
            with closing(_opened(staged)) as whole:
                _one_file(whole)
            _sync(staged)
            kept = _swapped(staged, place, done.line)
        finally:
            _remove(staged)
    return Restored(done.line, done.taken_back, done.waits_for, done.held, kept, before)


@contextmanager
def _alone(place: Path) -> Iterator[sqlite3.Connection | None]:
    """The database in the store's place, which no other process has open; None where it is gone or damaged."""
    if not place.exists():
        yield None
        return
    with closing(_opened(place)) as base:
        try:
            _one_file(base)
            base.execute("BEGIN IMMEDIATE")  # until the end nobody else opens it as a store
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
                raise RestoreError("STORE_IN_USE", f"{place} is open in another process") from None
            yield None
            return
        yield base


def _read_before(base: sqlite3.Connection | None, told: _Told) -> str:
    """Reads the ledger of the database that is there, as far as it can be read."""
    entries = 0
    if base is not None:
        try:
            for (line,) in base.execute("SELECT line FROM ledger ORDER BY seq"):
                told.take(bytes(line))
                entries += 1
        except (sqlite3.DatabaseError, ValueError, KeyError, TypeError, StatementError):
            base = None
    told.sources.append(f"the store before: {entries} entries")
    return "nothing" if not entries else "in part" if base is None else "whole"


def _read_ledger(file: Path, trust: TrustBundle, told: _Told) -> None:
    """Reads an exported ledger, once it is verified from its first entry to its checkpoint."""
    try:
        lines = [line.rstrip(b"\r\n") for line in file.read_bytes().splitlines()]
        first = json.loads(lines[0])["seq"]
    except OSError as error:
        raise RestoreError("UNREADABLE", f"{file}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, IndexError):
        raise RestoreError("ENTRY_MALFORMED", str(file)) from None
    found = ledger_file.verify(lines, trust, first=first)
    if isinstance(found, ledger_file.Defect):
        raise RestoreError(str(found.code), f"{file}: entry {found.seq}")
    for line in lines[:-1]:
        told.take(line)
    told.sources.append(f"a ledger: entries {first} to {found.size}, head {found.head}")


async def _begun(deployment: StoppedProvider, staged: Path, told: _Told, marks: Sequence[tuple[Path, str]]) -> Restored:
    """The restore has begun in the staged file, and all is taken back that ledgers and marks hold."""
    store = await Store.open(f"sqlite+aiosqlite:///{staged}")
    provider = Provider(
        deployment.settings, deployment.keys, store, deployment.now, platform=None, policies=deployment.policies
    )
    try:
        async with store.read() as view:
            after = await view.restoring.lacks(told.named)
        doubted = frozenset[str]().union(*(told.named[digest] for digest in after))
        begin = RestoreStore(told.line, doubted, told.suspended(after), tuple(told.sources))
        done = await provider.run(begin, actor=ACTOR)
        events: list[Any] = [*done.events]
        for at in range(0, len(told.lost), PAGE):
            events += (await provider.run(TakeBack(tuple(told.lost[at : at + PAGE])), actor=ACTOR)).events
        for file, text in marks:
            events += await _mark_taken(provider, file, text)
        async with store.read() as view:
            held = sum(getattr(party, "held", False) for party in await view.all_parties("agent"))
            waits_for = unheard(await view.load(Wanted(), young_ms=0))
    except Problem as problem:
        raise RestoreError(str(problem.code), problem.detail) from None
    finally:
        await store.close()
    line = max(event.line for event in events if isinstance(event, StoreRestored | LineBegun))
    taken_back = sum(isinstance(event, Revoked) for event in events)
    return Restored(line, taken_back, waits_for, held, None, "")


def _texts(file: Path) -> list[str]:
    """Signed parts of marks that a file holds."""
    try:
        return file.read_text("ascii").split()
    except (OSError, UnicodeDecodeError) as error:
        raise RestoreError("UNREADABLE", f"{file}: {error}") from error


async def _mark_taken(provider: Provider, file: Path, text: str) -> Iterable[object]:
    """Events that follow from a part of a mark; it is the point's newest on the word of its bringer."""
    async with provider.store.read() as view:
        points = {p.thumbprint: p for p in await view.active("pep") if isinstance(p, RegisteredPep)}
    try:
        mark_statement.open(text, {point.key for point in points.values()}, DEFAULT)
    except CapabilityError as error:
        raise RestoreError(str(error.code), f"{file}: {error.detail}") from None
    point = points[signer_thumbprint(text)]
    return (await provider.run(TakeMark(point.id, text), actor=point.id)).events


def _swapped(staged: Path, place: Path, line: int) -> Path | None:
    """Puts the staged file in the store's place in one step; the file that was there has another name, too."""
    kept = None
    if place.exists():
        names = (
            place.with_name(f"{place.name}.before-{line}{more}") for more in ("", *map("-{}".format, range(2, 99)))
        )
        kept = next(name for name in names if not name.exists())
        os.link(place, kept)
        for log in _LOGS:  # of a damaged store: beside the new one it would be taken for its own
            beside = place.with_name(place.name + log)
            if beside.exists():
                beside.rename(kept.with_name(kept.name + log))
    staged.replace(place)
    _sync(place)
    return kept
