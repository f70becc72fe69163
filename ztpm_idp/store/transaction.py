"""Transaction: the state that a command sees, and the rows that its events write."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Final, NamedTuple, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.asking.envelope_acts import EnvelopeRevoked, EnvelopeSigned
from ztpm_idp.domain.asking.latch_acts import ClearingSigned, LatchTaken
from ztpm_idp.domain.asking.pushes import PushFailed
from ztpm_idp.domain.entries import entry_of, traced
from ztpm_idp.domain.events import (
    AgentAttested,
    AgentRestored,
    AgentsHeld,
    AgentSuspended,
    AgentVouched,
    ApprovalActRefused,
    AskTaken,
    ChangeAnswered,
    ChangeEnded,
    ChangeProposed,
    ConductObserved,
    DelegationRefused,
    KeyAdded,
    LineBegun,
    MandateSigned,
    NonceConsumed,
    NonceGiven,
    OpeningClosed,
    OpeningMade,
    PartyRegistered,
    PermitConcluded,
    PermitOpened,
    PictureNamed,
    PictureTaken,
    PointHeard,
    RecordTaken,
    RefusalCounted,
    RefusalsSpent,
    Revoked,
    RolesChanged,
    StoreRestored,
    StoreResumed,
    SuspensionEnded,
    TokenDelegated,
    TokenIssued,
    ToolRegistered,
    TrustStated,
    VoteCast,
)
from ztpm_idp.domain.ledger import seal
from ztpm_idp.domain.login.events import DeviceEvent, SessionEvent
from ztpm_idp.domain.oauth.events import OAuthEvent
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    Standing,
)
from ztpm_idp.domain.upkeep.acts import UpkeepEvent
from ztpm_idp.store import prepared, rows
from ztpm_idp.store import schema as t
from ztpm_idp.store.counters import Counters
from ztpm_idp.store.database import postgres, postgres_trips
from ztpm_idp.store.errors import LocksTooFewError
from ztpm_idp.store.lending import spend
from ztpm_idp.store.revocations import batches
from ztpm_idp.store.view import View

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from ztpm_idp.domain.events import Event

NONCE_MEMORY_MS = 600_000
"""Milliseconds for which a nonce's row is kept: ten times the longest age at which it counts."""


_APPENDING: Final = postgres_trips.Appending([field.name for field in fields(Counters)])


class Made(NamedTuple):
    """Event of one command.

    Attributes:
        event: as it was decided.
        actor: for the ledger.
        trace_id: of the request that brought it about; None of none.
    """

    event: Event
    actor: str
    trace_id: str | None


class Transaction(View):
    """Reads and writes of one command, or of several. Made by `Store`.

    It commits when its block ends, and rolls back when it raises.

    Attributes:
        unused: of each proof with which it was opened, whether it was unused.
    """

    unused: Sequence[bool] = ()

    async def append(self, events: Iterable[Event], *, actor: str, at_ms: int, trace_id: str | None = None) -> int:
        """The events are in their tables and in the ledger; see `append_each`."""
        return await self.append_each([Made(event, actor, trace_id) for event in events], at_ms=at_ms)

    async def append_each(self, made: Sequence[Made], *, at_ms: int) -> int:
        """The events are in their tables and in the ledger, in this order.

        Returns the highest epoch given, or the epoch as it was.

        Args:
            made: events in order.
            at_ms: now.

        Raises:
            LocksTooFewError: they change more than this transaction has locked.
            OnceOnlyError: something that happens once has happened in another transaction.
        """
        counting = self._counting
        if self._locks is not None and not self._locks.cover(each.event for each in made):
            raise LocksTooFewError
        # Hops first: rows of access tokens name them.
        await self._write_alike([each.event for each in made], at_ms)
        for each in made:
            await self._write(each.event, each.actor, at_ms)
        # From here on others wait: entries are numbered and chained in the order of commits.
        revoked = [(each.actor, each.event) for each in made if isinstance(each.event, Revoked)]
        await self.revocations.write(revoked, at_ms)
        lines = await self._sealed(made, at_ms)
        if self._locks is None:
            for batch in batches(lines):
                await self._connection.execute(prepared.NEW_ENTRY, batch)
            await counting.write()
        elif counting.changed:
            after = asdict(await counting.stored())
            await _APPENDING.write(self._connection, lines, after, tell=bool(revoked))
        return (await counting.now()).epoch

    async def _sealed(self, made: Sequence[Made], at_ms: int) -> list[dict[str, object]]:
        """Rows of the ledger's entries about these events, which the counters count already."""
        kept = [(each, *told) for each in made if (told := entry_of(each.event)) is not None]
        if not kept:
            return []  # without an entry no lock of the counters, for which others would wait
        counters, lines = await self._counting.locked(), list[dict[str, object]]()
        size, head = counters.ledger_size, counters.ledger_head
        for each, kind, body in kept:
            whole = traced(kind, body, each.trace_id)
            entry = seal(seq=size + 1, prev=head, at_ms=at_ms, actor=each.actor, kind=kind, body=whole)
            lines.append({"seq": entry.seq, "hash": entry.digest, "line": entry.line})
            size, head = entry.seq, entry.digest
        await self._counting.change(ledger_size=size, ledger_head=head)
        return lines

    async def _write_alike(self, events: list[Event], at_ms: int) -> None:
        """Events that come most often are written kind by kind, each kind in its order, and before all others."""
        await spend(self._connection, [event for event in events if isinstance(event, NonceConsumed)], at_ms=at_ms)
        await self._give([event for event in events if isinstance(event, NonceGiven)], at_ms)
        await self.lending.write(
            (event for event in events if isinstance(event, TokenIssued | TokenDelegated)), at_ms=at_ms
        )
        await self.conduct.observe([event for event in events if isinstance(event, ConductObserved)])

    async def _give(self, events: list[NonceGiven], at_ms: int) -> None:
        if not events:
            return
        # Their own alone: another agent's are in nobody's way.
        if self._connection.dialect.name == postgres.DIALECT:
            made = [(event.nonce, event.agent, event.given_ms) for event in events]
            await postgres_trips.give(self._connection, made, old_ms=at_ms - NONCE_MEMORY_MS)
            return
        old = [{"agent_": event.agent, "old_ms": at_ms - NONCE_MEMORY_MS} for event in events]
        await self._connection.execute(prepared.FORGET_NONCES, old)
        given = [{"nonce": event.nonce, "agent": event.agent, "given_ms": event.given_ms} for event in events]
        await self._connection.execute(prepared.NEW_NONCE, given)

    async def _write(self, event: Event, actor: str, at_ms: int) -> None:
        if isinstance(event, SessionEvent):
            await self.sessions.write(event, at_ms=at_ms)
            return
        if isinstance(event, DeviceEvent):
            await self.devices.write(event, at_ms=at_ms)
            return
        if isinstance(event, OAuthEvent):
            await self.oauth.write(event, at_ms=at_ms)
            return
        if isinstance(event, ToolRegistered | UpkeepEvent):
            await self.upkeep.write(event, at_ms=at_ms)
            await self._registry_changed()
            return
        match event:
            case PartyRegistered(party=party):
                for insert in rows.party_inserts(party, at_ms):
                    await self._connection.execute(insert)
                match party:
                    case RegisteredSensor() | RegisteredPep():
                        await self._registry_changed()
                    case RegisteredPerson(roles=roles) if PersonRole.APPROVER in roles:
                        await self._registry_changed()
                    case _:
                        pass
            case KeyAdded() | RolesChanged() | ChangeProposed() | ChangeAnswered() | ChangeEnded():
                await self.people.write(event, at_ms=at_ms)
                if isinstance(event, KeyAdded | RolesChanged):
                    await self._registry_changed()
            case TrustStated(agent=agent, permille=permille):
                await self._connection.execute(
                    sa.update(t.agents).where(t.agents.c.id == agent).values(trust_permille=permille)
                )
                await self._registry_changed()
            case AgentSuspended(agent=agent) | SuspensionEnded(agent=agent):
                since_ms = at_ms if isinstance(event, AgentSuspended) else None
                await self._connection.execute(
                    sa.update(t.agents).where(t.agents.c.id == agent).values(suspended_ms=since_ms)
                )
                await self._registry_changed()
            case AgentAttested(agent=agent):
                await self._stand(agent, Standing.ACTIVE)
                await self._connection.execute(
                    sa.update(t.agents).where(t.agents.c.id == agent).values(attested_ms=at_ms)
                )
            case MandateSigned():
                await self.lending.sign(event)
            case RefusalCounted(agent=agent, since_ms=since_ms, number=number):
                await self._connection.execute(sa.delete(t.refusals).where(t.refusals.c.agent == agent))
                counted = sa.insert(t.refusals).values(agent=agent, since_ms=since_ms, number=number)
                await self._connection.execute(counted)
            case DelegationRefused() | ApprovalActRefused() | RefusalsSpent() | PushFailed():
                pass  # the ledger entry is all there is
            case NonceConsumed() | NonceGiven() | TokenIssued() | TokenDelegated() | ConductObserved() | Revoked():
                pass  # all of a kind at once
            case RecordTaken(pep=pep, seq=seq, digest=digest):
                await self._connection.execute(sa.insert(t.records).values(pep=pep, seq=seq, hash=digest))
                await self._connection.execute(
                    sa.update(t.peps).where(t.peps.c.id == pep).values(journal_seq=seq, journal_head=digest)
                )  # fmt: skip
            case PermitOpened() | PermitConcluded() | AgentRestored():
                await self.conduct.write(event)
            case PictureNamed(digest=digest):
                await self.pictures.name(digest, at_ms=at_ms)
            case PictureTaken(digest=digest, text=text):
                await self.pictures.keep(digest, text, at_ms=at_ms)
            case AskTaken() | VoteCast() | OpeningMade() | OpeningClosed():
                await self.approvals.write(event, actor=actor, at_ms=at_ms)
            case LatchTaken() | ClearingSigned():
                if isinstance(event, LatchTaken):
                    await self.pushes.begin_again(event.latch.latch_id)
                await self.latches.write(event, at_ms=at_ms)
            case EnvelopeSigned() | EnvelopeRevoked():
                await self.envelopes.write(event, actor=actor, at_ms=at_ms)
            case StoreRestored() | LineBegun() | PointHeard() | AgentsHeld() | StoreResumed() | AgentVouched():
                await self.restoring.write(event)
            case _:
                assert_never(event)

    async def _registry_changed(self) -> None:
        await self._counting.next("registry_version")

    async def _stand(self, party: str, standing: Standing) -> None:
        # Revoked is for ever: no later event brings a party back.
        await self._connection.execute(
            sa.update(t.parties)
            .where(t.parties.c.id == party, t.parties.c.standing != Standing.REVOKED.value)
            .values(standing=standing.value)
        )
