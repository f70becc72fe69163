"""Tokens of ours for the benchmark, made in another process: no memory of the measured one has seen their bytes."""

from __future__ import annotations

import functools
import hashlib
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, Final, assert_never

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities import (
    Attestation,
    CapabilityError,
    Chain,
    EvidenceKind,
    Grant,
    HopGrant,
    Limit,
    Range,
    Restriction,
    Scope,
    Sponsor,
    Tier,
    TrustBundle,
    delegate,
    mint,
    verify,
)
from capabilities.keys import keys
from capabilities.statements.revocation import RevocationView
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Stems, Words
from capabilities.values.units import Parameter
from evaluation.tokens.workload import OBJECT, WordLimit
from evaluation.tokens.workload import Limit as WorkLimit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities import Fault
    from capabilities.values.scope import Bound
    from evaluation.tokens.workload import AnyLimit, Workload

NOW: Final = 1_800_000_000
"""Seconds since the epoch at which everything of ours happens: time is an argument."""
ISSUER: Final = "http://127.0.0.1:8000/ztpm"
SERVER: Final = "http://127.0.0.1:9000/mcp"
ROOT_ID: Final = 1
LEASE_MS: Final = 2_000
REVOKED: Final = 1_000
"""Entries of the revocation view that each token is asked against."""
ROLE: Final = "worker"
DEEPEST: Final = 8


@dataclass(frozen=True, slots=True)
class HeldToken:
    """A token and the private key of its leaf, 32 bytes."""

    token: bytes
    seed: bytes


@dataclass(frozen=True, slots=True)
class Declined:
    """The reason code for which no such token is made."""

    code: str


@functools.cache
def key_of(name: str) -> Ed25519PrivateKey:
    """The private key of a name: the two processes must hold the same."""
    return Ed25519PrivateKey.from_private_bytes(_seed(name))


def _seed(name: str) -> bytes:
    return hashlib.sha256(b"bench/" + name.encode()).digest()


def _raw(name: str) -> bytes:
    return keys.public_raw(key_of(name))


@functools.cache
def trust() -> TrustBundle:
    """The bundle that tokens of the benchmark are verified with."""
    return TrustBundle(
        issuer=ISSUER,
        version=1,
        roots={ROOT_ID: _raw("root")},
        attesters=frozenset({_raw("attester")}),
        feed=frozenset({_raw("feed")}),
        registry=frozenset({_raw("registry")}),
        ledger=frozenset({_raw("ledger")}),
    )


@functools.cache
def view() -> RevocationView:
    """A view with `REVOKED` entries, none of them of a token of the benchmark."""
    revoked = frozenset(("hop", hashlib.sha256(b"gone %d" % n).hexdigest()[:32]) for n in range(REVOKED))
    return RevocationView(epoch=1, age_ms=100, revoked=revoked)


# --- making ----------------------------------------------------------------------------------------------------------


def grant_to(hop: int, serial: int) -> HopGrant:
    """Statement of the identity provider about the holder of this hop in the token of this serial number."""
    name = f"{serial}/{hop}"
    return HopGrant(
        hop_id=_seed(f"hop {name}").hex()[:32],
        agent=f"agent-{serial}-{hop}",
        key=_raw(name),
        delegator="alice" if hop == 0 else f"agent-{serial}-{hop - 1}",
        purpose="pick the red part",
        request_digest=_seed(f"request {name}"),
        attestation=Attestation(EvidenceKind.KEY, _seed(f"measurement {name}"), NOW - 10),
        role=ROLE,
    )


def _limit(limit: AnyLimit) -> Limit:
    bound: Bound
    match limit:
        case WorkLimit(_, _, low, high):
            bound = Range(low, high)
        case WordLimit(_, _, stem, words):
            bound = Words(frozenset(words)) if words else Stems(frozenset({stem}), limit.divider)
        case _:
            assert_never(limit)
    return Limit(Parameter(limit.name, limit.kind), bound)


def scope(workload: Workload, serial: int) -> Scope:
    """The whole scope with the limits of this serial number."""
    return Scope(
        grants=tuple(
            Grant(OBJECT, operation, tuple(map(_limit, limits))) for operation, limits in workload.lent(0, serial)
        ),
        ceiling=Tier.HIGH_CONSEQUENCE,
        audiences=frozenset({SERVER}),
        delegates=frozenset({f"role:{ROLE}"}),
        depth=DEEPEST,
        not_before=NOW - 60,
        not_after=NOW + 3_000,
    )


def restriction(workload: Workload, hop: int, serial: int) -> Restriction:
    """Restriction by this hop: the operations that it drops, and both ends of the limits that it tightens."""
    return Restriction(
        grants=tuple(
            Grant(
                OBJECT,
                operation,
                tuple(_limit(limit) for limit in limits if (operation, limit.name) in workload.tightened),
            )
            for operation, limits in workload.lent(hop, serial)
        )
    )


def first_of(workload: Workload, serial: int, *, limits: int = 0) -> dict[str, Any]:
    """Arguments of `mint` for the token of this serial number, under the limits of that one."""
    return {
        "root": key_of("root"),
        "root_key_id": ROOT_ID,
        "token_id": keys.b64u(_seed(f"token {serial}")[:16]),
        "sponsor": Sponsor(ISSUER, "alice", "operator-key", NOW - 10),
        "hop": grant_to(0, serial),
        "scope": scope(workload, limits),
        "caps": DEFAULT,
    }


def next_of(chain: Chain, narrowed: Restriction, serial: int) -> dict[str, Any]:
    """Arguments of `delegate` for one more hop."""
    return {
        "chain": chain,
        "attester": key_of("attester"),
        "trust": trust(),
        "hop": grant_to(len(chain.hops), serial),
        "restriction": narrowed,
        "caps": DEFAULT,
    }


def check(token: bytes) -> Chain | Fault:
    """The chain of a token, with nothing remembered."""
    return verify(token, at=NOW, audience=SERVER, view=view(), lease_ms=LEASE_MS, trust=trust(), caps=DEFAULT)


def chain_of(token: bytes) -> Chain:
    """Chain of a token that was just made.

    Raises:
        RuntimeError: when the made token does not verify.
    """
    chain = check(token)
    if not isinstance(chain, Chain):
        raise RuntimeError(f"a token of the benchmark does not verify: {chain.code}")  # noqa: TRY004 - not a type error
    return chain


def lend(workload: Workload, depth: int, serial: int, *, varied: bool = False) -> HeldToken:
    """A token of this depth and the key of its leaf.

    Args:
        workload: its scope.
        depth: how many hops after the first holder.
        serial: no two tokens of a run have the same one; agents, keys and ids go by it.
        varied: the limits, too.

    Raises:
        CapabilityError: where the caps of the profile do not allow it.
    """
    limits = serial if varied else 0
    token = mint(**first_of(workload, serial, limits=limits))
    for hop in range(1, depth + 1):
        token = delegate(token, **next_of(chain_of(token), restriction(workload, hop, limits), serial))
    return HeldToken(token, _seed(f"{serial}/{depth}"))


def lend_all(workload: Workload, depth: int, serials: range, varied: bool = False) -> list[HeldToken] | Declined:  # noqa: FBT001, FBT002 - across processes
    """A token for each serial number, or why there is none."""
    try:
        return [lend(workload, depth, serial, varied=varied) for serial in serials]
    except CapabilityError as error:
        return Declined(str(error.code))


@contextmanager
def elsewhere() -> Iterator[Callable[[Workload, int, range, bool], list[HeldToken] | Declined]]:
    """`lend_all` in a fresh process, which lives as long as the block."""
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as pool:
        yield lambda *asked: pool.submit(lend_all, *asked).result()
