"""Verification of a token, from bytes to a chain, in numbered steps; each cites its clause in docs/spec.md.

Steps 1 to 6 (capabilities.token.static_verification) ask nothing of the moment and are remembered. Steps 7 to 9 ask
time, audience and revocation, every time. Step 10, proof of possession, is `capabilities.proof.proof`. Steps 11 and 12
judge one request.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from capabilities.statements import revocation
from capabilities.token import scope_check, static_verification
from capabilities.token.scope_check import tightest
from capabilities.token.static_verification import inspect_token
from capabilities.token.token_text import token_from_text, token_to_text
from capabilities.values.errors import Fault, FaultCode

if TYPE_CHECKING:
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.revocation import RevocationView
    from capabilities.token.static_verification import StaticVerification
    from capabilities.values.arguments import Value
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain, Refusal
    from capabilities.values.scope import Tier

__all__ = ["Verifier", "inspect_token", "tightest", "token_from_text", "token_to_text", "verify"]

REMEMBERED: Final = 1_024
"""Tokens and verdicts that one verifier remembers; the least recently used goes first."""

FORMER: Final = 4
"""Earlier bundles whose chains still go on: a rotation of a role takes four steps."""
_AGREED: Final = object()
_FORGOTTEN: Final = "the token is no longer remembered; verify it again"

_K = TypeVar("_K")
_V = TypeVar("_V")


class _Remembered(Generic[_K, _V]):
    """A bounded memory, safe between threads."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._kept: OrderedDict[_K, _V] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: _K) -> _V | None:
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
            return found

    def put(self, key: _K, value: _V) -> None:
        with self._lock:
            self._kept[key] = value
            self._kept.move_to_end(key)
            while len(self._kept) > self._capacity:
                self._kept.popitem(last=False)


class Verifier:
    """Verifies tokens under a trust bundle, one at a time.

    It remembers the results of steps 1 to 6 by token digest, revocation epoch and bundle version, and the agreement of
    step 12 by the form of the blocks' checks and the operation. Only valid results are remembered, and only
    for the canonical bytes.
    """

    def __init__(self, trust: TrustBundle, caps: Caps, *, remembered: int = REMEMBERED) -> None:
        self._trust = trust
        self._former: tuple[int, ...] = ()
        self._caps = caps
        self._read: _Remembered[tuple[bytes, int, int], StaticVerification] = _Remembered(remembered)
        self._agreed: _Remembered[tuple[str, str, str], object] = _Remembered(remembered)

    def renew(self, trust: TrustBundle) -> None:
        """Verifies under this bundle from now on, which takes the place of the one before ([TRB-5]). Any thread.

        A chain of this verifier goes on where the newer bundle trusts its keys, too: it is read anew under that one.
        """
        if trust.version != self._trust.version:
            self._former = (self._trust.version, *self._former)[:FORMER]
        self._trust = trust

    def verify(self, token: bytes, *, at: float, audience: str, view: RevocationView, lease_ms: int) -> Chain | Fault:
        """The chain of a token that passes steps 1 to 9 now, here; or the first fault.

        Args:
            token: canonical bytes.
            at: seconds since the epoch.
            audience: canonical URL of this server.
            view: of revocations.
            lease_ms: oldest view that may be acted on.
        """
        read = self._known(token, view.epoch)  # [TOK-1] to [TOK-6]
        if isinstance(read, Fault):
            return read
        return self._now(read, at=at, audience=audience, view=view, lease_ms=lease_ms)

    def still(self, chain: Chain, *, at: float, audience: str, view: RevocationView, lease_ms: int) -> Chain | Fault:
        """Verifies a chain of this verifier once more: steps 7 to 9, now and under this view.

        For an act that goes on after its request: a stream, a motion under way. The token is not read again while it is
        remembered.

        Args:
            chain: that this verifier returned.
            at: seconds since the epoch.
            audience: canonical URL of this server.
            view: of revocations.
            lease_ms: oldest view that may be acted on.
        """
        trust = self._trust
        read = self._recalled(chain, trust, "TOK-7")
        if isinstance(read, Fault):
            return read
        self._read.put((chain.digest, view.epoch, trust.version), read)
        return self._now(read, at=at, audience=audience, view=view, lease_ms=lease_ms)

    def _now(
        self, read: StaticVerification, *, at: float, audience: str, view: RevocationView, lease_ms: int
    ) -> Chain | Fault:
        """Steps 7 to 9."""
        chain = read.under(view)
        return (
            _check_times(read, at, self._caps)  # [TOK-7]
            or self._check_signers(read, at)  # [TRB-2] and [TRB-3]
            or _check_audience(chain, audience)  # [TOK-8]
            or _check_revocation(read, audience, view, lease_ms)  # [TOK-9]
            or chain
        )

    def _check_signers(self, read: StaticVerification, at: float) -> Fault | None:
        start, end = read.trusted
        if start <= at < end:
            return None
        first = read.chain.hops[0].attestation.at
        refused = self._trust.refusal(read.chain.root_key_id, first, read.attesters, at=at)
        return refused or Fault(FaultCode.UNKNOWN_ROOT_KEY, "TRB-2")

    def audiences(self, token: bytes, *, view: RevocationView) -> frozenset[str] | Fault:
        """Audiences of a token that passes steps 1 to 6, for an issuer that serves no audience itself.

        Grants nothing; `verify` with the same view reads the token no second time.
        """
        read = self._known(token, view.epoch)
        return read if isinstance(read, Fault) else read.chain.scope.audiences

    def names(self, token: bytes, *, epoch: int) -> frozenset[tuple[str, str]] | Fault:
        """Every (kind, id) whose revocation concerns a token that passes steps 1 to 6: audiences and all that kills it.

        Grants nothing; `verify` with a view of this epoch reads the token no second time.

        Args:
            token: canonical bytes.
            epoch: at which it will be verified, as far as that is known.
        """
        read = self._known(token, epoch)
        if isinstance(read, Fault):
            return read
        return read.names | {(revocation.Revoked.AUDIENCE.value, url) for url in read.chain.scope.audiences}

    def _known(self, token: bytes, epoch: int) -> StaticVerification | Fault:
        """Result of steps 1 to 6 for a token, remembered when they pass."""
        digest = hashlib.sha256(token).digest()
        trust = self._trust
        key = digest, epoch, trust.version
        read = self._read.get(key)
        if read is None:
            found = static_verification.read(token, trust, self._caps, digest=digest)
            if isinstance(found, Fault):
                return found
            read = found
            self._read.put(key, read)
        return read

    def _recalled(self, chain: Chain, trust: TrustBundle, clause: str) -> StaticVerification | Fault:
        """Result of steps 1 to 6 for a chain of this verifier.

        One of an earlier bundle is made anew, once.
        """
        read = self._read.get((chain.digest, chain.epoch, trust.version))
        if read is not None:
            return read
        former = (self._read.get((chain.digest, chain.epoch, version)) for version in self._former)
        before = next((known for known in former if known is not None), None)
        if before is None:
            return Fault(FaultCode.LIMIT_EXCEEDED, clause, _FORGOTTEN)
        found = static_verification.read(before.opened.encode(), trust, self._caps, digest=chain.digest)
        if not isinstance(found, Fault):
            self._read.put((chain.digest, chain.epoch, trust.version), found)
        return found

    def check_request(
        self,
        chain: Chain,
        *,
        object: str,  # noqa: A002 - the word of the profile
        operation: str,
        values: tuple[Value, ...],
        base_tier: Tier,
        at: float,
    ) -> Refusal | Fault | None:
        """None when the chain allows the request (step 11) and Biscuit's own authorizer agrees (step 12).

        Args:
            chain: that this verifier returned.
            object: the thing acted on.
            operation: the requested one.
            values: every parameter, in the operation's order.
            base_tier: the operation's registered base tier.
            at: seconds since the epoch.
        """
        # [TOK-11] the compiled scope decides this request
        late = _check_window(chain, at, "TOK-11")
        if late is not None:
            return late
        refused = scope_check.refusal(chain, object=object, operation=operation, values=values, base_tier=base_tier)
        if refused is not None:
            return refused
        # [TOK-12] Biscuit's own authorizer agrees, once for each operation under checks of this form
        return self._check_agreement(chain, object, operation)

    def _check_agreement(self, chain: Chain, thing: str, operation: str) -> Fault | None:
        read = self._recalled(chain, self._trust, "TOK-12")
        if isinstance(read, Fault):
            return read
        known = read.form, thing, operation
        if self._agreed.get(known) is _AGREED:
            return None
        grant = chain.scope.find(thing, operation)
        if grant is None:
            return Fault(FaultCode.LIMIT_EXCEEDED, "TOK-12", "not granted, which step 11 asks")
        fault = scope_check.disagreement(read.opened, chain.scope, grant, self._caps)
        if fault is None:
            self._agreed.put(known, _AGREED)
        return fault


def verify(
    token: bytes, *, at: float, audience: str, view: RevocationView, lease_ms: int, trust: TrustBundle, caps: Caps
) -> Chain | Fault:
    """Verifies one token as `Verifier.verify` does, with nothing remembered."""
    return Verifier(trust, caps).verify(token, at=at, audience=audience, view=view, lease_ms=lease_ms)


# --- steps 7 to 9 ----------------------------------------------------------------------------------------------------


def _check_times(read: StaticVerification, at: float, caps: Caps) -> Fault | None:
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


def _check_revocation(read: StaticVerification, audience: str, view: RevocationView, lease_ms: int) -> Fault | None:
    """[TOK-9]: a revoked id stays revoked however old the view is, so that is asked first."""
    if not view.spares(read.names, audience=audience):
        why = view.why(read.chain, audience=audience)
        return Fault(FaultCode.REVOKED, "TOK-9", "" if why is None else f"{why[0]}:{why[1]}")
    if not 0 <= view.age_ms <= lease_ms:
        return Fault(FaultCode.REVOCATION_VIEW_STALE, "TOK-9", f"{view.age_ms} ms old, at most {lease_ms} ms")
    return None
