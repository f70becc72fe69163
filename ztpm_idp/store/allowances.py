"""Amounts that a sponsor has of bounded things, counted over the rows that are there: no counter is kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa

from ztpm_idp.domain.lending.amounts import HOUR_MS, AllowanceTable, Used
from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection

_SPONSOR: Final[sa.BindParameter[Any]] = sa.bindparam("sponsor_")
_AT_S: Final[sa.BindParameter[Any]] = sa.bindparam("at_s", type_=sa.BigInteger)


def _unrevoked(kind: str, column: sa.Column[str]) -> sa.ColumnElement[bool]:
    r = t.revocations.c
    return ~sa.select(r.id).where(r.kind == kind, r.id == column).exists()


_FIRST: Final = (t.hops.c.sponsor == _SPONSOR, t.hops.c.parent.is_(None))
# Who was made within the hour cannot have been over before it began: one range of the index has both.
_TOKENS: Final = sa.select(
    sa.func.coalesce(sa.func.sum(sa.case((t.hops.c.not_after > _AT_S, 1), else_=0)), 0),
    sa.func.coalesce(
        sa.func.sum(sa.case((t.hops.c.made_ms > sa.bindparam("since_ms", type_=sa.BigInteger), 1), else_=0)), 0
    ),
).where(*_FIRST, t.hops.c.not_after >= sa.bindparam("since_s", type_=sa.BigInteger))
_LIVE: Final = (
    sa.select(sa.func.count())
    .select_from(t.hops)
    .where(
        *_FIRST,
        t.hops.c.not_after > _AT_S,
        _unrevoked("token", t.hops.c.token_id),
        _unrevoked("hop", t.hops.c.hop_id),
    )
)
_TREE: Final = sa.select(sa.func.count()).select_from(t.hops).where(t.hops.c.token_id == sa.bindparam("token"))
_MANDATES: Final = (
    sa.select(sa.func.count())
    .select_from(t.mandates)
    .where(
        t.mandates.c.sponsor == _SPONSOR,
        t.mandates.c.not_after > _AT_S,
        _unrevoked("mandate", t.mandates.c.mandate_id),
    )
)
_AGENTS: Final = (
    sa.select(sa.func.count())
    .select_from(t.agents.join(t.parties, t.parties.c.id == t.agents.c.id))
    .where(t.agents.c.sponsor == _SPONSOR, t.parties.c.standing != Standing.REVOKED.value)
)


SPARE: Final = 1_000
"""Tokens left, at least, where a count may be as old as `RECENT_MS`; ours, more than one process makes meanwhile."""
RECENT_MS: Final = 1_000
REMEMBERED: Final = 1_024
"""Sponsors whose counts are remembered; beyond it all are counted anew."""


@dataclass(slots=True)
class Counted:
    """Allowances by which amounts are counted, and counts of a moment ago.

    Attributes:
        at_ms: now, milliseconds since the epoch.
        allowances: of every sponsor.
        recent: by sponsor, when its tokens were counted, live ones and those of an hour; of none near an allowance.
    """

    at_ms: int
    allowances: AllowanceTable
    recent: dict[str, tuple[int, int, int]]


class Using:
    """Access of one transaction to what sponsors have."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def tokens(self, sponsor: str, counted: Counted) -> tuple[int, int]:
        """Tokens of a sponsor that are live, and those made within the hour before now.

        Revoked ones are told from live ones only where that may decide. Far below its allowances a sponsor's tokens are
        counted once in `RECENT_MS`: there may be as many as a sponsor can have.
        """
        at_ms, most = counted.at_ms, counted.allowances.of(sponsor)
        found = counted.recent.get(sponsor)
        if found is not None and 0 <= at_ms - found[0] < RECENT_MS:
            return found[1:]
        live, made = await self._tokens(sponsor, at_ms)
        if live >= most.live_tokens:
            live = int(await self._connection.scalar(_LIVE, {"sponsor_": sponsor, "at_s": at_ms // 1_000}) or 0)
        if len(counted.recent) >= REMEMBERED:
            counted.recent.clear()
        if most.live_tokens - live >= SPARE and most.tokens_an_hour - made >= SPARE:
            counted.recent[sponsor] = at_ms, live, made
        else:
            counted.recent.pop(sponsor, None)
        return live, made

    async def _tokens(self, sponsor: str, at_ms: int) -> tuple[int, int]:
        """Tokens of a sponsor that are not over, revoked or not, and those made within the hour before `at_ms`."""
        at = {"sponsor_": sponsor, "at_s": at_ms // 1_000}
        hour = {"since_ms": at_ms - HOUR_MS, "since_s": (at_ms - HOUR_MS) // 1_000}
        live, made = (await self._connection.execute(_TOKENS, at | hour)).one()
        return int(live), int(made)

    async def tree(self, token: str) -> int:
        """Hops of a token and of all that were made of it."""
        return int(await self._connection.scalar(_TREE, {"token": token}) or 0)

    async def mandates(self, sponsor: str, *, at_ms: int) -> int:
        """Mandates of a sponsor that are in force."""
        return int(await self._connection.scalar(_MANDATES, {"sponsor_": sponsor, "at_s": at_ms // 1_000}) or 0)

    async def shown(self, sponsor: str, *, at_ms: int, asks: int) -> Used:
        """All that a sponsor has, exactly; `asks` are counted already."""
        at = {"sponsor_": sponsor, "at_s": at_ms // 1_000}
        _, made = await self._tokens(sponsor, at_ms)
        deepest = sa.select(sa.func.count().label("number")).where(
            t.hops.c.token_id.in_(sa.select(t.hops.c.token_id).where(*_FIRST, t.hops.c.not_after > _AT_S))
        )
        return Used(
            live_tokens=int(await self._connection.scalar(_LIVE, at) or 0),
            tokens_an_hour=made,
            delegations=int(
                await self._connection.scalar(
                    sa.select(sa.func.coalesce(sa.func.max(sa.column("number")), 0)).select_from(
                        deepest.group_by(t.hops.c.token_id).subquery()
                    ),
                    at,
                )
                or 0
            ),
            mandates=await self.mandates(sponsor, at_ms=at_ms),
            agents=int(await self._connection.scalar(_AGENTS, {"sponsor_": sponsor}) or 0),
            asks=asks,
        )
