"""PyJWT: an RFC 8693 access token with nested `act` claims and RFC 9396 details, and a DPoP proof.

One signature by one issuer at any depth: the chain is as the issuer states it, and only the issuer can make
a narrower token.
"""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, ClassVar, Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from evaluation.harness.absent import package
from evaluation.harness.timing import Cell, Verdict
from evaluation.tokens.cell import Kind, Prepared, TokenKey, endless
from evaluation.tokens.peers.plain import Ask, PlainPeer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from evaluation.tokens.workload import Workload

_ISSUER: Final = "https://as.example"
_SERVER: Final = "https://cell.example/mcp"
_EXPIRES: Final = 4_102_444_800
"""2100-01-01."""


@dataclass(frozen=True, slots=True)
class ActTokenCall:
    """One request with its proof."""

    token: str
    proof: str
    ask: Ask


class ActToken(PlainPeer):
    """See the module."""

    name = "pyjwt-act"
    checks: ClassVar[str] = "one signature; issuer, audience, expiry; limits by our comparison (the chain is a claim)"
    checks_seen: ClassVar[str] = ""

    def __init__(self) -> None:
        super().__init__()
        self._jwt, self.version = package("jwt", "pyjwt")
        self._root = Ed25519PrivateKey.generate()
        self._public = self._root.public_key()
        self._holder = Ed25519PrivateKey.generate()
        self._proofs = count()

    def mint(self, workload: Workload, serial: int) -> str:
        """A token of depth 0."""
        return self._signed(workload, 0, serial)

    def attenuate(self, made: Any, workload: Workload, hop: int, serial: int) -> str:  # noqa: ARG002 - the issuer mints anew
        """A token of depth `hop`: the issuer makes a new one."""
        return self._signed(workload, hop, serial)

    def wire(self, made: Any) -> str:
        """The compact form."""
        return str(made)

    def size(self, token: Any) -> int:
        """Bytes of the compact form; it has no other."""
        return len(token)

    def _signed(self, workload: Workload, depth: int, serial: int) -> str:
        act: dict[str, Any] = {"sub": f"agent-{serial}-0"}
        for hop in range(1, depth + 1):
            act = {"sub": f"agent-{serial}-{hop}", "act": act}
        claims = {
            "iss": _ISSUER,
            "sub": "alice",
            "aud": _SERVER,
            "exp": _EXPIRES,
            "jti": f"token-{serial}",
            "cnf": {"jkt": _thumbprint(self._holder.public_key())},
            "act": act,
            "authorization_details": [
                {"type": operation, "limits": {limit.name: [limit.low, limit.high] for limit in limits}}
                for operation, limits in workload.numbers(depth, serial)
            ],
        }
        return str(self._jwt.encode(claims, self._root, algorithm="EdDSA"))

    def decide(self, token: Any, ask: Ask) -> Verdict:
        """The signature and claims, then the values."""
        claims = self._claims(token)
        return Verdict.REFUSED if claims is None else _compare(claims, ask)

    def _claims(self, token: str) -> dict[str, Any] | None:
        required = {"require": ["exp", "aud", "iss", "jti"]}
        try:
            claims: dict[str, Any] = self._jwt.decode(
                token, self._public, algorithms=["EdDSA"], audience=_SERVER, issuer=_ISSUER, options=required
            )
        except self._jwt.PyJWTError:
            return None
        return claims

    # --- with a proof ------------------------------------------------------------------------------------------------

    def prepare(self, workload: Workload, depth: int, calls: int) -> Prepared:
        """The cells of a bearer token, and one with a proof."""
        plain = super().prepare(workload, depth, calls)
        pool = [self.lend(workload, depth, next(self._serials)) for _ in range(calls)]
        good = Ask(workload.operation, workload.named(workload.values))
        outside = Ask(workload.operation, workload.named(workload.outside))

        def call(
            token: str, ask: Ask = good, key: Ed25519PrivateKey | None = None, over: Ask | None = None
        ) -> ActTokenCall:
            return ActTokenCall(token, self._prove(token, over or ask, key or self._holder), ask)

        def fresh() -> Iterator[ActTokenCall]:
            for token in pool:
                yield call(token)

        stranger = Ed25519PrivateKey.generate()
        wrong: dict[str, Callable[[], ActTokenCall]] = {
            "a value out of limits": lambda: call(pool[-1], outside),
            "a proof by another key": lambda: call(pool[-1], key=stranger),
            "a proof for another request": lambda: call(pool[-1], over=outside),
        }
        cell = Cell(
            TokenKey(self.name, workload.name, depth, Kind.COLD, proof=True),
            checks=self.checks + "; a DPoP proof over method, URL, token and body (not replay)",
            fresh=endless(fresh()),
            act=self._decide_proven,
            wrong=wrong,
        )
        return Prepared((*plain.cells, cell), plain.bytes)

    def _prove(self, token: str, ask: Ask, key: Ed25519PrivateKey) -> str:
        claims = {
            "jti": f"{next(self._proofs):022d}",
            "htm": "POST",
            "htu": _SERVER,
            "iat": 1_800_000_000,
            "ath": _digest(token.encode()),
            "bdg": _digest(_body(ask)),
        }
        header = {"typ": "dpop+jwt", "jwk": _jwk(key.public_key())}
        return str(self._jwt.encode(claims, key, algorithm="EdDSA", headers=header))

    def _decide_proven(self, call: ActTokenCall) -> Verdict:
        claims = self._claims(call.token)
        if claims is None:
            return Verdict.REFUSED
        try:
            jwk = self._jwt.get_unverified_header(call.proof)["jwk"]
            key = Ed25519PublicKey.from_public_bytes(_unb64(jwk["x"]))
            proof = self._jwt.decode(call.proof, key, algorithms=["EdDSA"], options={"verify_iat": False})
        except (self._jwt.PyJWTError, KeyError, ValueError):
            return Verdict.REFUSED
        wanted = {
            "htm": "POST",
            "htu": _SERVER,
            "ath": _digest(call.token.encode()),
            "bdg": _digest(_body(call.ask)),
        }
        held = _thumbprint(key) == claims["cnf"]["jkt"] and all(proof.get(name) == wanted[name] for name in wanted)
        return _compare(claims, call.ask) if held else Verdict.REFUSED


def _compare(claims: dict[str, Any], ask: Ask) -> Verdict:
    for detail in claims["authorization_details"]:
        if detail["type"] == ask.operation:
            limits, arguments = detail["limits"], ask.arguments
            inside = limits.keys() == arguments.keys() and all(
                low <= arguments[name] <= high for name, (low, high) in limits.items()
            )
            return Verdict.ALLOWED if inside else Verdict.REFUSED
    return Verdict.REFUSED


def _body(ask: Ask) -> bytes:
    params = {"name": ask.operation, "arguments": ask.arguments}
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params}).encode()


def _jwk(key: Ed25519PublicKey) -> dict[str, str]:
    return {"crv": "Ed25519", "kty": "OKP", "x": _b64(key.public_bytes_raw())}


def _thumbprint(key: Ed25519PublicKey) -> str:
    return _digest(json.dumps(_jwk(key), separators=(",", ":")).encode())


def _digest(raw: bytes) -> str:
    return _b64(hashlib.sha256(raw).digest())


def _b64(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).rstrip(b"=").decode()


def _unb64(text: str) -> bytes:
    return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
