"""Forged tokens: each made for real out of honest ones, and wrong in one thing."""

from __future__ import annotations

import secrets
import time
from typing import TYPE_CHECKING, Any, Final

from capabilities.keys import keys
from capabilities.statements.revocation import RevocationView
from capabilities.token import biscuit, block
from capabilities.token.mint import mint
from capabilities.token.token_text import token_to_text
from capabilities.token.verify import verify
from capabilities.token.wire import MESSAGES
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind, HopGrant, Sponsor
from ztpm.stage.lending import raw
from ztpm.stage.stage import StageError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from capabilities.keys.trust import TrustBundle
    from capabilities.values.scope import Restriction, Scope
    from ztpm_idp.client import Agent

LEASE_MS: Final = 1
TOKEN_ID_BYTES: Final = 16
PURPOSE: Final = "nobody else needs to know"


def _hop(holder: Agent, delegator: str) -> HopGrant:
    """Statement about a holder that no provider has made."""
    return HopGrant(
        hop_id=secrets.token_hex(16),
        agent=holder.id,
        key=keys.public_raw(holder.key),
        delegator=delegator,
        purpose=PURPOSE,
        request_digest=secrets.token_bytes(32),
        attestation=Attestation(EvidenceKind.KEY, holder.measurement, int(time.time())),
    )


def grafted(
    token: str, holder: Agent, restriction: Restriction, *, audience: str, trust: TrustBundle,
    attester: Ed25519PrivateKey,
) -> str:  # fmt: skip
    """Token with one more hop, attested by a key that no provider has, narrower or not.

    Args:
        token: honest.
        holder: of the new hop.
        restriction: of the new hop; it may be wider.
        audience: of the token.
        trust: of the cell.
        attester: any key.

    Raises:
        StageError: the token is not honest.
    """
    view = RevocationView(epoch=0, age_ms=0, revoked=frozenset())
    honest = raw(token)
    chain = verify(
        honest, at=int(time.time()), audience=audience, view=view, lease_ms=LEASE_MS, trust=trust, caps=DEFAULT
    )
    if not isinstance(chain, Chain):
        raise StageError(f"a token that was just lent is {chain.code}")
    added = block.HopBlock(len(chain.hops), _hop(holder, chain.leaf.agent), restriction)
    opened = biscuit.open_token(honest, trust.roots[chain.root_key_id])
    return token_to_text(
        biscuit.append_hop(opened, block.fact(added), block.checks(added, chain.scope), attester=attester)
    )


def minted(holder: Agent, scope: Scope, *, sponsor: str, issuer: str, root_key_id: int) -> str:
    """A token that a root key of the forger's own has signed, in a person's name.

    Args:
        holder: of the token.
        scope: of the token.
        sponsor: the person.
        issuer: identity provider whose token it seems to be.
        root_key_id: id that the provider's own root key has.
    """
    now = int(time.time())
    return token_to_text(
        mint(
            root=keys.generate(),
            root_key_id=root_key_id,
            token_id=secrets.token_urlsafe(TOKEN_ID_BYTES),
            sponsor=Sponsor(issuer, sponsor, "operator-key", now),
            hop=_hop(holder, sponsor),
            scope=scope,
            caps=DEFAULT,
        )
    )


def altered(token: str, before: str, after: str) -> str:
    """The token with some of its own text replaced by another of the same length.

    Raises:
        StageError: that text is not in it.
    """
    was, becomes = before.encode(), after.encode()
    honest = raw(token)
    if was not in honest or len(was) != len(becomes):
        raise StageError(f"{before!r} is not in the token, or {after!r} is of another length")
    return token_to_text(honest.replace(was, becomes, 1))


def flipped(token: str, part: str) -> str:
    """The token with one bit of a part flipped: `signature`, `next key`, `attester` or `secret`."""
    message = MESSAGES["Biscuit"].FromString(raw(token))
    last = message.blocks[-1] if message.blocks else message.authority
    if part == "signature":
        last.signature = _one_bit(last.signature)
    elif part == "next key":
        last.nextKey.key = _one_bit(last.nextKey.key)
    elif part == "attester":
        last.externalSignature.signature = _one_bit(last.externalSignature.signature)
    else:
        message.proof.nextSecret = _one_bit(message.proof.nextSecret)
    return _written(message)


def spliced(token: str, other: str, how: str) -> str:
    """Blocks of two honest tokens in one.

    Args:
        token: honest.
        other: honest; its blocks are the source.
        how: `last hop` puts the other's last hop behind the token's own, `first block` puts the other's first block in
            place of its own, `truncated` leaves the last hop out and keeps the proof of both, `doubled` repeats it.
    """
    message, source = (MESSAGES["Biscuit"].FromString(raw(each)) for each in (token, other))
    if how == "last hop":
        message.blocks.append(source.blocks[-1])
        message.proof.CopyFrom(source.proof)
    elif how == "first block":
        message.authority.CopyFrom(source.authority)
    elif how == "truncated":
        del message.blocks[-1]
    else:
        message.blocks.append(message.blocks[-1])
    return _written(message)


def _one_bit(value: bytes) -> bytes:
    return bytes([value[0] ^ 1]) + value[1:]


def _written(message: Any) -> str:
    return token_to_text(bytes(message.SerializeToString()))
