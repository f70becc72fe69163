"""OAuth in the store: clients, scope templates, assents, codes and tokens."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.oauth.events import (
    AccessMade,
    AssentGiven,
    ClientRegistered,
    CodeSpent,
    FamilyEnded,
    RefreshMade,
    RefreshSpent,
    TemplateDeclared,
    TemplateEnded,
)
from ztpm_idp.domain.oauth.records import (
    NOTHING,
    AccessRecord,
    ClientRecord,
    CodeRecord,
    FamilyRecord,
    OAuthState,
    RefreshRecord,
    TemplateRecord,
)
from ztpm_idp.store import schema
from ztpm_idp.store.database.among import among
from ztpm_idp.store.errors import OnceOnlyError
from ztpm_idp.store.oauth import tables as t

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.oauth.events import OAuthEvent
    from ztpm_idp.domain.oauth.records import OAuthWanted

GRACE_MS: Final = 600_000
"""Milliseconds for which an access token's row is kept after its end, for a clock that is set back."""
LISTED: Final = 256
"""Most rows of a list that a caller is shown."""
_GONE: Final = schema.revocations.alias()
_LIVES: Final = ~sa.exists().where(
    sa.or_(
        sa.and_(_GONE.c.kind == RevocationKind.TOKEN.value, _GONE.c.id == t.access_tokens.c.token_id),
        sa.and_(_GONE.c.kind == RevocationKind.HOP.value, _GONE.c.id == t.access_tokens.c.jti),
    )
)
"""Access tokens whose own revocation is still to come."""

_A: Final = t.access_tokens.c
_ACCESS: Final = sa.select(
    _A.jti, _A.token_id, _A.family, _A.client_id, _A.actors, _A.sponsor, _A.authenticated_at, _A.audience, _A.scope,
    _A.jkt, _A.issued_at, _A.not_after, _A.capability,
)  # fmt: skip
"""Access tokens, in the order of the fields of `AccessRecord`."""
_ACCESSES: Final = _ACCESS.where(among(_A.jti, "jtis"))


class OAuth:
    """Access of one transaction to the records of OAuth."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    # --- reading

    async def state(self, wanted: OAuthWanted | None) -> OAuthState:
        """The wanted records."""
        if wanted is None:
            return NOTHING
        code = None if wanted.code is None else await self.code(wanted.code)
        refresh = None if wanted.refresh is None else await self.refresh(wanted.refresh)
        family = None if wanted.family is None else await self.family(wanted.family)
        about = family or (None if code is None else code.family) or (None if refresh is None else refresh.family)
        return OAuthState(
            client=None if wanted.client is None else await self.client(wanted.client),
            templates=tuple(await self.templates(names=wanted.templates)) if wanted.templates else (),
            code=code,
            refresh=refresh,
            family=family,
            access=None if wanted.access is None else await self._unrevoked(wanted.access),
            live=() if about is None else tuple(await self._accesses(t.access_tokens.c.family == about.family, _LIVES)),
        )

    async def client(self, client_id: str) -> ClientRecord | None:
        """The registered client."""
        found = await self._rows(sa.select(t.clients).where(t.clients.c.client_id == client_id))
        return _client(found[0]) if found else None

    async def clients(self) -> list[ClientRecord]:
        """Registered clients, by id."""
        return [_client(row) for row in await self._rows(sa.select(t.clients).order_by(t.clients.c.client_id))]

    async def templates(
        self, *, names: frozenset[str] | None = None, audience: str | None = None
    ) -> list[TemplateRecord]:
        """Templates of these names, of this audience, or every one; by name."""
        c = t.templates.c
        query = sa.select(c.name, c.words, c.audience, c.limits, c.declared_by).order_by(c.name)
        if names is not None:
            query = query.where(c.name.in_(sorted(names)))
        if audience is not None:
            query = query.where(c.audience == audience)
        return [TemplateRecord(*tuple(row)) for row in await self._rows(query)]

    async def code(self, digest: str) -> CodeRecord | None:
        """The code of this digest, with its family."""
        c = t.codes.c
        found = await self._rows(sa.select(t.codes).where(c.digest == digest))
        if not found:
            return None
        row = found[0]
        family = await self._family(row.family)
        return CodeRecord(row.digest, family, row.redirect, row.challenge, row.given_ms, row.spent_ms is not None)

    async def refresh(self, digest: str) -> RefreshRecord | None:
        """The refresh token of this digest, with its family."""
        c = t.refresh_tokens.c
        found = await self._rows(sa.select(c.digest, c.family, c.spent_ms).where(c.digest == digest))
        if not found:
            return None
        return RefreshRecord(found[0].digest, await self._family(found[0].family), found[0].spent_ms is not None)

    async def family(self, family: str) -> FamilyRecord | None:
        """The family of this id."""
        found = await self._families(t.families.c.family == family)
        return found[0] if found else None

    async def families_of(self, sponsor: str | None) -> list[FamilyRecord]:
        """Families of a person, or of everybody: the newest, at most `LISTED`."""
        return await self._families(sa.true() if sponsor is None else t.families.c.sponsor == sponsor)

    async def access(self, jti: str) -> AccessRecord | None:
        """The access token of this id, while its row is kept."""
        found = await self._accesses(t.access_tokens.c.jti == jti)
        return found[0] if found else None

    async def accesses(self, jtis: Sequence[str]) -> dict[str, AccessRecord]:
        """The access tokens of these ids, while their rows are kept."""
        found = await self._connection.execute(_ACCESSES, {"jtis": sorted(set(jtis))})
        return {row.jti: replace(AccessRecord(*tuple(row)), actors=tuple(row.actors)) for row in found}

    async def key_owners(self, keys: frozenset[bytes]) -> dict[bytes, str]:
        """Ids of clients by those of the keys that are theirs."""
        c = t.clients.c
        found = await self._rows(sa.select(c.key, c.client_id).where(c.key.in_(sorted(keys))))
        return {bytes(row.key): row.client_id for row in found}

    async def _family(self, family: str) -> FamilyRecord:
        (found,) = await self._families(t.families.c.family == family)
        return found

    async def _families(self, condition: sa.ColumnElement[bool]) -> list[FamilyRecord]:
        c = t.families.c
        columns = (
            c.family, c.client_id, c.agent, c.sponsor, c.method, c.authenticated_at, c.resource, c.scope, c.limits,
            c.jkt, c.not_after, c.ended_ms.is_not(None),
        )  # fmt: skip
        query = sa.select(*columns).where(condition).order_by(c.made_ms.desc(), c.family).limit(LISTED)
        return [FamilyRecord(*tuple(row)) for row in await self._rows(query)]

    async def _unrevoked(self, jti: str) -> AccessRecord | None:
        found = await self._accesses(t.access_tokens.c.jti == jti, _LIVES)
        return found[0] if found else None

    async def _accesses(self, *conditions: sa.ColumnElement[bool]) -> list[AccessRecord]:
        found = await self._rows(_ACCESS.where(*conditions).order_by(t.access_tokens.c.jti))
        return [replace(AccessRecord(*tuple(row)), actors=tuple(row.actors)) for row in found]

    async def _rows(self, query: sa.Select[Any]) -> Sequence[Any]:
        return list(await self._connection.execute(query))

    # --- writing

    async def write(self, event: OAuthEvent, *, at_ms: int) -> None:
        """Writes the event's rows.

        Raises:
            OnceOnlyError: the code or refresh token was spent in another transaction.
        """
        match event:
            case ClientRegistered(client=client):
                await self._insert(
                    t.clients,
                    client_id=client.client_id,
                    name=client.name,
                    key=client.key,
                    redirects=list(client.redirects),
                    registered_ms=at_ms,
                )
            case TemplateDeclared(template=made):
                await self._connection.execute(sa.delete(t.templates).where(t.templates.c.name == made.name))
                await self._insert(
                    t.templates,
                    name=made.name,
                    words=made.words,
                    audience=made.audience,
                    limits=made.limits,
                    declared_by=made.by,
                    declared_ms=at_ms,
                )
            case TemplateEnded(name=name):
                await self._connection.execute(sa.delete(t.templates).where(t.templates.c.name == name))
            case AssentGiven(code=code):
                await self._forget(at_ms)
                await self._assent(code, at_ms)
            case CodeSpent(digest=digest, family=family, jkt=jkt):
                await self._spend(t.codes, digest, at_ms)
                await self._connection.execute(
                    sa.update(t.families).where(t.families.c.family == family).values(jkt=jkt)
                )
            case RefreshSpent(digest=digest):
                await self._spend(t.refresh_tokens, digest, at_ms)
            case RefreshMade(digest=digest, family=family):
                await self._insert(t.refresh_tokens, digest=digest, family=family, made_ms=at_ms)
            case AccessMade(access=access):
                await self._access(access, at_ms)
            case FamilyEnded(family=family):
                c = t.families.c
                await self._connection.execute(
                    sa.update(t.families).where(c.family == family, c.ended_ms.is_(None)).values(ended_ms=at_ms)
                )
            case _:
                assert_never(event)

    async def _assent(self, code: CodeRecord, at_ms: int) -> None:
        family = code.family
        await self._insert(
            t.families,
            family=family.family,
            client_id=family.client_id,
            agent=family.agent,
            sponsor=family.sponsor,
            method=family.method,
            authenticated_at=family.authenticated_at,
            resource=family.resource,
            scope=family.scope,
            limits=family.limits,
            jkt=family.jkt,
            not_after=family.not_after,
            made_ms=at_ms,
        )
        await self._insert(
            t.codes,
            digest=code.digest,
            family=family.family,
            redirect=code.redirect,
            challenge=code.challenge,
            given_ms=code.given_ms,
        )

    async def _access(self, access: AccessRecord, at_ms: int) -> None:
        c = t.access_tokens.c
        over_s = (at_ms - GRACE_MS) // 1_000
        await self._connection.execute(sa.delete(t.access_tokens).where(c.not_after < over_s))
        await self._insert(
            t.access_tokens,
            jti=access.jti,
            token_id=access.token_id,
            family=access.family,
            client_id=access.client_id,
            actors=list(access.actors),
            sponsor=access.sponsor,
            authenticated_at=access.authenticated_at,
            audience=access.audience,
            scope=access.scope,
            jkt=access.jkt,
            issued_at=access.issued_at,
            not_after=access.not_after,
            capability=access.capability,
        )

    async def _forget(self, at_ms: int) -> None:
        """Families that were over a while ago go, with their codes and refresh tokens; the ledger keeps the assent."""
        over_s = (at_ms - GRACE_MS) // 1_000
        over = sa.select(t.families.c.family).where(t.families.c.not_after < over_s)
        for table in (t.access_tokens, t.refresh_tokens, t.codes, t.families):
            await self._connection.execute(sa.delete(table).where(table.c.family.in_(over)))

    async def _spend(self, table: sa.Table, digest: str, at_ms: int) -> None:
        c = table.c
        spent = await self._connection.execute(
            sa.update(table).where(c.digest == digest, c.spent_ms.is_(None)).values(spent_ms=at_ms)
        )
        if spent.rowcount != 1:
            raise OnceOnlyError

    async def _insert(self, table: sa.Table, **values: object) -> None:
        await self._connection.execute(sa.insert(table).values(**values))


def _client(row: Any) -> ClientRecord:
    return ClientRecord(row.client_id, row.name, None if row.key is None else bytes(row.key), tuple(row.redirects))
