"""A4: Wycheproof's vectors through our own functions, those that every proof and statement goes through."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from capabilities import CapabilityError
from capabilities.keys import jws, keys, signatures
from evaluation.harness.campaign import Campaign, Misses, Outcome, Settings, Skipped

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

ED25519: Final = "ed25519_test.json"
P256: Final = "ecdsa_secp256r1_sha256_p1363_test.json"
SIGNED: Final = "json_web_signature_test.json"
KEYS: Final = "json_web_key_test.json"
CRYPTO: Final = "json_web_crypto_test.json"
INVALID: Final = {ED25519: 63, P256: 89, SIGNED: 355, KEYS: 21, CRYPTO: 77}
"""Vectors of each file that nothing may accept; 605 in all."""
_OURS: Final = frozenset({"Ed25519", "P-256"})
"""Curves of which a valid vector must be accepted, or stand in `REFUSED` with its reason."""
_MOST_BYTES: Final = 10**6
_N: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
"""Order of P-256 (SP 800-186 section 3.2.1.3)."""
HIGHER_S: Final = "the higher of two s"

REFUSED: Final = {
    (SIGNED, 18): HIGHER_S,
    (CRYPTO, 18): HIGHER_S,
    (CRYPTO, 67): "a key to encrypt to",
}
"""Vectors that are valid elsewhere and refused here on purpose; and P-256 vectors whose s is the higher."""


@dataclass(slots=True)
class WycheproofTally:
    """Tally of one file.

    Attributes:
        seen, invalid: vectors, and the invalid ones among them.
        accepted, wrong: accepted vectors, and those among them that are not valid.
        listed: valid vectors that are refused for a reason that is listed.
        misses: vectors that were judged wrong.
    """

    seen: int = 0
    invalid: int = 0
    accepted: int = 0
    wrong: int = 0
    listed: int = 0
    misses: Misses = field(default_factory=Misses)

    def count(self, name: str, case: dict[str, Any], *, accepted: bool, why: str | None) -> None:
        """One vector: an invalid one must be refused, a valid one accepted or be refused for `why`."""
        self.seen += 1
        valid = case["result"] == "valid"
        self.invalid += case["result"] == "invalid"
        self.accepted += accepted
        if accepted and not valid:
            self.wrong += 1
            self.misses.add(f"{name} {case['tcId']} accepted")
        if valid and not accepted:
            self.listed += why is not None
            if why is None:
                self.misses.add(f"{name} {case['tcId']} refused")


def run(settings: Settings) -> Outcome | Skipped:
    """No invalid vector is accepted; every valid one of our two algorithms is, or is listed with a reason."""
    if settings.vectors is None:
        return Skipped("no vectors: give their directory with --vectors")
    found = tally(settings.vectors / "wycheproof", signatures.verify)
    misses = Misses()
    for name, one in found.items():
        for miss in one.misses.told():
            misses.add(miss)
        if one.invalid != INVALID[name]:
            misses.add(f"{name}: {one.invalid} invalid vectors, not {INVALID[name]}")
    every = found.values()
    return Outcome(
        sum(one.seen for one in every),
        {
            "invalid_accepted": sum(one.wrong for one in every),
            "invalid": sum(one.invalid for one in every),
            "accepted": sum(one.accepted for one in every),
            "valid_refused_with_reason": sum(one.listed for one in every),
        },
        misses.told(),
    )


def tally(folder: Path, verify: Callable[[bytes, bytes, bytes], object]) -> dict[str, WycheproofTally]:
    """Every file.

    Args:
        folder: with the five files.
        verify: true for a signature that holds: raw key, message, signature.
    """
    found = {name: WycheproofTally() for name in INVALID}
    for group, case in _cases(folder / ED25519):
        held = _holds(verify, bytes.fromhex(group["publicKey"]["pk"]), case)
        found[ED25519].count(ED25519, case, accepted=held, why=None)
    for group, case in _cases(folder / P256):
        point = bytes.fromhex(group["publicKey"]["uncompressed"])
        raw = bytes([2 + (point[-1] & 1)]) + point[1:33]
        found[P256].count(P256, case, accepted=_holds(verify, raw, case), why=_higher(verify, raw, case))
    for name in (SIGNED, CRYPTO):
        for group, case in _cases(folder / name):
            stated = group.get("public") or group.get("private") or {}
            # Of other algorithms we accept nothing at all; that is no fault of theirs or ours.
            why = REFUSED.get((name, case["tcId"])) if stated.get("crv") in _OURS else "another algorithm"
            found[name].count(name, case, accepted=_opens(stated, case), why=why)
    for group, case in _cases(folder / KEYS):
        found[KEYS].count(KEYS, case, accepted=_opens(_stated(group), case), why="a set of keys that are not all ours")
    return found


def _cases(file: Path) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    for group in json.loads(file.read_text("utf-8"))["testGroups"]:
        for case in group["tests"]:
            yield group, case


def _stated(group: dict[str, Any]) -> dict[str, Any]:
    return group.get("public") or group.get("private") or {}


def _holds(verify: Callable[[bytes, bytes, bytes], object], raw: bytes, case: dict[str, Any]) -> bool:
    try:
        return bool(verify(raw, bytes.fromhex(case["msg"]), bytes.fromhex(case["sig"])))
    except CapabilityError:
        return False


def _higher(verify: Callable[[bytes, bytes, bytes], object], raw: bytes, case: dict[str, Any]) -> str | None:
    """The reason, when the same signature with the lower s holds."""
    s = int(case["sig"][64:128] or "0", 16)
    if not _N // 2 < s < _N:
        return None
    lowered = case | {"sig": case["sig"][:64] + f"{_N - s:064x}"}
    return HIGHER_S if _holds(verify, raw, lowered) else None


def _opens(stated: dict[str, Any], case: dict[str, Any]) -> bool:
    """True where a JWS is accepted under every key that is stated, each read as a JWK."""
    text = case.get("jws", case.get("jwe", ""))
    try:
        unverified = jws.split(text if isinstance(text, str) else json.dumps(text), most_bytes=_MOST_BYTES)
        for candidate in stated.get("keys") or [stated]:
            jws.check(unverified, keys.check_raw(jws.key_of_jwk(candidate)))
    except CapabilityError:
        return False
    return True


CAMPAIGN: Final = Campaign("A4", "Wycheproof: Ed25519, P-256, JWS, JWK, JWC", "0 of 605 invalid accepted", run)
