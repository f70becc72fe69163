"""Rows of what is kept up: suspensions of parts and tools, and keys that were replaced."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, assert_never

import sqlalchemy as sa

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.events import ToolRegistered
from ztpm_idp.domain.parties import Standing
from ztpm_idp.domain.upkeep.acts import KeyReplaced, PartKind, PartRestored, PartSuspended, ToolAct, ToolChanged
from ztpm_idp.store import schema as t
from ztpm_idp.store.revocations import batches

if TYPE_CHECKING:
    from collections.abc import Collection

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.upkeep.acts import UpkeepEvent


class Upkeep:
    """Access of one transaction to suspensions and former keys."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def tool(self, what: tuple[str, str] | None) -> Standing | None:
        """Standing of the tool of this audience and name; None where it is not registered, or not wanted."""
        if what is None:
            return None
        c = t.tools.c
        query = sa.select(c.suspended_ms).where(c.audience == what[0], c.name == what[1])
        row = (await self._connection.execute(query)).one_or_none()
        if row is None:
            return None
        return Standing.ACTIVE if row.suspended_ms is None else Standing.SUSPENDED

    async def tools(self) -> list[sa.Row[Any]]:
        """Every tool of every audience, by audience and name."""
        c = t.tools.c
        return list(await self._connection.execute(sa.select(t.tools).order_by(c.audience, c.name)))

    async def tools_of(self, audience: str) -> list[sa.Row[Any]]:
        """The tools of an audience that are not suspended, by name."""
        c = t.tools.c
        query = sa.select(t.tools).where(c.audience == audience, c.suspended_ms.is_(None)).order_by(c.name)
        return list(await self._connection.execute(query))

    async def former_owners(self, keys: frozenset[bytes]) -> dict[bytes, str]:
        """Owners of those of these keys that were replaced."""
        c = t.former_keys.c
        found = await self._connection.execute(sa.select(c.key, c.party).where(c.key.in_(sorted(keys))))
        return {bytes(key): party for key, party in found}

    async def former_keys_of(self, parties: Collection[str]) -> dict[str, list[tuple[int, str]]]:
        """Thumbprints of the keys that these parties had before, each with when it was replaced, the earliest first."""
        c, found = t.former_keys.c, dict[str, list[tuple[int, str]]]()
        for some in batches(sorted(parties)):
            query = sa.select(c.party, c.replaced_ms, c.key).where(c.party.in_(some)).order_by(c.replaced_ms)
            for party, replaced_ms, key in await self._connection.execute(query):
                found.setdefault(party, []).append((replaced_ms, thumbprint(bytes(key))))
        return found

    async def write(self, event: UpkeepEvent | ToolRegistered, *, at_ms: int) -> None:
        """Writes one event; the registry's version is the caller's to raise."""
        match event:
            case PartSuspended(kind=kind, id=id_) | PartRestored(kind=kind, id=id_):
                table = t.peps if kind is PartKind.PEP else t.sensors
                since_ms = at_ms if isinstance(event, PartSuspended) else None
                change = sa.update(table).where(table.c.id == id_).values(suspended_ms=since_ms)
                await self._connection.execute(change)
            case KeyReplaced(id=id_, key=key, before=before):
                former = sa.insert(t.former_keys).values(key=before, party=id_, replaced_ms=at_ms)
                await self._connection.execute(former)
                p = t.parties.c
                now = sa.update(t.parties).where(p.id == id_).values(key=key, thumbprint=thumbprint(key))
                await self._connection.execute(now)
                # An agent has shown nothing yet that holds the new key.
                unattested = sa.update(t.parties).where(
                    p.id == id_, p.kind == "agent", p.standing == Standing.ACTIVE.value
                )
                await self._connection.execute(unattested.values(standing=Standing.REGISTERED.value))
            case ToolRegistered(tool=tool):
                await self._connection.execute(
                    sa.delete(t.tools).where(t.tools.c.audience == tool.audience, t.tools.c.name == tool.name)
                )  # fmt: skip
                await self._connection.execute(
                    sa.insert(t.tools).values(
                        audience=tool.audience,
                        name=tool.name,
                        definition_digest=tool.definition_digest,
                        operation=tool.operation,
                        base_tier=int(tool.base_tier),
                    )
                )
            case ToolChanged(audience=audience, name=name, act=act):
                c = t.tools.c
                this = (c.audience == audience, c.name == name)
                if act is ToolAct.RETIRE:
                    await self._connection.execute(sa.delete(t.tools).where(*this))
                else:
                    since_ms = at_ms if act is ToolAct.SUSPEND else None
                    await self._connection.execute(sa.update(t.tools).where(*this).values(suspended_ms=since_ms))
            case _:
                assert_never(event)
