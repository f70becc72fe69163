"""Two ways of reading a proof with one result.

Every defect comes singly, in the canonical spelling and in a free one.
"""

from __future__ import annotations

import json

import pytest
from capabilities.proof.proof import Proof, check_proof, prove, token_digest
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import CELL, NOW, key_of, raw_of

from capabilities.keys import jws, keys
from capabilities.proof import proof
from capabilities.values import strict_json

pytestmark = pytest.mark.clause("PRF-1", "PRF-2", "PRF-3")

HOLDER = key_of("gripper")
TOKEN = "dG9rZW4"
BODY = b'{"jsonrpc":"2.0"}'
JTI = "jti-0123456789abcdef"
CLAIMS = {
    "ath": token_digest(TOKEN),
    "htm": "POST",
    "htu": CELL,
    "iat": NOW,
    "jti": JTI,
}
CLAIMS["bdg"] = json.loads(
    jws.split(
        prove(HOLDER, method="POST", url=CELL, body=BODY, token=TOKEN, at=NOW, jti=JTI), most_bytes=4096
    ).payload_raw
)["bdg"]
HEADER = {"alg": "EdDSA", "jwk": jws.jwk(raw_of("gripper")), "typ": "dpop+jwt"}
EXPECTED = {
    "key": raw_of("gripper"),
    "method": "POST",
    "url": CELL,
    "body": BODY,
    "token": TOKEN,
    "at": NOW,
    "caps": DEFAULT,
}


def spelled(header: bytes, payload: bytes, *, key=HOLDER, tail: str = "") -> str:
    """A compact JWS of exactly these bytes, really signed."""
    signed = f"{keys.b64u(header)}.{keys.b64u(payload)}"
    return f"{signed}.{keys.b64u(key.sign(signed.encode()))}{tail}"


def canonical(claims: object = None, header: object = None, **other: object) -> str:
    return spelled(
        strict_json.canonical(HEADER if header is None else header),
        strict_json.canonical(CLAIMS if claims is None else claims),
        **other,
    )


def free(claims: object = None, header: object = None, **other: object) -> str:
    """The same with white space and turned members."""

    def turned(members: object) -> bytes:
        return json.dumps(dict(reversed(members.items())) if isinstance(members, dict) else members, indent=1).encode()

    return spelled(turned(HEADER if header is None else header), turned(CLAIMS if claims is None else claims), **other)


def both(text: str, **other: object) -> Proof | Fault:
    """The result, which is the same when only the strict way is there."""
    found = check_proof(text, **{**EXPECTED, **other})
    exact = proof._exact
    proof._exact = lambda *_: None
    try:
        assert check_proof(text, **{**EXPECTED, **other}) == found
    finally:
        proof._exact = exact
    return found


def code(found: Proof | Fault) -> tuple[FaultCode, str]:
    assert isinstance(found, Fault), found
    return found.code, found.clause


def test_both_spellings_hold_and_only_the_free_one_is_parsed(monkeypatch):
    assert isinstance(both(canonical()), Proof)
    assert isinstance(both(free()), Proof)
    assert both(prove(HOLDER, method="POST", url=CELL, body=BODY, token=TOKEN, at=NOW, jti=JTI)) == both(canonical())
    monkeypatch.setattr(proof, "_strict", lambda *_: pytest.fail("parsed"))
    assert isinstance(check_proof(canonical(), **EXPECTED), Proof)
    without = {name: value for name, value in CLAIMS.items() if name != "ath"}
    assert isinstance(check_proof(canonical(without), **{**EXPECTED, "token": None}), Proof)


WRONG_FORM = (FaultCode.PROOF_MALFORMED, "PRF-2")
OTHER = {
    "ath": (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-5"),
    "bdg": (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-4"),
    "htm": (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-4"),
    "htu": (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-4"),
    "iat": WRONG_FORM,
    "jti": WRONG_FORM,
}


@pytest.mark.parametrize("spell", [canonical, free])
@pytest.mark.parametrize("claim", sorted(CLAIMS))
class TestEachClaim:
    def test_missing(self, claim, spell):
        claims = {name: value for name, value in CLAIMS.items() if name != claim}
        assert code(both(spell(claims))) == (OTHER["ath"] if claim == "ath" else WRONG_FORM)

    @pytest.mark.parametrize("value", [None, True, False, [], {}, ["POST"], {"a": 1}])
    def test_of_another_type(self, claim, spell, value):
        assert code(both(spell({**CLAIMS, claim: value}))) == OTHER[claim]

    @pytest.mark.parametrize("value", ["", "x", "POST ", "post", CELL + "/", "A" * 43])
    def test_another_text(self, claim, spell, value):
        found = both(spell({**CLAIMS, claim: value}))
        if claim == "jti" and value == "A" * 43:
            assert isinstance(found, Proof)
        else:
            assert code(found) == OTHER[claim]

    def test_twice(self, claim, spell):
        """Equal or not, first or last: a member occurs once."""
        whole = json.dumps(CLAIMS, separators=(",", ":"), sort_keys=True)
        for value in (CLAIMS[claim], "x"):
            member = f"{json.dumps(claim)}:{json.dumps(value)}"
            for text in (f"{{{member},{whole[1:]}", f"{whole[:-1]},{member}}}"):
                head = strict_json.canonical(HEADER) if spell is canonical else json.dumps(HEADER).encode()
                assert code(both(spelled(head, text.encode()))) == (FaultCode.PROOF_MALFORMED, "PRF-1")

    def test_by_another_name(self, claim, spell):
        claims = {name if name != claim else name.upper(): value for name, value in CLAIMS.items()}
        assert code(both(spell(claims)))[0] is FaultCode.PROOF_MALFORMED


@pytest.mark.clause("PRF-2")
@pytest.mark.parametrize("spell", [canonical, free])
@pytest.mark.parametrize("name", ["exp", "nbf", "nonce", "aud", "cnf", "", "z"])
def test_one_claim_more(spell, name):
    assert code(both(spell({**CLAIMS, name: 1}))) == WRONG_FORM


@pytest.mark.clause("PRF-6")
@pytest.mark.parametrize(
    ("iat", "expected"),
    [
        (NOW + 5, None),
        (NOW + 6, (FaultCode.PROOF_STALE, "PRF-6")),
        (NOW - 30, None),
        (NOW - 31, (FaultCode.PROOF_STALE, "PRF-6")),
        (0, (FaultCode.PROOF_STALE, "PRF-6")),
        (-1, (FaultCode.PROOF_STALE, "PRF-6")),
        (10**15 - 1, (FaultCode.PROOF_STALE, "PRF-6")),
        (10**15, (FaultCode.PROOF_STALE, "PRF-6")),
        (2**53 - 1, (FaultCode.PROOF_STALE, "PRF-6")),
    ],
)
def test_times(iat, expected):
    found = both(canonical({**CLAIMS, "iat": iat}))
    assert isinstance(found, Proof) if expected is None else code(found) == expected


@pytest.mark.parametrize(
    "digits",
    [
        b"01800000000",
        b"+1800000000",
        b"1.8e9",
        b"1800000000.0",
        b"9007199254740992",
        b"1" * 400,
        b"1_0",
        "１８".encode(),
    ],
)
def test_spellings_of_a_number(digits):
    payload = strict_json.canonical(CLAIMS).replace(str(NOW).encode(), digits)
    assert code(both(spelled(strict_json.canonical(HEADER), payload))) == (FaultCode.PROOF_MALFORMED, "PRF-1")


def test_spellings_of_a_text_are_parsed_and_hold():
    """An escape is another spelling of the same text: no fast way, and no refusal either."""
    payload = strict_json.canonical(CLAIMS).replace(b"POST", b"\\u0050OST")
    assert isinstance(both(spelled(strict_json.canonical(HEADER), payload)), Proof)


@pytest.mark.parametrize("spell", [canonical, free])
def test_a_signature_by_another_key_under_the_holders_header(spell):
    assert code(both(spell(key=key_of("eve")))) == (FaultCode.PROOF_WRONG_KEY, "PRF-3")


@pytest.mark.parametrize("spell", [canonical, free])
def test_the_header_of_another_key(spell):
    other = {**HEADER, "jwk": jws.jwk(raw_of("eve"))}
    assert code(both(spell(header=other, key=key_of("eve")))) == (FaultCode.PROOF_WRONG_KEY, "PRF-3")
    assert isinstance(both(spell(header=other, key=key_of("eve")), key=raw_of("eve")), Proof)


@pytest.mark.parametrize("key", [b"", b"k", bytes(32), b"\2" * 33, b"k" * 64])
def test_an_expected_key_that_is_none(key):
    assert code(both(canonical(), key=key))[0] in {FaultCode.PROOF_WRONG_KEY, FaultCode.PROOF_MALFORMED}


def test_a_key_of_small_order_in_both_places():
    """Under it the zero signature would hold; the canonical header of it is no way around the check."""
    small = bytes([1]) + bytes(31)
    head, payload = strict_json.canonical({**HEADER, "jwk": jws.jwk(small)}), strict_json.canonical(CLAIMS)
    forged = ".".join(map(keys.b64u, (head, payload, small + bytes(32))))
    assert code(both(forged, key=small)) == (FaultCode.PROOF_MALFORMED, "PRF-3")


def test_one_body_more_than_a_part():
    for tail in (".", ".x", "=", " ", "A", "\n"):
        assert code(both(canonical(tail=tail)))[0] is FaultCode.PROOF_MALFORMED
    head, payload, signature = canonical().split(".")
    for size in (0, 63, 65, 128):
        assert code(both(f"{head}.{payload}.{keys.b64u(bytes(size))}")) == (FaultCode.PROOF_MALFORMED, "PRF-1")
    assert code(both(f"{head}.{payload}.{keys.b64u(bytes(64))}")) == (FaultCode.PROOF_WRONG_KEY, "PRF-3")
    assert code(both(f"{head}.{payload}")) == (FaultCode.PROOF_MALFORMED, "PRF-1")


@pytest.mark.clause("PRF-1")
def test_the_size_is_exact():
    from dataclasses import replace

    size = len(canonical())
    assert isinstance(both(canonical(), caps=replace(DEFAULT, proof_bytes=size)), Proof)
    assert code(both(canonical(), caps=replace(DEFAULT, proof_bytes=size - 1))) == (FaultCode.PROOF_MALFORMED, "PRF-1")


@pytest.mark.clause("PRF-4", "PRF-5")
@pytest.mark.parametrize("text", ["ä", '"', "\\", "\u2028", "\ud800", "a" * 300, "x\x00", "x\x7f"])
def test_strange_methods_addresses_and_tokens_are_compared_all_the_same(text):
    """They are the server's own, or text of a stranger; no exception, and no other text in their place."""
    assert code(both(canonical(), method=text))[0] is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    assert code(both(canonical(), url=text))[0] is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    assert code(both(canonical(), token=text)) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-5")
    if text.isprintable() or text == "\u2028":
        assert isinstance(both(canonical({**CLAIMS, "htm": text}), method=text), Proof)
        assert isinstance(both(canonical({**CLAIMS, "htu": text}), url=text), Proof)


VALUES = st.none() | st.booleans() | st.integers(-5, 5) | st.sampled_from(["POST", CELL, JTI, "x", "", "\x00", "ä"])


@given(
    claims=st.dictionaries(st.sampled_from([*CLAIMS, "exp"]), VALUES, max_size=2),
    dropped=st.sets(st.sampled_from(sorted(CLAIMS)), max_size=1),
    header=st.dictionaries(st.sampled_from(["alg", "typ", "jwk", "kid"]), VALUES, max_size=1),
    spell=st.sampled_from([canonical, free]),
    signer=st.sampled_from(["gripper", "eve"]),
    key=st.sampled_from([None, raw_of("gripper"), raw_of("eve")]),
    token=st.sampled_from([TOKEN, None, "x"]),
    at=st.sampled_from([NOW, NOW + 40, NOW - 6]),
)
def test_any_defects_together_have_one_result(claims, dropped, header, spell, signer, key, token, at):
    made = {name: value for name, value in {**CLAIMS, **claims}.items() if name not in dropped}
    found = both(spell(made, {**HEADER, **header}, key=key_of(signer)), key=key, token=token, at=at)
    wanted = {name: value for name, value in CLAIMS.items() if name != "ath" or token is not None}
    right = (
        made == wanted
        and token in {TOKEN, None}
        and {**HEADER, **header} == HEADER
        and signer == "gripper"
        and key != raw_of("eve")
    )
    assert isinstance(found, Proof) == (right and at == NOW)


@given(st.integers(0, len(canonical()) - 1), st.characters(), st.sampled_from(["replace", "insert", "cut", "delete"]))
def test_any_mutant_has_one_result_and_is_refused(at, character, how):
    text = canonical()
    mutant = {
        "replace": text[:at] + character + text[at + 1 :],
        "insert": text[:at] + character + text[at:],
        "cut": text[:at],
        "delete": text[:at] + text[at + 1 :],
    }[how]
    if mutant != text:
        assert isinstance(both(mutant), Fault)
