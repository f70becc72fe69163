"""Sessions, login links and the workers' shared secret, in their tables."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.login.events import AccessEnded, LoginAdded, LoginEnded, LoginOffered, SessionBegun, SessionEnded
from ztpm_idp.domain.login.records import OFFER_MS, Authentication, Method, Offer, Session
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.store.login import login_schema as t
from ztpm_idp.store.rows import REVOKED_KEYS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.login.events import SessionEvent


class Sessions:
    """Access of one transaction to sessions and login links."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def session(self, session_id: str | None) -> Session | None:
        """The session, unless the key or the login that began it has ended."""
        found = () if session_id is None else await self._sessions(t.sessions.c.session_id == session_id)
        return found[0] if found else None

    async def sessions_of(self, person: str | None) -> tuple[Session, ...]:
        """Sessions of a person that may last, oldest first."""
        return () if person is None else await self._sessions(t.sessions.c.person == person)

    async def offer(self, digest: bytes | None) -> Offer | None:
        """The login link, unless the key that signed for it has ended."""
        if digest is None:
            return None
        c = t.login_offers.c
        row = (
            await self._connection.execute(
                sa.select(t.login_offers).where(c.digest == digest, c.key_shown.not_in(REVOKED_KEYS))
            )
        ).one_or_none()
        return None if row is None else Offer(bytes(row.digest), row.person, row.key_shown, row.made_ms)

    async def login_owner(self, login: str | None) -> str | None:
        """The person whose login this is, ended or not."""
        if login is None:
            return None
        c = t.person_logins.c
        found: str | None = await self._connection.scalar(sa.select(c.person).where(c.login == login))
        return found

    async def logins(self) -> dict[str, list[str]]:
        """Every login at another provider, by person, in order."""
        c, found = t.person_logins.c, defaultdict[str, list[str]](list)
        for person, login in await self._connection.execute(sa.select(c.person, c.login).order_by(c.login)):
            found[person].append(login)
        return dict(found)

    async def secret(self) -> bytes:
        """Secret that all workers of this store share."""
        return bytes((await self._connection.execute(sa.select(t.login_secret.c.secret))).scalar_one())

    async def seen(self, session_id: str, *, at_ms: int) -> None:
        """The session was heard of now."""
        await self._connection.execute(
            sa.update(t.sessions).where(t.sessions.c.session_id == session_id).values(seen_ms=at_ms)
        )

    async def write(self, event: SessionEvent, *, at_ms: int) -> None:
        """The event is in its tables."""
        match event:
            case LoginOffered(offer=offer):
                # A person has one link at a time, and links that nobody opened are not kept.
                c = t.login_offers.c
                await self._connection.execute(
                    sa.delete(t.login_offers).where(sa.or_(c.person == offer.person, c.made_ms < at_ms - OFFER_MS))
                )
                await self._connection.execute(
                    sa.insert(t.login_offers).values(
                        digest=offer.digest, person=offer.person, key_shown=offer.key, made_ms=offer.made_ms
                    )
                )
            case SessionBegun(session=session, offer=offer_digest):
                if offer_digest is not None:
                    await self._connection.execute(
                        sa.delete(t.login_offers).where(t.login_offers.c.digest == offer_digest)
                    )
                await self._connection.execute(sa.delete(t.sessions).where(t.sessions.c.ends_ms < at_ms))
                await self._connection.execute(
                    sa.insert(t.sessions).values(
                        session_id=session.session_id,
                        person=session.person,
                        made_ms=session.made_ms,
                        seen_ms=session.seen_ms,
                        ends_ms=session.ends_ms,
                        **how_values(session.how, session.roles),
                    )
                )
            case SessionEnded(session_id=session_id):
                await self._connection.execute(sa.delete(t.sessions).where(t.sessions.c.session_id == session_id))
            case LoginAdded(person=person, login=login):
                await self._connection.execute(
                    sa.insert(t.person_logins).values(login=login, person=person, added_ms=at_ms)
                )
            case LoginEnded(login=login):
                # What it began is over with it: see `living`.
                await self._connection.execute(sa.delete(t.person_logins).where(t.person_logins.c.login == login))
            case AccessEnded(person=person):
                for table in (t.sessions, t.login_offers, t.person_logins):
                    await self._connection.execute(sa.delete(table).where(table.c.person == person))
                now = sa.case((t.session_keys.c.ends_ms > at_ms, at_ms), else_=t.session_keys.c.ends_ms)
                await self._connection.execute(
                    sa.update(t.session_keys).where(t.session_keys.c.person == person).values(ends_ms=now)
                )
            case _:
                assert_never(event)

    async def _sessions(self, condition: sa.ColumnElement[bool]) -> tuple[Session, ...]:
        found = await self._connection.execute(
            sa.select(t.sessions).where(condition, *living(t.sessions)).order_by(t.sessions.c.made_ms)
        )
        return tuple(
            Session(
                row.session_id, row.person, how_of(row), roles_of(row), row.made_ms, row.seen_ms, row.ends_ms, row.wrong
            )
            for row in found
        )


def living(table: sa.Table) -> tuple[sa.ColumnElement[bool], ...]:
    """Conditions under which the key or login that is behind a row of this table still stands."""
    known = sa.select(t.person_logins.c.login).where(t.person_logins.c.person == table.c.person)
    return (
        table.c.key_shown.not_in(REVOKED_KEYS),
        sa.or_(table.c.login == "", table.c.login.in_(known)),
    )


def how_values(how: Authentication, roles: Iterable[PersonRole]) -> dict[str, Any]:
    """Values of the columns that say how a person was authenticated."""
    return {
        "method": how.method.value,
        "at_ms": how.at_ms,
        "acr": how.acr,
        "amr": list(how.amr),
        "key_shown": how.key,
        "login": how.login,
        "roles": sorted(role.value for role in roles),
    }


def how_of(row: sa.Row[Any]) -> Authentication:
    """The authentication that a row states."""
    return Authentication(Method(row.method), row.at_ms, row.acr, tuple(row.amr), row.key_shown, row.login)


def roles_of(row: sa.Row[Any]) -> frozenset[PersonRole]:
    """The roles that a row states."""
    return frozenset(PersonRole(role) for role in row.roles)
