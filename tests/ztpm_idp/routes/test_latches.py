"""Latches at the provider: told by their enforcement point, cleared by approvers, carried as people signed."""

from __future__ import annotations

import secrets

import pytest
from capabilities.statements.people.clearing import Clearing
from capabilities.statements.people.latch import Latch, LatchCause
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT
from capabilities.values.form import plain
from capabilities.values.scope import Tier
from msgspec import structs
from tests.unread import unread
from tests.ztpm_idp.asks import AGENT, AUDIENCE, PEP, Cell
from tests.ztpm_idp.test_passkeys import NAMED, passkey, send
from tests.ztpm_idp.world import World

from capabilities.keys import keys
from capabilities.statements.people import clearing, latch, passkey_clearing
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.clause("STM-22")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with World(tmp_path_factory.mktemp("latches")) as world:
        yield Cell(world)


def fallen(cell, **changes):
    stated = {
        "latch_id": secrets.token_hex(16),
        "issuer": cell.world.issuer,
        "pep": PEP,
        "audience": AUDIENCE,
        "robot": "ur3e",
        "cause": LatchCause.WATCH,
        "reason": "IMPACT_ROSE",
        "tier": Tier.HIGH_CONSEQUENCE,
        "approvers": 1,
        "request_id": "",
        "at": cell.now,
        "no_retreat": "PERCEPTION_MISSING",
    }
    return Latch(**(stated | changes))


def told(cell, *, who=PEP, key=None, **changes):
    """Answer to the latch, and its text."""
    text = unread(latch, fallen(cell, **changes), cell.world.private[key or who])
    return cell.post(who, "/latches", {"latch": text}), text


def taken(cell, **changes):
    answer, text = told(cell, **changes)
    assert answer.status_code == 201, answer.text
    return answer.json()["latch_id"], text


def word(cell, latch_id, text, who="carol", *, key=None, **changes):
    stated = {
        "latch_id": latch_id,
        "latch_digest": digest_of(text),
        "audience": AUDIENCE,
        "robot": "ur3e",
        "cause": LatchCause.WATCH,
        "approver": who,
        "not_after": cell.now + 300,
        "at": cell.now,
    }
    return unread(clearing, Clearing(**(stated | changes)), cell.world.private[key or who])


def clear(cell, latch_id, text, who="carol", **changes):
    return cell.post(who, f"/latches/{latch_id}/clearings", {"clearing": word(cell, latch_id, text, who, **changes)})


def kinds(cell):
    return [line["kind"] for line in cell.ledger()]


def test_a_latch_waits_until_a_person_clears_it_and_the_clearing_is_carried_as_signed(cell):
    latch_id, text = taken(cell)
    assert cell.post(PEP, "/latches", {"latch": text}).status_code == 200, "told again, nothing happens"
    carol = cell.world.people["carol"]
    row = next(row for row in carol.latches() if row["latch_id"] == latch_id)
    assert (row["state"], row["robot"], row["cause"], row["approvers"]) == ("waits", "ur3e", "watch", 1)
    shown = carol.latch(latch_id)
    assert (shown.digest, shown.latch.reason, shown.state) == (digest_of(text), "IMPACT_ROSE", "waits")
    assert carol.clear_latch(shown) == "released"
    assert carol.latch(latch_id).state == "released"
    (carried,) = cell.answers().clearings
    opened = clearing.open(carried, [keys.public_raw(cell.world.private["carol"])], DEFAULT)
    assert (opened.latch_id, opened.approver) == (latch_id, "carol")
    assert {"latch-taken", "latch-clearing"} <= set(kinds(cell))
    entry = next(line for line in reversed(cell.ledger()) if line["kind"] == "latch-taken")
    assert (entry["body"]["latch_id"], entry["body"]["cause"], entry["body"]["latch"]) == (latch_id, "watch", text)


def test_after_tier_four_two_different_people_clear_it(cell):
    latch_id, text = taken(cell, tier=Tier.SAFETY_CRITICAL, approvers=2)
    assert clear(cell, latch_id, text, "carol").json()["state"] == "waits"
    assert clear(cell, latch_id, text, "carol").json()["state"] == "waits"
    assert clear(cell, latch_id, text, "carol", at=cell.now - 1).json()["code"] == "CLEARED_BEFORE"
    assert clear(cell, latch_id, text, "alice").json()["state"] == "released"


def test_a_latch_that_is_told_again_after_its_clearings_are_over_waits_again(cell):
    latch_id, text = taken(cell)
    assert clear(cell, latch_id, text, not_after=cell.now + 5).json()["state"] == "released"
    assert cell.post(PEP, "/latches", {"latch": text}).status_code == 200
    cell.world.clock.at_s += 10
    assert cell.post(PEP, "/latches", {"latch": text}).status_code == 201
    assert cell.world.people["carol"].latch(latch_id).state == "waits"


NOT_TAKEN = {
    "of a person": (dict(who="carol"), "NOT_PERMITTED"),
    "of an agent": (dict(who=AGENT), "NOT_PERMITTED"),
    "by another's key": (dict(key="carol"), "STATEMENT_UNTRUSTED"),
    "of another point": (dict(pep="another"), "NOT_PERMITTED"),
    "of another audience": (dict(audience="http://127.0.0.1:1/mcp"), "NOT_PERMITTED"),
    "of another provider": (dict(issuer="https://idp.example"), "NOT_PERMITTED"),
    "with one person for tier 4": (dict(tier=Tier.SAFETY_CRITICAL), "STATEMENT_MALFORMED"),
}


@pytest.mark.parametrize("what", NOT_TAKEN)
def test_a_latch_that_is_no_enforcement_points_own_is_not_taken(cell, what):
    changes, code = NOT_TAKEN[what]
    answer, _ = told(cell, **changes)
    assert (answer.status_code < 500, answer.json()["code"]) == (True, code)
    assert kinds(cell)[-1] == "latch-refused"


def test_an_id_means_one_latch(cell):
    latch_id, _ = taken(cell)
    assert told(cell, latch_id=latch_id, cause=LatchCause.AUTHORITY)[0].json()["code"] == "LATCH_DIFFERS"


NOT_CLEARED = {
    "by a sponsor": (dict(who="bob"), "NOT_PERMITTED"),
    "by an agent": (dict(who=AGENT), "NOT_PERMITTED"),
    "by an enforcement point": (dict(who=PEP), "NOT_PERMITTED"),
    "in another's name": (dict(approver="alice"), "CLEARING_NOT_YOURS"),
    "with another approver's key": (dict(key="alice"), "CLEARING_NOT_YOURS"),
    "with the point's key": (dict(key=PEP), "STATEMENT_UNTRUSTED"),
    "of another latch": (dict(latch_id="9" * 32), "CLEARING_NOT_FOR_THIS_LATCH"),
    "of another text": (dict(latch_digest="9" * 64), "CLEARING_NOT_FOR_THIS_LATCH"),
    "of another robot": (dict(robot="ur5e"), "CLEARING_NOT_FOR_THIS_LATCH"),
    "of another cause": (dict(cause=LatchCause.AUTHORITY), "CLEARING_NOT_FOR_THIS_LATCH"),
    "over already": (dict(at_=-400, not_after_=-100), "CLEARING_OUT_OF_TIME"),
    "from tomorrow": (dict(at_=60, not_after_=120), "CLEARING_OUT_OF_TIME"),
    "for too long": (dict(not_after_=601), "STATEMENT_MALFORMED"),
}


@pytest.mark.parametrize("what", NOT_CLEARED)
def test_a_clearing_that_does_not_count_is_refused_and_recorded(cell, what):
    changes, code = NOT_CLEARED[what]
    latch_id, text = taken(cell)
    who = changes.get("who", "carol")
    members = {name.rstrip("_"): cell.now + value if name.endswith("_") else value for name, value in changes.items()}
    members.pop("who", None)
    stated_id = members.pop("latch_id", latch_id)
    made = word(cell, stated_id, text, who, **members)
    answer = cell.post(who, f"/latches/{latch_id}/clearings", {"clearing": made})
    assert (answer.status_code < 500, answer.json()["code"]) == (True, code)
    assert kinds(cell)[-1] == "clearing-refused"
    assert cell.world.people["carol"].latch(latch_id).state == "waits"


def test_an_unknown_latch_and_a_reader_who_is_no_person(cell):
    for unknown in ("0" * 32, "x"):
        with pytest.raises(ClientError) as raised:
            cell.world.people["carol"].latch(unknown)
        assert raised.value.code == "LATCH_UNKNOWN"
    assert cell.get(AGENT, "/latches").json()["code"] == "NOT_PERMITTED"


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    with World(tmp_path_factory.mktemp("latches-named"), settings_changes={"issuer": NAMED}) as world:
        yield Cell(world)


def by_passkey(cell, held, latch_id, text, who="carol", **changes):
    shown = latch.open(text, [keys.public_raw(cell.world.private[PEP])], DEFAULT)
    stated = Clearing(latch_id, digest_of(text), AUDIENCE, "ur3e", shown.cause, who, cell.now + 300, cell.now)
    stated = structs.replace(stated, **changes)
    body = {"clearing": plain(stated), "assertion": held.body(passkey_clearing.challenge_of(stated, shown))}
    return send(cell, f"/latches/{latch_id}/passkey-clearings", body)


@pytest.mark.clause("PSK-7", "STM-22")
def test_a_passkey_clears_a_latch(named):
    held = passkey(named, "carol")
    latch_id, text = taken(named)
    assert by_passkey(named, held, latch_id, text, "alice").json()["code"] == "CLEARING_NOT_YOURS"
    answer = by_passkey(named, held, latch_id, text)
    assert (answer.status_code, answer.json()["state"]) == (201, "released")
    (carried,) = named.answers().clearings
    assert carried.count(".") == 4
    other, text = taken(named, cause=LatchCause.AUTHORITY)
    assert by_passkey(named, held, other, text, cause=LatchCause.WATCH).json()["code"] == "CLEARING_NOT_FOR_THIS_LATCH"


def test_the_page_shows_every_word_that_a_clearing_binds(cell):
    latch_id, text = taken(cell, tier=Tier.SAFETY_CRITICAL, approvers=2, person="bob")
    clear(cell, latch_id, text, "carol")
    with cell.world.anonymous() as http:
        page = http.get(f"{cell.world.issuer}/latches/{latch_id}/page")
        assert http.get(f"{cell.world.issuer}/latches/{'0' * 32}/page").status_code == 404
    shown = " ".join(page.text.split())
    for words in (
        latch_id, digest_of(text), "ur3e", "IMPACT_ROSE", "4 (safety critical)", "2 different people have", "waits for people",
        "PERCEPTION_MISSING", "Stopped by</th><td><code>bob", "carol", AUDIENCE, f"ztpm latch clear {latch_id}",
    ):  # fmt: skip
        assert words in shown, words
    assert "script" not in page.headers["content-security-policy"], "an issuer at an address has no passkeys"
    assert "<script" not in page.text
