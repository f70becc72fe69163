"""The one function that verifies, beside the libraries that it does not use."""

from __future__ import annotations

import jwt
import pytest
from capabilities.keys.signatures import P256_N, Checked
from capabilities.values.errors import BadKeyError, FaultCode, StatementError
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.capabilities.keys.test_keys import curve_of
from tests.capabilities.world import key_of

from capabilities.keys import jws, keys, signatures
from capabilities.values import strict_json

pytestmark = pytest.mark.clause("VAL-14")

SIGNERS = {"ed25519": key_of("signer"), "p256": curve_of("signer")}
each = pytest.mark.parametrize("key", SIGNERS.values(), ids=SIGNERS)


def test_the_answer_is_true_exactly_when_it_holds():
    assert (bool(Checked.HOLDS), bool(Checked.DOES_NOT_HOLD)) == (True, False)


@each
@given(message=st.binary(max_size=200))
@settings(max_examples=50)
def test_what_is_signed_holds_and_is_always_the_same(key, message):
    signature = signatures.sign(key, message)
    assert signature == signatures.sign(key, message)
    assert len(signature) == 64
    raw = keys.public_raw(key)
    assert signatures.verify(raw, message, signature) is Checked.HOLDS
    assert signatures.verify(raw, message + b"x", signature) is Checked.DOES_NOT_HOLD
    other = keys.public_raw(key_of("other") if len(raw) == 32 else curve_of("other"))
    assert signatures.verify(other, message, signature) is Checked.DOES_NOT_HOLD


@each
def test_every_flipped_bit_and_every_other_length_is_refused(key):
    raw, message = keys.public_raw(key), b"the message"
    signature = signatures.sign(key, message)
    for bit in range(512):
        mutant = (int.from_bytes(signature, "big") ^ 1 << bit).to_bytes(64, "big")
        assert signatures.verify(raw, message, mutant) is Checked.DOES_NOT_HOLD
    for other in (b"", signature[:-1], signature + b"\0", signature * 2, b"\0" + signature, bytes(64), b"\xff" * 64):
        assert signatures.verify(raw, message, other) is Checked.DOES_NOT_HOLD


@each
def test_the_border_between_signature_and_message_stays_where_it_is(key):
    """libsodium takes both in one piece: bytes of the message must not be passed as the end of the signature."""
    raw, message = keys.public_raw(key), b"the message"
    whole = signatures.sign(key, message) + message
    assert signatures.verify(raw, whole[64:], whole[:64]) is Checked.HOLDS
    for border in (0, 32, 63, *range(65, len(whole) + 1)):
        assert signatures.verify(raw, whole[border:], whole[:border]) is Checked.DOES_NOT_HOLD


@pytest.mark.clause("VAL-5", "VAL-14")
@pytest.mark.parametrize("raw", [b"", b"\1" * 31, bytes(32), b"\4" * 33, b"\2" + b"\xff" * 32, None, "x" * 32])
def test_nothing_is_verified_with_a_bad_key(raw):
    with pytest.raises(BadKeyError) as caught:
        signatures.verify(raw, b"message", bytes(64))
    assert caught.value.code is FaultCode.KEY_MALFORMED


def test_the_higher_s_holds_for_openssl_and_not_for_us():
    """r with n - s verifies under the same key, so anyone could make a second spelling of a statement."""
    key, message = SIGNERS["p256"], b"the message"
    signature = signatures.sign(key, message)
    r, s = int.from_bytes(signature[:32], "big"), int.from_bytes(signature[32:], "big")
    assert s <= P256_N // 2
    key.public_key().verify(utils.encode_dss_signature(r, P256_N - s), message, ec.ECDSA(hashes.SHA256()))
    mirrored = signature[:32] + (P256_N - s).to_bytes(32, "big")
    assert signatures.verify(keys.public_raw(key), message, mirrored) is Checked.DOES_NOT_HOLD


def test_both_halves_of_s_occur_before_they_are_lowered():
    """So that the test above tests something: OpenSSL's own deterministic signatures have the higher s half the time."""
    algorithm = ec.ECDSA(hashes.SHA256(), deterministic_signing=True)
    raised = 0
    for n in range(64):
        message = b"%d" % n
        r, s = utils.decode_dss_signature(SIGNERS["p256"].sign(message, algorithm))
        raised += s > P256_N // 2
        assert signatures.sign(SIGNERS["p256"], message) == r.to_bytes(32, "big") + min(s, P256_N - s).to_bytes(
            32, "big"
        )
    assert 8 < raised < 56


@given(st.binary(min_size=64, max_size=64), st.booleans(), st.integers(0, 511))
def test_libsodium_and_openssl_agree_on_ed25519(noise, real, bit):
    """Random and nearly right signatures under a key of large order: no answer differs."""
    key, message = key_of("signer"), b"message"
    signature = noise
    if real:
        signature = (int.from_bytes(key.sign(message), "big") ^ 1 << bit).to_bytes(64, "big")
    try:
        key.public_key().verify(signature, message)
        expected = Checked.HOLDS
    except InvalidSignature:
        expected = Checked.DOES_NOT_HOLD
    assert signatures.verify(keys.public_raw(key), message, signature) is expected


# --- JWS -------------------------------------------------------------------------------------------------------------------

ALGORITHMS = {"ed25519": "EdDSA", "p256": "ES256"}


@pytest.mark.clause(reason="others read what we write")
@pytest.mark.parametrize("name", SIGNERS)
def test_pyjwt_reads_what_we_write(name):
    key = SIGNERS[name]
    text = jws.sign({"typ": "x"}, b'{"a":1}', key)
    read = jwt.PyJWS().decode_complete(text, key.public_key(), algorithms=[ALGORITHMS[name]])
    assert (read["payload"], read["header"]) == (b'{"a":1}', {"alg": ALGORITHMS[name], "typ": "x"})
    assert jws.check(jws.split(text, most_bytes=10**4), keys.public_raw(key)) == b'{"a":1}'
    assert jws.sign({"typ": "x"}, b'{"a":1}', key) == text


@pytest.mark.parametrize("name", SIGNERS)
def test_the_key_fixes_the_algorithm(name):
    """A header that names the other algorithm is refused, though the key signed exactly these bytes."""
    key, wrong = SIGNERS[name], ALGORITHMS["p256" if name == "ed25519" else "ed25519"]
    head = keys.b64u(strict_json.canonical({"alg": wrong, "typ": "x"}))
    signed = f"{head}.{keys.b64u(b'{}')}"
    text = f"{signed}.{keys.b64u(signatures.sign(key, signed.encode()))}"
    with pytest.raises(StatementError) as caught:
        jws.check(jws.split(text, most_bytes=10**4), keys.public_raw(key))
    assert caught.value.code is FaultCode.STATEMENT_UNTRUSTED
    for other in ("none", "HS256", "ES384", "ES256K", "Ed25519", "es256", None, 5, ["ES256"]):
        head = keys.b64u(strict_json.canonical({"alg": other, "typ": "x"}))
        with pytest.raises(StatementError) as caught:
            jws.split(f"{head}.{keys.b64u(b'{}')}.{keys.b64u(bytes(64))}", most_bytes=10**4)
        assert caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("VAL-14", "STM-1")
def test_a_statement_with_the_higher_s_is_refused():
    key = SIGNERS["p256"]
    text = jws.sign({"typ": "x"}, b"{}", key)
    head, payload, spelled = text.split(".")
    signature = keys.unb64u(spelled)
    mirrored = signature[:32] + (P256_N - int.from_bytes(signature[32:], "big")).to_bytes(32, "big")
    second = f"{head}.{payload}.{keys.b64u(mirrored)}"
    jwt.PyJWS().decode_complete(second, key.public_key(), algorithms=["ES256"])  # another reader takes it
    with pytest.raises(StatementError) as caught:
        jws.check(jws.split(second, most_bytes=10**4), keys.public_raw(key))
    assert caught.value.code is FaultCode.STATEMENT_UNTRUSTED
