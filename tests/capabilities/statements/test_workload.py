"""Workload tokens: one platform, its own keys with their own algorithms, one audience, a few minutes, one key."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import jwt
import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError, FaultCode, ScopeError, StatementError
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import ISSUER, NOW, key_of, raw_of

from capabilities.keys import keys
from capabilities.statements import workload
from capabilities.values import text

DOMAIN = "cell.example"
PLATFORM_KEY = key_of("platform")
CURVE_KEY = ec.generate_private_key(ec.SECP256R1())
AGENT = keys.thumbprint(raw_of("robotic"))
SAID = workload.Workload(f"spiffe://{DOMAIN}/robotic", ISSUER, AGENT, b"\2" * 32, NOW, NOW + 300)


def b64(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).rstrip(b"=").decode()


def curve_jwk(key=CURVE_KEY, **more) -> dict:
    numbers = key.public_key().public_numbers()
    x, y = (b64(n.to_bytes(32, "big")) for n in (numbers.x, numbers.y))
    return {"kty": "EC", "crv": "P-256", "x": x, "y": y, "kid": "curve"} | more


def edwards_jwk(**more) -> dict:
    return {"kty": "OKP", "crv": "Ed25519", "x": b64(raw_of("platform")), "kid": "edwards"} | more


def jwks(*members) -> bytes:
    return json.dumps({"keys": list(members)}).encode()


PLATFORM = workload.Platform(DOMAIN, workload.key_set(jwks(edwards_jwk(), curve_jwk()))[0])
CLAIMS = {
    "sub": SAID.id, "aud": ISSUER, "exp": NOW + 300, "iat": NOW, "cnf": {"jkt": AGENT}, "measurement": "02" * 32,
}  # fmt: skip


def made(claims=None, *, key=PLATFORM_KEY, alg="EdDSA", header=None, payload=None) -> str:
    """A token as a third party's library makes it."""
    members = {"typ": "JWT", "kid": "edwards" if alg == "EdDSA" else "curve"} | (header or {})
    members = {name: value for name, value in members.items() if value is not None}
    raw = json.dumps(CLAIMS if claims is None else claims).encode() if payload is None else payload
    return jwt.PyJWS().encode(raw, key, algorithm=alg, headers=members)


def opened(token, *, at=NOW, audience=ISSUER, platform=PLATFORM):
    return workload.open(token, platform, audience=audience, at=at, caps=DEFAULT)


def refused(token, **how) -> FaultCode:
    with pytest.raises(StatementError) as caught:
        opened(token, **how)
    return caught.value.code


@pytest.mark.clause("WLD-1", "WLD-3")
def test_what_is_signed_is_what_is_read():
    ours = workload.Platform(DOMAIN, workload.key_set(workload.jwks(raw_of("platform")))[0])
    assert opened(workload.sign(SAID, PLATFORM_KEY), platform=ours) == SAID
    assert opened(made()) == SAID
    assert opened(made(key=CURVE_KEY, alg="ES256")) == SAID
    assert opened(made(CLAIMS | {"aud": [ISSUER], "iss": f"spiffe://{DOMAIN}", "nbf": NOW, "jti": "x"})) == replace(
        SAID, token_id="x"
    )
    assert opened(made(header={"typ": None})) == SAID


@pytest.mark.clause("WLD-2")
def test_the_algorithm_is_the_keys_not_the_headers():
    assert refused(made(key=CURVE_KEY, alg="ES256", header={"kid": "edwards"})) is FaultCode.STATEMENT_UNTRUSTED
    assert refused(made(header={"kid": "curve"})) is FaultCode.STATEMENT_UNTRUSTED
    # A public key taken for a secret, and no signature at all.
    with_secret = made(key=raw_of("platform"), alg="HS256", header={"kid": "edwards"})
    assert refused(with_secret) is FaultCode.STATEMENT_UNTRUSTED
    assert refused(made(key=None, alg="none", header={"kid": "edwards"})) is FaultCode.STATEMENT_UNTRUSTED
    head, body, _ = made().split(".")
    assert refused(f"{head}.{body}.") is FaultCode.STATEMENT_UNTRUSTED
    assert refused(f"{head}.{body}.{b64(bytes(64))}") is FaultCode.STATEMENT_UNTRUSTED
    big = rsa.generate_private_key(65537, 2048)
    assert refused(made(key=big, alg="RS256", header={"kid": "curve"})) is FaultCode.STATEMENT_UNTRUSTED


@pytest.mark.clause("WLD-1", "WLD-2")
def test_no_header_member_brings_a_key():
    mallory = Ed25519PrivateKey.generate()
    own = edwards_jwk(x=b64(keys.public_raw(mallory)))
    for member in (
        {"jwk": own},
        {"jku": "http://127.0.0.1/jwks"},
        {"x5u": "x"},
        {"x5c": ["x"]},
        {"crit": ["b64"]},
        {"b64": False},
    ):
        assert refused(made(key=mallory, header=member)) is FaultCode.STATEMENT_MALFORMED, member
        assert refused(made(header=member)) is FaultCode.STATEMENT_MALFORMED, member
    assert refused(made(key=mallory)) is FaultCode.STATEMENT_UNTRUSTED
    assert refused(made(key=mallory, header={"kid": "another"})) is FaultCode.STATEMENT_UNTRUSTED
    assert refused(made(header={"kid": None})) is FaultCode.STATEMENT_MALFORMED
    assert refused(made(header={"typ": "ztpm-attestation+jwt"})) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("WLD-3", "WLD-4")
@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"sub": "spiffe://other.example/robotic"}, FaultCode.STATEMENT_UNTRUSTED),
        ({"sub": f"spiffe://{DOMAIN}.evil.example/robotic"}, FaultCode.STATEMENT_UNTRUSTED),
        ({"iss": "spiffe://other.example"}, FaultCode.STATEMENT_UNTRUSTED),
        ({"iss": None}, FaultCode.STATEMENT_UNTRUSTED),
        ({"sub": "robotic"}, FaultCode.STATEMENT_MALFORMED),
        ({"sub": f"spiffe://{DOMAIN}/../robotic"}, FaultCode.STATEMENT_MALFORMED),
        ({"sub": [SAID.id]}, FaultCode.STATEMENT_MALFORMED),
        ({"aud": ISSUER + "/other"}, FaultCode.WRONG_AUDIENCE),
        ({"aud": [ISSUER, "http://127.0.0.1/other"]}, FaultCode.WRONG_AUDIENCE),
        ({"aud": []}, FaultCode.WRONG_AUDIENCE),
        ({"aud": {ISSUER: 1}}, FaultCode.WRONG_AUDIENCE),
        ({"exp": NOW}, FaultCode.EXPIRED),
        ({"exp": NOW - 1, "iat": NOW - 100}, FaultCode.EXPIRED),
        ({"exp": NOW + 301}, FaultCode.LIFETIME_TOO_LONG),
        ({"exp": NOW + 86_400, "iat": NOW}, FaultCode.LIFETIME_TOO_LONG),
        ({"exp": NOW + 200, "iat": NOW - 101}, FaultCode.LIFETIME_TOO_LONG),
        ({"iat": NOW + 6, "exp": NOW + 100}, FaultCode.NOT_YET_VALID),
        ({"nbf": NOW + 1}, FaultCode.NOT_YET_VALID),
        ({"exp": float(NOW + 300)}, FaultCode.STATEMENT_MALFORMED),
        ({"exp": str(NOW + 300)}, FaultCode.STATEMENT_MALFORMED),
        ({"exp": True}, FaultCode.STATEMENT_MALFORMED),
        ({"iat": -1}, FaultCode.STATEMENT_MALFORMED),
        ({"cnf": {"jkt": AGENT[:-1]}}, FaultCode.STATEMENT_MALFORMED),
        ({"cnf": {"jkt": AGENT, "kid": "x"}}, FaultCode.STATEMENT_MALFORMED),
        ({"cnf": {"jwk": {}}}, FaultCode.STATEMENT_MALFORMED),
        ({"cnf": AGENT}, FaultCode.STATEMENT_MALFORMED),
        ({"measurement": "02" * 31}, FaultCode.STATEMENT_MALFORMED),
        ({"measurement": "AB" * 32}, FaultCode.STATEMENT_MALFORMED),
        ({"admin": True}, FaultCode.STATEMENT_MALFORMED),
    ],
)  # fmt: skip
def test_each_claim_has_one_form(changes, code):
    assert refused(made(CLAIMS | changes)) is code
    assert opened(made()) == SAID


@pytest.mark.clause("WLD-3")
@pytest.mark.parametrize("missing", sorted(CLAIMS))
def test_no_claim_may_be_absent(missing):
    assert refused(made({k: v for k, v in CLAIMS.items() if k != missing})) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("WLD-4")
def test_times_at_their_edges():
    assert opened(made(), at=NOW + 299.9) == SAID
    assert refused(made(), at=NOW + 300) is FaultCode.EXPIRED
    assert opened(made(), at=NOW - 5) == SAID
    assert refused(made(), at=NOW - 5.1) is FaultCode.NOT_YET_VALID
    for at in (float("nan"), float("inf"), float("-inf")):
        assert refused(made(), at=at) in {FaultCode.EXPIRED, FaultCode.NOT_YET_VALID}


@pytest.mark.clause("WLD-1")
def test_two_readers_never_see_two_tokens():
    head, body, signature = made().split(".")
    for text_ in (
        f"{head}.{body}.{signature}=",
        f"{head}.{body}.{signature[:-1]}{chr(ord(signature[-1]) + 1)}",
        f"{head}.{body}\n.{signature}",
        f"{head}.{body}.{signature}.{signature}",
        f"{head}.{body}",
        "",
        "..",
        "a" * 5_000,
    ):
        assert refused(text_) in {FaultCode.STATEMENT_MALFORMED, FaultCode.STATEMENT_UNTRUSTED}
    doubled = json.dumps(CLAIMS)[:-1] + f', "sub": "spiffe://{DOMAIN}/vision"}}'
    assert refused(made(payload=doubled.encode())) is FaultCode.STATEMENT_MALFORMED
    assert refused(made(payload=b"[" * 900)) is FaultCode.STATEMENT_MALFORMED
    assert refused(made(payload=b'{"sub": NaN}')) is FaultCode.STATEMENT_MALFORMED
    assert refused(made(CLAIMS | {"jti": "x" * 2_000})) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("WLD-2")
@given(at=st.integers(0, 10_000), flip=st.integers(0, 7))
def test_no_flipped_bit_passes(at, flip):
    token = made().encode()
    raw = bytearray(token)
    raw[at % len(raw)] ^= 1 << flip
    if bytes(raw) != token:
        with pytest.raises(StatementError):
            opened(raw.decode("latin-1"))


@pytest.mark.clause("WLD-1")
def test_a_token_with_the_longest_names_fits_and_so_does_the_evidence_around_it():
    from capabilities.statements import attestation

    name = f"spiffe://{DOMAIN}/" + "w" * (text.WORKLOAD_BYTES - len(f"spiffe://{DOMAIN}/"))
    audience = "http://127.0.0.1/" + "a" * (256 - len("http://127.0.0.1/"))
    token = made(CLAIMS | {"sub": name, "aud": audience}, header={"kid": "edwards"})
    assert opened(token, audience=audience).id == name
    padded = made(CLAIMS | {"jti": "x" * ((2_048 - len(made())) * 3 // 4 - 14)})
    assert 2_040 <= len(padded) <= 2_048
    evidence = attestation.Evidence("a" * 63, AGENT, "n" * 64, "d" * 63, bytes(32), bytes(32), NOW, padded)
    signed = attestation.sign(evidence, key_of("robotic"))
    assert len(signed) <= 4_096, "the identity provider takes evidence of at most 4096 characters"
    assert attestation.open(signed, {raw_of("robotic")}, DEFAULT) == evidence


@pytest.mark.clause("WLD-2")
def test_key_sets():
    assert set(PLATFORM.keys) == {"edwards", "curve"}
    assert PLATFORM.all_keys == {raw_of("platform"), keys.public_raw(CURVE_KEY)}
    spiffe = json.dumps({"keys": [curve_jwk(use="jwt-svid")], "spiffe_sequence": 1, "spiffe_refresh_hint": 60})
    assert workload.key_set(spiffe.encode())[0]["curve"].algorithm == "ES256"
    rest = [
        curve_jwk(use="x509-svid", kid="cert"),
        {"kty": "RSA", "n": "AQAB", "e": "AQAB", "kid": "rsa"},
        curve_jwk(crv="P-384", kid="large"),
        curve_jwk(use="enc", kid="enc"),
    ]
    for n, other in enumerate(rest):
        usable, others = workload.key_set(b"\xef\xbb\xbf" + jwks(other, edwards_jwk()))
        assert set(usable) == {"edwards"} and len(others) == 1 and others[0].startswith("keys[0]: "), n
    usable, others = workload.key_set(jwks(*rest, edwards_jwk()))
    assert set(usable) == {"edwards"} and len(others) == len(rest)
    with pytest.raises(CapabilityError):
        workload.key_set(jwks(edwards_jwk(), curve_jwk(use="x509-svid", d=b64(bytes(32)))))
    off_curve = curve_jwk()
    off_curve["y"] = b64((CURVE_KEY.public_key().public_numbers().y ^ 1).to_bytes(32, "big"))
    point = b64((1).to_bytes(32, "little"))
    for raw, code in [
        (b"", FaultCode.STATEMENT_MALFORMED),
        (b"{}", FaultCode.STATEMENT_MALFORMED),
        (jwks(), FaultCode.STATEMENT_MALFORMED),
        (jwks(*(edwards_jwk(kid=str(n)) for n in range(17))), FaultCode.STATEMENT_MALFORMED),
        (b" " * 20_000, FaultCode.STATEMENT_MALFORMED),
        (b'{"keys":[],"keys":[]}', FaultCode.STATEMENT_MALFORMED),
        (jwks(edwards_jwk(), edwards_jwk(kid="again")), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(), curve_jwk(kid="edwards")), FaultCode.KEY_MALFORMED),
        (jwks("text"), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(kty=["OKP"])), FaultCode.KEY_MALFORMED),
        (jwks({k: v for k, v in edwards_jwk().items() if k != "kid"}), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(kid="")), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(kid="new\nline")), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(kid=1)), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(d=b64(bytes(32)))), FaultCode.KEY_MALFORMED),
        (jwks(curve_jwk(d=b64(bytes(32)))), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(x=point)), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(x=b64(bytes(31)))), FaultCode.KEY_MALFORMED),
        (jwks(off_curve), FaultCode.KEY_MALFORMED),
        (jwks(curve_jwk(crv="P-384")), FaultCode.KEY_MALFORMED),
        (jwks({"kty": "oct", "k": "AAAA", "kid": "x"}), FaultCode.KEY_MALFORMED),
        (jwks({"kty": "RSA", "n": "AQAB", "e": "AQAB", "kid": "x"}), FaultCode.KEY_MALFORMED),
        (jwks(edwards_jwk(use="enc")), FaultCode.KEY_WRONG_ROLE),
        (jwks(edwards_jwk(use=["sig"])), FaultCode.KEY_WRONG_ROLE),
        (jwks(edwards_jwk(key_ops=["sign"])), FaultCode.KEY_WRONG_ROLE),
        (jwks(edwards_jwk(alg="ES256")), FaultCode.KEY_WRONG_ROLE),
        (jwks(curve_jwk(alg="EdDSA")), FaultCode.KEY_WRONG_ROLE),
    ]:
        with pytest.raises(CapabilityError) as caught:
            workload.key_set(raw)
        assert caught.value.code is code, raw


@pytest.mark.clause("WLD-3")
@pytest.mark.parametrize("name", ["", "Cell", "cell/example", "cell example", "x" * 256, "cell\n"])
def test_what_is_no_trust_domain(name):
    with pytest.raises(StatementError):
        replace(PLATFORM, trust_domain=name)


@pytest.mark.clause("WLD-3")
@pytest.mark.parametrize(
    "name",
    ["", "spiffe://cell", "spiffe://cell/", "spiffe://cell//a", "spiffe://cell/a/", "spiffe://cell/./a", "spiffe://cell/a/..",
     "spiffe://Cell/a", "http://cell/a", "spiffe://cell:1/a", "spiffe://u@cell/a", "spiffe://cell/a?b", "spiffe://cell/a%20b",
     "spiffe://cell/ä", "spiffe://cell/a\n", "spiffe://cell/" + "a" * 256, 5, None],
)  # fmt: skip
def test_what_is_no_workload_id(name):
    with pytest.raises(ScopeError):
        text.workload_id(name)
    assert text.workload_id("spiffe://cell/a.b/..c") == "spiffe://cell/a.b/..c"
