"""The console's acts of administration: done by a passkey's word alone, exactly as it was asked, and by two people."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlencode

from urllib.parse import parse_qs, urlencode

import pytest
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.console.looking import AT, NAMED, Looking, party
from tests.ztpm_idp.console.test_tree import HOSTILE, lent
from tests.ztpm_idp.test_passkeys import passkey
from tests.ztpm_idp.world import World
from ztpm_idp.console import acts, revoking, words
from ztpm_idp.domain import commands
from ztpm_idp.domain.changes import Word as Answer
from ztpm_idp.domain.signed import AssertedAct
from ztpm_idp.provider.problems import Problem

from capabilities.keys import keys
from capabilities.statements.people import assertion
from capabilities.statements.people.assertion import Assertion, Word, challenge, login_challenge
from ztpm_idp.client import ClientError, Operator

SOFTWARE = "ab" * 32
WHY = "it is odd, größer"


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    with World(tmp_path_factory.mktemp("acting"), settings_changes={"issuer": NAMED}) as world:
        cell = Cell(world)
        world.agent("planner")
        world.agent("other", sponsor="bob")
        yield cell


@pytest.fixture(scope="module")
def held(named):
    """Passkeys of administrators alice and dan, of sponsor bob, and of approver carol."""
    by = {"alice": "dan", "dan": "alice", "bob": "dan", "carol": "dan"}
    return {name: passkey(named, name, confirmed_by=other) for name, other in by.items()}


def standing(named, kind, name):
    """Standing of a party, as the provider's list says."""
    alice = named.world.people["alice"]
    return {row["id"]: row["status"] for row in (alice.agents() if kind == "agent" else alice.persons())}.get(name)


def roles(named, name):
    return next(row["roles"] for row in named.world.people["alice"].persons() if row["id"] == name)


def waiting(named):
    return {row["change_id"]: row for row in named.world.people["alice"].changes()}


def entries(named):
    return len(named.ledger())


def public(named, name):
    """Public half of a new key, as text."""
    named.world.private[name] = keys.generate()
    return keys.b64u(keys.public_raw(named.world.private[name]))


def proposed(looking, held, act, /, **query):
    """Id of the change that is proposed so."""
    answer = looking.act(held[looking.name], act, **query)
    assert answer.status_code == 303, answer.text
    return re.search(r"after=([0-9a-f]{32})$", answer.headers["location"])[1]


@pytest.mark.clause("CON-11")
def test_an_agent_is_suspended_and_restored_by_a_passkeys_word(named, held):
    first, _ = lent(named)
    bob, alice = Looking(named.world, "bob"), Looking(named.world, "alice")
    assert "suspend-agent" in alice.see("/agents/planner") and "restore-agent" not in alice.page.text
    assert alice.act(held["alice"], "suspend-agent", agent="planner", reason=WHY).status_code == 303
    shown = alice.follow().text
    assert "suspended" in shown and "restore-agent" in shown and "suspend-agent" not in shown
    assert standing(named, "agent", "planner") == "suspended"
    kind, body = named.ledger()[-1]["kind"], named.ledger()[-1]["body"]
    assert (kind, body["agent"], body["reason"]) == ("agent-suspended", "planner", WHY)
    with pytest.raises(ClientError) as caught:
        lent(named)
    assert caught.value.code == "AGENT_SUSPENDED"
    assert alice.act(held["alice"], "restore-agent", agent="planner", reason="looked into").status_code == 303
    assert standing(named, "agent", "planner") == "active"
    # a sponsor does so with its own agents, and with no others
    bob.act(held["bob"], "suspend-agent", agent="other", reason=WHY)
    assert standing(named, "agent", "other") == "suspended"
    bob.act(held["bob"], "restore-agent", agent="other", reason=WHY)
    assert bob.asked("suspend-agent", agent="planner", reason=WHY) == (None, None)
    assert (bob.code(), standing(named, "agent", "planner")) == ("NOT_PERMITTED", "active")
    assert first.token_id


@pytest.mark.clause("CON-11")
def test_an_agent_is_registered_by_a_passkeys_word(named, held):
    bob, key = Looking(named.world, "bob"), public(named, "fresh")
    assert "register-agent" in bob.see("/agents")
    asked = {"id": "fresh", "key": key, "software_digest": SOFTWARE, "model": "m-1", "role": "packer", "sponsor": "bob"}
    assert bob.act(held["bob"], "register-agent", **asked).status_code == 303
    shown = bob.follow().text
    assert SOFTWARE in shown and "packer" in shown
    assert standing(named, "agent", "fresh") == "registered"
    for changes, code in (
        ({}, "ALREADY_REGISTERED"),
        ({"id": "fresh-2"}, "KEY_IN_USE"),
        ({"id": "x", "sponsor": "alice"}, "NOT_PERMITTED"),
        ({"id": "x", "workload": "spiffe://nowhere/x", "key": public(named, "x")}, "WORKLOAD_UNKNOWN"),
        ({"id": "x", "key": "no key"}, "QUERY_MALFORMED"),
        ({"id": "x", "software_digest": "AB"}, "QUERY_MALFORMED"),
    ):
        bob.act(held["bob"], "register-agent", **(asked | changes))
        assert bob.code() == code, changes
    assert standing(named, "agent", "x") is standing(named, "agent", "fresh-2") is None
    assert "register-agent" not in Looking(named.world, "carol").see("/agents")


@pytest.mark.clause("CON-11", "CON-13")
def test_a_person_who_only_lends_ends_at_once_with_all_that_it_lent(named, held):
    world = named.world
    world.person("gwen", "sponsor")
    world.people["gwen"] = world.caller(Operator, "gwen")
    world.agent("gwens", sponsor="gwen")
    dan = Looking(world, "dan")
    # the address for either kind of end is one: which it is depends on the person
    assert dan.act(held["dan"], "propose-end", person="gwen", reason="left us").status_code == 303
    shown = dan.follow().text
    assert "sponsor" in shown and "left us" in shown
    assert (standing(named, "person", "gwen"), standing(named, "agent", "gwens")) == ("revoked", "revoked")
    dan.act(held["dan"], "end-person", person="gwen", reason="again")
    assert dan.code() == "PARTY_ENDED"
    assert "propose-roles" in dan.see("/people") and 'value="gwen"' not in dan.page.text


@pytest.mark.clause("CON-13")
def test_an_approver_ends_by_two_people_of_whom_one_has_an_operator_key(named, held):
    named.world.person("erik", "approver")
    alice, dan = Looking(named.world, "alice"), Looking(named.world, "dan")
    change = proposed(alice, held, "end-person", person="erik", reason="left us")
    assert standing(named, "person", "erik") == "active"
    shown = alice.follow().text
    assert f"{change}</code>" in shown and "is leaving" in shown
    assert f"ztpm person confirm {change} --as alice" not in shown, "its proposer has no second word"
    # the second word is by operator key: a passkey's is refused on the page and by the provider
    assert f"ztpm person confirm {change} --as dan" in dan.see("/people")
    assert dan.asked("confirm-change", change_id=change) == (None, None)
    assert f"ztpm person confirm {change} --as dan" in dan.page.text and dan.code() is None
    assert confirmed_by_word(named, change, "dan") == "OPERATOR_KEY_NEEDED"
    assert standing(named, "person", "erik") == "active"
    # its proposer's own word is none, by whatever it is given
    with pytest.raises(ClientError) as caught:
        named.world.people["alice"].confirm_change(change)
    assert caught.value.code == "CHANGE_YOURS"
    assert named.world.people["dan"].confirm_change(change) == "done"
    assert standing(named, "person", "erik") == "revoked"


def confirmed_by_word(named, change, by):
    """Code of the refusal of a confirmation by passkey that no page asked for."""
    word = AssertedAct("{}", "k", "a", "c", "s")
    command = commands.AnswerChange(by, change, Answer.CONFIRM, "", word)
    running = named.world.provider.run(command, actor=by)
    with pytest.raises(Problem) as caught:
        asyncio.run_coroutine_threadsafe(running, named.world.loop).result(20)
    return caught.value.code.value


@pytest.mark.clause("CON-13")
def test_a_change_that_an_operator_key_proposed_is_confirmed_by_a_passkey(named, held):
    alice, dan, carol = (Looking(named.world, name) for name in ("alice", "dan", "carol"))
    change = named.world.people["alice"].propose_roles("bob", ["sponsor", "auditor"])
    assert "confirm-change" in dan.see("/people") and "confirm-change" not in alice.see("/people")
    assert "Waits for" in dan.page.text and change not in carol.see("/people")
    # neither its proposer, nor who is no administrator
    alice.act(held["alice"], "confirm-change", change_id=change)
    assert alice.code() == "CHANGE_YOURS"
    carol.act(held["carol"], "confirm-change", change_id=change)
    assert carol.code() == "NOT_PERMITTED"
    assert roles(named, "bob") == ["sponsor"]
    said, _ = dan.asked("confirm-change", change_id=change)
    assert (said["kind"], said["person"], said["roles"], said["proposed_by"]) == (
        "roles", "bob", "auditor sponsor", "alice",
    )  # fmt: skip
    assert said["had"] == "sponsor" and "login" not in said
    assert dan.act(held["dan"], "confirm-change", change_id=change).status_code == 303
    assert f"{change}</code> is done" in dan.follow().text
    assert "is done" not in carol.see(f"/people?after={change}"), "whose word it was not"
    assert roles(named, "bob") == ["auditor", "sponsor"]
    dan.act(held["dan"], "confirm-change", change_id=change)
    assert dan.code() == "CHANGE_OVER"
    dan.act(held["dan"], "confirm-change", change_id="0" * 32)
    assert dan.code() == "CHANGE_UNKNOWN"
    # the ledger has the word, and whoever has the key verifies it
    body = next(line["body"] for line in reversed(named.ledger()) if line["kind"] == "change-confirmed")
    signed = body["signed"]
    key = held["dan"].key
    assert (body["by"], signed["passkey"]) == ("dan", keys.thumbprint(key))
    made = Assertion(*(keys.unb64u(signed[name]) for name in ("authenticator", "client")), b"")
    made = assertion.of_browser(made.authenticator, made.client, keys.unb64u(signed["signature"]), key=key)
    digest = hashlib.sha256(b"ztpm-passkey-administration/1\n" + signed["said"].encode()).digest()
    assertion.check(made, expected=digest, party=party(), key=key)
    assert json.loads(signed["said"])["change_id"] == change
    undone = proposed(dan, held, "propose-roles", person="bob", role=["sponsor"])
    assert named.world.people["alice"].confirm_change(undone) == "done"
    assert roles(named, "bob") == ["sponsor"]


@pytest.mark.clause("CON-13")
def test_a_recovery_is_confirmed_by_operator_keys_and_declined_by_anything(named, held):
    world = named.world
    root = Operator("root", world.idp_keys.root, NAMED, transport=world.transport, now=world.clock)
    change = root.recover("zoe", "Zoe", keys.public_raw(keys.generate()))
    alice, dan = Looking(world, "alice"), Looking(world, "dan")
    assert dan.asked("confirm-change", change_id=change) == (None, None) and dan.code() is None
    assert confirmed_by_word(named, change, "dan") == "OPERATOR_KEY_NEEDED"
    assert dan.act(held["dan"], "decline-change", change_id=change, reason="unasked").status_code == 303
    assert change in waiting(named)
    alice.act(held["alice"], "decline-change", change_id=change, reason="unasked")
    assert change not in waiting(named)


@pytest.mark.clause("CON-13")
def test_people_are_enrolled_by_two_whatever_their_roles(named, held):
    alice, dan = Looking(named.world, "alice"), Looking(named.world, "dan")
    assert "propose-person" in alice.see("/people")
    change = proposed(alice, held, "propose-person", id="fay", name="Fay", key=public(named, "fay"), role=["sponsor"])
    assert standing(named, "person", "fay") is None
    assert "Register fay" in dan.see("/people") and "Fay" in dan.page.text
    assert named.world.people["dan"].confirm_change(change) == "done"
    assert (standing(named, "person", "fay"), roles(named, "fay")) == ("active", ["sponsor"])
    # one's own proposal is taken back by oneself, another's is declined
    for looking, reason in ((alice, "a slip"), (dan, "not Gus's key")):
        change = proposed(alice, held, "propose-person", id="gus", name="Gus", key=public(named, "gus"), role=["admin"])
        assert looking.act(held[looking.name], "decline-change", change_id=change, reason=reason).status_code == 303
        assert change not in waiting(named)
    assert standing(named, "person", "gus") is None


WRONG = {
    "another reason": ({"reason": "signed for this"}, {}, "STATEMENT_UNTRUSTED"),
    "another agent": ({"agent": "mover"}, {}, "STATEMENT_UNTRUSTED"),
    "another act": ({"act": "restore-agent"}, {}, "STATEMENT_UNTRUSTED"),
    "another person": ({"by": "dan"}, {}, "STATEMENT_UNTRUSTED"),
    "another issuer": ({"issuer": "http://localhost:8701/ztpm"}, {}, "STATEMENT_UNTRUSTED"),
    "another nonce": ({"nonce": "A" * 32}, {}, "STATEMENT_UNTRUSTED"),
    "another standing": ({"standing": "suspended"}, {}, "STATEMENT_UNTRUSTED"),
    "one member more": ({"more": "x"}, {}, "STATEMENT_UNTRUSTED"),
    "another page": ({}, {"origin": "http://localhost:8701"}, "STATEMENT_UNTRUSTED"),
    "a frame": ({}, {"crossOrigin": True}, "STATEMENT_UNTRUSTED"),
    "nobody verified": ({}, {"flags": 1}, "STATEMENT_UNTRUSTED"),
    "a registration": ({}, {"type": "webauthn.create"}, "STATEMENT_WRONG_KIND"),
}


@pytest.mark.clause("CON-12")
def test_a_word_that_is_not_exactly_this_act_does_nothing(named, held):
    alice, other = Looking(named.world, "alice"), Looking(named.world, "alice")
    ask = {"agent": "planner", "reason": "r"}
    before = entries(named)
    for what, (signed, changes, code) in WRONG.items():
        alice.act(held["alice"], "suspend-agent", signed=signed, changes=changes, **ask)
        assert alice.code() == code, what
    # the word of another kind of act over the very same members; a login's; another person's passkey
    said, sealed = alice.asked("suspend-agent", **ask)
    others = [challenge(word, said) for word in Word if word is not Word.ADMINISTRATION]
    others += [login_challenge(NAMED, said["nonce"]),
               revoking.bound(NAMED, said["nonce"], by="alice", kind="agent", id_="planner", reason="r")]  # fmt: skip
    page = alice.page
    for expected in others:
        alice.page = page
        alice.post(f"{AT}/acts", {"sealed": sealed} | held["alice"].body(expected))
        assert alice.code() == "STATEMENT_UNTRUSTED"
    alice.page = page
    alice.post(f"{AT}/acts", {"sealed": sealed} | held["dan"].body(acts.bound(said)))
    assert alice.code() == "NOT_PERMITTED"
    # an act's word is no revocation
    form, nonce = alice.question("agent", "planner")
    alice.post(f"{AT}/revocations", form | {"reason": "r"} | held["alice"].body(acts.bound(said | {"nonce": nonce})))
    assert alice.code() == "STATEMENT_UNTRUSTED"
    # a seal of another session, a changed one, one of another kind of question, one of long ago
    said, sealed = other.asked("suspend-agent", **ask)
    for kept in (sealed, sealed[:-2] + "AA", form["sealed"], "", "x.y"):
        alice.asked("suspend-agent", **ask)
        alice.post(f"{AT}/acts", {"sealed": kept} | held["alice"].body(acts.bound(said)))
        assert alice.code() == "LOGIN_OVER", kept
    said, sealed = alice.asked("suspend-agent", **ask)
    named.world.clock.at_s += words.QUESTION_S + 1
    alice.post(f"{AT}/acts", {"sealed": sealed} | held["alice"].body(acts.bound(said)))
    assert alice.code() == "LOGIN_OVER"
    assert (standing(named, "agent", "planner"), entries(named)) == ("active", before)


@pytest.mark.clause("CON-12")
def test_each_word_counts_once(named, held):
    alice = Looking(named.world, "alice")
    said, sealed = alice.asked("propose-roles", person="bob", role=["sponsor", "approver"])
    sent, page = {"sealed": sealed} | held["alice"].body(acts.bound(said)), alice.page
    assert alice.post(f"{AT}/acts", sent).status_code == 303
    alice.page, before = page, entries(named)
    alice.post(f"{AT}/acts", sent)
    assert (alice.code(), entries(named)) == ("LOGIN_OVER", before)
    (change,) = waiting(named)
    named.world.people["alice"].decline_change(change, "tried")
    # pressed twice at once
    said, sealed = alice.asked("propose-roles", person="bob", role=["sponsor", "approver"])
    sent, twin = {"sealed": sealed} | held["alice"].body(acts.bound(said)), Looking(named.world)
    twin.cookies, twin.page = dict(alice.cookies), alice.page
    with ThreadPoolExecutor(2) as both:
        answers = list(both.map(lambda one: one.post(f"{AT}/acts", sent).status_code, (alice, twin)))
    assert (sorted(answers), len(waiting(named))) == ([303, 409], 1)
    (change,) = waiting(named)
    named.world.people["alice"].decline_change(change, "tried")


@pytest.mark.clause("CON-11")
@pytest.mark.parametrize("given", [
    (acts.Act.SUSPEND, {"agent": ["mover"], "reason": ["ü & <b> = ?"]}),
    (acts.Act.RESTORE, {"agent": ["mover"], "reason": ["r"], "relearn": ["yes"]}),
    (acts.Act.PROPOSE_ROLES, {"person": ["bob"], "role": ["auditor", "sponsor"]}),
    (acts.Act.CONFIRM, {"change_id": ["0" * 32]}),
])  # fmt: skip
def test_a_question_can_be_asked_again_from_what_was_said(given):
    act, form = given
    said = acts.read(act, form)
    again = parse_qs(urlencode(acts.fields(act, said | {"nonce": "n"})))
    assert again == form and acts.read(act, again) == said


@pytest.mark.clause("CON-12")
def test_forms_of_other_sites_and_sessions_that_are_over_do_nothing(named, held):
    alice, before = Looking(named.world, "alice"), entries(named)
    said, sealed = alice.asked("suspend-agent", agent="planner", reason="r")
    sent, page = {"sealed": sealed} | held["alice"].body(acts.bound(said)), alice.page
    for headers in ({"origin": "http://evil.example"}, {"sec-fetch-site": "cross-site"}):
        alice.page = page
        alice.post(f"{AT}/acts", sent, **headers)
        assert alice.code() == "FORM_FORGED"
    alice.page = page
    alice.post(f"{AT}/acts", sent | {"reason": "another"})
    assert alice.code() == "FORM_MALFORMED"
    # without JavaScript the form has no word
    alice.page = page
    alice.post(f"{AT}/acts", {name: "" for name in words.ASSERTED} | {"sealed": sealed})
    assert alice.code() == "FORM_MALFORMED" and "<noscript>" in page.text and "ztpm agent suspend planner" in page.text
    alice.page = page
    assert entries(named) == before
    named.world.clock.at_s += 1_801
    alice.post(f"{AT}/acts", sent)
    assert (alice.code(), alice.asked_anew()) == ("NOT_LOGGED_IN", f"{AT}/acts/suspend-agent?agent=planner&reason=r")
    # nor does a browser that has lost its session, or a seal that is none of ours
    for seal, again in ((sealed, "/acts/suspend-agent?agent=planner&reason=r"), ("forged.seal", "")):
        lost = Looking(named.world)
        lost.page = page
        lost.post(f"{AT}/acts", sent | {"sealed": seal})
        assert (lost.code(), lost.asked_anew()) == ("NOT_LOGGED_IN", AT + again)
        lost.page = page
        lost.post(f"{AT}/acts", sent, origin="http://evil.example")
        assert (lost.code(), lost.asked_anew()) == ("FORM_FORGED", None)
    assert (standing(named, "agent", "planner"), entries(named)) == ("active", before)
    stranger = Looking(named.world)
    answer = stranger.get(f"{AT}/acts/suspend-agent?agent=planner&reason=r")
    assert (answer.status_code, answer.headers["location"].startswith("/ztpm/login?")) == (303, True)


@pytest.mark.clause("CON-14")
def test_what_changed_meanwhile_is_told_and_nothing_is_done(named, held):
    alice, dan = Looking(named.world, "alice"), Looking(named.world, "dan")
    # an agent that another administrator suspended
    said, sealed = alice.asked("suspend-agent", agent="planner", reason="r")
    dan.act(held["dan"], "suspend-agent", agent="planner", reason="first")
    alice.post(f"{AT}/acts", {"sealed": sealed} | held["alice"].body(acts.bound(said)))
    assert alice.code() == "CONFLICT"
    dan.act(held["dan"], "restore-agent", agent="planner", reason="r")
    # roles that two others changed: the first proposal of the same is not made on top of it
    said, sealed = alice.asked("propose-roles", person="bob", role=["sponsor", "auditor"])
    change = named.world.people["dan"].propose_roles("bob", ["auditor"])
    named.world.people["alice"].confirm_change(change)
    alice.post(f"{AT}/acts", {"sealed": sealed} | held["alice"].body(acts.bound(said)))
    assert alice.code() == "CONFLICT"
    assert (roles(named, "bob"), waiting(named)) == (["auditor"], {})
    # who became an approver between page and word does not end on one word
    said, sealed = alice.asked("end-person", person="bob", reason="left")
    assert said["act"] == "end-person"
    change = named.world.people["dan"].propose_roles("bob", ["sponsor", "approver"])
    named.world.people["alice"].confirm_change(change)
    alice.post(f"{AT}/acts", {"sealed": sealed} | held["alice"].body(acts.bound(said)))
    assert (alice.code(), standing(named, "person", "bob")) == ("CONFLICT", "active")
    change = named.world.people["dan"].propose_roles("bob", ["sponsor"])
    named.world.people["alice"].confirm_change(change)
    # two administrators decline the same: the second is told
    change = named.world.people["alice"].propose_roles("bob", ["auditor"])
    said, sealed = dan.asked("decline-change", change_id=change, reason="r")
    named.world.people["alice"].decline_change(change, "a slip")
    dan.post(f"{AT}/acts", {"sealed": sealed} | held["dan"].body(acts.bound(said)))
    assert dan.code() == "CHANGE_OVER"


@pytest.mark.clause("CON-11")
@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("/acts/anything", "NOT_FOUND"),
        ("/acts/suspend-agent", "QUERY_MALFORMED"),
        ("/acts/suspend-agent?agent=planner", "QUERY_MALFORMED"),
        ("/acts/suspend-agent?agent=planner&reason=", "QUERY_MALFORMED"),
        ("/acts/suspend-agent?agent=planner&reason=a&reason=b", "QUERY_MALFORMED"),
        ("/acts/suspend-agent?agent=planner&reason=a&more=b", "QUERY_MALFORMED"),
        ("/acts/suspend-agent?agent=nobody&reason=a", "NOT_PERMITTED"),
        ("/acts/suspend-agent?agent=alice&reason=a", "NOT_PERMITTED"),
        ("/acts/restore-agent?agent=planner&reason=a&relearn=perhaps", "QUERY_MALFORMED"),
        ("/acts/propose-roles?person=bob", "QUERY_MALFORMED"),
        ("/acts/propose-roles?person=bob&role=king", "QUERY_MALFORMED"),
        ("/acts/propose-roles?person=planner&role=admin", "NOT_FOUND"),
        ("/acts/end-person?person=nobody&reason=a", "NOT_FOUND"),
        ("/acts/confirm-change?change_id=x", "QUERY_MALFORMED"),
        ("/acts/propose-person?id=Upper Case&name=N&key=k&role=admin", "QUERY_MALFORMED"),
    ],
)
def test_what_is_no_act_is_told_with_its_code(named, held, path, code):
    alice = Looking(named.world, "alice")
    before = entries(named)
    alice.get(AT + path)
    assert (alice.code(), entries(named)) == (code, before)


@pytest.mark.clause("CON-11", "CON-4")
@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_texts_are_refused_or_spelled(named, held, what):
    alice, text = Looking(named.world, "alice"), HOSTILE[what]
    said, _ = alice.asked("suspend-agent", agent="planner", reason=text)
    shown = alice.page.text
    if what in {"bidi", "long"}:
        assert alice.code() == "QUERY_MALFORMED"
    else:
        assert said["reason"] == text
    assert "<script>alert" not in shown and "<img" not in shown and "\u202e" not in shown and "\u0430lice" not in shown
    for field in ("person", "id", "name", "key", "model"):
        alice.get(f"{AT}/acts/register-agent?{urlencode({field: text})}")
        assert alice.code() == "QUERY_MALFORMED" and text not in alice.page.text
    assert text not in alice.see(f"/people?{urlencode({'after': text})}")


@pytest.mark.clause("CON-11")
def test_who_is_no_administrator_changes_no_people(named, held):
    for name in ("bob", "carol"):
        looking = Looking(named.world, name)
        shown = looking.see("/people")
        assert "propose-roles" not in shown and "propose-person" not in shown and "end-person" in shown
        for path in ("propose-roles?person=bob&role=admin", "end-person?person=dan&reason=a",
                     f"propose-person?id=eve&name=Eve&key={public(named, 'eve')}&role=admin"):  # fmt: skip
            looking.get(f"{AT}/acts/{path}")
            assert looking.code() == "NOT_PERMITTED", path


@pytest.mark.clause("CON-11")
def test_without_a_passkey_the_page_says_the_command_filled_in(named):
    named.world.person("erin", "admin")
    named.world.people["erin"] = named.world.caller(Operator, "erin")
    looking = Looking(named.world, "erin")
    for path, line in (
        (
            "suspend-agent?agent=planner&reason=it's odd",
            "ztpm agent suspend planner --reason &#39;it&#39;&#34;&#39;&#34;&#39;s odd&#39; --as erin",
        ),
        (
            "restore-agent?agent=planner&reason=r&relearn=yes",
            "ztpm agent restore planner --reason r --relearn --as erin",
        ),
        ("propose-roles?person=bob&role=sponsor", "ztpm person roles bob --role sponsor --as erin"),
        ("end-person?person=bob&reason=left", "ztpm person retire bob --reason left --as erin"),
    ):
        shown = looking.see(f"/acts/{path}")
        assert line in shown and "data-word" not in shown, path


@pytest.mark.clause("CON-11", "CON-14")
def test_the_last_administrator_stays(named, held):
    """The last of this file: the others have left by it."""
    world = named.world
    alice = Looking(world, "alice")
    for name in {row["id"] for row in world.people["alice"].persons() if "admin" in row["roles"]} - {"alice"}:
        world.people[name].disable_person(name, "left")
    alice.act(held["alice"], "end-person", person="alice", reason="me, too")
    assert alice.code() == "LAST_ADMINISTRATOR"
    alice.act(held["alice"], "propose-roles", person="alice", role=["sponsor"])
    assert alice.code() == "LAST_ADMINISTRATOR"
    assert (standing(named, "person", "alice"), waiting(named)) == ("active", {})
