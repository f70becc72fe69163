"""Passkeys: an assertion counts for one relying party, one act and one key; every defect of it is refused."""

from __future__ import annotations

import dataclasses
import json

import pytest
from capabilities.statements.people.ask import Ask, Contributor
from capabilities.statements.people.assertion import (
    RelyingParty,
    Word,
    challenge,
    check,
    login_challenge,
    of_browser,
    relying_party,
)
from capabilities.statements.people.vote import Vote
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Unit
from cryptography.hazmat.primitives.asymmetric import utils
from msgspec import structs
from tests.authenticators import ATTESTED, PRESENT, VERIFIED, Authenticator

from capabilities.keys import keys, signatures
from capabilities.statements.people import passkey_vote
from capabilities.values import strict_json

PARTY = RelyingParty("idp.example", "https://idp.example:8443")
ISSUER = f"{PARTY.origin}/ztpm"
EXPECTED = challenge(Word.VOTE, {"a": 1})
BOTH = pytest.mark.parametrize("algorithm", list(keys.Algorithm))

ASK = Ask(
    ask_id="a" * 32, nonce="b" * 32, pep="cell-1", audience="http://127.0.0.1:8800/mcp", issuer=ISSUER,
    sponsor="alice", token_id="g" * 22, agent="mover", agent_key="k" * 43, object="ur3e", operation="move_joint",
    values=(Quantity("q0", Unit.MICRORADIAN, -1_570_796),), request_digest="1" * 64, start_urad=(0, 1, 2, 3, 4, -5),
    model_digest="2" * 64, policy_digest="3" * 64, scene_digest="4" * 64, tier=Tier(3), index_milli=2_640,
    reasons=("TIER_NEEDS_APPROVAL",), contributors=(Contributor("person-ssm", "forearm", "p1", 2_640, 412, 250, "cam"),),
    perception="fresh", perception_age_ms=38, approvers=1, opening_id="", asked_at=1_000, expires_at=1_100,
)  # fmt: skip
VOTE = Vote("a" * 32, "b" * 32, "c" * 64, "approve", "carol", sees_clear=False, uses=1, not_after=1_100, at=1_010)


def authenticator(algorithm=keys.Algorithm.P256) -> Authenticator:
    return Authenticator(PARTY, keys.generate(algorithm))


def refused(code, work, *args, **named):
    with pytest.raises(StatementError) as raised:
        work(*args, **named)
    assert raised.value.code is code


def checked(made, *, key, expected=EXPECTED, party=PARTY):
    check(made, expected=expected, party=party, key=key)


@BOTH
@pytest.mark.clause("PSK-5")
def test_an_assertion_over_the_challenge_holds(algorithm):
    held = authenticator(algorithm)
    checked(held.assertion(EXPECTED), key=held.key)


@BOTH
@pytest.mark.clause("PSK-3")
def test_what_browsers_add_or_leave_out_changes_nothing(algorithm):
    held = authenticator(algorithm)
    checked(held.assertion(EXPECTED, other_keys_can_be_added_here="do not compare", n=1.5), key=held.key)
    said = {"type": "webauthn.get", "challenge": keys.b64u(EXPECTED), "origin": PARTY.origin}
    checked(held.assertion(EXPECTED, client=json.dumps(said).encode()), key=held.key)
    checked(held.assertion(EXPECTED, flags=PRESENT | VERIFIED | 0x18, counter=0), key=held.key)


MALFORMED, KIND, UNTRUSTED = (
    FaultCode.STATEMENT_MALFORMED,
    FaultCode.STATEMENT_WRONG_KIND,
    FaultCode.STATEMENT_UNTRUSTED,
)
TWICE = b'{"type":"webauthn.get","type":"webauthn.get","challenge":"%s","origin":"%s","crossOrigin":false}'
DEFECTS = {
    "a registration": ({"type": "webauthn.create"}, KIND, "PSK-2"),
    "no type": ({"type": None}, KIND, "PSK-2"),
    "another challenge": ({"challenge": keys.b64u(bytes(32))}, UNTRUSTED, "PSK-2"),
    "a padded challenge": ({"challenge": keys.b64u(EXPECTED) + "="}, UNTRUSTED, "PSK-2"),
    "a challenge of another alphabet": ({"challenge": keys.b64u(EXPECTED) + "\n"}, UNTRUSTED, "PSK-2"),
    "no challenge": ({"challenge": None}, UNTRUSTED, "PSK-2"),
    "another origin": ({"origin": "https://idp.example.evil"}, UNTRUSTED, "PSK-3"),
    "another port": ({"origin": "https://idp.example"}, UNTRUSTED, "PSK-3"),
    "another scheme": ({"origin": "http://idp.example:8443"}, UNTRUSTED, "PSK-3"),
    "in a frame of another": ({"crossOrigin": True}, UNTRUSTED, "PSK-3"),
    "a frame that is no flag": ({"crossOrigin": 0}, UNTRUSTED, "PSK-3"),
    "a top origin": ({"topOrigin": PARTY.origin}, UNTRUSTED, "PSK-3"),
    "another relying party": ({"rp_id": "evil.example"}, UNTRUSTED, "PSK-4"),
    "nobody present": ({"flags": VERIFIED}, UNTRUSTED, "PSK-4"),
    "nobody verified": ({"flags": PRESENT}, UNTRUSTED, "PSK-4"),
    "a new credential": ({"flags": PRESENT | VERIFIED | ATTESTED}, MALFORMED, "PSK-4"),
    "extensions": ({"flags": PRESENT | VERIFIED | 0x80}, MALFORMED, "PSK-4"),
    "a reserved flag": ({"flags": PRESENT | VERIFIED | 0x02}, MALFORMED, "PSK-4"),
    "a copy of what was never copied": ({"flags": PRESENT | VERIFIED | 0x10}, MALFORMED, "PSK-4"),
    "a client that says too much": ({"padding": "x" * 512}, MALFORMED, "PSK-1"),
    "a member twice": (
        {"client": TWICE % (keys.b64u(EXPECTED).encode(), PARTY.origin.encode())}, MALFORMED, "PSK-1",
    ),
    "no object": ({"client": b"[]"}, MALFORMED, "PSK-1"),
    "no client": ({"client": b""}, MALFORMED, "PSK-1"),
    "two values": ({"client": b"{} {}"}, MALFORMED, "PSK-1"),
}  # fmt: skip


@pytest.mark.parametrize("what", DEFECTS)
@pytest.mark.clause("PSK-1", "PSK-2", "PSK-3", "PSK-4")
def test_a_defective_assertion(what):
    changes, code, _ = DEFECTS[what]
    held = authenticator()
    refused(code, checked, held.assertion(EXPECTED, **changes), key=held.key)


@BOTH
@pytest.mark.clause("PSK-5")
def test_a_signature_is_by_the_registered_key_and_has_one_spelling(algorithm):
    held, other = authenticator(algorithm), authenticator(algorithm)
    made = held.assertion(EXPECTED)
    refused(UNTRUSTED, checked, made, key=other.key)
    for place in (0, 31, 32, 63):
        changed = bytearray(made.signature)
        changed[place] ^= 1
        refused(UNTRUSTED, checked, dataclasses.replace(made, signature=bytes(changed)), key=held.key)
    high = made.signature[:32] + (signatures.P256_N - int.from_bytes(made.signature[32:], "big")).to_bytes(32, "big")
    refused(UNTRUSTED, checked, dataclasses.replace(made, signature=high), key=held.key)
    refused(UNTRUSTED, checked, dataclasses.replace(made, signature=made.signature + b"\0"), key=held.key)
    refused(MALFORMED, checked, dataclasses.replace(made, authenticator=made.authenticator + b"\0"), key=held.key)


@pytest.mark.clause("PSK-5")
def test_the_algorithm_is_that_of_the_key_and_never_the_signers_choice():
    ed, p256 = authenticator(keys.Algorithm.ED25519), authenticator()
    refused(UNTRUSTED, checked, ed.assertion(EXPECTED), key=p256.key)
    refused(UNTRUSTED, checked, p256.assertion(EXPECTED), key=ed.key)
    for broken in (b"", b"\x30\x00", utils.encode_dss_signature(2**300, 1)):
        refused(UNTRUSTED, from_browser, p256, broken)


def from_browser(held, signature):
    data, client, _ = held.parts(EXPECTED)
    checked(of_browser(data, client, signature, key=held.key), key=held.key)


@pytest.mark.clause("PSK-2")
def test_a_login_or_consent_is_no_vote():
    held, bound = authenticator(), {"ask": {}, "vote": {}}
    for word in Word:
        made = held.assertion(challenge(word, bound))
        for other in Word:
            if other is word:
                checked(made, key=held.key, expected=challenge(other, bound))
            else:
                refused(UNTRUSTED, checked, made, key=held.key, expected=challenge(other, bound))
    assert login_challenge(ISSUER, "n") == challenge(Word.LOGIN, {"issuer": ISSUER, "nonce": "n"})


@pytest.mark.parametrize(
    ("issuer", "party"),
    [
        ("https://idp.example/ztpm", RelyingParty("idp.example", "https://idp.example")),
        (ISSUER, PARTY),
        ("http://localhost:8700/ztpm", RelyingParty("localhost", "http://localhost:8700")),
        ("http://127.0.0.1:8700/ztpm", None),
        ("https://[::1]:8700/ztpm", None),
        ("https://10.0.0.7/ztpm", None),
        ("http://idp.example/ztpm", None),
        ("https://0x7f.1/ztpm", None),
    ],
)
@pytest.mark.clause("PSK-4")
def test_the_relying_party_is_the_name_of_the_issuers_host(issuer, party):
    assert relying_party(issuer) == party


# --- votes -----------------------------------------------------------------------------------------------------------


def opened(text, *credentials, ask=ASK, party=PARTY):
    return passkey_vote.open(text, credentials, ask=ask, party=party)


@BOTH
@pytest.mark.clause("PSK-6")
def test_a_vote_by_passkey_is_read_back(algorithm):
    held = authenticator(algorithm)
    text = held.vote(VOTE, ASK)
    assert opened(text, authenticator().key, held.key) == (VOTE, held.key)
    assert passkey_vote.is_one(text) and len(text) <= passkey_vote.VOTE_BYTES


@pytest.mark.clause("PSK-6")
def test_the_longest_vote_has_room():
    name = "n" * 63
    party = RelyingParty(
        f"{'a' * 60}.{'b' * 60}.{'c' * 60}.example", f"https://{'a' * 60}.{'b' * 60}.{'c' * 60}.example:65535"
    )
    held = Authenticator(party)
    text = held.vote(structs.replace(VOTE, approver=name, uses=100, at=2**52, not_after=2**53 - 1), ASK)
    assert opened(text, held.key, party=party)[0].approver == name


CHANGES = {
    "ask_id": "d" * 32, "nonce": "e" * 32, "sponsor": "bob", "token_id": "h" * 22, "agent": "other",
    "agent_key": "q" * 43, "audience": "http://127.0.0.1:8801/mcp", "request_digest": "9" * 64, "object": "ur5e",
    "operation": "move_linear", "start_urad": (0, 1, 2, 3, 4, -4), "model_digest": "8" * 64,
    "policy_digest": "7" * 64, "scene_digest": "6" * 64, "index_milli": 2_641, "expires_at": 1_101,
    "values": (Quantity("q0", Unit.MICRORADIAN, -1_570_797),), "contributors": (), "mandate_id": "f" * 32,
    "reasons": ("PERCEPTION_STALE",), "perception": "stale", "pep": "cell-2", "issuer": "https://other.example/ztpm",
}  # fmt: skip


@pytest.mark.clause("PSK-6")
def test_every_member_of_ask_and_vote_is_bound():
    """All that an approval binds (DESIGN section 6), and the vote: whichever differs, it is no vote on that ask."""
    held = authenticator()
    for name, value in CHANGES.items():
        refused(UNTRUSTED, opened, held.vote(VOTE, structs.replace(ASK, **{name: value})), held.key)
    text = held.vote(VOTE, ASK)
    header, _, *rest = text.split(".")
    others = {
        "answer": "deny", "approver": "alice", "sees_clear": True, "uses": 2, "not_after": 1_101, "at": 1_011,
        "ask_digest": "d" * 64, "nonce": "0" * 32, "ask_id": "0" * 32,
    }  # fmt: skip
    assert others.keys() == set(Vote.__struct_fields__)
    for name, value in others.items():
        said = structs.asdict(structs.replace(VOTE, **{name: value}))
        refused(UNTRUSTED, opened, ".".join([header, keys.b64u(strict_json.canonical(said)), *rest]), held.key)


@pytest.mark.clause("PSK-6")
def test_no_other_text_is_the_same_vote():
    held = authenticator()
    text = held.vote(VOTE, ASK)
    refused(UNTRUSTED, opened, text, authenticator().key)
    refused(UNTRUSTED, opened, text)
    for place in range(0, len(text), 7):
        other = text[:place] + ("A" if text[place] != "A" else "B") + text[place + 1 :]
        with pytest.raises(StatementError):
            opened(other, held.key)
    header, vote, *rest = text.split(".")
    spaced = keys.b64u(json.dumps(structs.asdict(VOTE)).encode())
    typed = keys.b64u(strict_json.canonical({"kid": keys.thumbprint(held.key), "typ": "ztpm-vote+jwt"}))
    for other, code in (
        (".".join([header, spaced, *rest]), MALFORMED),
        (".".join([typed, vote, *rest]), KIND),
        (f"{text}=", MALFORMED),
        (f"{text}.", MALFORMED),
        (" " + text, MALFORMED),
        ("...." + "A" * passkey_vote.VOTE_BYTES, MALFORMED),
    ):
        refused(code, opened, other, held.key)
