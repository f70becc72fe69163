"""Vectors made by others: Biscuit's samples and Wycheproof. They lie beside the checkout; where they are absent the tests skip."""

from __future__ import annotations

from tests.shared_data import SHARED
import json
from dataclasses import replace
from datetime import timedelta

import biscuit_auth
import pytest
from capabilities.keys import jws, keys, signatures
from capabilities.token import wire
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError, Fault, TokenError
from tests.capabilities.world import ROOT_ID, TRUST, check

VECTORS = SHARED / "vectors"
BISCUIT = VECTORS / "biscuit" / "samples.json"
WYCHEPROOF = VECTORS / "wycheproof"

pytestmark = [
    pytest.mark.shared,
    pytest.mark.skipif(not VECTORS.is_dir(), reason="the reference vectors are not beside this checkout"),
]


def samples() -> dict:
    return json.loads(BISCUIT.read_text())


def outcome(raw: bytes, root: biscuit_auth.PublicKey, code: str, *, extern: bool) -> tuple[str, int | None]:
    try:
        token = biscuit_auth.Biscuit.from_bytes(raw, root)
        builder = biscuit_auth.AuthorizerBuilder(code)
        limits = builder.limits()
        limits.max_time = timedelta(milliseconds=DEFAULT.datalog_ms)
        builder.set_limits(limits)
        if extern:
            builder.register_extern_func(
                "test",
                lambda left, right=None: (
                    left if right is None else ("equal strings" if left == right else "different strings")
                ),
            )
        return "Ok", builder.build(token).authorize()
    except Exception:
        return "Err", None


@pytest.mark.clause(reason="the library that signatures and Datalog come from")
def test_the_library_passes_all_fifty_biscuit_validations():
    described = samples()
    root = biscuit_auth.PublicKey("ed25519/" + described["root_public_key"])
    passed = 0
    for case in described["testcases"]:
        raw = (BISCUIT.parent / case["filename"]).read_bytes()
        for name, validation in case["validations"].items():
            got, policy = outcome(
                raw, root, validation["authorizer_code"], extern=case["filename"].startswith("test035")
            )
            assert got in validation["result"], (case["filename"], name)
            if got == "Ok":
                assert validation["result"]["Ok"] == policy
            passed += 1
    assert passed == 50


@pytest.mark.clause("TOK-2", "TOK-3", "TOK-6")
def test_no_biscuit_sample_is_a_token_of_this_profile():
    """Real Biscuits, signed by a root that we trust for the test, and none of them of the profile."""
    described = samples()
    trust = replace(TRUST, roots={ROOT_ID: bytes.fromhex(described["root_public_key"])})
    for case in described["testcases"]:
        raw = (BISCUIT.parent / case["filename"]).read_bytes()
        for token in (raw, b"\x08\x07" + raw):
            assert isinstance(check(token, trust=trust), Fault), case["filename"]


@pytest.mark.clause("TOK-2")
def test_the_wire_is_read_as_the_library_reads_it():
    described = samples()
    root = biscuit_auth.PublicKey("ed25519/" + described["root_public_key"])
    counted = 0
    for case in described["testcases"]:
        raw = (BISCUIT.parent / case["filename"]).read_bytes()
        try:
            token = biscuit_auth.Biscuit.from_bytes(raw, root)
            shape = wire.read(raw)
        except (TokenError, biscuit_auth.BiscuitValidationError):
            continue
        assert len(shape.blocks) == token.block_count()
        for signed, told in zip(shape.blocks, case["token"], strict=True):
            parts = wire.MESSAGES["Block"].FromString(signed.payload)
            statements = [line for line in told["code"].split("\n") if line]
            assert len(parts.checks) == sum(line.startswith(("check ", "reject ")) for line in statements), case[
                "filename"
            ]
            assert len(parts.rules) == sum(" <- " in line for line in statements), case["filename"]
        counted += 1
    assert counted > 30


def wycheproof(name: str) -> list[tuple[dict, dict]]:
    groups = json.loads((WYCHEPROOF / name).read_text())["testGroups"]
    return [(group, case) for group in groups for case in group["tests"]]


@pytest.mark.clause(reason="the library that signatures come from")
def test_wycheproof_ed25519_all_151():
    """Each vector through the one function that verifies."""
    seen = 0
    for group, case in wycheproof("ed25519_test.json"):
        assert holds(bytes.fromhex(group["publicKey"]["pk"]), case) == (case["result"] == "valid"), case
        seen += 1
    assert seen == 151


def holds(raw: bytes, case: dict) -> bool:
    try:
        return bool(signatures.verify(raw, bytes.fromhex(case["msg"]), bytes.fromhex(case["sig"])))
    except CapabilityError:
        return False


@pytest.mark.clause("VAL-14")
def test_wycheproof_p256_all_262():
    """Of the 173 valid vectors 70 have the higher s.

    Those are refused, and hold once s is lowered: nothing else is wrong.
    """
    accepted = raised = 0
    cases = wycheproof("ecdsa_secp256r1_sha256_p1363_test.json")
    for group, case in cases:
        point = bytes.fromhex(group["publicKey"]["uncompressed"])
        raw = keys.p256_raw(point[1:33], point[33:])
        s = int(case["sig"][64:] or "0", 16)
        if case["result"] == "valid" and s > signatures.P256_N // 2:
            assert not holds(raw, case), case
            raised += 1
            case = case | {"sig": case["sig"][:64] + f"{signatures.P256_N - s:064x}"}
        assert holds(raw, case) == (case["result"] == "valid"), case
        accepted += case["result"] == "valid"
    assert (len(cases), accepted, raised) == (262, 173, 70)


JOSE = ("json_web_signature_test.json", "json_web_key_test.json", "json_web_crypto_test.json")
VALID_ELSEWHERE = {
    # file and vector, P-256 or Ed25519, valid, and refused here for the reason beside it
    (JOSE[0], 18): "higher s",
    (JOSE[2], 18): "higher s",
    (JOSE[2], 67): "a key to encrypt to",
}


@pytest.mark.clause("PRF-1", "PRF-3", "VAL-14")
@pytest.mark.parametrize("name", JOSE)
def test_wycheproof_jose(name):
    """0 invalid accepted; of the valid ones, those of our two algorithms, but for what is listed with its reason."""
    seen, accepted, refused = 0, [], set()
    for group, case in wycheproof(name):
        text = case.get("jws", case.get("jwe", ""))
        key = group.get("public") or group.get("private") or {}
        try:
            unverified = jws.split(text if isinstance(text, str) else json.dumps(text), most_bytes=10**6)
            for candidate in key.get("keys") or [key]:
                jws.check(unverified, jws.key_of_jwk(candidate))
        except CapabilityError:
            if case["result"] == "valid" and key.get("crv") in {"P-256", "Ed25519"}:
                refused.add((name, case["tcId"]))
        else:
            assert case["result"] == "valid", case
            accepted.append(case["tcId"])
        seen += 1
    assert seen > 20
    assert refused == {known for known in VALID_ELSEWHERE if known[0] == name}
    assert len(accepted) == (name == JOSE[0])


@pytest.mark.clause("PRF-3", "VAL-5")
def test_wycheproof_keys():
    """RSA, AES and MAC keys, wrong curves and uses, a point beside the curve are refused.

    One member of one set is a P-256 key.
    """
    found = []
    for group, case in wycheproof("json_web_key_test.json"):
        for stated in (group.get("private"), group.get("public")):
            for candidate in (stated, *(stated or {}).get("keys", [])):
                try:
                    found.append((case["tcId"], keys.algorithm_of(jws.key_of_jwk(candidate))))
                except CapabilityError:
                    continue
    assert found == [(1, keys.Algorithm.P256)]
