"""Introspection (RFC 7662): an enforcement point asks what an access token stands for, and gets its capability.

For every asker but an enforcement point of the token's own audience there is no such token.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements.revocation import RevocationView
from capabilities.token.token_text import token_from_text
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from ztpm_idp.domain.parties import RegisteredPep
from ztpm_idp.oauth.access_token import act_of, jti_of
from ztpm_idp.store.asking import AskedTogether

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ztpm_idp.domain.oauth.records import AccessRecord
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.provider.provider import Provider

INACTIVE: Final[dict[str, object]] = {"active": False}
CAPABILITY: Final = "ztpm_capability"
"""Member of the answer with the capability, which the asker verifies in full."""
EPOCH: Final = "ztpm_epoch"
"""Member with the revocation epoch that the token was judged by."""


@dataclass(frozen=True, slots=True)
class Seen:
    """An access token as the store holds it.

    Attributes:
        access: its record, if there is one.
        view: of the revocations by which its capability may be dead, as of one instant with the record.
        restoring: a restore waits for its end.
    """

    access: AccessRecord | None
    view: RevocationView
    restoring: bool


class Lookups:
    """Looks at access tokens; at those that are asked for at once in one transaction.

    Args:
        provider: of the store and of the verifier.
    """

    def __init__(self, provider: Provider) -> None:
        self._provider = provider
        self._asked = AskedTogether[str, Seen](self._seen)

    async def look(self, keys: OAuthKeys, token: str, *, asker: Party) -> dict[str, object]:
        """The answer to this enforcement point about this token, judged by every revocation of now."""
        provider = self._provider
        jti = jti_of(token, keys, issuer=provider.settings.issuer)
        if jti is None or not isinstance(asker, RegisteredPep):
            return INACTIVE
        seen = await self._asked.ask(jti)
        access = seen.access
        if access is None or access.audience not in asker.audiences:
            return INACTIVE
        if seen.restoring or not _holds(provider, access, seen.view):
            return INACTIVE
        return _told(access, issuer=provider.settings.issuer, epoch=seen.view.epoch)

    async def _seen(self, jtis: Sequence[str]) -> list[Seen]:
        provider = self._provider
        async with provider.store.read() as view:
            found = await view.oauth.accesses(jtis)
            counters = await view.counters()
            names = frozenset[tuple[str, str]]().union(
                *(_names(provider, access, counters.epoch) for access in found.values())
            )
            dead = RevocationView(epoch=counters.epoch, age_ms=0, revoked=await view.dead_of(names))
        return [Seen(found.get(jti), dead, counters.restoring) for jti in jtis]


def _names(provider: Provider, access: AccessRecord, epoch: int) -> frozenset[tuple[str, str]]:
    """Every (kind, id) by which the capability may be dead; none of one that cannot be read, which never holds."""
    token = token_from_text(access.capability, provider.rules.caps)
    found = token if isinstance(token, Fault) else provider.rules.verifier.names(token, epoch=epoch)
    return frozenset() if isinstance(found, Fault) else found


def _told(access: AccessRecord, *, issuer: str, epoch: int) -> dict[str, object]:
    told = {
        "active": True,
        "iss": issuer,
        "sub": access.sponsor,
        "aud": access.audience,
        "client_id": access.client_id,
        "token_type": "Bearer" if access.jkt is None else "DPoP",
        "iat": access.issued_at,
        "exp": access.not_after,
        "auth_time": access.authenticated_at,
        "jti": access.jti,
        "act": act_of(access.actors),
        CAPABILITY: access.capability,
        EPOCH: epoch,
    }
    if access.scope:
        told["scope"] = access.scope
    if access.jkt is not None:
        told["cnf"] = {"jkt": access.jkt}
    return told


def _holds(provider: Provider, access: AccessRecord, revoked: RevocationView) -> bool:
    """True where the capability verifies in full, now."""
    token = token_from_text(access.capability, provider.rules.caps)
    if isinstance(token, Fault):
        return False
    found = provider.rules.verifier.verify(
        token, at=provider.now_ms() / 1_000, audience=access.audience, view=revoked, lease_ms=0
    )
    return isinstance(found, Chain)
