"""From token bytes to a verified chain, in numbered steps; each cites its clause in docs/spec.md.

Steps 1 to 6 ask nothing of the moment and are remembered. Steps 7 to 9 ask time, audience and revocation, every time.
Step 10, proof of possession, is `capabilities.proof`. Steps 11 and 12 judge one request.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from capabilities import biscuit, block, checks, fact, keys, links, request, wire
from capabilities.caps import DEFAULT
from capabilities.carriage import token_from_text, token_to_text
from capabilities.chain import Chain, Hop, Refusal
from capabilities.errors import Fault, FaultCode, TokenError
from capabilities.request import tightest
from capabilities.scope_json import scope_to_json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capabilities.caps import Caps
    from capabilities.scope import Tier
    from capabilities.statements.revocation import RevocationView
    from capabilities.trust import TrustBundle
    from capabilities.units import Quantity

__all__ = ["Verifier", "inspect_token", "tightest", "token_from_text", "token_to_text", "verify"]

REMEMBERED: Final = 1_024
"""Tokens and verdicts that one verifier remembers; the least recently used goes first."""

_AGREED: Final = object()

Form = tuple[tuple[object, ...], ...]

_K = TypeVar("_K")
_V = TypeVar("_V")


@dataclass(frozen=True, slots=True)
class _Read:
    """What steps 1 to 6 found.

    Attributes:
        chain: with no view of revocation yet.
        opened: the token.
        form: all that step 12 could find out about: what the blocks check, the numbers left out.
        lifetimes: what [TOK-7] says about them, whenever it is asked.
        attested_at: the latest instant at which anybody behind the chain was authenticated or attested.
        attesters: for each hop after the first, the key that attested it, and when.
    """

    chain: Chain
    opened: biscuit.OpenedToken
    form: Form
    lifetimes: Fault | None
    attested_at: int
    attesters: tuple[tuple[bytes, int], ...]


class _Remembered(Generic[_K, _V]):
    """A bounded memory, safe between threads."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._kept: OrderedDict[_K, _V] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: _K) -> _V | None:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def put(self, key: _K, value: _V) -> None:
        with self._lock:
            self._kept[key] = value
            self._kept.move_to_end(key)
            while len(self._kept) > self._capacity:
                self._kept.popitem(last=False)


class Verifier:
    """Verifies tokens under one trust bundle.

    It remembers what steps 1 to 6 found, by token digest, revocation epoch and bundle version, and that step 12 found
    agreement, by the form of what the blocks check and the operation. Only what was found valid is remembered, and only
    for the canonical bytes.
    """

    def __init__(self, trust: TrustBundle, caps: Caps, *, remembered: int = REMEMBERED) -> None:
        self._trust = trust
        self._caps = caps
        self._read: _Remembered[tuple[bytes, int, int], _Read] = _Remembered(remembered)
        self._agreed: _Remembered[tuple[Form, str, str], object] = _Remembered(remembered)

    def verify(self, token: bytes, *, at: float, audience: str, view: RevocationView, lease_ms: int) -> Chain | Fault:
        """The chain of a token that passes steps 1 to 9 now, here; or the first fault.

        Args:
            token: canonical bytes.
            at: seconds since the epoch.
            audience: canonical URL of this server.
            view: of revocations.
            lease_ms: oldest view that may be acted on.
        """
        read = self._known(token, view)  # [TOK-1] to [TOK-6]
        if isinstance(read, Fault):
            return read
        return self._now(read, at=at, audience=audience, view=view, lease_ms=lease_ms)

    def still(self, chain: Chain, *, at: float, audience: str, view: RevocationView, lease_ms: int) -> Chain | Fault:
        """As `verify`, for a chain that this verifier returned: steps 7 to 9 once more, now and under this view.

        For what goes on after a request: a stream, a motion under way. Nothing of the token is read again while it is
        remembered.

        Args:
            chain: that this verifier returned.
            at: seconds since the epoch.
            audience: canonical URL of this server.
            view: of revocations.
            lease_ms: oldest view that may be acted on.
        """
        read = self._read.get((chain.digest, chain.epoch, self._trust.version))
        if read is None:
            return Fault(FaultCode.LIMIT_EXCEEDED, "TOK-7", "the token is no longer remembered; verify it again")
        self._read.put((chain.digest, view.epoch, self._trust.version), read)
        return self._now(read, at=at, audience=audience, view=view, lease_ms=lease_ms)

    def _now(self, read: _Read, *, at: float, audience: str, view: RevocationView, lease_ms: int) -> Chain | Fault:
        """Steps 7 to 9."""
        chain = replace(read.chain, epoch=view.epoch, view_age_ms=view.age_ms)
        first = chain.hops[0].attestation.at
        return (
            _check_times(read, at, self._caps)  # [TOK-7]
            or self._trust.refusal(chain.root_key_id, first, read.attesters, at=at)  # [TRB-2] and [TRB-3], now
            or _check_audience(chain, audience)  # [TOK-8]
            or _check_revocation(chain, audience, view, lease_ms)  # [TOK-9]
            or chain
        )

    def audiences(self, token: bytes, *, view: RevocationView) -> frozenset[str] | Fault:
        """The servers that a token is for, when it passes steps 1 to 6: for who issues and serves no audience itself.

        Grants nothing; `verify` with the same view reads the token no second time.
        """
        read = self._known(token, view)
        return read if isinstance(read, Fault) else read.chain.scope.audiences

    def _known(self, token: bytes, view: RevocationView) -> _Read | Fault:
        """What steps 1 to 6 say of a token, remembered when they pass."""
        key = (hashlib.sha256(token).digest(), view.epoch, self._trust.version)
        read = self._read.get(key)
        if read is None:
            try:
                read = _read_chain(token, self._trust, self._caps)
            except _Broken as broken:
                return broken.fault
            self._read.put(key, read)
        return read

    def check_request(
        self,
        chain: Chain,
        *,
        object: str,  # noqa: A002 - the word of the profile
        operation: str,
        values: tuple[Quantity, ...],
        base_tier: Tier,
        at: float,
    ) -> Refusal | Fault | None:
        """None when the chain allows the request (step 11) and Biscuit's own authorizer agrees (step 12).

        Args:
            chain: that this verifier returned.
            object: the thing acted on.
            operation: what is done to it.
            values: every parameter, in the operation's order.
            base_tier: the operation's registered base tier.
            at: seconds since the epoch.
        """
        # [TOK-11] the compiled scope decides this request
        late = _check_window(chain, at, "TOK-11")
        if late is not None:
            return late
        refused = request.refusal(chain, object=object, operation=operation, values=values, base_tier=base_tier)
        if refused is not None:
            return refused
        # [TOK-12] Biscuit's own authorizer agrees, once for each operation under checks of this form
        return self._check_agreement(chain, object, operation)

    def _check_agreement(self, chain: Chain, thing: str, operation: str) -> Fault | None:
        read = self._read.get((chain.digest, chain.epoch, self._trust.version))
        grant = chain.scope.find(thing, operation)
        if read is None or grant is None:
            return Fault(FaultCode.LIMIT_EXCEEDED, "TOK-12", "the token is no longer remembered; verify it again")
        known = read.form, thing, operation
        if self._agreed.get(known) is _AGREED:
            return None
        fault = request.disagreement(read.opened, chain.scope, grant, self._caps)
        if fault is None:
            self._agreed.put(known, _AGREED)
        return fault


def verify(
    token: bytes, *, at: float, audience: str, view: RevocationView, lease_ms: int, trust: TrustBundle, caps: Caps
) -> Chain | Fault:
    """As `Verifier.verify`, for one token and with nothing remembered."""
    return Verifier(trust, caps).verify(token, at=at, audience=audience, view=view, lease_ms=lease_ms)


# --- steps 1 to 6 ----------------------------------------------------------------------------------------------------


class _Broken(Exception):  # noqa: N818 - not an error of the caller: it carries the fault out of the recipe
    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.code)
        self.fault = fault


def _read_chain(token: bytes, trust: TrustBundle, caps: Caps) -> _Read:
    # [TOK-1] the size cap, before anything is parsed
    with _clause("TOK-1"):
        _check_size(token, caps)

    # [TOK-2] the number of blocks, before any signature is checked
    with _clause("TOK-2"):
        shape = wire.read(token)
        _check_length(shape, caps)

    # [TOK-3] every signature
    with _clause("TOK-3"):
        root_key_id, root = _root_key(shape, trust)
        opened = biscuit.open_token(token, root)

    # [TOK-4] every hop signed by a trusted attester, before anything that it says is read
    with _clause("TOK-4"):
        signers = opened.external_keys()
        _check_attested(shape, signers, trust)

    # [TOK-5] canonical bytes
    with _clause("TOK-5"):
        _check_canonical(opened, token)

    # [TOK-6] profile, hop sequence, holder continuity, narrowing
    with _clause("TOK-6"):
        versions = fact.AUTHORITY_VERSION, *(fact.HOP_VERSION,) * (len(shape.blocks) - 1)
        contents = [wire.contents(each.payload, version=v) for each, v in zip(shape.blocks, versions, strict=True)]
        authority, hops, form = _chain(contents, trust, caps)

    chain = Chain(
        token_id=authority.token_id,
        digest=hashlib.sha256(token).digest(),
        sponsor=authority.sponsor,
        root_key_id=root_key_id,
        hops=hops,
        epoch=0,
        view_age_ms=0,
    )
    return _Read(
        chain=chain,
        opened=opened,
        form=form,
        lifetimes=_lifetimes(hops, caps),
        attested_at=max(authority.sponsor.authenticated_at, *(hop.attestation.at for hop in hops)),
        attesters=tuple((signer, hop.attestation.at) for signer, hop in zip(signers, hops, strict=True) if signer),
    )


@contextmanager
def _clause(clause: str) -> Iterator[None]:
    """Name the clause of whatever goes wrong inside."""
    try:
        yield
    except TokenError as error:
        raise _Broken(Fault(error.code, clause, error.detail)) from None


def _check_size(token: bytes, caps: Caps) -> None:
    """[TOK-1]."""
    if not token:
        raise TokenError(FaultCode.TOKEN_MISSING)
    if len(token) > caps.token_bytes:
        raise TokenError(FaultCode.TOKEN_TOO_LARGE, f"over {caps.token_bytes} bytes")


def _check_length(shape: wire.Structure, caps: Caps) -> None:
    """[TOK-2]."""
    if len(shape.blocks) > 1 + caps.hops:
        raise TokenError(FaultCode.TOO_MANY_HOPS, f"more than {caps.hops} hops")


def _root_key(shape: wire.Structure, trust: TrustBundle) -> tuple[int, bytes]:
    """[TOK-3]: the root key that the token names."""
    if shape.root_key_id is None or shape.root_key_id not in trust.roots:
        raise TokenError(FaultCode.UNKNOWN_ROOT_KEY)
    return shape.root_key_id, trust.roots[shape.root_key_id]


def _check_canonical(opened: biscuit.OpenedToken, token: bytes) -> None:
    """[TOK-5]: writing the token again gives the very same bytes."""
    if opened.encode() != token:
        raise TokenError(FaultCode.NOT_CANONICAL)


def _check_attested(shape: wire.Structure, signers: tuple[bytes | None, ...], trust: TrustBundle) -> None:
    """[TOK-4]: the authority block by nobody else, each further one by a trusted attester, at its place."""
    if len(signers) != len(shape.blocks):
        raise TokenError(FaultCode.TOKEN_MALFORMED, "two readers count different blocks")
    if signers[0] is not None:
        raise TokenError(FaultCode.HOP_NOT_ATTESTED, "an authority block with a second signer")
    for index, (signer, signed) in enumerate(zip(signers, shape.blocks, strict=True)):
        if index and not (signed.third_party and signer in trust.attesters):
            raise TokenError(FaultCode.HOP_NOT_ATTESTED, f"hop {index} is signed by no trusted attester")


def _chain(
    contents: list[wire.Contents], trust: TrustBundle, caps: Caps
) -> tuple[block.AuthorityBlock, tuple[Hop, ...], Form]:
    """[TOK-6]: each block is one of the profile, and narrows what the blocks before it leave."""
    first, *further = contents
    said = fact.authority_said(first)
    demanded = [checks.read(first.symbols, first.checks)]
    authority = block.authority_of(said, demanded[0], caps)
    hops = [links.first_hop(authority, reserved=trust.all_keys, caps=caps)]
    for each in further:
        parent, more = hops[-1], fact.hop_said(each)
        demanded.append(checks.read(each.symbols, each.checks))
        added = block.hop_of(
            more, demanded[-1], index=len(hops), delegator=parent.agent, parent=parent.scope, caps=caps
        )
        hops.append(links.next_hop(tuple(hops), added, reserved=trust.all_keys, caps=caps))
    return authority, tuple(hops), tuple(map(_form, demanded))


def _form(demanded: checks.Checks) -> tuple[object, ...]:
    """[TOK-12]: what a block checks, the numbers left out: no two ways to read it differ by them alone."""
    stated = demanded.not_before is not None, demanded.not_after is not None, demanded.ceiling is not None
    return demanded.alternatives and checks.forms(demanded.alternatives), stated


# --- steps 7 to 9 ----------------------------------------------------------------------------------------------------


def _lifetimes(hops: tuple[Hop, ...], caps: Caps) -> Fault | None:
    """The part of [TOK-7] that asks nothing of the moment."""
    try:
        links.check_lifetimes(hops, caps)
    except TokenError as error:
        return Fault(error.code, "TOK-7", error.detail)
    return None


def _check_times(read: _Read, at: float, caps: Caps) -> Fault | None:
    """[TOK-7]."""
    if read.lifetimes is not None:
        return read.lifetimes
    if not read.attested_at <= at + caps.skew_s:
        return Fault(FaultCode.NOT_YET_VALID, "TOK-7", "attested in the future")
    return _check_window(read.chain, at, "TOK-7")


def _check_window(chain: Chain, at: float, clause: str) -> Fault | None:
    scope = chain.scope
    if not at >= scope.not_before:
        return Fault(FaultCode.NOT_YET_VALID, clause)
    if not at < scope.not_after:
        return Fault(FaultCode.EXPIRED, clause)
    return None


def _check_audience(chain: Chain, audience: str) -> Fault | None:
    """[TOK-8]."""
    return None if audience in chain.scope.audiences else Fault(FaultCode.WRONG_AUDIENCE, "TOK-8")


def _check_revocation(chain: Chain, audience: str, view: RevocationView, lease_ms: int) -> Fault | None:
    """[TOK-9]: what is revoked stays revoked however old the view is, so that is asked first."""
    why = view.why(chain, audience=audience)
    if why is not None:
        return Fault(FaultCode.REVOKED, "TOK-9", f"{why[0]}:{why[1]}")
    if not 0 <= view.age_ms <= lease_ms:
        return Fault(FaultCode.REVOCATION_VIEW_STALE, "TOK-9", f"{view.age_ms} ms old, at most {lease_ms} ms")
    return None


# --- looking ---------------------------------------------------------------------------------------------------------


def inspect_token(token: bytes, trust: TrustBundle, caps: Caps = DEFAULT) -> dict[str, object]:
    """A JSON-ready description of a token that passes steps 1 to 6: never the token, its signatures or its secret.

    Raises:
        TokenError: with the code of the fault.
    """
    try:
        chain = _read_chain(token, trust, caps).chain
    except _Broken as broken:
        raise TokenError(broken.fault.code, f"{broken.fault.clause} {broken.fault.detail}".strip()) from None
    return {
        "profile": fact.PROFILE,
        "token_id": chain.token_id,
        "digest": chain.digest.hex(),
        "bytes": len(token),
        "root_key_id": chain.root_key_id,
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
