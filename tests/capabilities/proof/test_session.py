"""Opening of a session: the rights to open and answer, and the purpose of each value in the two messages."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import pytest
from capabilities.proof.key_agreement import PROFILE
from capabilities.proof.proof import prove
from capabilities.proof.session_frames import Session, SessionMessage
from capabilities.proof.session_opening import AnsweredSession, PendingSession, answer, begin, conclude
from capabilities.token.token_text import token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.proof.test_session_agreement import LOW_ORDER, P
from tests.capabilities.world import CELL, NOW, OTHER_CELL, chain_of_four, key_of, mint_root, raw_of

from capabilities.keys import jws, keys
from capabilities.proof import key_agreement
from capabilities.values import strict_json

URL = CELL + "/sessions"
TOKEN = token_to_text(chain_of_four())
OTHER_TOKEN = token_to_text(mint_root())
ENDS = NOW + 600


def seeded(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


def begun(**other: object) -> PendingSession:
    wanted = {
        "key": key_of("gripper"),
        "url": URL,
        "audience": CELL,
        "token": TOKEN,
        "verifier_key": raw_of("pep"),
        "private": seeded("holder"),
        "nonce": seeded("holder nonce"),
        "at": NOW,
        "jti": "jti-0123456789abcdef",
    }
    return begin(**{**wanted, **other})


def answered(pending: PendingSession, **other: object) -> AnsweredSession | Fault:
    wanted = {
        "holder_key": raw_of("gripper"),
        "url": URL,
        "audience": CELL,
        "token": TOKEN,
        "signer": key_of("pep"),
        "private": seeded("verifier"),
        "nonce": seeded("verifier nonce"),
        "not_after": ENDS,
        "at": NOW,
        "most_missing": 0,
        "caps": DEFAULT,
    }
    return answer(pending.body, pending.proof, **{**wanted, **other})


def concluded(pending: PendingSession, text: bytes, **other: object) -> Session | Fault:
    return conclude(pending, text, **{"at": NOW, "most_missing": 0, "caps": DEFAULT, **other})


def opened(**other: object) -> tuple[Session, Session]:
    """Both ends: the holder's, the verifier's."""
    pending = begun()
    verifier = answered(pending, **other)
    holder = concluded(pending, verifier.text)
    assert isinstance(holder, Session), holder
    return holder, verifier.session


def code(found: object) -> tuple[FaultCode, str]:
    assert isinstance(found, Fault), found
    return found.code, found.clause


def talk(holder: Session, verifier: Session) -> bool:
    """True where a message passes in each direction."""
    there, back = holder.seal(b"move", at=NOW), verifier.seal(b"state", at=NOW)
    return verifier.open(there, at=NOW) == SessionMessage(b"move", 0) and holder.open(back, at=NOW) == SessionMessage(
        b"state", 0
    )


@pytest.mark.clause("SES-1", "SES-5", "SES-6")
def test_two_ends_talk():
    assert talk(*opened())


@pytest.mark.clause("SES-2", "SES-5")
def test_without_a_static_key_of_the_verifier():
    pending = begun(verifier_key=None)
    verifier = answered(pending, signer=None)
    assert json.loads(verifier.text)["signature"] == ""
    assert talk(concluded(pending, verifier.text), verifier.session)


@pytest.mark.clause("SES-1")
def test_the_opening_is_the_body_of_an_ordinary_proof():
    pending = begun()
    assert json.loads(pending.body) == {
        "profile": PROFILE,
        "audience": CELL,
        "token": keys.b64u(hashlib.sha256(TOKEN.encode()).digest()),
        "key": keys.b64u(key_agreement.public_of(seeded("holder"))),
        "nonce": keys.b64u(seeded("holder nonce")),
        "verifier": keys.thumbprint(raw_of("pep")),
    }
    proof = answered(pending).proof
    assert (proof.jti, proof.key, proof.digest) == (
        "jti-0123456789abcdef",
        raw_of("gripper"),
        hashlib.sha256(pending.proof.encode()).digest(),
    )


# --- [SES-1] the proof


@pytest.mark.clause("SES-1")
@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ({"holder_key": raw_of("eve")}, (FaultCode.PROOF_WRONG_KEY, "PRF-3")),
        ({"url": CELL}, (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-4")),
        ({"token": OTHER_TOKEN}, (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-5")),
        ({"at": NOW + 31}, (FaultCode.PROOF_STALE, "PRF-6")),
        ({"at": NOW - 6}, (FaultCode.PROOF_STALE, "PRF-6")),
    ],
)
def test_an_opening_without_its_proof_opens_nothing(other, expected):
    assert code(answered(begun(), **other)) == expected


@pytest.mark.clause("SES-1", "SES-2")
def test_nobody_between_puts_another_key_into_an_opening():
    pending, eve = begun(), begun(key=key_of("eve"), private=seeded("eve"))
    assert code(answered(replace(pending, body=eve.body))) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "PRF-4")
    assert code(answered(replace(pending, proof=eve.proof, body=eve.body))) == (FaultCode.PROOF_WRONG_KEY, "PRF-3")
    assert code(answered(replace(pending, proof=""))) == (FaultCode.PROOF_MISSING, "PRF-1")


# --- [SES-2] the opening


def with_body(change: dict[str, object] | bytes) -> PendingSession:
    """An opening with other members, really proved by the holder."""
    pending = begun()
    body = change if isinstance(change, bytes) else strict_json.canonical({**json.loads(pending.body), **change})
    proof = prove(key_of("gripper"), method="POST", url=URL, body=body, token=TOKEN, at=NOW, jti="jti-0123456789abcdef")
    return replace(pending, body=body, proof=proof)


@pytest.mark.clause("SES-2")
@pytest.mark.parametrize(
    "change",
    [
        {"profile": "ztpm-session/2"},
        {"profile": 1},
        {"audience": OTHER_CELL},
        {"audience": CELL + "/"},
        {"audience": None},
        {"token": keys.b64u(seeded("other"))},
        {"token": ""},
        {"verifier": ""},
        {"verifier": keys.thumbprint(raw_of("eve"))},
        {"verifier": None},
    ],
)
def test_an_opening_for_something_else(change):
    assert code(answered(with_body(change))) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-2")


@pytest.mark.clause("SES-2", "SES-5")
def test_a_verifier_signs_exactly_when_it_is_expected_to():
    assert code(answered(begun(), signer=None)) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-2")
    assert code(answered(begun(verifier_key=None))) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-2")
    assert code(answered(begun(), signer=key_of("eve"))) == (FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-2")


def spoiled(members: dict[str, object]) -> dict[str, bytes]:
    """Texts that no reader may take for the object."""
    text = strict_json.canonical(members)
    first = next(iter(sorted(members)))
    return {
        "empty": b"",
        "no object": b"[]",
        "null": b"null",
        "white space": text + b" ",
        "indented": json.dumps(members, indent=1).encode(),
        "turned": json.dumps(dict(reversed(sorted(members.items()))), separators=(",", ":")).encode(),
        "twice": text[:-1] + b"," + strict_json.canonical({first: members[first]})[1:],
        "extra": strict_json.canonical({**members, "x": 1}),
        "cut": text[:-1],
        "two": text + text,
        "not UTF-8": text + b"\xff",
        "mark": b"\xef\xbb\xbf" + text,
        "escaped": text.replace(b"ztpm", b"\\u007atpm"),
        "too long": strict_json.canonical({**members, first: "x" * 2_048}),
        "nan": text.replace(b'"ztpm-session/1"', b"NaN"),
        **{
            f"without {name}": strict_json.canonical({k: v for k, v in members.items() if k != name})
            for name in members
        },
    }


@pytest.mark.clause("SES-2")
@pytest.mark.parametrize("how", sorted(spoiled(json.loads(begun().body))))
def test_an_opening_has_one_spelling(how):
    text = spoiled(json.loads(begun().body))[how]
    assert code(answered(with_body(text))) == (FaultCode.PROOF_MALFORMED, "SES-2")


BAD_RAW = [
    None,
    1,
    True,
    [],
    {},
    "",
    "AAAA",
    keys.b64u(bytes(31)),
    keys.b64u(bytes(33)),
    keys.b64u(seeded("x")) + "=",
    keys.b64u(seeded("x"))[:-1] + "!",
]


@pytest.mark.clause("SES-2")
@pytest.mark.parametrize("name", ["key", "nonce"])
@pytest.mark.parametrize("value", BAD_RAW)
def test_keys_and_nonces_have_one_form(name, value):
    assert code(answered(with_body({name: value}))) == (FaultCode.PROOF_MALFORMED, "SES-2")


# --- [SES-3] the agreement

WEAK = [*LOW_ORDER, P.to_bytes(32, "little"), (P + 9).to_bytes(32, "little"), b"\xff" * 32]


@pytest.mark.clause("SES-3")
@pytest.mark.parametrize("raw", WEAK, ids=lambda raw: raw.hex()[:8])
def test_weak_keys_from_either_end(raw):
    assert code(answered(with_body({"key": keys.b64u(raw)}))) == (FaultCode.PROOF_MALFORMED, "SES-3")
    pending = begun()
    assert code(concluded(pending, with_answer(pending, key=keys.b64u(raw)))) == (FaultCode.PROOF_MALFORMED, "SES-3")


# --- [SES-4] lifetime


@pytest.mark.clause("SES-4")
def test_a_session_ends_with_the_token_or_sooner():
    assert answered(begun()).not_after == ENDS
    assert answered(begun(), not_after=NOW + 10**6).not_after == NOW + DEFAULT.session_lifetime_s
    assert answered(begun(), not_after=NOW + 1).not_after == NOW + 1
    for ended in (NOW, NOW - 1, 0):
        assert code(answered(begun(), not_after=ended)) == (FaultCode.PROOF_STALE, "SES-4")


@pytest.mark.clause("SES-4")
@pytest.mark.parametrize(
    ("at", "holds"), [(ENDS - 1, True), (ENDS - 0.001, True), (ENDS, False), (ENDS + 1, False), (float("nan"), False)]
)
def test_a_holder_takes_no_answer_for_a_session_that_is_over(at, holds):
    pending = begun()
    found = concluded(pending, answered(pending).text, at=at)
    assert isinstance(found, Session) if holds else code(found) == (FaultCode.PROOF_STALE, "SES-4")


@pytest.mark.clause("SES-4")
def test_a_holder_takes_no_session_longer_than_any():
    """Its clock may be behind the verifier's by the skew, and no more."""
    pending = begun()
    text = answered(pending, not_after=NOW + 10**6).text
    assert isinstance(concluded(pending, text, at=NOW - DEFAULT.skew_s), Session)
    assert code(concluded(pending, text, at=NOW - DEFAULT.skew_s - 1)) == (FaultCode.PROOF_STALE, "SES-4")


# --- [SES-5] the answer


def with_answer(pending: PendingSession, **change: object) -> bytes:
    return strict_json.canonical({**json.loads(answered(pending).text), **change})


@pytest.mark.clause("SES-5")
@pytest.mark.parametrize("how", sorted(spoiled(json.loads(answered(begun()).text))))
def test_an_answer_has_one_spelling(how):
    pending = begun()
    assert code(concluded(pending, spoiled(json.loads(answered(pending).text))[how])) == (
        FaultCode.PROOF_MALFORMED,
        "SES-5",
    )


@pytest.mark.clause("SES-5")
@pytest.mark.parametrize("name", ["key", "nonce", "mac"])
@pytest.mark.parametrize("value", BAD_RAW)
def test_the_raw_members_of_an_answer_have_one_form(name, value):
    pending = begun()
    assert code(concluded(pending, with_answer(pending, **{name: value}))) == (FaultCode.PROOF_MALFORMED, "SES-5")


@pytest.mark.clause("SES-5")
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"profile": "ztpm-session/2"}, FaultCode.PROOF_NOT_FOR_THIS_REQUEST),
        ({"profile": None}, FaultCode.PROOF_NOT_FOR_THIS_REQUEST),
        ({"not_after": "1"}, FaultCode.PROOF_MALFORMED),
        ({"not_after": True}, FaultCode.PROOF_MALFORMED),
        ({"not_after": None}, FaultCode.PROOF_MALFORMED),
        ({"signature": None}, FaultCode.PROOF_MALFORMED),
        ({"signature": 1}, FaultCode.PROOF_MALFORMED),
        ({"not_after": ENDS + 1}, FaultCode.PROOF_WRONG_KEY),
        ({"nonce": keys.b64u(seeded("other"))}, FaultCode.PROOF_WRONG_KEY),
        ({"key": keys.b64u(key_agreement.public_of(seeded("other")))}, FaultCode.PROOF_WRONG_KEY),
        ({"mac": keys.b64u(seeded("other"))}, FaultCode.PROOF_WRONG_KEY),
        ({"signature": ""}, FaultCode.PROOF_WRONG_KEY),
        ({"signature": "x.y.z"}, FaultCode.PROOF_WRONG_KEY),
    ],
)
def test_an_answer_of_something_else(change, expected):
    pending = begun()
    assert concluded(pending, with_answer(pending, **change)).code is expected


@pytest.mark.clause("SES-5")
def test_the_one_in_the_middle_who_answers_needs_the_static_key():
    """It has a key of its own for X25519 and can make every MAC, but it cannot sign.

    With its own signature it is another party.
    """
    pending = begun()
    mine = dict(private=seeded("eve"), nonce=seeded("eve nonce"))
    for signer in (None, key_of("eve")):
        # What a verifier of that key would answer to an opening that names it.
        named = None if signer is None else raw_of("eve")
        theirs = answered(begun(verifier_key=named), signer=signer, **mine)
        assert code(concluded(pending, theirs.text)) == (FaultCode.PROOF_WRONG_KEY, "SES-5")
    for forged in forgeries(pending):
        assert code(concluded(pending, forged)) == (FaultCode.PROOF_WRONG_KEY, "SES-5")


def forgeries(pending: PendingSession):
    """Answers of the one in the middle, with the right MAC and each signature that it can get."""
    genuine = json.loads(answered(pending).text)["signature"]
    transcript = key_agreement.Transcript(
        audience=CELL,
        token=pending.token,
        proof=hashlib.sha256(pending.proof.encode()).digest(),
        holder_key=raw_of("gripper"),
        verifier_key=raw_of("pep"),
        holder_public=key_agreement.public_of(seeded("holder")),
        holder_nonce=pending.nonce,
        verifier_public=key_agreement.public_of(seeded("eve")),
        verifier_nonce=seeded("eve nonce"),
        not_after=ENDS,
    )
    derived = key_agreement.derive(key_agreement.agree(seeded("eve"), transcript.holder_public), transcript)
    kid = keys.thumbprint(raw_of("pep"))
    signatures = [
        "",
        genuine,
        key_agreement.sign(transcript, key_of("eve")),
        jws.sign({"kid": kid, "typ": "ztpm-session+jwt"}, transcript.digest(), key_of("eve")),
        # Signed by the verifier's own key, for another purpose or about something else:
        jws.sign({"kid": kid, "typ": "ztpm-ask+jwt"}, transcript.digest(), key_of("pep")),
        jws.sign({"kid": "x", "typ": "ztpm-session+jwt"}, transcript.digest(), key_of("pep")),
        jws.sign({"typ": "ztpm-session+jwt"}, transcript.digest(), key_of("pep")),
        jws.sign({"kid": kid, "typ": "ztpm-session+jwt", "x": "y"}, transcript.digest(), key_of("pep")),
        jws.sign({"kid": kid, "typ": "ztpm-session+jwt"}, bytes(32), key_of("pep")),
        key_agreement.sign(replace(transcript, not_after=ENDS + 1), key_of("pep")),
        prove(
            key_of("pep"),
            method="POST",
            url=URL,
            body=transcript.digest(),
            token=None,
            at=NOW,
            jti="jti-0123456789abcdef",
        ),
    ]
    for signature in signatures:
        yield strict_json.canonical(
            {
                "profile": PROFILE,
                "key": keys.b64u(transcript.verifier_public),
                "nonce": keys.b64u(transcript.verifier_nonce),
                "not_after": ENDS,
                "signature": signature,
                "mac": keys.b64u(key_agreement.confirmation(derived, transcript, signature)),
            }
        )
    # The same answer with the verifier's own signature would hold: nothing but the signature was wrong.
    signature = key_agreement.sign(transcript, key_of("pep"))
    whole = {
        "profile": PROFILE,
        "key": keys.b64u(transcript.verifier_public),
        "nonce": keys.b64u(transcript.verifier_nonce),
        "not_after": ENDS,
        "signature": signature,
        "mac": keys.b64u(key_agreement.confirmation(derived, transcript, signature)),
    }
    assert isinstance(concluded(pending, strict_json.canonical(whole)), Session)
    # And the signature alone, without the keys, is not enough.
    yield strict_json.canonical({**whole, "mac": keys.b64u(bytes(32))})


@pytest.mark.clause("SES-5")
def test_without_a_static_key_the_middle_can_answer_but_reaches_no_verifier():
    """Both halves of the documented promise for such a session."""
    pending = begun(verifier_key=None)
    theirs = answered(pending, signer=None, private=seeded("eve"), nonce=seeded("eve nonce"))
    deceived = concluded(pending, theirs.text)
    assert talk(deceived, theirs.session)
    verifier = answered(pending, signer=None).session
    for frame in (deceived.seal(b"move", at=NOW), theirs.session.seal(b"move", at=NOW)):
        assert code(verifier.open(frame, at=NOW)) == (FaultCode.PROOF_WRONG_KEY, "SES-7")


@pytest.mark.clause("SES-5")
@pytest.mark.parametrize("signer", ["pep", "eve"])
def test_a_signature_that_nobody_asked_for_is_none(signer):
    """The holder could not check it, so an answer that carries one is not the one that was agreed on."""
    pending = begun(verifier_key=None)
    transcript = key_agreement.Transcript(
        audience=CELL,
        token=pending.token,
        proof=hashlib.sha256(pending.proof.encode()).digest(),
        holder_key=raw_of("gripper"),
        verifier_key=b"",
        holder_public=key_agreement.public_of(seeded("holder")),
        holder_nonce=pending.nonce,
        verifier_public=key_agreement.public_of(seeded("verifier")),
        verifier_nonce=seeded("verifier nonce"),
        not_after=ENDS,
    )
    derived = key_agreement.derive(key_agreement.agree(seeded("verifier"), transcript.holder_public), transcript)
    for signature in (
        "",
        jws.sign(
            {"kid": keys.thumbprint(raw_of(signer)), "typ": key_agreement.ANSWER_TYPE},
            transcript.digest(),
            key_of(signer),
        ),
    ):
        mac = keys.b64u(key_agreement.confirmation(derived, transcript, signature))
        members = {**json.loads(answered(pending, signer=None).text), "signature": signature, "mac": mac}
        found = concluded(pending, strict_json.canonical(members))
        assert code(found) == (FaultCode.PROOF_WRONG_KEY, "SES-5") if signature else isinstance(found, Session)


@pytest.mark.clause("SES-3", "SES-5")
@pytest.mark.parametrize(
    "change",
    [
        {"private": seeded("another")},
        {"nonce": seeded("another")},
        {"jti": "another-0123456789"},
        {"at": NOW - 1},
    ],
)
def test_an_answer_belongs_to_one_opening(change):
    assert code(concluded(begun(**change), answered(begun()).text)) == (FaultCode.PROOF_WRONG_KEY, "SES-5")


@pytest.mark.clause("SES-3", "SES-7")
def test_sessions_share_no_frames():
    """Same holder, token, verifier and opening; another nonce or key of the verifier, or another end, makes another session."""
    holder, _ = opened()
    frame = holder.seal(b"move", at=NOW)
    for other in ({"nonce": seeded("another")}, {"private": seeded("another")}, {"not_after": ENDS - 1}):
        assert code(answered(begun(), **other).session.open(frame, at=NOW)) == (FaultCode.PROOF_WRONG_KEY, "SES-7")
    assert answered(begun()).session.open(frame, at=NOW) == SessionMessage(b"move", 0)


@pytest.mark.clause(reason="what a value prints is no matter of the wire")
def test_secrets_are_not_shown():
    pending = begun()
    assert seeded("holder").hex() not in repr(pending)
    assert repr(seeded("holder")) not in repr(pending)


TEXT = answered(begun()).text


@pytest.mark.clause("SES-5")
@given(st.integers(0, len(TEXT) - 1), st.integers(0, 255), st.sampled_from(["replace", "insert", "delete", "cut"]))
def test_no_mutant_of_an_answer_opens_a_session(at, value, how):
    mutant = {
        "replace": TEXT[:at] + bytes([value]) + TEXT[at + 1 :],
        "insert": TEXT[:at] + bytes([value]) + TEXT[at:],
        "delete": TEXT[:at] + TEXT[at + 1 :],
        "cut": TEXT[:at],
    }[how]
    if mutant != TEXT:
        assert isinstance(concluded(begun(), mutant), Fault)
