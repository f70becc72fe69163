"""Encryption for browsers agrees with the example of RFC 8291, and the word to a push service with RFC 8292."""

from __future__ import annotations

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from tests.ztpm_idp.push.push_service import opened
from ztpm_idp.push.encryption import (
    PADDED_BYTES,
    SAID_S,
    authorization,
    encrypt,
    public_point,
    raw_point,
    signing_key,
)

from capabilities.keys.keys import unb64u

pytestmark = pytest.mark.clause("PSH-8")
TEXT = b"When I grow up, I want to be a watermelon"
BROWSER_KEY = unb64u("BCVxsr7N_eNgVRqvHtD0zTZsEc6-VV-JvLexhqUzORcxaOzi6-AYWXvTBHm4bjyPjs7Vd8pZGH6SRpkNtoIAiw4")
BROWSER_PRIVATE = unb64u("q1dXpw3UpT5VOmu_cf_v6ih07Aems3njxI-JWgLcM94")
EPHEMERAL = unb64u("yfWPiYE-n46HLnH0KqZOF1fJJU3MYrct3AELtAQ-oRw")
SALT, SECRET = unb64u("DGv6ra1nlYgDCS1FRnbzlw"), unb64u("BTBZMqHH6r4Tts7J_aSIgg")
SEALED = unb64u(
    "DGv6ra1nlYgDCS1FRnbzlwAAEABBBP4z9KsN6nGRTbVYI_c7VJSPQTBtkgcy27mlmlMoZIIgDll6e3vCYLocInmYWAmS6TlzAC8wEqKK6PBru3jl"
    "7A_yl95bQpu6cVPTpK4Mqgkf1CXztLVBSt2Ks3oZwbuwXPXLWyouBWLVWGNWQexSgSxsj_Qulcy4a-fN"
)
"""Section 5 of RFC 8291."""
ENDPOINT = "https://push.example:8443/w/abc"


def private(raw):
    return ec.derive_private_key(int.from_bytes(raw, "big"), ec.SECP256R1())


def sealed(text, **changes):
    stated = {"key": BROWSER_KEY, "secret": SECRET, "ephemeral": private(EPHEMERAL), "salt": SALT}
    return encrypt(text, **(stated | changes))


def test_the_example_of_the_rfc_is_made_byte_for_byte():
    assert raw_point(private(BROWSER_PRIVATE).public_key()) == BROWSER_KEY
    assert sealed(TEXT, padded_bytes=0) == SEALED


def test_a_browser_reads_it_and_its_length_says_nothing():
    browser = private(BROWSER_PRIVATE)
    short, long = sealed(b"a"), sealed(b"b" * PADDED_BYTES)
    assert len(short) == len(long)
    assert opened(short, browser, SECRET) == b"a"
    assert opened(long, browser, SECRET) == b"b" * PADDED_BYTES
    with pytest.raises(ValueError, match="record"):
        sealed(b"c" * 4_096)


@pytest.mark.parametrize("raw", [b"", b"\x04" * 65, b"\x02" + bytes(32), BROWSER_KEY[:-1], b"\x05" + BROWSER_KEY[1:]])
def test_what_is_no_point_is_refused(raw):
    with pytest.raises(ValueError, match=r"point|curve|key"):
        public_point(raw)


def test_the_word_to_a_push_service_names_its_origin_and_the_contact_for_an_hour():
    key = signing_key(b"s" * 32)
    scheme, _, words = authorization(ENDPOINT, contact="mailto:a@b.example", key=key, at_s=1_800_000_000).partition(" ")
    said = dict(each.strip().split("=", 1) for each in words.split(","))
    assert (scheme, said.keys()) == ("vapid", {"t", "k"})
    told = jwt.decode(
        said["t"], public_point(unb64u(said["k"])), ["ES256"], audience="https://push.example:8443",
        options={"verify_exp": False},
    )  # fmt: skip
    assert told == {"aud": "https://push.example:8443", "exp": 1_800_000_000 + SAID_S, "sub": "mailto:a@b.example"}


def test_all_workers_of_a_store_have_one_key_and_other_stores_another():
    numbers = {signing_key(each).private_numbers().private_value for each in (b"a" * 32, b"a" * 32, b"b" * 32)}
    assert len(numbers) == 2
