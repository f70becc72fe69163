"""Making the first block of a token."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.keys import keys
from capabilities.keys.signing_key import SigningKey
from capabilities.token import biscuit, block, block_signatures, hop_rules
from capabilities.values.chain import HopGrant, Sponsor
from capabilities.values.errors import FaultCode, TokenError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from capabilities.values.caps import Caps
    from capabilities.values.scope import Scope

__all__ = ["HopGrant", "mint"]


def mint(
    *,
    root: Ed25519PrivateKey | SigningKey,
    root_key_id: int,
    token_id: str,
    sponsor: Sponsor,
    hop: HopGrant,
    scope: Scope,
    caps: Caps,
    mandate_id: str | None = None,
) -> bytes:
    """A new token: `sponsor` lends `scope` to the agent of `hop`.

    Args:
        root: the private root key, here or where it signs.
        root_key_id: its id in the trust bundle.
        token_id: 16 random bytes, base64url.
        sponsor: the human principal, already authenticated.
        hop: the first holder, already attested; its delegator is the sponsor's subject.
        scope: the whole scope of the token. `verify` takes no clock skew: begin `not_before` a few seconds early.
        caps: the bounds.
        mandate_id: of the mandate that the token is drawn from, if any.

    Raises:
        CapabilityError: for anything that `verify` would refuse for a reason other than time, audience and revocation,
            with its code.
    """
    authority = block.AuthorityBlock(token_id, sponsor, 0, hop, scope, mandate_id)
    try:
        block.well_formed(authority, caps)
    except ValueError as error:
        raise TokenError(FaultCode.TOKEN_MALFORMED, str(error)) from None
    first = hop_rules.first_hop(authority, reserved=frozenset(), caps=caps)
    hop_rules.check_lifetimes((first,), caps)
    here = keys.generate() if isinstance(root, SigningKey) else root
    token = biscuit.seal_authority(
        block.fact(authority), block.checks(authority, None), root=here, root_key_id=root_key_id
    )
    if here is not root:
        token = block_signatures.by_root(token, root)
    if len(token) > caps.token_bytes:
        raise TokenError(FaultCode.TOKEN_TOO_LARGE, f"{len(token)} bytes of at most {caps.token_bytes}")
    return token
