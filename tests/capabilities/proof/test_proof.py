"""Proofs of possession: one request, one key, one moment, one spelling."""

from __future__ import annotations

import json

import pytest
from capabilities.proof.proof import Proof, check_proof, prove
from capabilities.token.token_text import token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import CELL, NOW, OTHER_CELL, chain_of_four, key_of, raw_of

from capabilities.keys import jws, keys
from capabilities.values import strict_json

TOKEN = token_to_text(chain_of_four())
BODY = b'{"jsonrpc":"2.0"}'
JTI = "jti-0123456789abcdef"
HOLDER = key_of("gripper")


def made(**other: object) -> str:
    return prove(
        **{"key": HOLDER, "method": "POST", "url": CELL, "body": BODY, "token": TOKEN, "at": NOW, "jti": JTI, **other}
    )


def checked(proof: str, **other: object) -> Proof | Fault:
    expected = {
        "key": raw_of("gripper"),
        "method": "POST",
        "url": CELL,
        "body": BODY,
        "token": TOKEN,
        "at": NOW,
        "caps": DEFAULT,
    }
    return check_proof(proof, **{**expected, **other})


def found(proof: str, **other: object) -> tuple[FaultCode, str]:
    fault = checked(proof, **other)
    assert isinstance(fault, Fault), fault
    return fault.code, fault.clause


@pytest.mark.clause("PRF-4", "PRF-5")
def test_a_proof_holds_for_its_request():
    proof = checked(made())
    assert isinstance(proof, Proof)
    assert (proof.jti, proof.iat, proof.key, len(proof.digest)) == (JTI, NOW, raw_of("gripper"), 32)
    assert checked(made(), key=None) == proof
    assert isinstance(checked(made(token=None), token=None), Proof)


@pytest.mark.clause("PRF-4", "PRF-5")
@pytest.mark.parametrize(
    ("other", "clause"),
    [
        ({"method": "GET"}, "PRF-4"),
        ({"method": "post"}, "PRF-4"),
        ({"url": OTHER_CELL}, "PRF-4"),
        ({"url": CELL + "/"}, "PRF-4"),
        ({"url": CELL + "?x"}, "PRF-4"),
        ({"body": b""}, "PRF-4"),
        ({"body": BODY + b" "}, "PRF-4"),
        ({"token": TOKEN[:-1]}, "PRF-5"),
        ({"token": None}, "PRF-5"),
    ],
)
def test_a_proof_holds_for_no_other_request(other, clause):
    assert found(made(), **other) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, clause)


@pytest.mark.clause("PRF-5")
def test_a_proof_without_token_does_not_carry_one():
    assert found(made(token=None)) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-5")


@pytest.mark.clause("PRF-3", "TOK-10")
def test_another_key():
    assert found(made(key=key_of("eve"))) == (FaultCode.PROOF_WRONG_KEY, "PRF-3")
    assert checked(made(key=key_of("eve")), key=None).key == raw_of("eve")


@pytest.mark.clause("PRF-6")
@pytest.mark.parametrize("age", [31, 30.001, -5.001, -6, 1e12, float("nan"), float("inf"), float("-inf")])
def test_stale(age):
    assert found(made(), at=NOW + age) == (FaultCode.PROOF_STALE, "PRF-6")


@pytest.mark.clause("PRF-6")
@pytest.mark.parametrize("age", [30, 0, 0.5, -5])
def test_fresh(age):
    assert isinstance(checked(made(), at=NOW + age), Proof)


CLAIMS = {
    "jti": JTI,
    "htm": "POST",
    "htu": CELL,
    "iat": NOW,
    "bdg": json.loads(jws.split(made(), most_bytes=4096).payload_raw)["bdg"],
    "ath": json.loads(jws.split(made(), most_bytes=4096).payload_raw)["ath"],
}
HEADER = {"typ": "dpop+jwt", "jwk": jws.jwk(raw_of("gripper"))}


def built(claims: object = CLAIMS, header: dict = HEADER, payload: bytes | None = None) -> str:
    return jws.sign(header, json.dumps(claims).encode() if payload is None else payload, HOLDER)


@pytest.mark.clause(reason="the builder of the tests below")
def test_the_builder_makes_good_proofs():
    assert isinstance(checked(built()), Proof)


@pytest.mark.clause("PRF-2")
@pytest.mark.parametrize("claim", sorted(CLAIMS))
def test_each_claim_is_needed(claim):
    code, _ = found(built({name: value for name, value in CLAIMS.items() if name != claim}))
    assert code in {FaultCode.PROOF_MALFORMED, FaultCode.PROOF_NOT_FOR_THIS_REQUEST}


@pytest.mark.clause("PRF-2", "PRF-4")
@pytest.mark.parametrize("claim", sorted(CLAIMS))
@pytest.mark.parametrize("value", [None, True, 0, -1, "", "x", [], {}, ["POST"], {"a": 1}])
def test_each_claim_has_one_value(claim, value):
    code, _ = found(built({**CLAIMS, claim: value}))
    assert code in {FaultCode.PROOF_MALFORMED, FaultCode.PROOF_NOT_FOR_THIS_REQUEST, FaultCode.PROOF_STALE}


@pytest.mark.clause("PRF-2")
@pytest.mark.parametrize("extra", ["exp", "nbf", "nonce", "aud", "x"])
def test_no_other_claim(extra):
    assert found(built({**CLAIMS, extra: 1})) == (FaultCode.PROOF_MALFORMED, "PRF-2")


@pytest.mark.clause("PRF-2")
@pytest.mark.parametrize("jti", ["short", "x" * 65, "with space 0123456", "ümlaut-0123456789", "a" * 16 + "\n"])
def test_form_of_the_id(jti):
    assert found(built({**CLAIMS, "jti": jti})) == (FaultCode.PROOF_MALFORMED, "PRF-2")


@pytest.mark.clause("PRF-2")
@pytest.mark.parametrize("iat", [1.5, True, "1800000000", None, 2**53])
def test_form_of_the_time(iat):
    code, _ = found(built({**CLAIMS, "iat": iat}))
    assert code is FaultCode.PROOF_MALFORMED


@pytest.mark.clause("PRF-2", "PRF-3")
@pytest.mark.parametrize(
    "change",
    [
        {"typ": "jwt"},
        {"typ": "DPOP+JWT"},
        {"typ": None},
        {"kid": "x"},
        {"jku": "http://evil.example/keys"},
        {"x5u": "http://evil.example/cert"},
        {"x5c": ["MII"]},
        {"crit": ["exp"]},
        {"b64": False, "crit": ["b64"]},
        {"zip": "DEF"},
        {"jwk": None},
        {"jwk": {}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "d": "AAAA"}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "crv": "X25519"}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "kty": "EC"}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "x": 1}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "use": "enc"}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "key_ops": ["sign"]}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "key_ops": ["verify", "sign"]}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "alg": "ES256"}},
        {"jwk": {"kty": "oct", "k": keys.b64u(raw_of("gripper"))}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "x": keys.b64u(bytes(32))}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "x": keys.b64u(raw_of("gripper")) + "="}},
        {"jwk": {**jws.jwk(raw_of("gripper")), "x": keys.b64u(raw_of("gripper")[:31])}},
    ],
)
def test_the_header_is_closed_and_chooses_nothing(change):
    for key in (None, raw_of("gripper")):
        fault = checked(built(header={**HEADER, **change}), key=key)
        assert isinstance(fault, Fault)
        assert fault.code is FaultCode.PROOF_MALFORMED


def recoded(header: dict, payload: bytes, signature: bytes) -> str:
    return ".".join(keys.b64u(part) for part in (json.dumps(header).encode(), payload, signature))


@pytest.mark.clause("PRF-1")
@pytest.mark.parametrize(
    "alg", ["none", "None", "HS256", "ES256", "RS256", "eddsa", "Ed25519", "EdDSA ", "", None, 1, ["EdDSA"]]
)
def test_the_algorithm_is_fixed(alg):
    signature = keys.unb64u(made().split(".")[2])
    payload = strict_json.canonical(CLAIMS)
    for mac in (b"", signature, bytes(64)):
        assert found(recoded({"alg": alg, **HEADER}, payload, mac))[0] is FaultCode.PROOF_MALFORMED


@pytest.mark.clause("PRF-1", "PRF-3")
def test_a_mac_under_the_public_key_is_no_signature():
    """CVE-2022-29217 and its relatives: every encoding of the public key offered as a symmetric secret."""
    import hashlib  # noqa: PLC0415
    import hmac  # noqa: PLC0415

    from cryptography.hazmat.primitives import serialization as form  # noqa: PLC0415

    public = HOLDER.public_key()
    secrets = [
        public.public_bytes_raw(),
        public.public_bytes(form.Encoding.PEM, form.PublicFormat.SubjectPublicKeyInfo),
        public.public_bytes(form.Encoding.DER, form.PublicFormat.SubjectPublicKeyInfo),
        public.public_bytes(form.Encoding.OpenSSH, form.PublicFormat.OpenSSH),
        json.dumps(jws.jwk(raw_of("gripper"))).encode(),
    ]
    for alg in ("HS256", "EdDSA"):
        signed = ".".join(
            keys.b64u(part) for part in (json.dumps({"alg": alg, **HEADER}).encode(), strict_json.canonical(CLAIMS))
        )
        for secret in secrets:
            mac = hmac.digest(secret, signed.encode(), hashlib.sha256)
            for signature in (mac, mac + mac):
                assert isinstance(checked(f"{signed}.{keys.b64u(signature)}"), Fault)


@pytest.mark.clause("PRF-1")
@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"null",
        b"[]",
        b"{",
        b"\xff",
        b'{"jti":1}{"jti":2}',
        json.dumps(CLAIMS).replace('"iat"', '"htm": "POST", "iat"').encode(),  # a member twice
        json.dumps({**CLAIMS, "iat": float("nan")}).encode(),
        json.dumps(CLAIMS).encode("utf-16"),
        b"\xef\xbb\xbf" + json.dumps(CLAIMS).encode(),
        b"[" * 5_000,
        b'{"a":' * 400 + b"1" + b"}" * 400,
        json.dumps(CLAIMS).replace(str(NOW), "1" * 3_000).encode(),
    ],
)
def test_the_payload_has_one_meaning(payload):
    text = built(payload=payload)
    fault = checked(text)
    assert isinstance(fault, Fault)
    assert fault.code is FaultCode.PROOF_MALFORMED


@pytest.mark.clause("PRF-1")
def test_a_proof_has_one_spelling():
    proof = made()
    head, payload, signature = proof.split(".")
    others = [
        "",
        ".",
        "..",
        "...",
        proof + ".",
        "." + proof,
        proof + "=",
        f"{head}=.{payload}.{signature}",
        f"{head}.{payload}=.{signature}",
        proof + " ",
        " " + proof,
        proof + "\n",
        f"{head}.{payload}",
        f"{head}.{payload}.",
        f"{head}..{signature}",
        proof + "A",
        proof.replace("-", "+").replace("_", "/") if set("-_") & set(proof) else proof + "+",
        "ä" + proof,
        f'{{"protected":"{head}","payload":"{payload}","signature":"{signature}"}}',
        proof + "A" * 5_000,
    ]
    for other in others:
        assert isinstance(checked(other), Fault), other
    assert found("")[0] is FaultCode.PROOF_MISSING
    last = signature[-1]
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    for spare in alphabet:  # two characters share the bits that count, one of them is canonical
        if spare != last:
            assert isinstance(checked(proof[:-1] + spare), Fault)


@pytest.mark.clause("PRF-1", "PRF-3")
@given(st.integers(0, len(made()) - 1), st.integers(0, 127))
def test_no_mutant_is_accepted(at, character):
    proof = made()
    mutant = proof[:at] + chr(character) + proof[at + 1 :]
    if mutant != proof:
        assert isinstance(checked(mutant), Fault)


@pytest.mark.clause("PRF-3")
def test_the_signature_must_be_the_low_one():
    """S + L is another signature of the same message in lax implementations (RFC 8032 section 5.1.7 forbids it)."""
    head, payload, signature = made().split(".")
    raw = keys.unb64u(signature)
    order = 2**252 + 27_742_317_777_372_353_535_851_937_790_883_648_493
    high = raw[:32] + (int.from_bytes(raw[32:], "little") + order).to_bytes(32, "little")
    assert found(f"{head}.{payload}.{keys.b64u(high)}") == (FaultCode.PROOF_WRONG_KEY, "PRF-3")
