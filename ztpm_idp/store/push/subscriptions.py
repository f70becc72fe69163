"""Subscriptions of devices in their table, written beside the state: nothing is decided on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import sqlalchemy as sa

from ztpm_idp.domain.asking.subscriptions import Subscription
from ztpm_idp.domain.parties import Standing
from ztpm_idp.store import schema
from ztpm_idp.store.login.login_schema import sessions
from ztpm_idp.store.login.sessions import living
from ztpm_idp.store.push import push_schema as t

if TYPE_CHECKING:
    from sqlalchemy.ext.asyncio import AsyncConnection


class Subscriptions:
    """Access of one transaction to subscriptions."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def living(self, *, at_ms: int) -> tuple[Subscription, ...]:
        """Subscriptions of active people whose session is not at its end, the oldest first."""
        c = t.push_subscriptions.c
        found = await self._connection.execute(
            sa.select(t.push_subscriptions, sessions.c.person)
            .join_from(t.push_subscriptions, sessions, sessions.c.session_id == c.session_id)
            .join(schema.parties, schema.parties.c.id == sessions.c.person)
            .where(
                sessions.c.ends_ms > at_ms,
                schema.parties.c.standing == Standing.ACTIVE.value,
                *living(sessions),
            )
            .order_by(c.made_ms, c.subscription_id)
        )
        return tuple(
            Subscription(row.person, row.session_id, row.endpoint, bytes(row.key), bytes(row.secret), row.made_ms)
            for row in found
        )

    async def keep(self, subscription: Subscription) -> None:
        """The subscription is in the table, in place of one of the same browser."""
        await self.end(subscription.id)
        await self._connection.execute(
            sa.insert(t.push_subscriptions).values(
                subscription_id=subscription.id,
                session_id=subscription.session_id,
                endpoint=subscription.endpoint,
                key=subscription.key,
                secret=subscription.secret,
                made_ms=subscription.made_ms,
            )
        )

    async def end(self, subscription_id: str) -> None:
        """There is no such subscription any more."""
        c = t.push_subscriptions.c
        await self._connection.execute(sa.delete(t.push_subscriptions).where(c.subscription_id == subscription_id))
