"""Tokens of `capabilities` as a measured peer, through its public functions alone."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any, ClassVar, Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities import (
    CapabilityError,
    Chain,
    Fault,
    Tier,
    Verifier,
    check_proof,
    delegate,
    mint,
    prove,
    token_to_text,
)
from capabilities.values.caps import DEFAULT
from evaluation.harness.bench import Row
from evaluation.harness.timing import Cell, Verdict
from evaluation.tokens.cell import Kind, Prepared, TokenKey, endless
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.peers import session as stream
from evaluation.tokens.peers.lending import Declined
from evaluation.tokens.workload import OBJECT, body, values_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities.values.arguments import Value
    from evaluation.tokens.peers.lending import HeldToken
    from evaluation.tokens.workload import Given, Workload

NAME: Final = "ztpm"
CHECKS: Final = (
    "every signature, attestation of each hop, canonical bytes, narrowing, limits, tier, times, audience, "
    f"{tokens.REVOKED} revocations, Biscuit's own authorizer"
)
PROVEN: Final = "; a DPoP proof over method, URL, body and token (not replay: the server's store)"


@dataclass(frozen=True, slots=True)
class OurCall:
    """One request under one token.

    Attributes:
        verifier: that decides.
        token, text: the bytes, and the same as they stood in the header.
        proof: empty where none is checked.
        body: that the proof is over.
        values: of the request.
    """

    verifier: Verifier
    token: bytes
    text: str
    proof: str
    body: bytes
    values: tuple[Value, ...]


def forget() -> None:
    """Forgets everything that the package remembers for the whole process."""
    for name, module in list(sys.modules.items()):
        if name.split(".", 1)[0] == "capabilities":
            for member in list(vars(module).values()):
                clear = getattr(member, "cache_clear", None)
                if callable(clear):
                    clear()


class OurTokens:
    """See the module."""

    name = NAME
    version = metadata.version("ztpm")
    words: ClassVar[bool] = True

    def __init__(self, lend: Callable[[Workload, int, range, bool], list[HeldToken] | Declined]) -> None:
        self._lend = lend
        self._serials = 0
        self._proofs = 0
        self._trust = tokens.trust()
        self._view = tokens.view()

    def prepare(self, workload: Workload, depth: int, calls: int) -> Prepared:
        """Cells of one scope at one depth, each good for `calls` calls."""
        cells: list[Cell[TokenKey] | Row[TokenKey]] = []
        wanted = [(kind, proof) for kind in (Kind.COLD, Kind.NOVEL, Kind.FIRST) for proof in (False, True)]
        one = self._lend(workload, depth, self._next(1), False)  # noqa: FBT003 - across processes
        if isinstance(one, Declined):
            kinds = [*wanted, (Kind.WARM, False), (Kind.WARM, True), (Kind.STREAM, True)]
            why = f"refused: {one.code}"
            return Prepared(
                tuple(Row(TokenKey(NAME, workload.name, depth, k, proof=p), why=why) for k, p in kinds), None
            )
        for kind, proof in wanted:
            pool = self._lend(workload, depth, self._next(calls), kind is not Kind.COLD)
            assert not isinstance(pool, Declined)
            cells.append(self._unseen(workload, depth, kind, proof=proof, pool=pool))
        cells += [self._seen(workload, depth, one[0], proof=proof) for proof in (False, True)]
        cells.append(self._mint(workload) if depth == 0 else self._attenuate(workload, depth))
        cells.append(stream.cell(NAME, workload, depth, one[0], view=self._view))
        return Prepared(tuple(cells), len(one[0].token))

    def _next(self, count: int) -> range:
        self._serials += count
        return range(self._serials - count, self._serials)

    # --- deciding ----------------------------------------------------------------------------------------------------

    def _decide(self, workload: Workload, *, proof: bool) -> Callable[[OurCall], Verdict]:
        view, operation = self._view, workload.operation

        def decide(call: OurCall) -> Verdict:
            chain = call.verifier.verify(
                call.token, at=tokens.NOW, audience=tokens.SERVER, view=view, lease_ms=tokens.LEASE_MS
            )
            if isinstance(chain, Fault):
                return Verdict.REFUSED
            if proof:
                proven = check_proof(
                    call.proof,
                    key=chain.leaf.key,
                    method="POST",
                    url=tokens.SERVER,
                    body=call.body,
                    token=call.text,
                    at=tokens.NOW,
                    caps=DEFAULT,
                )
                if isinstance(proven, Fault):
                    return Verdict.REFUSED
            refused = call.verifier.check_request(
                chain,
                object=OBJECT,
                operation=operation,
                values=call.values,
                base_tier=Tier.CONSEQUENTIAL,
                at=tokens.NOW,
            )
            return Verdict.ALLOWED if refused is None else Verdict.REFUSED

        return decide

    def _call(
        self,
        workload: Workload,
        held: HeldToken,
        *,
        proof: bool,
        verifier: Verifier,
        values: tuple[Given, ...] | None = None,
        signer: Ed25519PrivateKey | None = None,
        body_of: tuple[Given, ...] | None = None,
    ) -> OurCall:
        """A request with a proof of its own; `signer` and `body_of` make the proof one of another key or body."""
        values = workload.values if values is None else values
        text, sent = token_to_text(held.token), body(workload, values)
        self._proofs += 1
        made = ""
        if proof:
            made = prove(
                Ed25519PrivateKey.from_private_bytes(held.seed) if signer is None else signer,
                method="POST",
                url=tokens.SERVER,
                body=sent if body_of is None else body(workload, body_of),
                token=text,
                at=tokens.NOW - 1,
                jti=f"{self._proofs:022d}",
            )
        return OurCall(verifier, held.token, text, made, sent, values_of(workload, values))

    def _wrong(
        self, workload: Workload, held: HeldToken, *, proof: bool, verifier: Verifier
    ) -> dict[str, Callable[[], OurCall]]:
        wrong = {
            "a value out of limits": lambda: self._call(
                workload, held, proof=proof, verifier=verifier, values=workload.outside
            )
        }
        if proof:
            stranger = tokens.key_of("stranger")
            wrong["a proof by another key"] = lambda: self._call(
                workload, held, proof=True, verifier=verifier, signer=stranger
            )
            wrong["a proof for another request"] = lambda: self._call(
                workload, held, proof=True, verifier=verifier, body_of=workload.outside
            )
        return wrong

    def _unseen(
        self, workload: Workload, depth: int, kind: Kind, *, proof: bool, pool: list[HeldToken]
    ) -> Cell[TokenKey]:
        """Cell from bytes that were never seen: a new verifier for each call of `FIRST`, else one for all."""
        verifier = Verifier(self._trust, DEFAULT)

        def calls() -> Iterator[OurCall]:
            for held in pool:
                if kind is not Kind.FIRST:
                    yield self._call(workload, held, proof=proof, verifier=verifier)
                else:
                    call = self._call(workload, held, proof=proof, verifier=Verifier(self._trust, DEFAULT))
                    forget()
                    yield call

        flipped = bytearray(pool[-1].token)
        flipped[len(flipped) // 2] ^= 1
        spoiled = tokens.HeldToken(bytes(flipped), pool[-1].seed)
        wrong = self._wrong(workload, pool[-1], proof=proof, verifier=Verifier(self._trust, DEFAULT))
        wrong["one bit of the token"] = lambda: self._call(workload, spoiled, proof=proof, verifier=verifier)
        return Cell(
            TokenKey(NAME, workload.name, depth, kind, proof=proof),
            checks=CHECKS + (PROVEN if proof else ""),
            fresh=endless(calls()),
            act=self._decide(workload, proof=proof),
            wrong=wrong,
        )

    def _seen(self, workload: Workload, depth: int, held: HeldToken, *, proof: bool) -> Cell[TokenKey]:
        verifier = Verifier(self._trust, DEFAULT)
        fixed = self._call(workload, held, proof=False, verifier=verifier)
        return Cell(
            TokenKey(NAME, workload.name, depth, Kind.WARM, proof=proof),
            checks="of the token once; times, audience, revocations, limits, tier" + (PROVEN if proof else ""),
            fresh=(lambda: self._call(workload, held, proof=True, verifier=verifier)) if proof else (lambda: fixed),
            act=self._decide(workload, proof=proof),
            wrong=self._wrong(workload, held, proof=proof, verifier=verifier),
        )

    # --- making ------------------------------------------------------------------------------------------------------

    def _mint(self, workload: Workload) -> Cell[TokenKey]:
        def act(asked: dict[str, Any]) -> bytes:
            return mint(**asked)

        return Cell(
            TokenKey(NAME, workload.name, 0, Kind.MINT, proof=False),
            checks="the scope is well formed, lifetimes, key roles",
            fresh=lambda: tokens.first_of(workload, self._next(1)[0]),
            act=act,
            judge=lambda token: self._grants(token, hops=1),
        )

    def _attenuate(self, workload: Workload, depth: int) -> Cell[TokenKey]:
        """Cell from a verified chain, as the identity provider does it: attestation and checking are its own steps."""
        serial = self._next(1)[0]
        parent = tokens.lend(workload, depth - 1, serial, varied=True).token
        chain = tokens.chain_of(parent)

        def asked(hop: int) -> dict[str, Any]:
            return tokens.next_of(chain, tokens.restriction(workload, hop, serial), serial)

        def act(asked: dict[str, Any]) -> bytes | None:
            try:
                return delegate(parent, **asked)
            except CapabilityError:
                return None

        return Cell(
            TokenKey(NAME, workload.name, depth, Kind.ATTENUATE, proof=False),
            checks="signatures of the parent, strictly narrower, delegate, depth, lifetimes, key roles",
            fresh=lambda: asked(depth),
            act=act,
            judge=lambda token: self._grants(token, hops=depth + 1),
            wrong={"a wider bound": lambda: asked(depth - 2)},
        )

    def _grants(self, token: bytes | None, *, hops: int) -> Verdict:
        chain = None if token is None else tokens.check(token)
        return Verdict.ALLOWED if isinstance(chain, Chain) and len(chain.hops) == hops else Verdict.REFUSED
