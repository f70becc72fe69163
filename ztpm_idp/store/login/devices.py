"""Devices that wait for a person, and session-bound keys, in their tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

import sqlalchemy as sa

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.login.events import (
    CodeWrong,
    DeviceAnswered,
    DeviceAsked,
    DevicePolled,
    SessionKeyAdded,
    SessionKeyEnded,
)
from ztpm_idp.domain.login.records import DEVICE_MS, Device, DeviceState, SessionKey
from ztpm_idp.store.login import login_schema as t
from ztpm_idp.store.login.sessions import how_of, how_values, living, roles_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.login.events import DeviceEvent


class Devices:
    """Access of one transaction to devices and session-bound keys."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def devices(self) -> tuple[Device, ...]:
        """Every device that waits, or did a moment ago."""
        found = await self._connection.execute(sa.select(t.device_logins).order_by(t.device_logins.c.made_ms))
        return tuple(
            Device(
                bytes(row.digest), row.user_code, bytes(row.key), row.name, row.address,
                row.made_ms, row.polled_ms, row.interval_s, DeviceState(row.state), row.person,
            )
            for row in found
        )  # fmt: skip

    async def session_key(self, key: bytes) -> SessionKey | None:
        """The session-bound key, unless the key or login behind it has ended."""
        found = await self._keys(t.session_keys.c.key == key)
        return found[0] if found else None

    async def session_keys_of(self, person: str | None) -> tuple[SessionKey, ...]:
        """Session-bound keys of a person, oldest first."""
        return () if person is None else await self._keys(t.session_keys.c.person == person)

    async def owners(self, keys: Iterable[bytes]) -> dict[bytes, str]:
        """The people whose session-bound keys these are or were."""
        c = t.session_keys.c
        found = await self._connection.execute(sa.select(c.key, c.person).where(c.key.in_(sorted(keys))))
        return {bytes(key): person for key, person in found}

    async def write(self, event: DeviceEvent, *, at_ms: int) -> None:
        """The event is in its tables."""
        d, k, s = t.device_logins.c, t.session_keys.c, t.sessions.c
        match event:
            case DeviceAsked(device=device):
                await self._connection.execute(sa.delete(t.device_logins).where(d.made_ms < at_ms - DEVICE_MS))
                values = {name: getattr(device, name) for name in Device.__slots__} | {"state": device.state.value}
                await self._connection.execute(sa.insert(t.device_logins).values(**values))
            case DevicePolled(digest=digest, interval_s=interval_s):
                await self._connection.execute(
                    sa.update(t.device_logins).where(d.digest == digest).values(polled_ms=at_ms, interval_s=interval_s)
                )
            case CodeWrong(session_id=session_id, wrong=wrong):
                await self._connection.execute(
                    sa.update(t.sessions).where(s.session_id == session_id).values(wrong=wrong)
                )
            case DeviceAnswered(digest=digest, person=person, confirmed=confirmed):
                state = DeviceState.CONFIRMED if confirmed else DeviceState.DECLINED
                await self._connection.execute(
                    sa.update(t.device_logins).where(d.digest == digest).values(state=state.value, person=person)
                )
            case SessionKeyAdded(session_key=made):
                await self._connection.execute(
                    sa.insert(t.session_keys).values(
                        key=made.key,
                        thumbprint=thumbprint(made.key),
                        person=made.person,
                        name=made.name,
                        made_ms=made.made_ms,
                        ends_ms=made.ends_ms,
                        **how_values(made.how, made.roles),
                    )
                )
            case SessionKeyEnded(key=key):
                await self._connection.execute(
                    sa.update(t.session_keys).where(k.key == key, k.ends_ms > at_ms).values(ends_ms=at_ms)
                )
            case _:
                assert_never(event)

    async def _keys(self, condition: sa.ColumnElement[bool]) -> tuple[SessionKey, ...]:
        found = await self._connection.execute(
            sa.select(t.session_keys).where(condition, *living(t.session_keys)).order_by(t.session_keys.c.made_ms)
        )
        return tuple(
            SessionKey(bytes(row.key), row.person, row.name, how_of(row), roles_of(row), row.made_ms, row.ends_ms)
            for row in found
        )
