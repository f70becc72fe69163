"""View: the state that a command sees in its transaction."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING, Any, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import (
    RevocationKind,
)
from ztpm_idp.domain.lending.amounts import Used
from ztpm_idp.domain.locks import WHOLE, Locks, party
from ztpm_idp.domain.parties import (
    Party,
    RegisteredAgent,
    RegisteredPep,
    Standing,
)
from ztpm_idp.domain.state import NOTHING_USED, Journal, MandateRecord, Nonce, State, Wanted
from ztpm_idp.domain.wanted import wanted_by_change
from ztpm_idp.store import counts, prepared, rows
from ztpm_idp.store import schema as t
from ztpm_idp.store.allowances import Counted, Using
from ztpm_idp.store.approvals import Approvals
from ztpm_idp.store.audit import Audit
from ztpm_idp.store.conduct import Conduct
from ztpm_idp.store.counters import Counters, Counting
from ztpm_idp.store.database import postgres
from ztpm_idp.store.envelopes import Envelopes
from ztpm_idp.store.latches import Latches
from ztpm_idp.store.lending import Lending, hops_by_token, refusals_by_agent
from ztpm_idp.store.login.devices import Devices
from ztpm_idp.store.login.enrolments import Enrolments
from ztpm_idp.store.login.sessions import Sessions
from ztpm_idp.store.oauth.access import OAuth
from ztpm_idp.store.people import People
from ztpm_idp.store.pictures.pictures import Pictures
from ztpm_idp.store.points import Points
from ztpm_idp.store.push.pushes import Pushes
from ztpm_idp.store.push.subscriptions import Subscriptions
from ztpm_idp.store.restoring import Restoring
from ztpm_idp.store.revocations import Revocations, batches, by_kind, epochs
from ztpm_idp.store.upkeep import Upkeep

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection


class View:
    """State as one transaction sees it, and locks, so that it holds until the end.

    Args:
        connection: within the transaction.
        locks: what it locks; None for one that only reads, and where there is one writer anyway.
    """

    def __init__(self, connection: AsyncConnection, locks: Locks | None) -> None:
        self._connection = connection
        self._locks = locks
        self._counting = Counting(connection, waits=locks is not None)
        self.approvals = Approvals(connection)
        self.conduct = Conduct(connection, self._counting)
        self.audit = Audit(connection)
        self.enrolments = Enrolments(connection)
        self.envelopes = Envelopes(connection)
        self.latches = Latches(connection)
        self.lending = Lending(connection)
        self.oauth = OAuth(connection)
        self.people = People(connection)
        self.points = Points(connection)
        self.pictures = Pictures(connection)
        self.pushes = Pushes(connection)
        self.subscriptions = Subscriptions(connection)
        self.revocations = Revocations(connection, self._counting)
        self.restoring = Restoring(connection, self._counting, self.revocations)
        self.upkeep = Upkeep(connection)
        self.using = Using(connection)
        self.sessions = Sessions(connection)
        self.devices = Devices(connection)

    async def load(self, wanted: Wanted, *, young_ms: int, counted: Counted | None = None) -> State:
        """The state that `wanted` names.

        Args:
            wanted: by a command.
            young_ms: before now; nonces given before it, and asks, approvals and openings over before it, are left out.
            counted: allowances of sponsors, by which their amounts are counted; None: none are.
        """
        change = None if wanted.change is None else await self.people.change(wanted.change)
        if change is not None:
            about = wanted_by_change(change)
            wanted = replace(about, parties=about.parties | wanted.parties)
        open_, made = await self.conduct.met(wanted.concerned, wanted.journal)
        # Agents whose conduct will change are loaded too, for their role.
        met = frozenset(report.agent for report in open_.values()) | {edge.delegate for edge in made.values()}
        await self._lock_also(met)
        held = await self.conduct.held(met | wanted.conduct_of, open_, made)
        since_s, mandate = young_ms // 1_000, await self.lending.mandate(wanted.mandate)
        behind = frozenset() if mandate is None else frozenset({mandate.sponsor, mandate.agent})
        latch = await self.latches.one(wanted.latch)
        told = frozenset() if latch is None else frozenset({latch.pep})
        parties = await self._parties(wanted.parties | met | behind | told)
        living = met | wanted.conduct_of | (frozenset() if wanted.mandates_of is None else {wanted.mandates_of})
        waiting = await self.devices.devices() if wanted.devices else ()
        asks_of, openings_of = wanted.asks_of, wanted.openings_of
        served = openings_of or wanted.envelopes_of
        counters, owners = await self.counters(), await self._owners(wanted.thumbprints, parties)
        indexed = {} if wanted.revocation is None else await self.revocations.among((wanted.revocation,))
        crowd, crowd_of_all = await counts.count(self._connection, wanted.crowd)
        return State(
            parties=parties,
            key_owners=await self._key_owners(wanted.keys | {device.key for device in waiting}),
            nonces=(await self._nonces(_those(wanted.nonces_of), young_ms)).get(wanted.nonces_of or "", {}),
            hops=await self.lending.hops(wanted),
            owner_of_thumbprint=await self._owner_of(wanted.thumbprint, parties),
            journal=await self._journal(wanted),
            revoked_at_epoch=None if wanted.revocation is None else indexed.get(wanted.revocation),
            crowd=crowd,
            crowd_of_all=crowd_of_all,
            agents_of=await counts.unrevoked_agents(self._connection, wanted.agents_of),
            empty=wanted.empty and await self._scalar(sa.select(t.parties.c.id).limit(1)) is None,
            revoked=await (self.dead() if wanted.revocations else self.dead_of(wanted.revocations_of)),
            epoch=counters.epoch,
            asked=None if wanted.ask is None else await self.approvals.asked(wanted.ask),
            standing=() if asks_of is None else await self.approvals.standing(asks_of, since_s=since_s),
            taken_ms=() if asks_of is None else await self.approvals.taken(since_s=since_s),
            approvers=0 if asks_of is None else await self.people.approvers(),
            opening=None if wanted.opening is None else await self.approvals.opening(wanted.opening),
            openings=()
            if openings_of is None and not wanted.every_opening
            else await self.approvals.openings(since_s=since_s, audience=openings_of),
            served=frozenset() if served is None else await self.approvals.served(served),
            latch=latch,
            clearings=await self.latches.clearings(wanted.latch),
            envelope=await self.envelopes.one(wanted.envelope),
            envelopes=()
            if wanted.envelopes_of is None and not wanted.every_opening
            else await self.envelopes.lasting(since_s=since_s, audience=wanted.envelopes_of),
            administrators=await self.people.administrators() if wanted.people else frozenset(),
            open_changes=await self.people.open_changes(at_ms=young_ms) if wanted.people else (),
            change=change,
            held=held,
            refusals=(await self.lending.refusals(_those(wanted.refusals_of))).get(wanted.refusals_of or "", (0, 0)),
            line=counters.revocation_line,
            restoring=counters.restoring,
            points=await self._points() if wanted.points or counters.restoring else (),
            owners=owners,
            mandate=mandate,
            drawn=await self.lending.drawn(wanted.mandate, since_s=since_s),
            mandates=await self.lending.mandates(
                since_s=since_s, agents=living, key=wanted.mandates_by, sponsor=wanted.mandates_from
            ),
            oauth=await self.oauth.state(wanted.oauth),
            tool=await self.upkeep.tool(wanted.tool),
            picture=await self.pictures.text(wanted.picture),
            sessions=await self.sessions.sessions_of(wanted.sessions_of),
            session=await self.sessions.session(wanted.session),
            offer=await self.sessions.offer(wanted.offer),
            devices=waiting,
            session_keys=await self.devices.session_keys_of(wanted.session_keys_of),
            login_owner=await self.sessions.login_owner(wanted.login),
            used=NOTHING_USED if counted is None else await self._used(wanted, mandate, counted),
            tokens_from=await self.lending.tokens_from(wanted.tokens_from, since_s=since_s),
        )

    async def load_each(self, wanted: Sequence[Wanted], *, young_ms: int, counted: Counted) -> list[State]:
        """The state of each of several commands of `domain.joint`, which want no more than such commands do.

        Args: as of `load`.
        """
        every = frozenset[str]()
        conduct_of = every.union(*(one.conduct_of for one in wanted))
        named = frozenset[tuple[str, str]]().union(*(one.revocations_of for one in wanted))
        asked = (one.revocation for one in wanted if one.revocation is not None)
        values = by_kind(sorted(named.union(asked))) | {
            "parties": sorted(every.union(*(one.parties for one in wanted))),
            "nonces_of": _those(*(one.nonces_of for one in wanted)),
            "young_ms": young_ms,
            "refusals_of": _those(*(one.refusals_of for one in wanted)),
            "tokens": _those(*(one.token for one in wanted)),
            "conduct_of": sorted(conduct_of),
            "since_s": young_ms // 1_000,
            "trees": _those(*(one.tree for one in wanted)),
            "agents": sorted(id_ for kind, id_ in named if kind == RevocationKind.AGENT.value),
        }
        read = await prepared.JOINT.read(self._connection, values)
        registered, given, refused, made, known, promised, revoked, suspended, (row,), sizes = read
        parties = {party.id: party for party in rows.parties(registered)}
        nonces, refusals, first = _nonces(given), refusals_by_agent(refused), hops_by_token(made)
        held = await self.conduct.held_by(conduct_of, known)
        mandates = [MandateRecord(*each) for each in promised]
        indexed, counters = epochs(revoked), self._counting.seen(row)
        used = {each: await self._used(each, None, counted) for each in {_counted(one) for one in wanted}}
        dead, trees = named & indexed.keys() | _agents_of(suspended), {token: int(number) for token, number in sizes}
        return [
            State(
                parties=_of(parties, one.parties),
                nonces=nonces.get(one.nonces_of or "", {}),
                hops=first.get(one.token or "", {}) if one.hop is None else await self.lending.hops(one),
                revoked_at_epoch=None if one.revocation is None else indexed.get(one.revocation),
                revoked=dead & one.revocations_of,
                epoch=counters.epoch,
                held=held.of(one.conduct_of),
                refusals=refusals.get(one.refusals_of or "", (0, 0)),
                line=counters.revocation_line,
                restoring=counters.restoring,
                mandates=tuple(mandate for mandate in mandates if mandate.agent in one.conduct_of),
                used=replace(used[_counted(one)], delegations=trees.get(one.tree or "", 0)),
            )
            for one in wanted
        ]

    async def _used(self, wanted: Wanted, mandate: MandateRecord | None, counted: Counted) -> Used:
        """Amounts that the wanted sponsor, or token, has."""
        lender = mandate.sponsor if wanted.draws and mandate is not None else wanted.lent_by
        live, made = (0, 0)
        if lender is not None:
            live, made = await self.using.tokens(lender, counted)
        return Used(
            live_tokens=live,
            tokens_an_hour=made,
            delegations=0 if wanted.tree is None else await self.using.tree(wanted.tree),
            mandates=0
            if wanted.promised_by is None
            else await self.using.mandates(wanted.promised_by, at_ms=counted.at_ms),
        )

    async def counters(self) -> Counters:
        """The counters, with this transaction's own changes."""
        return await self._counting.now()

    async def party_of_key(self, key: bytes) -> Party | None:
        """Party that owns a key, ended or not."""
        return (await self.parties_of_keys([key]))[0]

    async def parties_of_keys(self, keys: Sequence[bytes]) -> list[Party | None]:
        """Party that owns each key, ended or not."""
        found = await self._connection.execute(prepared.PARTIES_OF_KEYS, {"keys": sorted(set(keys))})
        owners = dict[bytes, Party]()
        for key, of_key in groupby(found, key=lambda row: bytes(row.shown)):
            owners[key] = rows.parties(of_key)[0]
        return [owners.get(key) for key in keys]

    async def party(self, id_: str) -> Party | None:
        """Party of this id, ended or not."""
        found = await self._read(t.parties.c.id == id_)
        return found[0] if found else None

    async def knows(self, kind: RevocationKind, id_: str) -> bool:
        """True where a thing of this kind was ever made or registered here."""
        match kind:
            case RevocationKind.TOKEN | RevocationKind.HOP | RevocationKind.MANDATE:
                return await self.lending.knows(kind, id_)
            case RevocationKind.KEY:
                return await self._owner_of(id_, {}) is not None
            case RevocationKind.AGENT | RevocationKind.SPONSOR:
                found = t.parties.c.id
            case RevocationKind.AUDIENCE:
                lists = await self._connection.execute(sa.select(t.peps.c.audiences))
                return any(id_ in audiences for (audiences,) in lists)
            case _:
                assert_never(kind)
        return await self._scalar(sa.select(found).where(found == id_).limit(1)) is not None

    async def all_parties(self, kind: str) -> list[Party]:
        """Every party of a kind, by id."""
        return await self._read(t.parties.c.kind == kind)

    async def active(self, kind: str, *, audience: str | None = None) -> list[Party]:
        """Active parties of a kind, by id; of sensors, those of an audience."""
        of = (t.parties.c.kind == kind, t.parties.c.standing == Standing.ACTIVE.value)
        return await self._read(sa.and_(*of, *(() if audience is None else (t.sensors.c.audience == audience,))))

    async def trusted(self) -> list[tuple[str, int]]:
        """Living agents whose trust is stated, by id, with that trust in permille."""
        a, p = t.agents.c, t.parties.c
        found = await self._connection.execute(
            sa.select(a.id, a.trust_permille)
            .join_from(t.agents, t.parties, p.id == a.id)
            .where(a.trust_permille.is_not(None), p.standing != Standing.REVOKED.value)
            .order_by(a.id)
        )
        return [(agent, permille) for agent, permille in found]

    async def attested(self) -> dict[str, int]:
        """Time of each agent's last attestation, wall clock in milliseconds, by id; nothing of one that never was."""
        c = t.agents.c
        query = sa.select(c.id, c.attested_ms).where(c.attested_ms.is_not(None))
        return {agent: int(at_ms) for agent, at_ms in await self._connection.execute(query)}

    async def suspended(self) -> list[str]:
        """Ids of suspended agents, in order."""
        a, p = t.agents.c, t.parties.c
        found = await self._connection.execute(
            sa.select(a.id)
            .join_from(t.agents, t.parties, p.id == a.id)
            .where(a.suspended_ms.is_not(None), p.standing != Standing.REVOKED.value)
            .order_by(a.id)
        )
        return list(found.scalars())

    async def ledger_lines(self, *, after: int, through: int, most: int) -> list[bytes]:
        """Lines of the ledger with after < seq <= through, in order, at most `most`."""
        c = t.ledger.c
        found = await self._connection.execute(
            sa.select(c.line).where(c.seq > after, c.seq <= through).order_by(c.seq).limit(most)
        )  # fmt: skip
        return [bytes(line) for (line,) in found]

    async def dead(self) -> frozenset[tuple[str, str]]:
        """Every (kind, id) by which a token is dead now: what is revoked, and agents that are suspended."""
        suspended = {(RevocationKind.AGENT.value, agent) for agent in await self.suspended()}
        return await self.revocations.every() | suspended

    async def dead_of(self, names: frozenset[tuple[str, str]]) -> frozenset[tuple[str, str]]:
        """Those of these (kind, id) by which a token is dead now."""
        if not names:
            return frozenset()
        return names & (await self.revocations.among(names)).keys() | await self._suspended(names)

    async def _suspended(self, names: frozenset[tuple[str, str]]) -> frozenset[tuple[str, str]]:
        """Agents among these (kind, id) that are suspended, in the same form."""
        agents = sorted(id_ for kind, id_ in names if kind == RevocationKind.AGENT.value)
        if not agents:
            return frozenset()
        return _agents_of(await self._connection.execute(prepared.SUSPENDED, {"agents": agents}))

    async def _scalar(self, query: sa.Select[Any]) -> Any:
        return (await self._connection.execute(query)).scalar_one_or_none()

    async def _parties(self, ids: frozenset[str]) -> dict[str, Party]:
        """The parties, with the sponsors of agents: a judgement of an agent is one of its sponsor too."""
        found = dict[str, Party]()
        for batch in batches(sorted(ids)):
            read = rows.parties(await self._connection.execute(prepared.PARTIES, {"parties": batch}))
            found |= {party.id: party for party in read}
        return found

    async def _read(self, condition: sa.ColumnElement[bool]) -> list[Party]:
        """The parties that meet the condition, by id; people with all their keys."""
        query = rows.PARTY_COLUMNS.where(condition).order_by(t.parties.c.id)
        return rows.parties(await self._connection.execute(query))

    async def _key_owners(self, keys: frozenset[bytes]) -> dict[bytes, str]:
        if not keys:
            return {}
        c = t.parties.c
        found = await self._connection.execute(sa.select(c.key, c.id).where(c.key.in_(sorted(keys))))
        now = {bytes(key): id_ for key, id_ in found} | await self.people.owners(keys)
        more = await self.upkeep.former_owners(keys) | await self.oauth.key_owners(keys)
        return now | more | await self.devices.owners(keys)

    async def _nonces(self, agents: list[str], young_ms: int) -> dict[str, dict[str, Nonce]]:
        """Nonces of these agents given since then, by agent and nonce."""
        if not agents:
            return {}
        return _nonces(await self._connection.execute(prepared.NONCES, {"nonces_of": agents, "young_ms": young_ms}))

    async def _owner_of(self, thumbprint: str | None, parties: dict[str, Party]) -> str | None:
        if thumbprint is None:
            return None
        owner = await self._owner(t.parties.c.thumbprint == thumbprint, t.person_keys.c.thumbprint == thumbprint)
        if owner is None:
            return None
        parties[owner.id] = owner
        return owner.id

    async def _owner(self, first: sa.ColumnElement[bool], further: sa.ColumnElement[bool]) -> Party | None:
        """The party whose first key meets one condition, or with a further key that meets the other."""
        found = await self._read(sa.or_(first, t.parties.c.id.in_(sa.select(t.person_keys.c.person).where(further))))
        return found[0] if found else None

    async def _owners(self, thumbprints: frozenset[str], parties: dict[str, Party]) -> dict[str, str]:
        found = {thumbprint: await self._owner_of(thumbprint, parties) for thumbprint in sorted(thumbprints)}
        return {thumbprint: owner for thumbprint, owner in found.items() if owner is not None}

    async def _points(self) -> tuple[RegisteredPep, ...]:
        return tuple(point for point in await self.active("pep") if isinstance(point, RegisteredPep))

    async def _journal(self, wanted: Wanted) -> Journal | None:
        if wanted.journal is None:
            return None
        c = t.peps.c
        query = sa.select(c.journal_seq, c.journal_head).where(c.id == wanted.journal)
        row = (await self._connection.execute(query)).one_or_none()
        if row is None:
            return None
        seqs = sorted(seq for seq in wanted.journal_seqs if 1 <= seq <= row.journal_seq)
        r = t.records.c
        found = await self._connection.execute(
            sa.select(r.seq, r.hash).where(r.pep == wanted.journal, r.seq.in_(seqs))
        )  # fmt: skip
        return Journal(row.journal_seq, row.journal_head, {row.seq: row.hash for row in found})

    async def _lock_also(self, parties: frozenset[str]) -> None:
        """These parties are locked alone, too: they come last in the order of locks."""
        more = frozenset(map(party, parties))
        if self._locks is None or WHOLE in self._locks.alone or more <= self._locks.alone:
            return
        await postgres.take(self._connection, Locks(frozenset(), more - self._locks.alone))
        self._locks = self._locks.with_alone(more)


def _nonces(given: Iterable[Any]) -> dict[str, dict[str, Nonce]]:
    """Nonces of rows of `prepared.NONCES`, by agent and nonce."""
    found = dict[str, dict[str, Nonce]]()
    for nonce, owner, given_ms, spent_on in given:
        found.setdefault(owner, {})[nonce] = Nonce(nonce, owner, given_ms, spent_on is not None)
    return found


def _agents_of(found: Iterable[Any]) -> frozenset[tuple[str, str]]:
    """Agents of rows of `prepared.SUSPENDED`, as (kind, id)."""
    return frozenset((RevocationKind.AGENT.value, agent) for (agent,) in found)


def _those(*names: str | None) -> list[str]:
    """The names, each once, in order."""
    return sorted({name for name in names if name is not None})


def _of(parties: Mapping[str, Party], ids: frozenset[str]) -> dict[str, Party]:
    """These of the parties, with the sponsors of agents among them."""
    found = {id_: parties[id_] for id_ in ids if id_ in parties}
    sponsors = {party.sponsor for party in found.values() if isinstance(party, RegisteredAgent)}
    return found | {id_: parties[id_] for id_ in sponsors if id_ in parties}


def _counted(wanted: Wanted) -> Wanted:
    """The part of it that is counted by itself: the same for all commands of one sponsor."""
    return Wanted(lent_by=wanted.lent_by, promised_by=wanted.promised_by)
