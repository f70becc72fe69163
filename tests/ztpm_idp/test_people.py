"""Changes of approvers and administrators by two people, recovery by the root key, and keys without a second vote."""

from __future__ import annotations

import json

import pytest
from capabilities.values.caps import DEFAULT
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.test_lending import chain_of
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World

from capabilities.keys import keys
from capabilities.statements import registry
from ztpm_idp.client import ClientError, Operator

pytestmark = pytest.mark.long

DAY_S = 86_400
EVERYTHING = ("sponsor", "approver", "admin")


class Trio(World):
    """Alice, bob and carol, each with all roles, as `ztpm init` makes them."""

    ROLES = {"alice": EVERYTHING, "bob": EVERYTHING, "carol": EVERYTHING}


@pytest.fixture
def trio(tmp_path):
    with Trio(tmp_path) as made:
        yield made


def code_of(attempt):
    with pytest.raises(ClientError) as caught:
        attempt()
    return caught.value.code


def fresh(world, name):
    """Public half of a new key, kept in the world under this name."""
    world.private[name] = keys.generate()
    return keys.public_raw(world.private[name])


def by(world, person, key):
    """The person with another of its keys."""
    return Operator(person, world.private[key], ISSUER, transport=world.transport, now=world.clock)


def snapshot(world):
    with world.known("bob") as http:
        text = http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
    return registry.open(text, world.trust.registry, DEFAULT)


def standing(world, viewer="alice"):
    return {row["id"]: row["status"] for row in world.people[viewer].persons()}


def kinds(world):
    return [json.loads(line)["kind"] for line in world.people["carol"].export_ledger().splitlines()[:-1]]


# --- the two attacks ----------------------------------------------------------------------------------------------------


def test_a_second_key_under_another_name_takes_a_second_person(trio):
    carol, raw = trio.people["carol"], fresh(trio, "carol-2")
    assert code_of(lambda: carol.register_person("mallory", "Mallory", raw, ["approver"])) == "TWO_PEOPLE_NEEDED"
    assert code_of(lambda: carol.register_person("mallory", "Mallory", raw, ["admin"])) == "TWO_PEOPLE_NEEDED"
    change = carol.propose_person("mallory", "Mallory", raw, ["approver"])
    assert code_of(lambda: carol.confirm_change(change)) == "CHANGE_YOURS"
    assert "mallory" not in standing(trio)
    assert code_of(by(trio, "mallory", "carol-2").persons) == "CALLER_UNKNOWN"


def test_two_keys_of_one_person_are_one_vote(trio):
    cell, carol, raw = Cell(trio), trio.people["carol"], fresh(trio, "carol-2")
    assert trio.people["bob"].confirm_change(carol.propose_key(raw)) == "done"
    assert [entry.id for entry in snapshot(trio).approvers] == ["alice", "bob", "carol", "carol"]
    assert [len(row["keys"]) for row in carol.persons()] == [1, 1, 2]
    opened = by(trio, "carol", "carol-2").open_tier_4(
        audience=AUDIENCE, agent="mover", object="ur3e", operation="move_joint"
    )
    ask_id, _ = cell.taken(tier=4, approvers=2, opening_id=opened)
    assert by(trio, "carol", "carol-2").approve(ask_id)["state"] == "open"
    assert code_of(lambda: carol.approve(ask_id)) == "VOTED_BEFORE"
    assert trio.people["bob"].approve(ask_id)["state"] == "granted"
    assert code_of(lambda: trio.people["bob"].propose_person("erin", "Erin", raw, ["approver"])) == "KEY_IN_USE"
    assert code_of(lambda: trio.people["bob"].register_pep("cell-9", raw, [AUDIENCE])) == "KEY_IN_USE"


@pytest.mark.parametrize("door", ["disable", "sponsor", "key"])
def test_one_administrator_ends_no_approver_and_no_administrator(trio, door):
    bob = trio.people["bob"]

    def end(name):
        match door:
            case "disable":
                return bob.disable_person(name, "r")
            case "sponsor":
                return bob.revoke("sponsor", name, "r")
            case "key":
                return bob.revoke("key", keys.thumbprint(keys.public_raw(trio.private[name])), "r")

    for name in ("alice", "carol"):
        assert code_of(lambda: end(name)) == "TWO_PEOPLE_NEEDED"
    assert set(standing(trio).values()) == {"active"}
    end("bob")
    assert standing(trio) == {"alice": "active", "bob": "revoked", "carol": "active"}


@pytest.mark.parametrize("door", ["disable", "sponsor", "key"])
def test_the_last_administrator_cannot_be_ended(trio, door):
    for name in ("alice", "bob"):
        trio.people[name].disable_person(name, "left")
    carol = trio.people["carol"]
    attempts = {
        "disable": lambda: carol.disable_person("carol", "r"),
        "sponsor": lambda: carol.revoke("sponsor", "carol", "r"),
        "key": lambda: carol.revoke("key", keys.thumbprint(keys.public_raw(trio.private["carol"])), "r"),
    }
    assert code_of(attempts[door]) == "LAST_ADMINISTRATOR"
    assert standing(trio, "carol")["carol"] == "active"


# --- two people -----------------------------------------------------------------------------------------------------------


def test_another_administrator_confirms(world):
    """In the world alice and dan are administrators, bob only sponsors, and carol only approves."""
    alice, raw = world.people["alice"], fresh(world, "erin")
    for who in ("bob", "carol"):
        assert code_of(lambda: world.people[who].propose_person("erin", "E", raw, ["approver"])) == "NOT_PERMITTED"
    change = alice.propose_person("erin", "Erin", raw, ["approver", "admin"])
    shown = {row["change_id"]: row for row in world.people["dan"].changes()}
    assert shown[change] == {
        "change_id": change, "kind": "person", "person": "erin", "name": "Erin", "key": keys.thumbprint(raw),
        "roles": ["admin", "approver"], "reason": "", "by": "alice", "state": "open",
        "until": int(world.clock()) + DAY_S, "login": "", "passkey": False, "confirmed": [], "declined": [],
    }  # fmt: skip
    for who in ("bob", "carol"):
        assert code_of(lambda: world.people[who].confirm_change(change)) == "NOT_PERMITTED"
    assert world.people["dan"].confirm_change(change) == "done"
    assert code_of(lambda: world.people["dan"].confirm_change(change)) == "CHANGE_OVER"
    assert by(world, "erin", "erin").changes() == []
    assert snapshot(world).approver("erin").key == raw
    assert kinds(world)[-4:] == ["change-proposed", "change-confirmed", "person-registered", "change-ended"]
    said = [json.loads(line)["body"] for line in alice.export_ledger().splitlines()[-5:-3]]
    assert said[0]["told"] == ["alice", "dan"]
    assert [keys.thumbprint(keys.public_raw(world.private[who])) for who in ("alice", "dan")] == [
        _signer(body["signed"]["proof"]) for body in said
    ]


def _signer(proof):
    header = json.loads(keys.unb64u(proof.split(".")[0]))
    return keys.thumbprint(keys.unb64u(header["jwk"]["x"]))


def test_two_administrators_end_a_third_person_and_the_person_has_no_say(trio):
    alice, bob, carol = (trio.people[name] for name in ("alice", "bob", "carol"))
    trio.agent("mover", sponsor="carol")
    change = alice.propose_end("carol", "key stolen")
    assert code_of(lambda: carol.confirm_change(change)) == "CHANGE_YOURS"
    assert code_of(lambda: carol.decline_change(change, "no")) == "CHANGE_YOURS"
    assert bob.confirm_change(change) == "done"
    assert standing(trio)["carol"] == "revoked"
    assert {row["id"]: row["status"] for row in bob.agents()} == {"mover": "revoked"}
    assert code_of(lambda: bob.confirm_change(alice.propose_end("bob", "r"))) == "CHANGE_YOURS"


def test_a_change_is_declined_withdrawn_or_over(world):
    alice, dan, raw = world.people["alice"], world.people["dan"], fresh(world, "erin")
    for declined_by in (dan, alice):
        change = alice.propose_person("erin", "Erin", raw, ["approver"])
        assert declined_by.decline_change(change, "who is erin?") == "declined"
        assert code_of(lambda: dan.confirm_change(change)) == "CHANGE_OVER"
    change = alice.propose_person("erin", "Erin", raw, ["approver"])
    world.clock.at_s += DAY_S
    assert code_of(lambda: dan.confirm_change(change)) == "CHANGE_OVER"
    assert dan.changes() == []
    assert code_of(lambda: dan.confirm_change("0" * 32)) == "CHANGE_UNKNOWN"
    assert "erin" not in standing(world)


def test_what_a_change_rests_on_is_judged_when_it_is_confirmed(trio):
    alice, bob, carol = (trio.people[name] for name in ("alice", "bob", "carol"))
    raw = fresh(trio, "erin")
    first, second = (who.propose_person("erin", "Erin", raw, ["approver"]) for who in (alice, bob))
    of_bob = bob.propose_person("frank", "Frank", fresh(trio, "frank"), ["admin"])
    assert carol.confirm_change(first) == "done"
    assert code_of(lambda: carol.confirm_change(second)) == "ALREADY_REGISTERED"
    bob.disable_person("bob", "left")
    assert code_of(lambda: carol.confirm_change(of_bob)) == "CHANGE_OVER"
    assert "frank" not in standing(trio)


def test_nobody_fills_the_list_of_changes(trio):
    alice = trio.people["alice"]
    for n in range(8):
        alice.propose_person(f"p{n}", "P", fresh(trio, f"p{n}"), ["approver"])
    assert code_of(lambda: alice.propose_end("bob", "r")) == "TOO_MANY_CHANGES"
    assert len(trio.people["bob"].changes()) == 8
    trio.people["bob"].propose_end("carol", "r")


def test_a_lost_key_ends_alone_while_the_person_has_another(trio):
    carol, raw = trio.people["carol"], fresh(trio, "carol-2")
    trio.people["bob"].confirm_change(carol.propose_key(raw))
    first = keys.thumbprint(keys.public_raw(trio.private["carol"]))
    second = by(trio, "carol", "carol-2")
    before = snapshot(trio)
    second.revoke("key", first, "lost")
    assert code_of(carol.persons) == "CALLER_INACTIVE"
    assert second.persons()[2]["keys"] == [keys.thumbprint(raw)]
    after = snapshot(trio)
    assert after.version > before.version
    assert after.approver("carol").key == raw
    # A key that was a person's is nobody else's, ever.
    old = keys.public_raw(trio.private["carol"])
    assert code_of(lambda: second.propose_key(old)) == "KEY_IN_USE"
    second.revoke("key", keys.thumbprint(raw), "lost, too")
    assert standing(trio)["carol"] == "revoked"


# --- one administrator --------------------------------------------------------------------------------------------------


class Alone(World):
    """A cell with a single administrator."""

    ROLES = {"alice": EVERYTHING, "bob": ("sponsor",), "carol": ("approver",)}


def test_a_single_administrator_works_with_sponsors_and_parts_and_changes_no_approver(tmp_path):
    with Alone(tmp_path) as world:
        alice = world.people["alice"]
        alice.register_person("frank", "Frank", fresh(world, "frank"), ["sponsor"])
        alice.disable_person("frank", "left")
        world.pep()
        world.agent("mover", sponsor="bob")
        change = alice.propose_person("erin", "Erin", fresh(world, "erin"), ["approver"])
        for who in ("alice", "carol", "bob"):
            assert code_of(lambda: world.people[who].confirm_change(change)) in {"CHANGE_YOURS", "NOT_PERMITTED"}
        assert code_of(lambda: alice.disable_person("carol", "r")) == "TWO_PEOPLE_NEEDED"
        assert code_of(lambda: alice.disable_person("alice", "r")) == "LAST_ADMINISTRATOR"


# --- recovery by the root key ---------------------------------------------------------------------------------------------


def root(world):
    """The root key's holder."""
    return Operator("root", world.idp_keys.root, ISSUER, transport=world.transport, now=world.clock)


def test_the_root_key_makes_an_administrator_after_a_day_and_all_administrators_are_told(tmp_path):
    with Alone(tmp_path) as world:
        cell, alice = Cell(world), world.people["alice"]
        assert alice.notice == ""
        raw = fresh(world, "erin")
        change = root(world).recover("erin", "Erin", raw)
        alice.agents()
        assert change in alice.notice
        world.people["carol"].agents()
        assert world.people["carol"].notice == ""  # no administrator
        erin = by(world, "erin", "erin")
        assert code_of(erin.changes) == "CALLER_UNKNOWN"
        world.clock.at_s += DAY_S - 1
        assert code_of(erin.changes) == "CALLER_UNKNOWN"
        waiting = alice.propose_person("frank", "Frank", fresh(world, "frank"), ["approver"])
        opened = world.people["carol"].open_tier_4(
            audience=AUDIENCE, agent="mover", object="ur3e", operation="move_joint"
        )
        assert opened in {row["opening_id"] for row in alice.openings()}
        world.clock.at_s += 1
        # One administrator alone, who may be the thief, stops no recovery.
        assert alice.decline_change(change, "not mine") == "open"
        assert [row["change_id"] for row in erin.changes()] == []
        assert [row["roles"] for row in erin.persons() if row["id"] == "erin"] == [["admin"]]
        assert alice.openings() == []
        assert cell.answers().openings == ()
        assert code_of(lambda: erin.confirm_change(waiting)) == "CHANGE_OVER"
        told = [json.loads(line) for line in alice.export_ledger().splitlines()[:-1]]
        proposed = next(e for e in told if e["kind"] == "change-proposed" and e["body"]["kind"] == "recovery")
        assert proposed["body"]["told"] == ["alice"]
        assert _signer(proposed["body"]["signed"]["proof"]) == keys.thumbprint(keys.public_raw(world.idp_keys.root))
        assert [e["kind"] for e in told[-4:]] == ["person-registered", "change-ended", "change-ended", "opening-closed"]
        alice.agents()
        assert alice.notice == ""


def test_two_administrators_confirm_a_recovery_at_once_or_decline_it(trio):
    alice, bob = trio.people["alice"], trio.people["bob"]
    kept, refused = (root(trio).recover(name, name.title(), fresh(trio, name)) for name in ("erin", "frank"))
    assert alice.decline_change(refused, "whose?") == "open"
    assert bob.decline_change(refused, "nobody's") == "declined"
    assert alice.confirm_change(kept) == "open"
    assert code_of(lambda: alice.confirm_change(kept)) == "VOTED_BEFORE"
    assert bob.confirm_change(kept) == "done"
    assert standing(trio)["erin"] == "active"
    trio.clock.at_s += 2 * DAY_S
    assert code_of(by(trio, "frank", "frank").persons) == "CALLER_UNKNOWN"


def test_an_administrator_who_lost_the_key_comes_back_with_another(tmp_path):
    with Alone(tmp_path) as world:
        raw = fresh(world, "alice-2")
        root(world).recover("alice", "Alice", raw)
        world.clock.at_s += DAY_S
        back = by(world, "alice", "alice-2")
        assert [row["keys"] for row in back.persons() if row["id"] == "alice"] == [[keys.thumbprint(raw)]]
        assert code_of(world.people["alice"].agents) == "CALLER_INACTIVE"
        back.register_person("frank", "Frank", fresh(world, "frank"), ["sponsor"])


def test_a_recovery_takes_the_mandates_along_that_the_lost_keys_signed(tmp_path):
    with Alone(tmp_path) as world:
        world.agent("mover")
        week = world.scope(not_after=int(world.clock()) + 7 * DAY_S)
        mandate_id = world.people["alice"].sign_mandate("mover", week, purpose="p")
        root(world).recover("alice", "Alice", fresh(world, "alice-2"))
        world.clock.at_s += DAY_S
        (told,) = by(world, "alice", "alice-2").mandates()
        assert (told["mandate_id"], told["state"]) == (mandate_id, "revoked")
        assert code_of(lambda: world.agents["mover"].draw(mandate_id)) == "MANDATE_REVOKED"


def test_only_the_root_key_recovers(trio):
    raw = fresh(trio, "erin")
    for key in (trio.private["alice"], trio.idp_keys.attester, trio.idp_keys.registry, keys.generate()):
        thief = Operator("root", key, ISSUER, transport=trio.transport, now=trio.clock)
        assert code_of(lambda: thief.recover("erin", "Erin", raw)) == "NOT_PERMITTED"
    holder = root(trio)
    assert code_of(lambda: holder.recover("dora", "Dora", keys.public_raw(trio.private["bob"]))) == "KEY_IN_USE"
    trio.people["alice"].register_person("sven", "Sven", fresh(trio, "sven"), ["sponsor"])
    assert code_of(lambda: holder.recover("sven", "Sven", raw)) == "ALREADY_REGISTERED"
    holder.recover("erin", "Erin", raw)
    trio.clock.at_s += 8 * DAY_S  # nobody came
    assert code_of(by(trio, "erin", "erin").persons) == "CALLER_UNKNOWN"


# --- roles, and what is left behind ---------------------------------------------------------------------------------------


def test_roles_are_changed_by_two_and_what_stood_on_them_ends(world):
    alice, dan = world.people["alice"], world.people["dan"]
    world.person("eve", "sponsor", "approver")
    eve = by(world, "eve", "eve")
    cell = Cell(world)
    token = lend(world, eve)
    assert cell.post("eve", "/openings", {"opening": cell.opening("eve")}).status_code == 201
    ask_id, text = cell.taken()
    assert cell.post("eve", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text, "eve")}).json()["state"] == "granted"
    for person, roles, code in (
        ("nobody", ["admin"], "NOT_FOUND"),
        ("mover", ["admin"], "NOT_FOUND"),
        ("eve", ["approver", "sponsor"], "ALREADY_REGISTERED"),
    ):
        assert code_of(lambda p=person, r=roles: alice.propose_roles(p, r)) == code
    assert code_of(lambda: eve.propose_roles("eve", ["admin"])) == "NOT_PERMITTED"
    change = alice.propose_roles("eve", ["admin"])
    assert code_of(lambda: eve.confirm_change(change)) == "NOT_PERMITTED"
    assert code_of(lambda: alice.confirm_change(change)) == "CHANGE_YOURS"
    assert dan.confirm_change(change) == "done"
    assert next(row["roles"] for row in alice.persons() if row["id"] == "eve") == ["admin"]
    # what she lent, opened and approved ends with the roles for it, and she does not
    assert {("token", token)} == {(b["kind"], b["id"]) for b in entries(cell, "revoked")}
    assert (cell.told(ask_id).state, cell.answers().openings) == ("open", ())
    assert "eve" not in {entry.id for entry in snapshot(world).approvers}
    assert eve.changes() == []
    # and back: her key votes again
    dan.confirm_change(alice.propose_roles("eve", ["approver"]))
    assert "eve" in {entry.id for entry in snapshot(world).approvers}


def test_off_boarding_is_one_command_and_one_run_of_epochs(world):
    """Chains, agents, mandates, openings and asks of a person end together, in the transaction of its end."""
    world.person("eve", "sponsor", "approver")
    eve, cell = by(world, "eve", "eve"), Cell(world)
    lend(world, eve)
    mandate = eve.sign_mandate("eve-mover", world.scope(delegates=frozenset()), purpose="")
    assert cell.post("eve", "/openings", {"opening": cell.opening("eve")}).status_code == 201
    ask_id, text = cell.taken(sponsor="eve", agent="eve-mover")
    assert cell.told(ask_id).state == "open"
    world.end("eve")
    assert [(b["kind"], b["id"]) for b in entries(cell, "revoked")] == [
        ("sponsor", "eve"),
        ("agent", "eve-mover"),
    ]
    assert world.people["alice"].mandate(mandate)["state"] == "ended"
    assert (cell.told(ask_id).state, cell.answers().openings) == ("expired", ())
    refused = cell.post("carol", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text)})
    assert refused.json()["code"] == "ASK_OVER"
    assert [line["kind"] for line in cell.ledger()][-3:] == ["opening-closed", "change-ended", "vote-refused"]


def entries(cell, kind):
    return [line["body"] for line in cell.ledger() if line["kind"] == kind]


def lend(world, person):
    """The id of a token that this person lent to an agent of its own."""
    world.people["eve"] = person
    agent = world.agent("eve-mover", sponsor="eve")
    return chain_of(world, person.issue(agent, world.scope(delegates=frozenset()), purpose="p").token).token_id
