"""Counts of the parties whose number is bounded, and the agents that end with a person."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import PersonRole, Standing
from ztpm_idp.domain.state import AgentsOf, Approvers, PepsOf, SensorsOf, SuspendedBeside, ToolsBeside, TrustBeside
from ztpm_idp.store import schema as t
from ztpm_idp.store.rows import REVOKED_KEYS

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.state import Crowd


async def count(connection: AsyncConnection, crowd: Crowd | None) -> tuple[int, int]:
    """Number in a crowd: of the same sponsor where sponsors are bounded singly, and of all."""
    living = t.parties.c.standing != Standing.REVOKED.value
    match crowd:
        case None:
            return 0, 0
        case AgentsOf(sponsor):
            found = _living(t.agents).where(living, t.agents.c.sponsor == sponsor)
        case TrustBeside(agent):
            return await _beside(connection, agent, t.agents.c.trust_permille)
        case SuspendedBeside(agent):
            return await _beside(connection, agent, t.agents.c.suspended_ms)
        case ToolsBeside(audience, name):
            found = sa.select(t.tools.c.name).where(t.tools.c.audience == audience, t.tools.c.name != name)
        case SensorsOf(audience):
            found = _living(t.sensors).where(living, t.sensors.c.audience == audience)
        case PepsOf(audiences):
            # Audiences are a list in one column, too.
            rows = await connection.execute(_living(t.peps).add_columns(t.peps.c.audiences).where(living))
            served = Counter(audience for row in rows for audience in audiences.intersection(row.audiences))
            most = max(served.values(), default=0)
            return most, most
        case Approvers():
            # Roles are a list in one column; people are few.
            rows = await connection.execute(_living(t.people).add_columns(t.people.c.roles).where(living))
            who = [row.id for row in rows if PersonRole.APPROVER.value in row.roles]
            k = t.person_keys.c
            further = sa.select(k.thumbprint).where(k.person.in_(who), k.thumbprint.not_in(REVOKED_KEYS))
            approvers = len(who) + await _number(connection, further)
            return approvers, approvers
        case _:
            assert_never(crowd)
    number = await _number(connection, found)
    return number, number


async def unrevoked_agents(connection: AsyncConnection, person: str | None) -> tuple[str, ...]:
    """Ids of a person's agents that are not in the revocation index, in order."""
    if person is None:
        return ()
    r = t.revocations.c
    revoked = sa.select(r.id).where(r.kind == RevocationKind.AGENT.value, r.id == t.agents.c.id).exists()
    found = await connection.execute(
        sa.select(t.agents.c.id).where(t.agents.c.sponsor == person, ~revoked).order_by(t.agents.c.id)
    )
    return tuple(found.scalars())


async def _beside(connection: AsyncConnection, agent: str, column: sa.Column[int]) -> tuple[int, int]:
    """Number of other living agents that have a value in this column: of the agent's sponsor, and of all."""
    a = t.agents.c
    others = _living(t.agents).where(
        t.parties.c.standing != Standing.REVOKED.value, column.is_not(None), a.id != agent
    )  # fmt: skip
    sponsor_of = sa.select(a.sponsor).where(a.id == agent).scalar_subquery()
    return await _number(connection, others.where(a.sponsor == sponsor_of)), await _number(connection, others)


def _living(table: sa.Table) -> sa.Select[tuple[str]]:
    return sa.select(table.c.id).join(t.parties, t.parties.c.id == table.c.id)


async def _number(connection: AsyncConnection, found: sa.Select[tuple[str]]) -> int:
    return int((await connection.execute(sa.select(sa.func.count()).select_from(found.subquery()))).scalar_one())
