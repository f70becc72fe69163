"""Conduct of agents in its tables: the reducers' states, their published part, and PERMITs without an outcome yet."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

import sqlalchemy as sa

from capabilities.statements.conduct import AgentEntry, DeviationEntry, EdgeEntry
from policies.conduct.behaviour import BehaviourState
from policies.conduct.report import Edge, Report
from policies.conduct.trust import TrustState
from ztpm_idp.domain.agent_conduct import AgentConduct, Held
from ztpm_idp.domain.conduct import OPEN_RECORDS
from ztpm_idp.domain.events import AgentRestored, ConductObserved, PermitConcluded, PermitOpened
from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import prepared
from ztpm_idp.store import schema as t
from ztpm_idp.store.database import postgres
from ztpm_idp.store.errors import StoreUnavailableError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

    from policies.conduct.history import AgentHistory
    from ztpm_idp.domain.agent_conduct import Concerned, Published
    from ztpm_idp.store.counters import Counting

ConductEvent = PermitOpened | PermitConcluded | AgentRestored
IDS: Final = 500
"""Ids in one statement: below any database's limit on variables."""


@dataclass(frozen=True, slots=True)
class Told:
    """Changes of conduct after some version.

    Attributes:
        edges, agents: each in the order of their versions.
    """

    edges: tuple[EdgeEntry, ...]
    agents: tuple[AgentEntry, ...]


class Conduct:
    """Access of one transaction to agents' conduct."""

    def __init__(self, connection: AsyncConnection, counting: Counting) -> None:
        self._connection = connection
        self._counting = counting

    # --- reading -----------------------------------------------------------------------------------------------------

    async def met(self, concerned: Concerned | None, pep: str | None) -> tuple[dict[str, Report], dict[str, Edge]]:
        """Open PERMITs, by request, and edges, by hop, that the records of `pep`'s journal are about."""
        if concerned is None or pep is None:
            return {}, {}
        return await self._open(pep, concerned.requests), await self._made(concerned.hops)

    async def held(self, agents: frozenset[str], open_: dict[str, Report], made: dict[str, Edge]) -> Held:
        """Conduct of these agents, beside what is known of records already.

        A young one's peers are as they are at this moment: only their own records may change them meanwhile.
        """
        return await self._beside(agents, await self._agents(agents), open_, made)

    async def held_by(self, agents: frozenset[str], rows: Iterable[Any]) -> Held:
        """Conduct of these agents, of which the rows of `prepared.CONDUCT` were read."""
        return await self._beside(agents, _by_agent(rows), {}, {})

    async def _beside(
        self, agents: frozenset[str], found: dict[str, AgentConduct], open_: dict[str, Report], made: dict[str, Edge]
    ) -> Held:
        peers = await self._peers([agent for agent in sorted(agents) if _young(agent, found.get(agent))])
        return Held(agents=found, open=open_, made=made, peers=peers)

    async def told(self, *, since: int, most: int) -> Told:
        """Changes after `since` of living parties: the oldest, at most `most` edges and as many agents."""
        e, c = t.edges.c, t.conduct.c
        living = sa.select(t.parties.c.id).where(t.parties.c.standing != Standing.REVOKED.value)
        edges = await self._connection.execute(
            sa.select(e.version, e.delegator, e.delegate, e.score_permille)
            .where(e.version > since, e.delegate.in_(living), e.delegator.in_(living))
            .order_by(e.version)
            .limit(most)
        )
        agents = await self._connection.execute(
            sa.select(c.version, c.agent, c.standing)
            .where(c.version > since, c.agent.in_(living))
            .order_by(c.version)
            .limit(most)
        )
        return Told(
            tuple(EdgeEntry(*row) for row in edges),
            tuple(_entry(version, agent, json.loads(standing)) for version, agent, standing in agents),
        )

    async def everybody(self) -> tuple[dict[str, dict[str, int]], dict[str, dict[str, Any]]]:
        """Published trust of each delegator and last standing, both by agent."""
        e, c = t.edges.c, t.conduct.c
        scores: dict[str, dict[str, int]] = {}
        for delegator, delegate, permille in await self._connection.execute(
            sa.select(e.delegator, e.delegate, e.score_permille).order_by(e.delegate, e.delegator)
        ):
            scores.setdefault(delegate, {})[delegator] = permille
        found = await self._connection.execute(sa.select(c.agent, c.standing))
        return scores, {agent: json.loads(standing) for agent, standing in found}

    async def _open(self, pep: str, requests: frozenset[str]) -> dict[str, Report]:
        p, found = t.permits.c, dict[str, Report]()
        for ids in _some(requests):
            rows = await self._connection.execute(
                sa.select(p.request_id, p.report).where(p.pep == pep, p.request_id.in_(ids))
            )
            found |= {request_id: Report.from_json(json.loads(report)) for request_id, report in rows}
        return found

    async def _made(self, hops: frozenset[str]) -> dict[str, Edge]:
        """Edge of each of these hops; the delegator of a first hop is its sponsor."""
        parent, found = t.hops.alias("above"), dict[str, Edge]()
        for ids in _some(hops):
            rows = await self._connection.execute(
                sa.select(t.hops.c.hop_id, t.hops.c.sponsor, t.hops.c.agent, parent.c.agent.label("delegator"))
                .select_from(t.hops.outerjoin(parent, parent.c.hop_id == t.hops.c.parent))
                .where(t.hops.c.hop_id.in_(ids))
            )
            found |= {row.hop_id: Edge(row.delegator or row.sponsor, row.agent) for row in rows}
        return found

    async def _agents(self, agents: frozenset[str]) -> dict[str, AgentConduct]:
        found = dict[str, AgentConduct]()
        for ids in _some(agents):
            found |= _by_agent(await self._connection.execute(prepared.CONDUCT, {"conduct_of": ids}))
        return found

    async def _peers(self, agents: list[str]) -> dict[str, dict[str, AgentHistory]]:
        """Histories of other living agents of the same sponsor and role, for each of these agents.

        A sponsor answers for one agent and for those that it is compared with.
        """
        found: dict[str, dict[str, AgentHistory]] = {agent: {} for agent in agents}
        if self._connection.dialect.name == postgres.DIALECT:
            rows = [row for ids in _some(agents) for row in await self._each(prepared.PEERS_OF_EACH, {"ids": ids})]
        else:
            rows = [row for agent in agents for row in await self._each(prepared.PEERS, {"agent_": agent})]
        for peer, text, agent in rows:
            if (career := _behaviour(text).careers.get(peer)) is not None:
                found[agent][peer] = career
        return found

    async def _each(self, query: sa.Select[Any], values: dict[str, Any]) -> Sequence[Any]:
        rows: Sequence[Any] = (await self._connection.execute(query, values)).all()
        return rows

    # --- writing -----------------------------------------------------------------------------------------------------

    async def write(self, event: ConductEvent) -> None:
        """The event is in its tables."""
        p = t.permits.c
        match event:
            case PermitOpened(pep=pep, seq=seq, report=report):
                same = sa.and_(p.pep == pep, p.request_id == report.request_id)
                # A new decision takes the place of one that was not acted on; one that is too old for an outcome goes.
                await self._connection.execute(
                    sa.delete(t.permits).where(sa.or_(same, sa.and_(p.pep == pep, p.seq < seq - OPEN_RECORDS)))
                )
                text = json.dumps(report.to_json())
                values = {"pep": pep, "request_id": report.request_id, "seq": seq, "report": text}
                await self._connection.execute(sa.insert(t.permits).values(**values))
            case PermitConcluded(pep=pep, request_id=request_id):
                await self._connection.execute(sa.delete(t.permits).where(p.pep == pep, p.request_id == request_id))
            case AgentRestored():
                await self.observe([event])
            case _:
                assert_never(event)

    async def observe(self, events: Sequence[ConductObserved | AgentRestored]) -> None:
        """The conduct of agents, of which each event is about another one, is in its tables."""
        if not events:
            return
        ids = {"ids": [event.agent for event in events]}
        before = {agent: (told, at) for agent, told, at in await self._connection.execute(prepared.STANDING, ids)}
        edges: dict[str, dict[str, int]] = {event.agent: {} for event in events}
        for agent, delegator, permille in await self._connection.execute(prepared.EDGES, ids):
            edges[agent][delegator] = permille
        made, changed = list[dict[str, Any]](), list[dict[str, Any]]()
        for event in events:
            row = await self._row(event, before.get(event.agent))
            if event.agent in before:
                changed.append({"agent_": event.agent, **row})
            else:
                made.append({"agent": event.agent, **row})
            await self._edges(event.agent, event.published, edges[event.agent])
        if made:
            await self._connection.execute(prepared.NEW_CONDUCT, made)
        if changed:
            await self._connection.execute(prepared.CHANGE_CONDUCT, changed)

    async def _row(self, event: ConductObserved | AgentRestored, before: tuple[str, int] | None) -> dict[str, Any]:
        conduct, standing = event.conduct, _standing(event.published)
        was = _NOTHING_TO_TELL if before is None else _told(json.loads(before[0]))
        version = 0 if before is None else before[1]
        if _told(standing) != was:
            version = await self._counting.next("conduct_version")
        return {
            "trust": json.dumps(conduct.trust.to_json()),
            "behaviour": json.dumps(conduct.behaviour.to_json()),
            "restored_at": conduct.restored_at,
            "standing": json.dumps(standing),
            "version": version,
        }

    async def _edges(self, agent: str, published: Published, before: dict[str, int]) -> None:
        e = t.edges.c
        now = {edge.delegator: permille for edge, permille in published.scores.items()}
        for delegator in sorted(before.keys() | now.keys()):
            score = now.get(delegator, published.default_permille)
            if score == before.get(delegator, published.default_permille):
                continue
            values = {"score_permille": score, "version": await self._counting.next("conduct_version")}
            if delegator in before:
                same = sa.and_(e.delegator == delegator, e.delegate == agent)
                await self._connection.execute(sa.update(t.edges).where(same).values(**values))
            else:
                await self._connection.execute(sa.insert(t.edges).values(delegator=delegator, delegate=agent, **values))


def _trust(text: str) -> TrustState:
    try:
        return TrustState.from_json(json.loads(text))
    except ValueError as error:
        # A changed row, or one of another version: to begin anew would be to forgive everything.
        raise StoreUnavailableError from error


def _behaviour(text: str) -> BehaviourState:
    try:
        return BehaviourState.from_json(json.loads(text))
    except ValueError as error:
        raise StoreUnavailableError from error  # as above


def _by_agent(rows: Iterable[Any]) -> dict[str, AgentConduct]:
    """Conduct of rows of `prepared.CONDUCT`, by agent."""
    return {
        agent: AgentConduct(_trust(trust), _behaviour(behaviour), restored_at)
        for agent, trust, behaviour, restored_at in rows
    }


def _young(agent: str, known: AgentConduct | None) -> bool:
    """True where the agent has no baseline of its own yet."""
    career = None if known is None else known.behaviour.careers.get(agent)
    return career is None or career.baseline is None


_NOTHING_TO_TELL: Final = ((), None, False, None)


def _standing(published: Published) -> dict[str, Any]:
    reading = published.reading
    return {
        "deviations": [
            {"feature": str(d.feature), "since": d.since, "score_milli": d.score_milli} for d in reading.deviations
        ],
        "deviated_at": reading.deviated_at,
        "contracted": reading.contracted,
        "samples": reading.samples,
        "restored_at": published.restored_at,
    }


def _told(standing: dict[str, Any]) -> tuple[object, ...]:
    """Part of a standing whose change is news.

    The number of acts that it rests on is none, nor how far a feature has left its baseline by now.
    """
    features = tuple((d["feature"], d["since"]) for d in standing["deviations"])
    return features, standing["deviated_at"], standing["contracted"], standing["restored_at"]


def _entry(version: int, agent: str, standing: dict[str, Any]) -> AgentEntry:
    deviations = tuple(DeviationEntry(**deviation) for deviation in standing["deviations"])
    return AgentEntry(version=version, agent=agent, **(standing | {"deviations": deviations}))


def _some(ids: Iterable[str]) -> list[list[str]]:
    """The ids, `IDS` at a time."""
    every = sorted(ids)
    return [every[at : at + IDS] for at in range(0, len(every), IDS)]
