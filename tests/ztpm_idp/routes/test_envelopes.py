"""Envelopes at the provider: signed by an approver, carried as they came, revoked by any, ended with their people."""

from __future__ import annotations

import secrets

import pytest
from capabilities.values.caps import DEFAULT
from msgspec import structs
from tests.unread import unread
from tests.ztpm_idp.asks import AGENT, PEP, Cell
from tests.ztpm_idp.world import World
from ztpm_idp.client.envelopes import Bounds, around

from capabilities.keys import keys
from capabilities.statements.people import ask, envelope
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.clause("ENV-1")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with World(tmp_path_factory.mktemp("envelopes")) as world:
        yield Cell(world)


BOUNDS = Bounds(index_milli=2_700, speed_um_s=250_000, uses=3, lifetime_s=300, room={"q0": 1_000})


def made(cell, approver="carol", **changes):
    shown = ask.open(cell.text(), {keys.public_raw(cell.world.private[PEP])}, DEFAULT)
    signed = around(shown, BOUNDS, approver=approver, envelope_id=secrets.token_hex(16), at=cell.now)
    return structs.replace(signed, **changes)


def post(cell, who, signed, *, key=None):
    text = unread(envelope, signed, cell.world.private[key or who])
    return cell.post(who, "/envelopes", {"envelope": text}), text


def test_an_envelope_is_carried_as_it_was_signed_until_it_is_revoked(cell):
    carol, signed = cell.world.people["carol"], made(cell)
    answer, text = post(cell, "carol", signed)
    assert (answer.status_code, answer.json()) == (201, {"envelope_id": signed.envelope_id})
    assert post(cell, "carol", signed)[0].status_code == 200
    assert text in cell.answers().envelopes
    (row,) = carol.envelopes()
    assert (row["envelope_id"], row["approver"], row["envelope"]) == (signed.envelope_id, "carol", text)
    cell.world.people["alice"].revoke_envelope(signed.envelope_id, "enough")
    cell.world.people["alice"].revoke_envelope(signed.envelope_id, "again")
    assert (cell.answers().envelopes, carol.envelopes()) == ((), [])
    kinds = [line["kind"] for line in cell.ledger()]
    assert (kinds.count("envelope-signed"), kinds.count("envelope-revoked")) == (1, 1)


REFUSED = {
    "by a sponsor": (dict(who="bob", approver="bob"), "NOT_PERMITTED"),
    "by an agent": (dict(who=AGENT, approver="carol", key="carol"), "NOT_PERMITTED"),
    "with another's key": (dict(key="alice"), "ENVELOPE_NOT_YOURS"),
    "in another's name": (dict(approver="alice"), "ENVELOPE_NOT_YOURS"),
    "with a stranger's key": (dict(key="stranger"), "STATEMENT_UNTRUSTED"),
    "for later": (dict(not_before=1_900_000_000, not_after=1_900_000_600), "ENVELOPE_OUT_OF_TIME"),
    "over already": (dict(not_before=1_799_999_000, not_after=1_799_999_500), "ENVELOPE_OUT_OF_TIME"),
    "for too long": (dict(not_after=1_800_000_601), "STATEMENT_MALFORMED"),
    "above tier 3": (dict(tier=4), "STATEMENT_MALFORMED"),
    "too often": (dict(uses=11), "STATEMENT_MALFORMED"),
    "for no agent": (dict(agent="nobody"), "NOT_FOUND"),
    "for a person": (dict(agent="bob"), "NOT_FOUND"),
    "for another key": (dict(agent_key="k" * 43), "NOT_FOUND"),
    "for no audience": (dict(audience="http://127.0.0.1:1/mcp"), "NOT_FOUND"),
}


def test_a_defective_envelope_is_refused_recorded_and_carried_nowhere(cell):
    cell.world.private["stranger"] = keys.generate()
    before = len([line for line in cell.ledger() if line["kind"] == "envelope-refused"])
    for what, (changes, code) in REFUSED.items():
        who, key = changes.get("who", "carol"), changes.get("key")
        members = {name: value for name, value in changes.items() if name not in {"who", "key"}}
        answer, _ = post(cell, who, made(cell, **members), key=key)
        assert (answer.json()["code"], answer.status_code < 500) == (code, True), what
    after = len([line for line in cell.ledger() if line["kind"] == "envelope-refused"])
    assert (after - before, cell.answers().envelopes) == (len(REFUSED), ())


def test_an_id_means_one_thing(cell):
    signed = made(cell)
    post(cell, "carol", signed)
    answer, _ = post(cell, "carol", structs.replace(signed, uses=2))
    assert answer.json()["code"] == "ENVELOPE_DIFFERS"
    ask_id, _ = cell.taken()
    assert post(cell, "carol", made(cell, envelope_id=ask_id))[0].json()["code"] == "ENVELOPE_DIFFERS"
    with pytest.raises(ClientError) as raised:
        cell.world.people["bob"].revoke_envelope(signed.envelope_id, "r")
    assert raised.value.code == "NOT_PERMITTED"
    for unknown in ("0" * 32, "x"):
        with pytest.raises(ClientError) as raised:
            cell.world.people["carol"].revoke_envelope(unknown, "r")
        assert raised.value.code == "ENVELOPE_UNKNOWN"
    cell.world.people["carol"].revoke_envelope(signed.envelope_id, "r")


def test_envelopes_of_an_audience_are_few_and_end_with_their_person(cell):
    cell.world.person("eve", "approver")
    for _ in range(8):
        assert post(cell, "eve", made(cell, "eve"))[0].status_code == 201
    assert post(cell, "carol", made(cell))[0].json()["code"] == "TOO_MANY_ENVELOPES"
    assert len(cell.answers().envelopes) == 8
    cell.world.end("eve")
    assert cell.answers().envelopes == ()
    assert [line["kind"] for line in cell.ledger()].count("envelope-revoked") >= 8


def test_an_envelope_around_an_ask_bounds_what_was_asked(cell):
    shown = cell.ask()
    found = around(shown, BOUNDS, approver="carol", envelope_id="a" * 32, at=cell.now)
    sides = {side.name: (side.low, side.high) for side in found.box}
    assert sides == {
        "q0": (-1_571_796, -1_569_796), "speed": (523_599, 523_599), "acceleration": (1_400_000, 1_400_000),
    }  # fmt: skip
    assert [(seen.kind, seen.object) for seen in found.seen] == [("person-ssm", "person-7")]
    with pytest.raises(ValueError, match="no parameter"):
        around(shown, structs_room("q9"), approver="carol", envelope_id="a" * 32, at=cell.now)


def structs_room(name):
    return Bounds(index_milli=1, speed_um_s=1, uses=1, lifetime_s=1, room={name: 1})
