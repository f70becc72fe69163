"""Vectors made by others: Biscuit's samples and Wycheproof. They lie beside the checkout; where they are absent the tests skip."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path

import biscuit_auth
import pytest

from capabilities import jws, keys, wire
from capabilities.caps import DEFAULT
from capabilities.errors import CapabilityError, Fault, TokenError
from tests.capabilities.world import ROOT_ID, TRUST, check, raw_of
from dataclasses import replace

VECTORS = Path(__file__).parents[3] / "shared" / "data" / "vectors"
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


def test_no_biscuit_sample_is_a_token_of_this_profile():
    """Real Biscuits, signed by a root that we trust for the test, and none of them of the profile."""
    described = samples()
    trust = replace(TRUST, roots={ROOT_ID: bytes.fromhex(described["root_public_key"])})
    for case in described["testcases"]:
        raw = (BISCUIT.parent / case["filename"]).read_bytes()
        for token in (raw, b"\x08\x07" + raw):
            assert isinstance(check(token, trust=trust), Fault), case["filename"]


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


def test_wycheproof_ed25519_all_151():
    """Each vector through the very path of our statements: key check, then signature."""
    seen = 0
    for group, case in wycheproof("ed25519_test.json"):
        raw = bytes.fromhex(group["publicKey"]["pk"])
        try:
            key = keys.public_key(raw)
            key.verify(bytes.fromhex(case["sig"]), bytes.fromhex(case["msg"]))
            accepted = True
        except Exception:
            accepted = False
        assert accepted == (case["result"] == "valid"), case
        seen += 1
    assert seen == 151


@pytest.mark.parametrize(
    "name", ["json_web_signature_test.json", "json_web_key_test.json", "json_web_crypto_test.json"]
)
def test_wycheproof_jose_nothing_of_another_algorithm_passes(name):
    """None of these vectors is signed with Ed25519, so every one of them must be refused, the valid ones included."""
    seen = 0
    for group, case in wycheproof(name):
        text = case.get("jws", case.get("jwe", ""))
        assert "EdDSA" not in json.dumps(group.get("public", group.get("private", {})))
        with pytest.raises(CapabilityError):
            jws.check(
                jws.split(text if isinstance(text, str) else json.dumps(text), most_bytes=10**6), raw_of("signer")
            )
        seen += 1
    assert seen > 20


def test_wycheproof_keys_are_no_keys_of_ours():
    for group, _ in wycheproof("json_web_key_test.json"):
        for candidate in [group.get("private"), group.get("public"), *(group.get("private") or {}).get("keys", [])]:
            with pytest.raises(CapabilityError):
                jws.key_of_jwk(candidate)
