"""Keys of both algorithms, their spelling and their files."""

from __future__ import annotations

import pytest
from capabilities.values.errors import BadKeyError, FaultCode
from cryptography.hazmat.primitives import serialization as form
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import key_of, raw_of

from capabilities.keys import jws, keys

P = 2**255 - 19


@pytest.mark.clause("VAL-5")
def test_the_rfc_8037_thumbprint():
    raw = keys.unb64u("11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo")
    assert keys.thumbprint(raw) == "kPrK_qmxVWaYVA9wwBF6Iuo3vVzz7TxHCTwXBygrS4k"  # RFC 8037 appendix A.3


@pytest.mark.clause("VAL-6")
@given(st.binary(max_size=80))
def test_base64url_comes_back(raw):
    assert keys.unb64u(keys.b64u(raw)) == raw


@pytest.mark.clause("VAL-6")
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


@pytest.mark.clause("VAL-5")
def test_keys_of_small_order_and_other_encodings_are_refused():
    encodings = {y | sign << 255 for y in (*torsion(), P, P + 1) for sign in (0, 1)}
    encodings |= {(y + P) for y in range(19)} | {2**255 - 1, 2**256 - 1}
    for encoding in encodings:
        with pytest.raises(BadKeyError):
            keys.check_raw(encoding.to_bytes(32, "little"))
    for bad in (b"", b"\1" * 31, b"\1" * 33, b"\2" * 34, "x" * 32, None, bytearray(32), 5):
        with pytest.raises(BadKeyError):
            keys.check_raw(bad)


@pytest.mark.clause("VAL-5")
def test_why_small_order_matters():
    """OpenSSL verifies this signature, made by nobody, under the identity point; we never get that far."""
    identity = (1).to_bytes(32, "little")
    Ed25519PublicKey.from_public_bytes(identity).verify(identity + bytes(32), b"any message")
    with pytest.raises(BadKeyError):
        keys.public_key(identity)


@pytest.mark.clause(reason="how private keys lie on a disk is no matter of the wire")
def test_a_key_file_comes_back_only_with_its_passphrase():
    key = key_of("someone")
    pem = keys.to_pem(key, b"open sesame")
    assert b"ENCRYPTED" in pem
    assert keys.public_raw(keys.from_pem(pem, b"open sesame")) == raw_of("someone")
    plain = key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption())
    other = ec.generate_private_key(ec.SECP384R1()).private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.BestAvailableEncryption(b"open sesame")
    )
    exchange = X25519PrivateKey.generate().private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.BestAvailableEncryption(b"open sesame")
    )
    for bad, passphrase in (
        (pem, b"wrong"),
        (pem, b""),
        (plain, b"open sesame"),
        (other, b"open sesame"),
        (exchange, b"open sesame"),
        (b"", b"x"),
        (b"junk", b"x"),
    ):
        with pytest.raises(BadKeyError) as caught:
            keys.from_pem(bad, passphrase)
        assert caught.value.code is FaultCode.KEY_MALFORMED
    with pytest.raises(BadKeyError):
        keys.to_pem(key, b"")


@pytest.mark.clause(reason="where private keys come from is no matter of the wire")
def test_generated_keys_differ():
    assert keys.public_raw(keys.generate()) != keys.public_raw(keys.generate())


# --- P-256 -----------------------------------------------------------------------------------------------------------------


def curve_of(name: str) -> ec.EllipticCurvePrivateKey:
    return ec.derive_private_key(int.from_bytes(key_of(name).private_bytes_raw(), "big"), ec.SECP256R1())


CURVE = curve_of("someone")
RAW = keys.public_raw(CURVE)
B = 0x5AC635D8AA3A93E7B3EBBD55769886BC651D06B0CC53B0F63BCE3C3E27D2604B
"""SP 800-186 section 3.2.1.3."""


def on_curve(x: int) -> bool:
    """Euler's criterion, by hand: what OpenSSL says is checked against arithmetic."""
    square = (x**3 - 3 * x + B) % keys.P256_P
    return pow(square, (keys.P256_P - 1) // 2, keys.P256_P) == 1


@pytest.mark.clause("VAL-5")
def test_the_thumbprint_of_the_p256_key_of_rfc_7515():
    """RFC 7515 appendix A.3.1; the thumbprint of its minimal JWK by RFC 7638 section 3, spelled out."""
    import hashlib  # noqa: PLC0415

    x, y = "f83OJ3D2xF1Bg8vub9tLe1gHMzV76e8Tus9uPHvRVEU", "x_FEzRu9m36HLN_tue659LNpXW6pCyStikYjKIWI5a0"
    raw = jws.key_of_jwk({"kty": "EC", "crv": "P-256", "x": x, "y": y})
    assert raw == b"\2" + keys.unb64u(x) or raw == b"\3" + keys.unb64u(x)
    assert jws.jwk(raw) == {"kty": "EC", "crv": "P-256", "x": x, "y": y}
    minimal = '{"crv":"P-256","kty":"EC","x":"%s","y":"%s"}' % (x, y)
    assert keys.thumbprint(raw) == keys.b64u(hashlib.sha256(minimal.encode()).digest())


@pytest.mark.clause("VAL-5")
def test_a_p256_key_has_one_raw_form():
    uncompressed = CURVE.public_key().public_bytes(form.Encoding.X962, form.PublicFormat.UncompressedPoint)
    x = RAW[1:]
    assert (len(RAW), RAW[0]) == (33, 2 + (uncompressed[-1] & 1))
    assert keys.check_raw(RAW) == RAW
    bad = [
        uncompressed,
        *(bytes([first]) + x for first in range(256) if first not in (2, 3)),
        *(first + (keys.P256_P + more).to_bytes(32, "big") for first in (b"\2", b"\3") for more in range(6)),
        b"\2" + b"\xff" * 32,
        RAW + b"\0",
        RAW[:-2],
    ]
    for raw in bad:
        with pytest.raises(BadKeyError) as caught:
            keys.check_raw(raw)
        assert caught.value.code is FaultCode.KEY_MALFORMED


@pytest.mark.clause("VAL-5")
@given(st.integers(0, keys.P256_P - 1), st.sampled_from([b"\2", b"\3"]))
def test_a_point_is_on_the_curve(x, sign):
    raw = sign + x.to_bytes(32, "big")
    try:
        accepted = keys.check_raw(raw) == raw
    except BadKeyError:
        accepted = False
    assert accepted == on_curve(x)
    if accepted:
        left, y = (int.from_bytes(part, "big") for part in keys.p256_coordinates(raw))
        assert (left, y & 1) == (x, raw[0] & 1)
        assert (y * y - x**3 + 3 * x - B) % keys.P256_P == 0


@pytest.mark.clause("VAL-5")
def test_a_jwk_names_a_point_by_both_coordinates():
    good = jws.jwk(RAW)
    assert jws.key_of_jwk({**good, "use": "sig", "key_ops": ["verify"], "alg": "ES256", "kid": "x"}) == RAW
    y = int.from_bytes(keys.unb64u(good["y"]), "big")
    for change in (
        {"y": keys.b64u((y ^ 1).to_bytes(32, "big"))},
        {"y": keys.b64u((y ^ 2).to_bytes(32, "big"))},
        {"y": keys.b64u(b"\0" + y.to_bytes(32, "big"))},
        {"y": ""},
        {"y": None},
        {"x": good["y"], "y": good["x"]},
        {"x": keys.b64u((keys.P256_P + 1).to_bytes(32, "big"))},
        {"crv": "P-384"},
        {"crv": "Ed25519"},
        {"kty": "OKP"},
        {"d": good["x"]},
    ):
        with pytest.raises(BadKeyError) as caught:
            jws.key_of_jwk({**good, **change})
        assert caught.value.code is FaultCode.KEY_MALFORMED
    for change in (
        {"use": "enc"},
        {"key_ops": ["sign"]},
        {"key_ops": ["verify", "sign"]},
        {"alg": "EdDSA"},
        {"alg": 5},
    ):
        with pytest.raises(BadKeyError) as caught:
            jws.key_of_jwk({**good, **change})
        assert caught.value.code is FaultCode.KEY_WRONG_ROLE
    edwards = jws.jwk(raw_of("someone"))
    for change in ({"x": keys.b64u(RAW)}, {"y": good["y"]}, {"crv": "P-256"}, {"kty": "EC"}, {"kty": 5}, {"kty": []}):
        with pytest.raises(BadKeyError):
            jws.key_of_jwk({**edwards, **change})


@pytest.mark.clause("VAL-5")
def test_no_two_keys_share_a_thumbprint():
    opposite = bytes([RAW[0] ^ 1]) + RAW[1:]
    raws = [RAW, opposite, raw_of("someone"), raw_of("other"), keys.public_raw(curve_of("other"))]
    assert len({keys.thumbprint(raw) for raw in raws}) == len(raws)
    for raw in (b"", b"\1" * 31, b"\2" + b"\xff" * 32):
        with pytest.raises(BadKeyError):
            keys.thumbprint(raw)


@pytest.mark.clause("VAL-5")
def test_keys_of_other_curves_enter_nowhere():
    from capabilities.keys import signatures  # noqa: PLC0415

    for curve in (ec.SECP384R1(), ec.SECP256K1()):
        other = ec.generate_private_key(curve)
        for use in (
            lambda: keys.public_raw(other),
            lambda: keys.public_raw(other.public_key()),
            lambda: keys.to_pem(other, b"secret"),
            lambda: signatures.sign(other, b"message"),
            lambda: jws.sign({"typ": "x"}, b"{}", other),
        ):
            with pytest.raises(BadKeyError) as caught:
                use()
            assert caught.value.code is FaultCode.KEY_MALFORMED


@pytest.mark.clause(reason="how private keys lie on a disk is no matter of the wire")
def test_a_p256_key_file_comes_back():
    assert keys.public_raw(keys.from_pem(keys.to_pem(CURVE, b"open sesame"), b"open sesame")) == RAW
    assert keys.public_raw(keys.generate(keys.Algorithm.P256)) != keys.public_raw(keys.generate(keys.Algorithm.P256))
    assert keys.algorithm_of(keys.public_raw(keys.generate(keys.Algorithm.P256))) is keys.Algorithm.P256
