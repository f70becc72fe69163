"""Steps 1 to 6 of verification, in order; each cites its clause in docs/spec.md. They ask nothing of the moment."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import msgspec

from capabilities.keys import keys
from capabilities.statements.revocation import named
from capabilities.token import biscuit, block, block_reading, checks, fact, hop_rules, wire
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain, Hop, make_chain
from capabilities.values.errors import Fault, FaultCode, TokenError
from capabilities.values.scope_json import scope_to_json

if TYPE_CHECKING:
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.revocation import RevocationView
    from capabilities.token.byte_layout import Contents, Structure
    from capabilities.values.caps import Caps


class StaticVerification(msgspec.Struct, frozen=True, kw_only=True):
    """Result of steps 1 to 6.

    Attributes:
        chain: with no view of revocation yet.
        opened: the token.
        form: all that step 12 could find out about: the checks of the blocks, the numbers left out; in one text.
        lifetimes: the fault that [TOK-7] finds in them at any time, or None.
        attested_at: the latest instant at which a party of the chain was authenticated or attested.
        attesters: for each hop after the first, the key that attested it, and when.
        trusted: from when, and up to and without which time, all who signed are trusted.
        names: every (kind, id) whose revocation kills the chain, audiences apart.
    """

    chain: Chain
    opened: biscuit.OpenedToken
    form: str
    lifetimes: Fault | None
    attested_at: int
    attesters: tuple[tuple[bytes, int], ...]
    trusted: tuple[int, int]
    names: frozenset[tuple[str, str]]

    def under(self, view: RevocationView) -> Chain:
        """The chain as it is checked against this view."""
        chain = self.chain
        return make_chain(
            chain.token_id,
            chain.digest,
            chain.sponsor,
            chain.root_key_id,
            chain.hops,
            view.epoch,
            view.age_ms,
            chain.mandate_id,
        )


def read(token: bytes, trust: TrustBundle, caps: Caps, *, digest: bytes) -> StaticVerification | Fault:
    """Result of steps 1 to 6 for a token, or the first fault.

    Args:
        token: its bytes.
        trust: the keys that it is read under.
        caps: the bounds.
        digest: SHA-256 of the bytes.
    """
    clause = "TOK-1"
    try:
        # [TOK-1] the size cap, before anything is parsed
        _check_size(token, caps)

        # [TOK-2] the number of blocks, before any signature is checked
        clause = "TOK-2"
        shape = wire.read(token)
        _check_length(shape, caps)

        # [TOK-3] every signature
        clause = "TOK-3"
        root_key_id, root = _root_key(shape, trust)
        opened = biscuit.open_token(token, root)

        # [TOK-4] every hop signed by a trusted attester, before anything that it says is read
        clause = "TOK-4"
        signers = opened.external_keys()
        _check_attested(shape, signers, trust)

        # [TOK-5] canonical bytes
        clause = "TOK-5"
        _check_canonical(opened, token)

        # [TOK-6] profile, hop sequence, holder continuity, narrowing
        clause = "TOK-6"
        authority, hops, form = _chain(_contents(shape), trust, caps)
    except TokenError as error:
        return Fault(error.code, clause, error.detail)

    chain = make_chain(
        authority.token_id,
        digest,
        authority.sponsor,
        root_key_id,
        hops,
        epoch=0,
        view_age_ms=0,
        mandate_id=authority.mandate_id,
    )
    attested = [hop.attestation.at for hop in hops]
    attesters = tuple([(signer, at) for signer, at in zip(signers, attested, strict=True) if signer])
    return StaticVerification(
        chain=chain,
        opened=opened,
        form=form,
        lifetimes=_lifetimes(hops, caps),
        attested_at=max(chain.sponsor.authenticated_at, *attested),
        attesters=attesters,
        trusted=trust.span(root_key_id, attested[0], attesters),
        names=named(chain),
    )


def _check_size(token: bytes, caps: Caps) -> None:
    """[TOK-1]."""
    if not token:
        raise TokenError(FaultCode.TOKEN_MISSING)
    if len(token) > caps.token_bytes:
        raise TokenError(FaultCode.TOKEN_TOO_LARGE, f"over {caps.token_bytes} bytes")


def _check_length(shape: Structure, caps: Caps) -> None:
    """[TOK-2]."""
    if len(shape.blocks) > 1 + caps.hops:
        raise TokenError(FaultCode.TOO_MANY_HOPS, f"more than {caps.hops} hops")


def _root_key(shape: Structure, trust: TrustBundle) -> tuple[int, bytes]:
    """[TOK-3]: the root key that the token names."""
    if shape.root_key_id is None or shape.root_key_id not in trust.roots:
        raise TokenError(FaultCode.UNKNOWN_ROOT_KEY)
    return shape.root_key_id, trust.roots[shape.root_key_id]


def _check_canonical(opened: biscuit.OpenedToken, token: bytes) -> None:
    """[TOK-5]: writing the token again gives the very same bytes."""
    if opened.encode() != token:
        raise TokenError(FaultCode.NOT_CANONICAL)


def _check_attested(shape: Structure, signers: tuple[bytes | None, ...], trust: TrustBundle) -> None:
    """[TOK-4]: the authority block by nobody else, each further one by a trusted attester, at its place."""
    if len(signers) != len(shape.blocks):
        raise TokenError(FaultCode.TOKEN_MALFORMED, "two readers count different blocks")
    if signers[0] is not None:
        raise TokenError(FaultCode.HOP_NOT_ATTESTED, "an authority block with a second signer")
    for index in range(1, len(signers)):
        if not (shape.blocks[index].third_party and signers[index] in trust.attesters):
            raise TokenError(FaultCode.HOP_NOT_ATTESTED, f"hop {index} is signed by no trusted attester")


def _contents(shape: Structure) -> list[Contents]:
    """[TOK-6]: the messages of all blocks."""
    first, *further = shape.blocks
    return [
        wire.contents(first.payload, version=fact.AUTHORITY_VERSION),
        *[wire.contents(each.payload, version=fact.HOP_VERSION) for each in further],
    ]


def _chain(
    contents: list[Contents], trust: TrustBundle, caps: Caps
) -> tuple[block.AuthorityBlock, tuple[Hop, ...], str]:
    """[TOK-6]: each block is one of the profile, and narrows the scope that the blocks before it leave."""
    first, *further = contents
    said = fact.authority_said(first)
    demanded = [_demanded(first)]
    authority = block_reading.authority_of(said, demanded[0], caps)
    hops = [hop_rules.first_hop(authority, reserved=trust.all_keys, caps=caps)]
    for each in further:
        parent, more = hops[-1], fact.hop_said(each)
        demanded.append(_demanded(each))
        added = block_reading.hop_of(
            more, demanded[-1], index=len(hops), delegator=parent.agent, parent=parent.scope, caps=caps
        )
        hops.append(hop_rules.next_hop(tuple(hops), added, reserved=trust.all_keys, caps=caps))
    return authority, tuple(hops), "\n".join([_form(each) for each in demanded])


def _demanded(content: Contents) -> checks.Checks:
    """[TOK-6]: the checks of a block, whose version of Datalog is the one that they need."""
    demanded = checks.read(content.symbols, content.checks)
    needed = demanded.alternatives is not None and checks.needs_closures(demanded.alternatives)
    if needed != (content.version == wire.CLOSURES):
        raise TokenError(FaultCode.WRONG_PROFILE, "another version of Datalog than its checks need")
    return demanded


def _form(demanded: checks.Checks) -> str:
    """[TOK-12]: the checks of a block, the numbers left out: no two ways to read it differ by them alone."""
    context = "-" if demanded.not_before is None else "b"
    context += "-" if demanded.not_after is None else "a"
    context += "-" if demanded.ceiling is None else "c"
    return context if demanded.alternatives is None else f"{context} {checks.form(demanded.alternatives)}"


def _lifetimes(hops: tuple[Hop, ...], caps: Caps) -> Fault | None:
    """The part of [TOK-7] that asks nothing of the moment."""
    try:
        hop_rules.check_lifetimes(hops, caps)
    except TokenError as error:
        return Fault(error.code, "TOK-7", error.detail)
    return None


# --- looking ---------------------------------------------------------------------------------------------------------


def inspect_token(token: bytes, trust: TrustBundle, caps: Caps = DEFAULT) -> dict[str, object]:
    """A JSON-ready description of a token that passes steps 1 to 6: never the token, its signatures or its secret.

    Raises:
        TokenError: with the code of the fault.
    """
    found = read(token, trust, caps, digest=hashlib.sha256(token).digest())
    if isinstance(found, Fault):
        raise TokenError(found.code, f"{found.clause} {found.detail}".strip())
    chain = found.chain
    return {
        "profile": fact.PROFILE,
        "token_id": chain.token_id,
        "digest": chain.digest.hex(),
        "bytes": len(token),
        "root_key_id": chain.root_key_id,
        "mandate_id": chain.mandate_id,
        "sponsor": {
            "issuer": chain.sponsor.issuer,
            "subject": chain.sponsor.subject,
            "method": chain.sponsor.method,
            "authenticated_at": chain.sponsor.authenticated_at,
        },
        "hops": [_describe(hop) for hop in chain.hops],
    }


def _describe(hop: Hop) -> dict[str, object]:
    return {
        "index": hop.index,
        "hop_id": hop.hop_id,
        "agent": hop.agent,
        "role": hop.role,
        "key": keys.thumbprint(hop.key),
        "delegator": hop.delegator,
        "purpose": hop.purpose,
        "request_digest": hop.request_digest.hex(),
        "attestation": {
            "kind": str(hop.attestation.kind),
            "measurement": hop.attestation.measurement.hex(),
            "at": hop.attestation.at,
        },
        "scope": scope_to_json(hop.scope),
    }
