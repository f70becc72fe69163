"""Passkeys at the provider: enrolled by a browser, proposed by a person, confirmed by another, voting from then on."""

from __future__ import annotations

import json

import pytest
from capabilities.statements.people.assertion import login_challenge
from capabilities.statements.people.vote import Vote
from capabilities.values.caps import DEFAULT
from msgspec import structs
from tests.authenticators import ATTESTED, PRESENT, VERIFIED, Authenticator
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.hostile.faults import commits
from tests.ztpm_idp.world import AUDIENCE, World
from ztpm_idp.provider import passkeys
from ztpm_idp.provider.problems import Problem
from ztpm_idp.provider.wire import AssertionBody

from capabilities.keys import keys
from capabilities.statements import registry
from capabilities.statements.people import ask, passkey_vote, vote
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.clause(reason="the provider's part; the clauses are tried where assertions are verified")
NAMED = "http://localhost:8700/ztpm"


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    with World(tmp_path_factory.mktemp("passkeys"), settings_changes={"issuer": NAMED}) as world:
        yield Cell(world)


def party(cell):
    return passkeys.party_of(cell.world.provider)


def send(cell, path, body):
    with cell.world.anonymous() as http:
        return http.post(NAMED + path, content=json.dumps(body).encode())


def enrolled(cell, person, **changes):
    """An authenticator that made a credential for the person, the enrolment, and the provider's answer."""
    held = Authenticator(party(cell), **changes.pop("held", {}))
    enrolment = cell.world.people[person].begin_passkey()["enrolment_id"]
    expected = passkeys.enrolment_challenge(enrolment, changes.pop("whom", person))
    made = held.registration(expected, **changes)
    return held, enrolment, send(cell, f"/passkeys/enrolments/{enrolment}/credential", {"credential": made})


def passkey(cell, person, confirmed_by="dan", **changes) -> Authenticator:
    held, enrolment, answer = enrolled(cell, person, **changes)
    assert answer.status_code == 201, answer.text
    caller = cell.world.people[person]
    assert caller.enrolled_passkey(enrolment) == answer.json()["key"] == keys.b64u(held.key)
    change = caller.propose_passkey(enrolment, keys.b64u(held.key))
    (shown,) = (row for row in caller.changes() if row["change_id"] == change)
    assert (shown["kind"], shown["passkey"], shown["key"]) == ("key", True, keys.thumbprint(held.key))
    assert cell.world.people[confirmed_by].confirm_change(change) == "done"
    return held


def voting(cell, held, text, approver="carol", *, assertion=None, **changes):
    """The body of a vote on this ask."""
    shown = ask.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT)
    digest = vote.digest_of(text)
    stated = Vote(shown.ask_id, shown.nonce, digest, "approve", approver, False, 1, cell.now + 120, cell.now)
    stated = structs.replace(stated, **changes)
    challenge = passkey_vote.challenge_of(stated, shown)
    return {"vote": structs.asdict(stated), "assertion": held.body(challenge, **(assertion or {}))}


def cast(cell, ask_id, body):
    return send(cell, f"/approvals/{ask_id}/passkey-votes", body)


def refused(answer, code, status=None):
    assert answer.json()["code"] == code, answer.text
    assert status is None or answer.status_code == status


def test_a_passkey_of_two_peoples_making_votes(named):
    held = passkey(named, "carol", held={"private": keys.generate()})
    ask_id, text = named.taken()
    answer = cast(named, ask_id, voting(named, held, text))
    assert (answer.status_code, answer.json()["state"]) == (201, "granted")
    (carried,) = named.told(ask_id).votes
    assert passkey_vote.is_one(carried)
    snapshot = registry.open(
        named.get("cell-1", f"/registry?audience={AUDIENCE}").text, named.world.trust.registry, DEFAULT
    )
    assert (held.key, "carol") in {(entry.key, entry.id) for entry in snapshot.passkeys}
    assert held.key not in {entry.key for entry in snapshot.approvers}
    kinds = [line["kind"] for line in named.ledger()]
    assert {"person-passkey-added", "vote-cast"} <= set(kinds)
    # the same assertion again, and another of the same person, by key or passkey
    refused(cast(named, ask_id, voting(named, held, text)), "VOTED_BEFORE")
    refused(named.post("carol", f"/approvals/{ask_id}/votes", {"vote": named.vote(text)}), "VOTED_BEFORE")


def test_one_person_is_one_voter_whatever_it_votes_with(named):
    held = passkey(named, "carol")
    opening = named.opening()
    named.post("carol", "/openings", {"opening": opening})
    ask_id, text = named.taken(approvers=2)
    assert cast(named, ask_id, voting(named, held, text)).json()["state"] == "open"
    refused(named.post("carol", f"/approvals/{ask_id}/votes", {"vote": named.vote(text)}), "VOTED_BEFORE")
    assert named.post("alice", f"/approvals/{ask_id}/votes", {"vote": named.vote(text, "alice")}).status_code == 201
    assert named.told(ask_id).state == "granted"


VOTES = {
    "of another person": ({"approver": "alice"}, None, "VOTE_NOT_YOURS"),
    "on another ask": ({"ask_id": "0" * 32}, None, "VOTE_NOT_FOR_THIS_ASK"),
    "on another text": ({"ask_digest": "0" * 64}, None, "VOTE_NOT_FOR_THIS_ASK"),
    "from before the ask": ({"at": 1}, None, "VOTE_OUT_OF_TIME"),
    "for too long": ({"not_after": 2_000_000_000}, None, "VOTE_OUT_OF_TIME"),
    "of no known form": ({"answer": "perhaps"}, None, "STATEMENT_MALFORMED"),
    "with nobody verified": ({}, {"flags": PRESENT}, "STATEMENT_UNTRUSTED"),
    "made on another page": ({}, {"origin": "http://localhost:8701"}, "STATEMENT_UNTRUSTED"),
    "in a frame": ({}, {"crossOrigin": True}, "STATEMENT_UNTRUSTED"),
    "as a registration": ({}, {"type": "webauthn.create"}, "STATEMENT_WRONG_KIND"),
    "for another relying party": ({}, {"rp_id": "127.0.0.1"}, "STATEMENT_UNTRUSTED"),
}


def test_defective_votes_by_passkey_leave_the_ask_as_it_was(named):
    held = passkey(named, "carol")
    ask_id, text = named.taken()
    for what, (changes, assertion, code) in VOTES.items():
        answer = cast(named, ask_id, voting(named, held, text, assertion=assertion, **changes))
        assert (answer.json()["code"], answer.status_code < 500) == (code, True), what
    body = voting(named, held, text)
    refused(cast(named, ask_id, body | {"vote": body["vote"] | {"uses": 2}}), "STATEMENT_UNTRUSTED", 403)
    stranger = Authenticator(party(named))
    refused(cast(named, ask_id, voting(named, stranger, text)), "PASSKEY_UNKNOWN", 403)
    borrowed = Authenticator(party(named), credential=held.credential)
    refused(cast(named, ask_id, voting(named, borrowed, text)), "STATEMENT_UNTRUSTED", 403)
    login = held.body(login_challenge(NAMED, "n"))
    refused(cast(named, ask_id, body | {"assertion": login}), "STATEMENT_UNTRUSTED", 403)
    for broken in (b"", b"[]", b'{"vote":{}}', b'{"vote":{},"assertion":{}}'):
        with named.world.anonymous() as http:
            assert http.post(f"{NAMED}/approvals/{ask_id}/passkey-votes", content=broken).status_code == 400
    refused(cast(named, "0" * 32, body), "ASK_UNKNOWN", 404)
    assert named.told(ask_id).state == "open"
    assert cast(named, ask_id, body).json()["state"] == "granted"


def test_a_passkey_counts_while_it_is_a_key_of_an_approver(named):
    held = passkey(named, "carol")
    ask_id, text = named.taken()
    body = voting(named, held, text)
    named.world.people["carol"].revoke("key", keys.thumbprint(held.key), "lost the phone")
    refused(cast(named, ask_id, body), "PASSKEY_UNKNOWN", 403)
    assert named.told(ask_id).state == "open"
    # carol goes on with her operator key
    assert named.post("carol", f"/approvals/{ask_id}/votes", {"vote": named.vote(text)}).status_code == 201
    # a sponsor may have a passkey, and no vote
    other = passkey(named, "bob")
    ask_id, text = named.taken()
    refused(cast(named, ask_id, voting(named, other, text, "bob")), "NOT_PERMITTED", 403)


def test_a_passkey_signs_no_request_and_no_vote_of_the_other_kind(named):
    held = passkey(named, "carol")
    named.world.private["carol-phone"] = held.private
    refused(named.get("carol-phone", "/people"), "CALLER_INACTIVE", 403)
    ask_id, text = named.taken()
    answer = named.post("carol", f"/approvals/{ask_id}/votes", {"vote": named.vote(text, key="carol-phone")})
    assert answer.json()["code"] in {"VOTE_NOT_YOURS", "STATEMENT_UNTRUSTED"}
    # and an operator key makes no assertion
    operator = Authenticator(party(named), private=named.world.private["carol"], credential=held.credential)
    refused(cast(named, ask_id, voting(named, operator, text)), "STATEMENT_UNTRUSTED")


REGISTRATIONS = {
    "another person's": {"whom": "alice"},
    "nobody verified": {"flags": PRESENT | ATTESTED},
    "nobody present": {"flags": VERIFIED | ATTESTED},
    "another origin": {"origin": "http://localhost:1"},
    "an assertion": {"type": "webauthn.get"},
    "another algorithm": {"algorithm": -257},
    "a credential without end": {"held": {"credential": bytes(600)}},
}


def test_defective_registrations_make_nothing(named):
    for what, changes in REGISTRATIONS.items():
        _, enrolment, answer = enrolled(named, "carol", **changes)
        assert (answer.json()["code"], answer.status_code) == ("PASSKEY_REFUSED", 400), what
        assert named.world.people["carol"].enrolled_passkey(enrolment) == ""
        named.world.clock.at_s += 601  # its enrolment is over
    for broken in ({}, {"id": "x"}, {"id": 1, "rawId": [], "response": 3, "type": None}):
        enrolment = named.world.people["carol"].begin_passkey()["enrolment_id"]
        answer = send(named, f"/passkeys/enrolments/{enrolment}/credential", {"credential": broken})
        refused(answer, "PASSKEY_REFUSED", 400)
    named.world.clock.at_s += 601


def test_an_enrolment_is_of_its_person_once_and_for_ten_minutes(named):
    carol, alice = named.world.people["carol"], named.world.people["alice"]
    held, enrolment, _ = enrolled(named, "carol")
    again = {"credential": held.registration(passkeys.enrolment_challenge(enrolment, "carol"))}
    refused(send(named, f"/passkeys/enrolments/{enrolment}/credential", again), "ENROLMENT_UNKNOWN", 404)
    key = keys.b64u(held.key)
    for person, named_key in ((alice, key), (carol, keys.b64u(keys.public_raw(keys.generate())))):
        with pytest.raises(ClientError) as raised:
            person.propose_passkey(enrolment, named_key)
        assert raised.value.code == "ENROLMENT_UNKNOWN"
    with pytest.raises(ClientError) as raised:
        alice.enrolled_passkey(enrolment)
    assert raised.value.code == "ENROLMENT_UNKNOWN"
    for _ in range(3):
        carol.begin_passkey()
    with pytest.raises(ClientError) as raised:
        carol.begin_passkey()
    assert raised.value.code == "TOO_MANY_ENROLMENTS"
    change = carol.propose_passkey(enrolment, key)
    with pytest.raises(ClientError) as raised:
        carol.confirm_change(change)
    assert raised.value.code == "NOT_PERMITTED"
    named.world.clock.at_s += 601
    with pytest.raises(ClientError) as raised:
        carol.propose_passkey(enrolment, key)
    assert raised.value.code == "ENROLMENT_UNKNOWN"


def test_an_enrolment_ends_in_the_commit_of_its_proposal(named):
    carol, (held, enrolment, _) = named.world.people["carol"], enrolled(named, "carol")
    key = keys.b64u(held.key)
    assert commits(named.world, lambda: carol.propose_passkey(enrolment, key)) == 2  # the other one uses the proof up
    with pytest.raises(ClientError) as raised:
        carol.propose_passkey(enrolment, key)
    assert raised.value.code == "ENROLMENT_UNKNOWN"


def test_a_login_is_whose_passkey_asserted_its_nonce(named):
    held, world = passkey(named, "dan", "alice"), named.world

    def login(nonce="n1", **changes):
        body = AssertionBody(**held.body(login_challenge(NAMED, changes.pop("signed", nonce)), **changes))
        return world.on_loop(passkeys.verified_login(world.provider, body, nonce=nonce))

    assert login().id == "dan"
    for changes in ({"signed": "n2"}, {"flags": PRESENT}, {"origin": "http://localhost"}, {"topOrigin": "x"}):
        with pytest.raises(Problem) as raised:
            login(**changes)
        assert raised.value.code.value == "STATEMENT_UNTRUSTED", changes
    world.people["dan"].revoke("key", keys.thumbprint(held.key), "lost")
    with pytest.raises(Problem) as raised:
        login()
    assert raised.value.code.value == "PASSKEY_UNKNOWN"


def test_where_the_issuer_is_an_address_there_are_no_passkeys(tmp_path):
    with World(tmp_path) as world:
        cell = Cell(world)
        with pytest.raises(ClientError) as raised:
            world.people["carol"].begin_passkey()
        assert raised.value.code == "PASSKEYS_UNAVAILABLE"
        ask_id, _ = cell.taken()
        with world.anonymous() as http:
            page = http.get(f"{world.issuer}/approvals/{ask_id}/page")
        assert 'id="approve"' not in page.text and "data-passkey" not in page.text


def test_pages_hold_our_scripts_and_nothing_of_another_host(named):
    ask_id, text = named.taken()
    enrolment = named.world.people["carol"].begin_passkey()
    with named.world.anonymous() as http:
        pages = [http.get(url) for url in (f"{NAMED}/approvals/{ask_id}/page", enrolment["url"])]
        script = http.get(f"{NAMED}/passkeys/passkey.js")
    assert script.headers["content-type"].startswith("text/javascript")
    for page in pages:
        policy = page.headers["content-security-policy"]
        assert f"script-src {NAMED}/passkeys/passkey.js" in policy and "unsafe" not in policy
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        assert page.text.count("<script") == page.text.count(f'<script src="{NAMED}/') and "onclick" not in page.text
    assert text in pages[0].text
