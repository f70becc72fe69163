"""A9: every cap exactly at, below and above: two pass, the third is refused for its reason."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

from capabilities import (
    CapabilityError,
    Fault,
    FaultCode,
    Grant,
    HopGrant,
    Limit,
    OneOf,
    Range,
    Scope,
    Tier,
    check_proof,
    mint,
    prove,
    token_from_text,
    token_to_text,
    verify,
)
from capabilities.statements import statement_form
from capabilities.values.budgets import least
from capabilities.values.caps import DEFAULT, Caps
from capabilities.values.scope import Budget
from capabilities.values.units import Parameter, Unit
from evaluation.harness.campaign import Campaign, Misses, Outcome, Settings
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.workload import SMALL

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LONGEST_MS: Final = 1
"""Longest time of a refusal that comes before any signature is checked or made."""
BEST_OF: Final = 5
_ROOMY: Final = replace(DEFAULT, token_bytes=1_000_000)
"""Caps under which the edge of another cap can be reached at all."""

ELSEWHERE: Final = {
    "nonce_age_s": "a rule of the identity provider",
    "workload_token_lifetime_s": "a platform's token, not ours",
    "workload_token_bytes": "a platform's token, not ours",
    "credential_bytes": "a platform's or publisher's, not ours",
    "jwt_evidence_ceiling": "the highest tier that there is: nothing is above it",
    **dict.fromkeys(("datalog_ms", "datalog_facts", "datalog_iterations"), "a limit of the engine, not of an input"),
    **dict.fromkeys(("session_lifetime_s", "frame_bytes"), "a bound of sessions"),
}
"""Caps that are no size or depth of a token, a scope, a proof or a statement, and why."""


@dataclass(frozen=True, slots=True)
class Edge:
    """One cap, approached.

    Attributes:
        cap: its field of `Caps`.
        where: who is asked.
        reason: for which the first value above is refused.
        ask: the code for which the value at this distance from the cap is refused, or None.
        early: the refusal comes before any signature, so that its time is bounded.
    """

    cap: str
    where: str
    reason: FaultCode
    ask: Callable[[int], FaultCode | None]
    early: bool


def run(settings: Settings) -> Outcome:
    """Each edge at -1 and 0 without its reason, at +1 with it, and in time."""
    misses, slowest, count = Misses(), 0, 0
    for edge in edges():
        settings.told(f"{edge.cap}, {edge.where}")
        count += 1
        for distance in (-1, 0):
            said = edge.ask(distance)
            if said is not None:
                misses.add(f"{edge.cap} {distance:+d}, {edge.where}: {said}")
        took, said = _timed(edge, settings)
        if said != edge.reason:
            misses.add(f"{edge.cap} +1, {edge.where}: {said}, not {edge.reason}")
        if edge.early:
            slowest = max(slowest, took)
            if took > LONGEST_MS * 1_000_000:
                misses.add(f"{edge.cap} +1, {edge.where}: {took / 1e6:.1f} ms")
    caps = {edge.cap for edge in edges()}
    figures = {"edges": count, "caps": len(caps), "slowest_early_ms": round(slowest / 1e6, 3)}
    return Outcome(3 * count, figures, misses.told())


def _timed(edge: Edge, settings: Settings) -> tuple[int, FaultCode | None]:
    """The shortest of some refusals, ns, and the code."""
    best, said = 0, None
    for turn in range(BEST_OF):
        began = settings.clock_ns()
        said = edge.ask(1)
        took = settings.clock_ns() - began
        best = took if turn == 0 else min(best, took)
    return best, said


def edges() -> Iterator[Edge]:
    """Every edge of every cap."""
    yield from _of_tokens()
    yield from _of_scopes()
    yield from _of_scopes_in_tokens()
    yield from _of_evidence()
    yield from _of_proofs()


_TRUST: Final = tokens.trust()
_VIEW: Final = tokens.view()


def _verified(token: bytes, caps: Caps) -> FaultCode | None:
    found = verify(
        token, at=tokens.NOW, audience=tokens.SERVER, view=_VIEW, lease_ms=tokens.LEASE_MS, trust=_TRUST, caps=caps
    )
    return found.code if isinstance(found, Fault) else None


# --- tokens ----------------------------------------------------------------------------------------------------------


def _of_tokens() -> Iterator[Edge]:
    large, small = FaultCode.TOKEN_TOO_LARGE, tokens.lend(SMALL, 1, 0).token
    deep = tokens.lend(SMALL, DEFAULT.hops, 0).token

    def junk(distance: int) -> FaultCode | None:
        # Zeros are no token: the question is only whether that or the size is found first.
        said = _verified(bytes(DEFAULT.token_bytes + distance), DEFAULT)
        return None if said is FaultCode.TOKEN_MALFORMED else said

    def text(distance: int) -> FaultCode | None:
        most = len(token_to_text(bytes(DEFAULT.token_bytes)))
        said = token_from_text("A" * (most + 4 * distance), DEFAULT)
        return said.code if isinstance(said, Fault) else None

    yield Edge("token_bytes", "zeros, by verify", large, junk, early=True)
    yield Edge("token_bytes", "zeros, as text", large, text, early=True)
    yield Edge(
        "token_bytes",
        "a token, by verify",
        large,
        lambda d: _verified(small, replace(DEFAULT, token_bytes=len(small) - d)),
        early=True,
    )
    yield Edge(
        "hops",
        f"a token of {DEFAULT.hops} hops, by verify",
        FaultCode.TOO_MANY_HOPS,
        lambda d: _verified(deep, replace(_ROOMY, hops=DEFAULT.hops - d)),
        early=True,
    )


# --- scopes ----------------------------------------------------------------------------------------------------------


def _mint(scope: Scope, hop: HopGrant | None = None) -> FaultCode | None:
    asked = tokens.first_of(SMALL, 0) | {"scope": scope, "caps": _ROOMY}
    if hop is not None:
        asked["hop"] = hop
    try:
        mint(**asked)
    except CapabilityError as error:
        return error.code
    return None


def _of_scopes() -> Iterator[Edge]:
    whole, out = tokens.scope(SMALL, 0), FaultCode.OUT_OF_RANGE

    def grants(distance: int) -> FaultCode | None:
        count = DEFAULT.grants + distance
        return _mint(replace(whole, grants=tuple(Grant("ur3e", f"operation_{n:03d}") for n in range(count))))

    def parameters(distance: int) -> FaultCode | None:
        count = DEFAULT.parameters + distance
        limits = tuple(Limit(Parameter(f"p{n}", Unit.COUNT), Range(0, 1)) for n in range(count))
        return _mint(replace(whole, grants=(Grant("ur3e", "move", limits),)))

    def budgets(distance: int) -> FaultCode | None:
        some = tuple(Budget("", tokens.SERVER, n + 1, 500 + n) for n in range(DEFAULT.budgets + distance))
        return _mint(replace(whole, grants=(Grant("ur3e", "move", (), some),)))

    def one_of(distance: int) -> FaultCode | None:
        some = OneOf(frozenset(range(0, 2 * (DEFAULT.one_of + distance), 2)))
        return _mint(replace(whole, grants=(Grant("ur3e", "move", (Limit(Parameter("p", Unit.COUNT), some),)),)))

    def audiences(distance: int) -> FaultCode | None:
        count = DEFAULT.one_of + distance
        return _mint(replace(whole, audiences=frozenset(f"http://127.0.0.1:{9_000 + n}/mcp" for n in range(count))))

    def name(distance: int) -> FaultCode | None:
        return _mint(replace(whole, grants=(Grant("ur3e", "o" * (DEFAULT.text_bytes + distance)),)))

    def depth(distance: int) -> FaultCode | None:
        return _mint(replace(whole, depth=DEFAULT.hops + distance))

    def purpose(distance: int) -> FaultCode | None:
        return _mint(whole, replace(tokens.grant_to(0, 0), purpose="p" * (DEFAULT.purpose_bytes + distance)))

    yield Edge("grants", "by mint", out, grants, early=True)
    yield Edge("parameters", "by mint", out, parameters, early=True)
    yield Edge("budgets", "by mint", out, budgets, early=True)
    yield Edge("one_of", "members of a set, by mint", out, one_of, early=True)
    yield Edge("one_of", "audiences, by mint", out, audiences, early=True)
    yield Edge("text_bytes", "a name, by mint", FaultCode.STATEMENT_MALFORMED, name, early=True)
    yield Edge("hops", "depth of a scope, by mint", out, depth, early=True)
    yield Edge("purpose_bytes", "by mint", FaultCode.STATEMENT_MALFORMED, purpose, early=True)


def _of_scopes_in_tokens() -> Iterator[Edge]:
    """Cases of a token that was minted under wider caps than the verifier's."""
    longest = tokens.ISSUER + "/" + "a" * 100
    audiences = frozenset({tokens.SERVER, longest})
    paces = least(Budget("", where, window, most) for where in audiences for window, most in ((1, 5), (9, 6)))
    two = Limit(Parameter("p", Unit.COUNT), OneOf(frozenset({1, 3, 5})))
    whole = replace(
        tokens.scope(SMALL, 0),
        grants=(
            Grant("ur3e", "a", (two, Limit(Parameter("q", Unit.COUNT), Range(0, 1)))),
            Grant("ur3e", "b", (), paces),
        ),
    )
    wide = tokens.first_of(SMALL, 0) | {"scope": replace(whole, audiences=audiences)}
    token = mint(**wide)
    purpose = tokens.grant_to(0, 0).purpose
    sizes = {
        "grants": 2,
        "parameters": 2,
        "budgets": 4,
        "one_of": 3,
        "text_bytes": len(longest),
        "purpose_bytes": len(purpose),
    }

    def asked(cap: str, distance: int) -> FaultCode | None:
        return _verified(token, replace(DEFAULT, **{cap: sizes[cap] - distance}))

    for cap in sizes:
        yield Edge(cap, "of a token, by verify", FaultCode.CHAIN_BROKEN, partial(asked, cap), early=False)


def _of_evidence() -> Iterator[Edge]:
    whole, hop = tokens.scope(SMALL, 0), tokens.grant_to(0, 0)
    attested = hop.attestation.at

    def ceiling(distance: int) -> FaultCode | None:
        return _mint(replace(whole, ceiling=Tier(DEFAULT.key_evidence_ceiling + distance)))

    def of_kind(kind: str, longest_s: int, distance: int) -> FaultCode | None:
        by = replace(hop, attestation=replace(hop.attestation, kind=type(hop.attestation.kind)(kind)))
        low = Tier(min(whole.ceiling, DEFAULT.client_evidence_ceiling))
        return _mint(replace(whole, ceiling=low, not_after=attested + longest_s + distance), by)

    def of_client(distance: int) -> FaultCode | None:
        by = replace(hop, attestation=replace(hop.attestation, kind=type(hop.attestation.kind)("client")))
        top = Tier(DEFAULT.client_evidence_ceiling + distance)
        return _mint(replace(whole, ceiling=top, not_after=attested + DEFAULT.client_evidence_lifetime_s), by)

    def lifetime(distance: int) -> FaultCode | None:
        ends = attested + DEFAULT.key_evidence_lifetime_s
        return _mint(replace(whole, not_before=ends - DEFAULT.lifetime_s - distance, not_after=ends))

    long = FaultCode.LIFETIME_TOO_LONG

    def ceiling_of(kind: str, distance: int) -> FaultCode | None:
        by = replace(hop, attestation=replace(hop.attestation, kind=type(hop.attestation.kind)(kind)))
        return _mint(replace(whole, ceiling=Tier(getattr(DEFAULT, f"{kind}_evidence_ceiling") + distance)), by)

    yield Edge("key_evidence_ceiling", "by mint", FaultCode.HOP_NOT_ATTESTED, ceiling, early=True)
    yield Edge("client_evidence_ceiling", "by mint", FaultCode.HOP_NOT_ATTESTED, of_client, early=True)
    for kind in ("bearer", "x509", "release"):
        reached = partial(ceiling_of, kind)
        yield Edge(f"{kind}_evidence_ceiling", "by mint", FaultCode.HOP_NOT_ATTESTED, reached, early=True)
    yield Edge("lifetime_s", "by mint", long, lifetime, early=True)
    for kind in ("key", "jwt", "client", "bearer", "x509", "release"):
        cap = f"{kind}_evidence_lifetime_s"
        yield Edge(cap, "by mint", long, partial(of_kind, kind, getattr(DEFAULT, cap)), early=True)


# --- proofs and statements -------------------------------------------------------------------------------------------


def _of_proofs() -> Iterator[Edge]:
    key = tokens.key_of("holder")
    proof = prove(key, method="POST", url=tokens.SERVER, body=b"{}", token=None, at=tokens.NOW, jti="0" * 22)
    statement = statement_form.sign("edge", {"n": 1}, tokens.key_of("feed"))

    def asked(text: str, caps: Caps, later_s: float = 0) -> FaultCode | None:
        at = tokens.NOW + later_s
        found = check_proof(text, key=None, method="POST", url=tokens.SERVER, body=b"{}", token=None, at=at, caps=caps)
        return found.code if isinstance(found, Fault) else None

    def opened(caps: Caps) -> FaultCode | None:
        return _opened(statement, caps)

    malformed, stale = FaultCode.PROOF_MALFORMED, FaultCode.PROOF_STALE
    yield Edge(
        "proof_bytes",
        "by check_proof",
        malformed,
        lambda d: asked(proof, replace(DEFAULT, proof_bytes=len(proof) - d)),
        early=True,
    )
    yield Edge(
        "proof_age_s", "by check_proof", stale, lambda d: asked(proof, DEFAULT, DEFAULT.proof_age_s + d), early=False
    )
    yield Edge("skew_s", "by check_proof", stale, lambda d: asked(proof, DEFAULT, -(DEFAULT.skew_s + d)), early=False)
    yield Edge(
        "statement_bytes",
        "by sealed.open",
        FaultCode.STATEMENT_MALFORMED,
        lambda d: opened(replace(DEFAULT, statement_bytes=len(statement) - d)),
        early=True,
    )


def _opened(statement: str, caps: Caps) -> FaultCode | None:
    try:
        statement_form.open("edge", statement, _TRUST.feed, caps)
    except CapabilityError as error:
        return error.code
    return None


CAMPAIGN: Final = Campaign("A9", "each cap at, below and above", f"exact, early refusals under {LONGEST_MS} ms", run)
