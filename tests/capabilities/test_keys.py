"""Keys, their spelling, their files, and the bundle of trust."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from cryptography.hazmat.primitives import serialization as form
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from hypothesis import given
from hypothesis import strategies as st

from capabilities import keys
from capabilities.errors import BadKeyError, CapabilityError, FaultCode
from tests.capabilities.world import TRUST, key_of, raw_of

P = 2**255 - 19


def test_the_rfc_8037_thumbprint():
    raw = keys.unb64u("11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo")
    assert keys.thumbprint(raw) == "kPrK_qmxVWaYVA9wwBF6Iuo3vVzz7TxHCTwXBygrS4k"  # RFC 8037 appendix A.3


@given(st.binary(max_size=80))
def test_base64url_comes_back(raw):
    assert keys.unb64u(keys.b64u(raw)) == raw


@pytest.mark.parametrize(
    "text", ["=", "AA==", "AA=", "A", "AB", "AAB", "A A", "AA\n", "AA+/", "ä", "AAAA=", "\0\0\0\0", "AA.A"]
)
def test_other_spellings_are_refused(text):
    with pytest.raises(BadKeyError) as caught:
        keys.unb64u(text)
    assert caught.value.code is FaultCode.KEY_MALFORMED


def torsion() -> list[int]:
    """The y of all points of small order, found by adding: the multiples of a point of order eight."""
    d = -121665 * pow(121666, -1, P) % P

    def add(a, b):
        (x1, y1), (x2, y2) = a, b
        k = d * x1 * x2 * y1 * y2
        return (x1 * y2 + x2 * y1) * pow(1 + k, -1, P) % P, (y1 * y2 + x1 * x2) * pow(1 - k, -1, P) % P

    y = keys._ORDER_EIGHT_Y  # noqa: SLF001
    square = (y * y - 1) * pow(d * y * y + 1, -1, P) % P
    x = pow(square, (P + 3) // 8, P)
    x = x if (x * x - square) % P == 0 else x * pow(2, (P - 1) // 4, P) % P
    points = [(0, 1)]
    for _ in range(8):
        points.append(add(points[-1], (x, y)))
    assert points[8] == (0, 1)
    assert len(set(points)) == 8
    return [found for _, found in points[:8]]


def test_keys_of_small_order_and_other_encodings_are_refused():
    encodings = {y | sign << 255 for y in (*torsion(), P, P + 1) for sign in (0, 1)}
    encodings |= {(y + P) for y in range(19)} | {2**255 - 1, 2**256 - 1}
    for encoding in encodings:
        with pytest.raises(BadKeyError):
            keys.check_raw(encoding.to_bytes(32, "little"))
    for bad in (b"", b"\1" * 31, b"\1" * 33, "x" * 32, None, bytearray(32), 5):
        with pytest.raises(BadKeyError):
            keys.check_raw(bad)


def test_why_small_order_matters():
    """OpenSSL verifies this signature, made by nobody, under the identity point; we never get that far."""
    identity = (1).to_bytes(32, "little")
    Ed25519PublicKey.from_public_bytes(identity).verify(identity + bytes(32), b"any message")
    with pytest.raises(BadKeyError):
        keys.public_key(identity)


def test_a_key_file_comes_back_only_with_its_passphrase():
    key = key_of("someone")
    pem = keys.to_pem(key, b"open sesame")
    assert b"ENCRYPTED" in pem
    assert keys.public_raw(keys.from_pem(pem, b"open sesame")) == raw_of("someone")
    plain = key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption())
    other = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.BestAvailableEncryption(b"open sesame")
    )
    for bad, passphrase in (
        (pem, b"wrong"),
        (pem, b""),
        (plain, b"open sesame"),
        (other, b"open sesame"),
        (b"", b"x"),
        (b"junk", b"x"),
    ):
        with pytest.raises(BadKeyError) as caught:
            keys.from_pem(bad, passphrase)
        assert caught.value.code is FaultCode.KEY_MALFORMED
    with pytest.raises(BadKeyError):
        keys.to_pem(key, b"")


def test_generated_keys_differ():
    assert keys.public_raw(keys.generate()) != keys.public_raw(keys.generate())


def test_a_bundle_comes_back_in_one_spelling():
    wire = TRUST.to_json()
    assert keys.TrustBundle.from_json(wire) == TRUST
    assert keys.TrustBundle.from_json(wire).to_json() == wire
    with pytest.raises(TypeError):
        TRUST.roots[9] = b""


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"attesters": frozenset()}, FaultCode.KEY_MALFORMED),
        ({"feed": frozenset()}, FaultCode.KEY_MALFORMED),
        ({"roots": {}}, FaultCode.KEY_MALFORMED),
        ({"attesters": frozenset({raw_of("root")})}, FaultCode.KEY_WRONG_ROLE),
        ({"feed": frozenset({raw_of("ledger")})}, FaultCode.KEY_WRONG_ROLE),
        ({"roots": {1: raw_of("root"), 2: raw_of("root")}}, FaultCode.KEY_WRONG_ROLE),
        ({"ledger": frozenset({bytes(32)})}, FaultCode.KEY_MALFORMED),
        ({"issuer": ""}, FaultCode.KEY_MALFORMED),
        ({"issuer": "idp"}, FaultCode.KEY_MALFORMED),
        ({"version": -1}, FaultCode.KEY_MALFORMED),
        ({"roots": {-1: raw_of("root")}}, FaultCode.KEY_MALFORMED),
        ({"roots": {2**32: raw_of("root")}}, FaultCode.KEY_MALFORMED),
    ],
)
def test_a_bad_bundle_is_refused(change, code):
    with pytest.raises(BadKeyError) as caught:
        replace(TRUST, **change)
    assert caught.value.code is code


def test_a_bad_bundle_file_is_refused():
    good = json.loads(TRUST.to_json())
    changes = [
        {"extra": 1},
        {"roots": []},
        {"roots": {"07": good["roots"]["7"]}},
        {"roots": {"x": good["roots"]["7"]}},
        {"roots": {"7": 5}},
        {"version": "1"},
        {"version": True},
        {"version": 1.0},
        {"issuer": 1},
        {"feed": good["feed"] * 2},
        {"feed": good["feed"][0]},
        {"feed": [good["feed"][0] + "="]},
        {"feed": [None]},
    ]
    for change in changes:
        with pytest.raises(CapabilityError):
            keys.TrustBundle.from_json(json.dumps({**good, **change}).encode())
    for raw in (
        b"",
        b"null",
        b"[]",
        b"\xff",
        TRUST.to_json()[:-1],
        TRUST.to_json().replace(b'"feed"', b'"feed":[],"feed"', 1),
    ):
        with pytest.raises(CapabilityError):
            keys.TrustBundle.from_json(raw)
