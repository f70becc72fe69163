"""Copies of the store, made while it serves, and put back with every revocation that is known elsewhere.

A copy that is put back begins a new line of revocations in the state of being restored, before it stands in the
store's place; what it waits for there is the domain's (`ztpm_idp.domain.restoring`).
"""

from __future__ import annotations

import asyncio
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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
from ztpm_idp.store.database.copies import SqlitePlace, UnreadableError
from ztpm_idp.store.database.postgres import DIALECT
from ztpm_idp.store.database.postgres_copies import PostgresPlace
from ztpm_idp.store.errors import RestoreError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from capabilities.keys.trust import TrustBundle
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.settings import Settings
    from ztpm_idp.store.database.copies import Place

ACTOR: Final = "restore"
"""Actor in the ledger for acts of a restore that nobody did over the wire."""
PAGE: Final = 1_000
"""Revocations that are taken back in one transaction."""
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


def place_of(database_url: str, folder: Path) -> Place:
    """The place of a store.

    Args:
        database_url: as in the settings.
        folder: for the files of a restore into a server.
    """
    url = sa.make_url(database_url)
    return PostgresPlace(url, folder) if url.get_backend_name() == DIALECT else SqlitePlace(Path(url.database or ""))


def backup(database_url: str, destination: Path) -> int:
    """A consistent copy of the store, one file of mode 0600, while the service runs; its size in bytes.

    Raises:
        RestoreError: `EXISTS`, `UNREADABLE`, `UNWRITABLE`, `COPY_UNUSABLE`.
        StoreUnavailableError: the server cannot be had.
    """
    place_of(database_url, destination.parent).copied_to(destination)
    return destination.stat().st_size


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
    place = place_of(deployment.settings.database_url, Path() if copy is None else copy.parent)
    told = _Told()
    for ledger in ledgers:
        _read_ledger(ledger, deployment.keys.trust(issuer=deployment.settings.issuer, root_key_id=0), told)
    texts = [(file, text) for file in marks for text in _texts(file)]
    with place.alone() as lines:
        before = _read_before(lines, told)
        with place.staged(copy) as staged:
            done = asyncio.run(_begun(deployment, staged, told, texts))
            kept = place.put(staged, done.line)
    return Restored(done.line, done.taken_back, done.waits_for, done.held, kept, before)


def _read_before(lines: Iterable[bytes], told: _Told) -> str:
    """Reads the ledger of the database that is there, as far as it can be read."""
    entries, whole = 0, True
    try:
        for line in lines:
            told.take(line)
            entries += 1
    except (UnreadableError, ValueError, KeyError, TypeError, StatementError):
        whole = False
    told.sources.append(f"the store before: {entries} entries")
    return "nothing" if not entries else "whole" if whole else "in part"


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
