"""DPoP at the endpoints of clients (RFC 9449): the proof, its nonce, and its one use."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import b64u, unb64u
from capabilities.proof.dpop import check_plain
from capabilities.values.errors import BadKeyError, Fault
from ztpm_idp.oauth.problem import OAuthError, OAuthProblem

if TYPE_CHECKING:
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.provider.provider import Provider

NONCE_S: Final = 300
"""Seconds for which a nonce of ours is taken."""
HEADER: Final = "DPoP-Nonce"
_LABEL: Final = "dpop nonce"
_NONCE: Final = re.compile(r"([0-9]{1,12})\.([A-Za-z0-9_-]{43})", re.ASCII)


def nonce(keys: OAuthKeys, *, at_s: int) -> str:
    """A fresh nonce, which any worker recognises without a table."""
    said = str(at_s)
    return f"{said}.{b64u(keys.mac(_LABEL, said.encode()))}"


def is_young(text: str | None, keys: OAuthKeys, *, at_s: int) -> bool:
    """True for a nonce of ours that is at most `NONCE_S` old."""
    found = None if text is None else _NONCE.fullmatch(text)
    if found is None:
        return False
    try:
        ours = keys.made(_LABEL, found[1].encode(), unb64u(found[2]))
    except BadKeyError:
        return False
    return ours and 0 <= at_s - int(found[1]) <= NONCE_S


async def thumbprint_of(
    provider: Provider, keys: OAuthKeys, proofs: list[str], *, url: str, method: str = "POST"
) -> str | None:
    """The thumbprint of the key that the request proves, or None for a request without a proof.

    Args:
        provider: remembers proofs.
        keys: make the nonces.
        proofs: every `DPoP` header.
        url: of the endpoint, as the issuer names it.
        method: of HTTP.

    Raises:
        OAuthProblem: `invalid_dpop_proof`; `use_dpop_nonce`, with a nonce, for a good proof without a young one.
    """
    if not proofs:
        return None
    if len(proofs) > 1:
        raise OAuthProblem(OAuthError.INVALID_DPOP_PROOF, "one DPoP header")
    at_ms, caps = provider.now_ms(), provider.rules.caps
    found = check_plain(proofs[0], method=method, url=url, token=None, at=at_ms / 1_000, caps=caps)
    if isinstance(found, Fault):
        raise OAuthProblem(OAuthError.INVALID_DPOP_PROOF, found.code.value)
    if not is_young(found.nonce, keys, at_s=at_ms // 1_000):
        fresh = {HEADER: nonce(keys, at_s=at_ms // 1_000)}
        raise OAuthProblem(OAuthError.USE_DPOP_NONCE, "a proof with this nonce", headers=fresh)
    expires_ms = (found.iat + caps.proof_age_s + caps.skew_s) * 1_000
    if not await provider.store.first_use(key=found.key, jti=found.jti, expires_ms=expires_ms, at_ms=at_ms):
        raise OAuthProblem(OAuthError.INVALID_DPOP_PROOF, "the proof was used before")
    return found.thumbprint
