"""Succession of trust bundles: the rules by which one may take the place of another.

Clauses [TRB-4] and [TRB-5] in docs/spec.md.

As a root of TUF follows a root (The Update Framework, section 5.3), in small: a newer bundle is signed by a registry
key that both the older and the newer one trust, so nobody is led over a gap; versions only grow; and what was issued
last is remembered, so that an old file put back is seen.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from capabilities.keys.keys import thumbprint
from capabilities.keys.windows import Role, Standing
from capabilities.statements import statement_form
from capabilities.statements import trust as trust_bundle
from capabilities.values.errors import Fault, FaultCode, StatementError

if TYPE_CHECKING:
    from capabilities.keys.trust import TrustBundle
    from capabilities.rotation.rotation import KeyRecord, KeyRing
    from capabilities.values.caps import Caps


@dataclass(frozen=True, slots=True)
class NewestBundle:
    """The newest bundle that a verifier has ever acted on; it keeps this where a restart does not lose it.

    Attributes:
        version: its version.
        digest: SHA-256 of its canonical JSON.
    """

    version: int
    digest: bytes

    @classmethod
    def of(cls, bundle: TrustBundle) -> NewestBundle:
        """Mark of this bundle."""
        return cls(bundle.version, hashlib.sha256(bundle.to_json()).digest())


def check_bundle(bundle: TrustBundle, seen: NewestBundle | None, *, at: float, caps: Caps) -> NewestBundle | Fault:
    """Mark of the bundle, to be remembered, when the bundle may be acted on now; or the first fault ([TRB-4]).

    Args:
        bundle: out of band, over an authenticated channel, or from `succeed`.
        seen: the mark that was remembered; None only where nothing ever was.
        at: seconds since the epoch.
        caps: the bounds.
    """
    now = NewestBundle.of(bundle)
    if seen is not None and (now.version < seen.version or (now.version == seen.version and now != seen)):
        return Fault(FaultCode.REPLAYED, "TRB-4", f"version {now.version}, but {seen.version} was seen")
    if not bundle.issued_at <= at + caps.skew_s:
        return Fault(FaultCode.NOT_YET_VALID, "TRB-4", "a bundle of the future")
    if not at < bundle.valid_until:
        return Fault(FaultCode.EXPIRED, "TRB-4", "the bundle is over")
    return now


def succeed(held: TrustBundle, text: str, *, at: float, caps: Caps) -> TrustBundle | Fault:
    """The bundle that takes the place of `held`, which may be the same one again; or the first fault ([TRB-5]).

    Args:
        held: the bundle that is acted on, itself not over.
        text: a statement of kind `trust`.
        at: seconds since the epoch.
        caps: the bounds.
    """
    # 1 a registry key that is trusted now, by a bundle that is not over
    try:
        newer = trust_bundle.open(text, held.signers(Role.REGISTRY, at), caps)
    except StatementError as error:
        return Fault(error.code, "TRB-5", error.detail)
    if newer.issuer != held.issuer:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "TRB-5", "of another issuer")
    # 2 not older, not of the future, not over
    now = check_bundle(newer, NewestBundle.of(held), at=at, caps=caps)
    if isinstance(now, Fault):
        return now
    if newer.issued_at < held.issued_at:
        return Fault(FaultCode.REPLAYED, "TRB-5", "a later version that was issued earlier")
    # 3 the signer is a registry key of both, in neither tainted before it signed
    both = _registry(held, newer.issued_at, at) & _registry(newer, newer.issued_at, at)
    if statement_form.signer_thumbprint(text) not in both:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "TRB-5", "by a key that not both trust")
    # 4 one key, one role; one root key id, one key
    moved = any(held.of_role(a) & newer.of_role(b) for a in Role for b in Role if a is not b)
    if moved or any(newer.roots.get(number, raw) != raw for number, raw in held.roots.items()):
        return Fault(FaultCode.KEY_WRONG_ROLE, "TRB-5", "a key in another role, or under another id")
    return newer


def ring_follows(held: KeyRing, newer: KeyRing) -> Fault | None:
    """None when a ring is what steps of a rotation make of the held one; else the fault ([TRB-6]).

    No key is missing or another, no step that was taken is undone or moved.
    """
    if newer.issuer != held.issuer:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "TRB-6", "of another issuer")
    if newer.version < held.version or (newer.version == held.version and newer != held):
        return Fault(FaultCode.REPLAYED, "TRB-6", f"version {newer.version}, but {held.version} is acted on")
    for before in held.records:
        after = newer.find(before.id)
        if after is None or after.key != before.key:
            return Fault(FaultCode.KEY_WRONG_ROLE, "TRB-6", f"{before.id} is missing, or another key")
        if any(was is not None and was != now for was, now in zip(_steps(before), _steps(after), strict=True)):
            return Fault(FaultCode.REPLAYED, "TRB-6", f"a step of {before.id} is undone")
    return None


def _steps(record: KeyRecord) -> tuple[int | None, ...]:
    return record.prepared_at, record.activated_at, record.retired_at, record.tainted_at, record.revoked_at


def _registry(bundle: TrustBundle, signed_at: int, at: float) -> frozenset[str]:
    return frozenset(
        thumbprint(raw)
        for raw in bundle.registry
        if bundle.standing(raw, signed_at=signed_at, at=at) is Standing.TRUSTED
    )
