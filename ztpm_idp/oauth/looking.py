"""Introspection (RFC 7662): an enforcement point asks what an access token stands for, and gets its capability.

For every asker but an enforcement point of the token's own audience there is no such token.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.revocation import RevocationView
from capabilities.token.token_text import token_from_text
from capabilities.token.verify import Verifier
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from ztpm_idp.domain.parties import RegisteredPep
from ztpm_idp.oauth.access_token import act_of, jti_of

if TYPE_CHECKING:
    from ztpm_idp.domain.oauth.records import AccessRecord
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.provider.provider import Provider

INACTIVE: Final[dict[str, object]] = {"active": False}
CAPABILITY: Final = "ztpm_capability"
"""Member of the answer with the capability, which the asker verifies in full."""
EPOCH: Final = "ztpm_epoch"
"""Member with the revocation epoch that the token was judged by."""


async def look(provider: Provider, keys: OAuthKeys, token: str, *, asker: Party) -> dict[str, object]:
    """The answer to this enforcement point about this token, judged by every revocation of now."""
    jti = jti_of(token, keys, issuer=provider.settings.issuer)
    if jti is None or not isinstance(asker, RegisteredPep):
        return INACTIVE
    async with provider.store.read() as view:
        access = await view.oauth.access(jti)
        if access is None or access.audience not in asker.audiences:
            return INACTIVE
        counters = await view.counters()
        revoked = RevocationView(epoch=counters.epoch, age_ms=0, revoked=await view.dead())
    if counters.restoring or not _holds(provider, access, revoked):
        return INACTIVE
    told = {
        "active": True,
        "iss": provider.settings.issuer,
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
        EPOCH: counters.epoch,
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
    found = Verifier(provider.rules.trust, provider.rules.caps).verify(
        token, at=provider.now_ms() / 1_000, audience=access.audience, view=revoked, lease_ms=0
    )
    return isinstance(found, Chain)
