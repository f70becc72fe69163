"""The session form of ours: a proof opens it, and each frame after that carries a MAC with a counter."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities import Fault, Tier, Verifier, token_to_text
from capabilities.proof import session_opening
from capabilities.values.caps import DEFAULT
from evaluation.harness.bench import Row
from evaluation.harness.timing import Cell, Verdict
from evaluation.tokens.cell import Kind, TokenKey
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.workload import OBJECT, body, values_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.proof.session_frames import Session
    from capabilities.statements.revocation import RevocationView
    from capabilities.values.arguments import Value
    from evaluation.tokens.peers.lending import HeldToken
    from evaluation.tokens.workload import Given, Workload

CHECKS: Final = (
    "the token once; MAC, counter (so replay too), times, audience, revocations, limits and tier of each frame"
)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame, and the values that its message states."""

    frame: bytes
    values: tuple[Value, ...]


def cell(
    peer: str, workload: Workload, depth: int, held: HeldToken, *, view: RevocationView
) -> Cell[TokenKey] | Row[TokenKey]:
    """A cell of one open session; or a row that says that the package has no session form."""
    verifier = Verifier(tokens.trust(), DEFAULT)
    first = verifier.verify(held.token, at=tokens.NOW, audience=tokens.SERVER, view=view, lease_ms=tokens.LEASE_MS)
    if isinstance(first, Fault):
        return Row(TokenKey(peer, workload.name, depth, Kind.STREAM, proof=True), why=str(first.code))
    holder_end, verifier_end = _opened(held)

    def decide(given: Frame) -> Verdict:
        message = verifier_end.open(given.frame, at=tokens.NOW)
        if isinstance(message, Fault):
            return Verdict.REFUSED
        chain = verifier.still(first, at=tokens.NOW, audience=tokens.SERVER, view=view, lease_ms=tokens.LEASE_MS)
        if isinstance(chain, Fault):
            return Verdict.REFUSED
        refused = verifier.check_request(
            chain,
            object=OBJECT,
            operation=workload.operation,
            values=given.values,
            base_tier=Tier.CONSEQUENTIAL,
            at=tokens.NOW,
        )
        return Verdict.ALLOWED if refused is None else Verdict.REFUSED

    def sealed(values: tuple[Given, ...]) -> Frame:
        frame = holder_end.seal(body(workload, values), at=tokens.NOW)
        if isinstance(frame, Fault):
            raise RuntimeError(f"a frame of the benchmark is refused: {frame.code}")  # noqa: TRY004 - not a type error
        return Frame(frame, values_of(workload, values))

    def spoiled() -> Frame:
        good = sealed(workload.values)
        return Frame(good.frame[:-1] + bytes([good.frame[-1] ^ 1]), good.values)

    def again() -> Frame:
        good = sealed(workload.values)
        decide(good)
        return good

    wrong: dict[str, Callable[[], Frame]] = {
        "a value out of limits": lambda: sealed(workload.outside),
        "one bit of the MAC": spoiled,
        "a frame twice": again,
    }
    return Cell(
        TokenKey(peer, workload.name, depth, Kind.STREAM, proof=True),
        checks=CHECKS,
        fresh=lambda: sealed(workload.values),
        act=decide,
        wrong=wrong,
    )


def _opened(held: HeldToken) -> tuple[Session, Session]:
    """Both ends of a session: the holder's, the verifier's."""
    key, text = Ed25519PrivateKey.from_private_bytes(held.seed), token_to_text(held.token)
    asked = session_opening.begin(
        key=key,
        url=tokens.SERVER,
        audience=tokens.SERVER,
        token=text,
        verifier_key=None,
        private=_bytes("holder's private key"),
        nonce=_bytes("holder's nonce"),
        at=tokens.NOW,
        jti="0" * 22,
    )
    answered = session_opening.answer(
        asked.body,
        asked.proof,
        holder_key=key.public_key().public_bytes_raw(),
        url=tokens.SERVER,
        audience=tokens.SERVER,
        token=text,
        signer=None,
        private=_bytes("verifier's private key"),
        nonce=_bytes("verifier's nonce"),
        not_after=tokens.NOW + 600,
        at=tokens.NOW,
        most_missing=_LOST,
        caps=DEFAULT,
    )
    if isinstance(answered, Fault):
        raise RuntimeError(f"the benchmark's session is refused: {answered.code}")  # noqa: TRY004 - not a type error
    concluded = session_opening.conclude(asked, answered.text, at=tokens.NOW, most_missing=_LOST, caps=DEFAULT)
    if isinstance(concluded, Fault):
        raise RuntimeError(f"the benchmark's session is refused: {concluded.code}")  # noqa: TRY004 - not a type error
    return concluded, answered.session


_LOST: Final = 8
"""Frames in a row that may be missing: one for each counter-example that is never opened, and some to spare."""


def _bytes(name: str) -> bytes:
    return hashlib.sha256(name.encode()).digest()
