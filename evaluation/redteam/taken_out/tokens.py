"""Identity, scope and narrowing, taken out of the verification of tokens and proofs.

Each function undoes the checks of one primitive wherever a process makes them before a policy is asked; with its own
judgement (`rows.take_out`) nothing of it is left. A fault that several primitives find is gone once all are off.
"""

from __future__ import annotations

import secrets
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from capabilities.statements.revocation import Revoked
from capabilities.token import biscuit, hop_rules, static_verification, verify
from capabilities.token.verify import Verifier
from capabilities.values import algebra
from capabilities.values.chain import Refusal
from capabilities.values.errors import Fault, FaultCode, TokenError
from pep.base.operation_row import Operation
from pep.gate.gate import Gate
from pep.journal.conduct import Conduct
from pep.journal.replay_cache import ReplayCache
from pep.request.authority import Authority, Credentials
from pep.rtde.judge.lease_bounds import LeaseBounds
from policies.primitives.base import fault_owners
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from capabilities.statements.revocation import RevocationView
    from capabilities.token.biscuit import OpenedToken
    from capabilities.token.block import HopBlock
    from capabilities.token.static_verification import StaticVerification
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain, Hop
    from capabilities.values.scope import Scope
    from pep.request.authority import PresentedRequest
    from pep.request.call import Call
    from policies.evidence.evidence import Evidence, TrustReading

    Off = frozenset[str]


def lifted(fault: Fault | Refusal | None, off: Off) -> bool:
    """True where every primitive that finds this fault is off."""
    if fault is None:
        return False
    owners = REASONS[Reason(fault.code)].owners if isinstance(fault, Refusal) else fault_owners(fault)
    return bool(owners) and off.issuperset(owners)


def agent_authentication(off: Off) -> None:
    """Any proof counts, also none, and a second time; a key may have any role."""

    def prove(self: Authority, presented: PresentedRequest, so_far: Credentials, chain: Chain) -> Credentials:
        return replace(so_far, proof=True, proof_name=secrets.token_hex(32))

    Authority._prove = prove  # type: ignore[method-assign]
    ReplayCache.first_use = lambda self, jti, *, key, expires_ms: True  # type: ignore[method-assign]


def human_root(off: Off) -> None:
    """A sponsor who was revoked counts as any other."""
    _spare(off)


def link_validity(off: Off) -> None:
    """Signatures, times, revocations and the age of their view are not asked; bytes need not be canonical.

    The library opens no token whose signatures fail, so the last one that it opened stands for such a token: what a
    token says is read by the project's own reader anyway.
    """
    honest, last = biscuit.open_token, list[Any]()

    def open_token(token: bytes, root: bytes) -> OpenedToken:
        try:
            last[:] = [honest(token, root)]
        except TokenError:
            if not last:
                raise
        found: OpenedToken = last[0]
        return found

    def times(read: StaticVerification, at: float, caps: Caps) -> Fault | None:
        return None if read.lifetimes is None or "AID-5" in off else read.lifetimes

    biscuit.open_token = open_token
    static_verification._check_canonical = lambda opened, token: None
    verify._check_times = times
    verify._check_window = lambda chain, at, clause: None
    _spare(off)


def _spare(off: Off) -> None:
    """Revocations count that belong to primitives which are on, and so does the age of their view."""

    def check(read: StaticVerification, audience: str, view: RevocationView, lease_ms: int) -> Fault | None:
        gone = view.revoked & {*read.names, (Revoked.AUDIENCE.value, audience)}
        sponsor = any(kind == Revoked.SPONSOR for kind, _ in gone)
        if sponsor and "AID-2" not in off:
            return Fault(FaultCode.REVOKED, "TOK-9", "sponsor")
        if gone and not sponsor and "AID-3" not in off:  # with a person its agents are revoked too
            return Fault(FaultCode.REVOKED, "TOK-9")
        if "AID-3" not in off and not 0 <= view.age_ms <= lease_ms:
            return Fault(FaultCode.REVOCATION_VIEW_STALE, "TOK-9")
        return None

    verify._check_revocation = check


def scope_escalation(off: Off) -> None:
    """A hop may be wider than its parent, as far as nobody asks it to be strictly narrower."""
    _narrowing(off)


def scope_narrowing(off: Off) -> None:
    """A hop may have as much as its parent; more than that, once AID-4 is off too."""
    _narrowing(off)


def _narrowing(off: Off) -> None:
    def narrower(parent: Scope, block: HopBlock) -> Scope:
        child = algebra.hop(parent, block.restriction, lay=hop_rules._lay_over)
        if not isinstance(child, algebra.Narrowing):
            return child
        if "CATP-2" not in off or (child.widenings and "AID-4" not in off):
            raise hop_rules.NotNarrowerError(child.widenings)
        return algebra.stated(parent, block.restriction)

    hop_rules._narrower = narrower


def bounded_chain(off: Off) -> None:
    """Size, depth, audience and lifetime have no bound."""
    static_verification._check_size = lambda token, caps: None
    static_verification._check_length = lambda shape, caps: None
    static_verification._lifetimes = lambda hops, caps: None
    hop_rules.check_lifetimes = lambda hops, caps: None
    verify._check_audience = lambda chain, audience: None
    _eased(lambda scope, added: replace(scope, depth=max(1, scope.depth)))


def boundary_attestation(off: Off) -> None:
    """A hop needs no attester, its evidence carries any ceiling, and its delegate need not be named."""
    honest = Verifier._check_signers

    def signers(self: Verifier, read: StaticVerification, at: float) -> Fault | None:
        found = honest(self, read, at)
        return None if lifted(found, off) else found

    static_verification._check_attested = lambda shape, signers, trust: None
    Verifier._check_signers = signers  # type: ignore[method-assign]
    hop_rules._check_ceiling = lambda hop, caps: None
    _eased(lambda scope, added: replace(scope, delegates=scope.delegates | {added}))


def _eased(ease: Any) -> None:
    """Has each hop judged by a parent whose scope was eased for it."""
    honest = hop_rules.next_hop

    def next_hop(parents: tuple[Hop, ...], block: HopBlock, **rest: Any) -> Hop:
        parent = replace(parents[-1], scope=ease(parents[-1].scope, block.hop.agent))
        return honest((*parents[:-1], parent), block, **rest)

    hop_rules.next_hop = next_hop


def tool_scope(off: Off) -> None:
    """An operation need not be granted."""
    _requests(off)


def parameter_limits(off: Off) -> None:
    """A parameter may have any value, of a stream too."""
    _requests(off)
    Operation.refuse = lambda self, request: None  # type: ignore[method-assign]
    LeaseBounds.outside = lambda self, numbers: None  # type: ignore[method-assign]


def ceiling(off: Off) -> None:
    """Step 11 does not compare the base tier with the ceiling."""
    _requests(off)


def _requests(off: Off) -> None:
    """Steps 11 and 12 without the refusals whose primitives are off."""
    honest = Verifier.check_request

    def check(self: Verifier, chain: Chain, **request: Any) -> Refusal | Fault | None:
        found = honest(self, chain, **request)
        return None if lifted(found, off) else found

    Verifier.check_request = check  # type: ignore[method-assign]


def tool_identity(off: Off) -> None:
    """A tool is taken to be the one that was approved, with the least base tier where none is registered."""
    honest = Gate._cheap

    def cheap(self: Gate, call: Call) -> Evidence:
        tool = call.tool
        base = tool.base_tier if tool.base_tier is not None else call.operation.base_tier
        known = replace(tool, approved_digest=tool.actual_digest, base_tier=base)
        return honest(self, replace(call, tool=known))

    Gate._cheap = cheap  # type: ignore[method-assign]


def non_transitive_trust(off: Off) -> None:
    """Trust flows along the chain: all of it is as trusted as its most trusted edge."""
    honest = Conduct.trust

    def trust(self: Conduct, chain: Chain, *, at: float) -> TrustReading:
        found = honest(self, chain, at=at)
        return replace(found, score_permille=max((edge.score_permille for edge in found.edges), default=0))

    Conduct.trust = trust  # type: ignore[method-assign]
