"""X25519 and HKDF under the session: RFC vectors, weak keys, and a transcript that tells every value apart."""

from __future__ import annotations

from tests.shared_data import SHARED
import hashlib
import hmac
import json
from dataclasses import fields, replace

import pytest
from capabilities.proof.key_agreement import SessionKeys, Transcript, agree, derive, public_of
from capabilities.values.errors import BadKeyError, FaultCode
from hypothesis import given, settings
from hypothesis import strategies as st

pytestmark = pytest.mark.clause("SES-3")

P = 2**255 - 19
BASE = bytes([9]) + bytes(31)
WYCHEPROOF = SHARED / "vectors" / "wycheproof" / "x25519_test.json"


def u(number: int) -> bytes:
    return number.to_bytes(32, "little")


def test_rfc_7748_section_5_2():
    scalar = bytes.fromhex("a546e36bf0527c9d3b16154b82465edd62144c0ac1fc5a18506a2244ba449ac4")
    point = bytes.fromhex("e6db6867583030db3594c1a424b15f7c726624ec26b3353b10a903a6d0ab1c4c")
    assert agree(scalar, point).hex() == "c3da55379de9c6908e94ea4df28d084f32eccf03491c71f754b4075577a28552"


def test_rfc_7748_section_5_2_iterated():
    k, point = BASE, BASE
    for turn in range(1_000):
        # The intermediate points are canonical or not; the RFC masks the top bit and reduces, we take one spelling.
        k, point = agree(k, u((int.from_bytes(point, "little") & (2**255 - 1)) % P)), k
        if turn == 0:
            assert k.hex() == "422c8e7a6227d7bca1350b3e2bb7279f7897b87bb6854b783c60e80311ae3079"
    assert k.hex() == "684cf59ba83309552800ef566f2f4d3c1c3887c49360e3875f2eb94d99532c51"


def test_rfc_7748_section_6_1():
    alice = bytes.fromhex("77076d0a7318a57d3c16c17251b26645df4c2f87ebc0992ab177fba51db92c2a")
    bob = bytes.fromhex("5dab087e624a8a4b79e17f8b83800ee66f3bb1292618b6fd1c2f8b27ff88e0eb")
    assert public_of(alice).hex() == "8520f0098930a754748b7ddcb43ef75a0dbf3a0d26381af4eba4a98eaa9b4e6a"
    assert public_of(bob).hex() == "de9edb7d7b7dc1b4d35b61c2ece435373f8343c85b78674dadfc7e146f882b4f"
    secret = agree(alice, public_of(bob))
    assert secret == agree(bob, public_of(alice))
    assert secret.hex() == "4a5d9d5ba4ce2de1728e3bf480350f25e07e21c947d19e3376f09b3c1e161742"


@pytest.mark.shared
@pytest.mark.skipif(not WYCHEPROOF.is_file(), reason="Wycheproof's X25519 vectors are not beside this checkout")
def test_wycheproof():
    """Every canonical key gives the stated secret or, where that is zero, is refused; every other spelling is refused."""
    for group in json.loads(WYCHEPROOF.read_text())["testGroups"]:
        for case in group["tests"]:
            public, private = bytes.fromhex(case["public"]), bytes.fromhex(case["private"])
            shared = bytes.fromhex(case["shared"])
            if int.from_bytes(public, "little") >= P or not any(shared):
                with pytest.raises(BadKeyError):
                    agree(private, public)
            else:
                assert agree(private, public) == shared, case["tcId"]


ORDER_EIGHT = "e0eb7a7c3b41b8ae1656e3faf19fc46ada098deb9c32b1fd866205165f49b800"
ORDER_EIGHT_TOO = "5f9c95bca3508c24b1d0b1559c83ef5b04445cc4581c8e86d8224eddd09f1157"
LOW_ORDER = [u(0), u(1), bytes.fromhex(ORDER_EIGHT), bytes.fromhex(ORDER_EIGHT_TOO), u(P - 1)]


@pytest.mark.parametrize("public", LOW_ORDER, ids=lambda raw: raw.hex()[:8])
@pytest.mark.parametrize("private", [b"\1" * 32, b"\xff" * 32, bytes(32), hashlib.sha256(b"x").digest()])
def test_points_of_low_order(private, public):
    with pytest.raises(BadKeyError) as raised:
        agree(private, public)
    assert raised.value.code is FaultCode.KEY_MALFORMED


@pytest.mark.parametrize(
    "public",
    [
        b"", bytes(31), b"\1" * 31, b"\1" * 33, BASE + b"\0", u(P), u(P + 1), u(P + 9), u(2**255 - 1), u(2**255), u(2**255 + 9), u(2**256 - 1),
        *(bytes([*raw[:31], raw[31] | 0x80]) for raw in LOW_ORDER),
    ],
    ids=lambda raw: raw.hex()[:8] + str(len(raw)),
)  # fmt: skip
def test_a_key_has_one_spelling(public):
    with pytest.raises(BadKeyError) as raised:
        agree(b"\1" * 32, public)
    assert raised.value.code is FaultCode.KEY_MALFORMED


def test_the_greatest_key():
    assert agree(b"\1" * 32, u(P - 2)) == agree(b"\1" * 32, u(P - 2))


TRANSCRIPT = Transcript(
    audience="http://127.0.0.1:9000/mcp",
    token="t" * 43,
    proof=b"\1" * 32,
    holder_key=b"\2" * 32,
    verifier_key=b"\3" * 32,
    holder_public=b"\4" * 32,
    holder_nonce=b"\5" * 32,
    verifier_public=b"\6" * 32,
    verifier_nonce=b"\7" * 32,
    not_after=1_800_003_600,
)


def other(value: object) -> object:
    match value:
        case int():
            return value + 1
        case str():
            return value + "x"
        case _:
            return bytes([value[0] ^ 1]) + value[1:]


@pytest.mark.parametrize("name", [field.name for field in fields(Transcript)])
def test_each_value_makes_other_keys(name):
    changed = replace(TRANSCRIPT, **{name: other(getattr(TRANSCRIPT, name))})
    assert changed.digest() != TRANSCRIPT.digest()
    mine, theirs = derive(b"s" * 32, TRANSCRIPT), derive(b"s" * 32, changed)
    assert not {mine.to_verifier, mine.to_holder, mine.answer} & {theirs.to_verifier, theirs.to_holder, theirs.answer}


def test_values_cannot_flow_into_each_other():
    """Moved over a boundary, or the roles exchanged: another transcript."""
    moved = replace(TRANSCRIPT, audience=TRANSCRIPT.audience + "t", token=TRANSCRIPT.token[1:])
    keyless = replace(TRANSCRIPT, holder_key=TRANSCRIPT.holder_key + TRANSCRIPT.verifier_key, verifier_key=b"")
    turned = replace(
        TRANSCRIPT,
        holder_public=TRANSCRIPT.verifier_public,
        verifier_public=TRANSCRIPT.holder_public,
        holder_nonce=TRANSCRIPT.verifier_nonce,
        verifier_nonce=TRANSCRIPT.holder_nonce,
    )
    assert len({each.digest() for each in (TRANSCRIPT, moved, keyless, turned)}) == 4


def twin_keys(secret: bytes, transcript: Transcript) -> SessionKeys:
    """RFC 5869 and the spec's text once more, by hand."""
    image = b""
    for part in (
        b"ztpm-session/1", transcript.audience.encode(), transcript.token.encode(), transcript.proof, transcript.holder_key,
        transcript.verifier_key, transcript.holder_public, transcript.holder_nonce, transcript.verifier_public,
        transcript.verifier_nonce, transcript.not_after.to_bytes(8, "big"),
    ):  # fmt: skip
        image += len(part).to_bytes(4, "big") + part
    info = b"ztpm-session/1 keys" + hashlib.sha256(image).digest()
    prk = hmac.new(transcript.holder_nonce + transcript.verifier_nonce, secret, "sha256").digest()
    block, okm = b"", b""
    for counter in (1, 2, 3):
        block = hmac.new(prk, block + info + bytes([counter]), "sha256").digest()
        okm += block
    return SessionKeys(okm[:32], okm[32:64], okm[64:])


@settings(max_examples=50, deadline=None)
@given(st.binary(min_size=32, max_size=32), st.binary(max_size=40), st.integers(0, 2**53))
def test_the_keys_are_those_of_the_spec(secret, verifier_key, not_after):
    transcript = replace(TRANSCRIPT, verifier_key=verifier_key, not_after=not_after)
    assert derive(secret, transcript) == twin_keys(secret, transcript)


def test_a_direction_and_a_use_for_each_key_and_none_is_shown():
    keys = derive(b"s" * 32, TRANSCRIPT)
    assert len({keys.to_verifier, keys.to_holder, keys.answer}) == 3
    assert keys.to_holder.hex() not in repr(keys)
    assert repr(keys) == "SessionKeys()"
