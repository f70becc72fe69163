"""A6: hostile Datalog in a token, put there by its holder or by a trusted attester gone bad.

An attester's block comes in three forms: hostile statements alone; the facts of an honest hop with a hostile condition
for its check; and an honest hop whose own check has a costly condition beside it, which changes no answer.
"""

from __future__ import annotations

import resource
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import biscuit_auth

from capabilities import Chain, Fault, FaultCode, Tier, Verifier
from capabilities.keys import keys
from capabilities.values.caps import DEFAULT
from evaluation.harness.campaign import Campaign, Misses, Outcome, Settings
from evaluation.tokens.campaigns.blocks import CONDITIONS, STATEMENTS, BlockKind
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.workload import OBJECT, SMALL, quantities

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_library: Any = biscuit_auth
_ED25519: Final[Any] = _library.Algorithm.Ed25519
LONGEST_MS: Final = 100
MOST_MIB: Final = 64
_CHECK: Final = "check if req("
_TRUST: Final = tokens.trust()
_VIEW: Final = tokens.view()

BY_HOLDER: Final = frozenset({FaultCode.HOP_NOT_ATTESTED})
BY_ATTESTER: Final = frozenset(
    {FaultCode.WRONG_PROFILE, FaultCode.CHAIN_BROKEN, FaultCode.NOT_CANONICAL, FaultCode.TOKEN_MALFORMED}
)
"""Reasons for which such a block may be refused: it is not of the profile."""


@dataclass(frozen=True, slots=True)
class Hostile:
    """Hostile token: its description, and the reasons for which it may be refused."""

    name: str
    token: bytes
    reasons: frozenset[FaultCode]


def run(settings: Settings) -> Outcome:
    """Every one of 400 tokens is refused by `verify`, for its reason, in time, and without much memory."""
    settings.told("writing blocks")
    made = list(crafted(every=5 if settings.quick else 1))
    misses, reasons, slowest, late = Misses(), Counter[str](), 0, 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for one in made:
        settings.told(one.name)
        began = settings.clock_ns()
        found = verdict(one.token)
        took = settings.clock_ns() - began
        slowest = max(slowest, took)
        match found:
            case Fault(code):
                reasons[str(code)] += 1
                if code not in one.reasons:
                    misses.add(f"{one.name}: {code}")
            case Later(said):
                late += 1
                misses.add(f"{one.name}: passes verify; then {said}")
        if took > LONGEST_MS * 1_000_000:
            misses.add(f"{one.name}: {took / 1e6:.0f} ms")
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1_024
    if grown > MOST_MIB:
        misses.add(f"{grown:.0f} MiB")
    figures: dict[str, int | float | str] = {
        "refused_by_verify": sum(reasons.values()),
        "not_refused_by_verify": late,
        "slowest_ms": round(slowest / 1e6, 1),
        "memory_mib": round(grown, 1),
        **dict(sorted(reasons.items())),
    }
    return Outcome(len(made), figures, misses.told())


@dataclass(frozen=True, slots=True)
class Later:
    """`verify` let the token pass; this came of the request."""

    said: str


def verdict(token: bytes) -> Fault | Later:
    """Answer of `verify` to a token, or that to a later request which the honest hop would allow."""
    verifier = Verifier(_TRUST, DEFAULT)
    chain = verifier.verify(token, at=tokens.NOW, audience=tokens.SERVER, view=_VIEW, lease_ms=tokens.LEASE_MS)
    if not isinstance(chain, Chain):
        return chain
    refused = verifier.check_request(
        chain,
        object=OBJECT,
        operation=SMALL.operation,
        values=quantities(SMALL, SMALL.values),
        base_tier=Tier.CONSEQUENTIAL,
        at=tokens.NOW,
    )
    return Later("allowed" if refused is None else str(refused.code))


# --- making ----------------------------------------------------------------------------------------------------------


def crafted(*, every: int) -> Iterator[Hostile]:
    """200 tokens by a holder and 200 by an attester, or each n-th of them."""
    parent, honest = tokens.lend(SMALL, 1, 0).token, _last_source(tokens.lend(SMALL, 2, 0).token)
    blocks = [(kind, n, kind.write(n)) for kind in STATEMENTS for n in kind.sizes()]
    blocks += [(kind, n, f"check if {kind.write(n)};") for kind in CONDITIONS for n in kind.sizes()]
    for kind, n, source in blocks[::every]:
        yield Hostile(f"holder: {kind.name} {n}", _appended(parent, source), BY_HOLDER)
    for kind, n, source in blocks[1::2][::every]:
        yield Hostile(f"attester: {kind.name} {n}", _attested(parent, source), BY_ATTESTER)
    forms: tuple[tuple[str, Callable[[str], str]], ...] = (
        ("in place of a check", lambda condition: _replaced(honest, f"check if {condition};")),
        ("beside a check", lambda condition: _replaced(honest, _own_check(honest).rstrip(";") + f", {condition};")),
    )
    for form, write in forms:
        chosen: list[tuple[BlockKind, int]] = [(kind, n) for kind in CONDITIONS for n in kind.sizes()][1::2][::every]
        for kind, n in chosen:
            source = write(kind.write(n))
            yield Hostile(f"attester, {form}: {kind.name} {n}", _attested(parent, source), BY_ATTESTER)


def _opened(token: bytes) -> Any:
    return _library.Biscuit.from_bytes(
        token, _library.PublicKey.from_bytes(keys.public_raw(tokens.key_of("root")), _ED25519)
    )


def _last_source(token: bytes) -> str:
    """The Datalog of a token's last block. All its texts are ours, so that it can be parsed again."""
    opened = _opened(token)
    return str(opened.block_source(opened.block_count() - 1))


def _own_check(honest: str) -> str:
    return next(line for line in honest.splitlines() if line.startswith(_CHECK))


def _replaced(honest: str, check: str) -> str:
    return honest.replace(_own_check(honest), check)


def _appended(parent: bytes, source: str) -> bytes:
    """Token with a block that any holder can append alone."""
    return bytes(_opened(parent).append(_library.BlockBuilder(source)).to_bytes())


def _attested(parent: bytes, source: str) -> bytes:
    private = _library.PrivateKey.from_bytes(tokens.key_of("attester").private_bytes_raw(), _ED25519)
    opened = _opened(parent)
    made = opened.third_party_request().create_block(private, _library.BlockBuilder(source))
    public = _library.KeyPair.from_private_key(private).public_key
    return bytes(opened.append_third_party(public, made).to_bytes())


CAMPAIGN: Final = Campaign(
    "A6",
    "hostile Datalog by a holder and by an attester",
    f"all refused within {LONGEST_MS} ms, under {MOST_MIB} MiB",
    run,
)
