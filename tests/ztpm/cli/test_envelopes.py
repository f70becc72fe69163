"""`ztpm approvals envelope`, `envelopes` and `revoke`; `ztpm person passkey` and `roles`: each done, and each refused."""

from __future__ import annotations

import hashlib

import pytest
from tests.capabilities.statements.people.test_passkey_votes import ASK
from ztpm_idp.client.envelopes import Bounds, around

from capabilities.keys import keys
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.long

ID = "0123456789abcdef" * 2
ENVELOPE = around(
    ASK,
    Bounds(index_milli=2_700, speed_um_s=200_000, uses=5, lifetime_s=300, room={"q0": 50_000}, start_room_urad=2_000),
    approver="bob",
    envelope_id=ID,
    at=1_800_000_000,
)
SIGN = ["envelope", ID, "--uses", "5", "--minutes", "5", "--index", "2.7", "--speed-mm-s", "200", "--room", "q0=50000"]
ROW = {"envelope_id": ID, "approver": "bob", "agent": "mover", "not_after": 1_800_000_300}
KEY = keys.b64u(keys.public_raw(keys.generate()))
COMMANDS = {
    "envelope": (["approvals", *SIGN, "--yes"], {"envelope_around": ENVELOPE, "sign_envelope": ID}, 0),
    "envelopes": (["approvals", "envelopes"], {"envelopes": [ROW]}, 0),
    "revoke": (["approvals", "revoke", ID, "--reason", "enough"], {"revoke_envelope": None}, 0),
    "roles": (["person", "roles", "erin", "--role", "approver"], {"propose_roles": ID}, 4),
    "passkey": (
        ["person", "passkey", "--yes"],
        {
            "begin_passkey": {"enrolment_id": ID, "url": "http://localhost/x", "expires_at": 1},
            "enrolled_passkey": KEY,
            "propose_passkey": ID,
        },
        4,
    ),
}


@pytest.fixture
def who(cell):
    return ("--data", cell.root, "--as", "bob")


@pytest.mark.parametrize("command", COMMANDS)
def test_done(run, who, double, command):
    arguments, double.answers, status = COMMANDS[command]
    told = run(*arguments, *who, "--json")
    assert told.status == status, told.err
    assert double.asked[-1][0] == list(double.answers)[-1]


@pytest.mark.parametrize("command", COMMANDS)
def test_refused(run, who, double, command):
    arguments, double.answers, _ = COMMANDS[command]
    double.answers = {**double.answers, list(double.answers)[0]: ClientError("NOT_PERMITTED", 403)}
    told = run(*arguments, *who, "--json")
    assert (told.status, told.json["code"]) == (3, "NOT_PERMITTED")


def test_what_is_signed_is_shown(run, who, double):
    double.answers = COMMANDS["envelope"][1]
    told = run("approvals", *SIGN, "--yes", *who)
    for shown in (
        "q0: -1620796 to -1520796",
        "joint5: -2005 to 1995",
        "in view: person-ssm p1",
        "tier 3",
        "2.700",
        "5 acts",
    ):
        assert shown in told.out, told.out


def test_the_code_of_a_passkey_is_that_of_its_key(run, who, double):
    double.answers = COMMANDS["passkey"][1]
    told = run("person", "passkey", "--yes", *who)
    assert hashlib.sha256(keys.unb64u(KEY)).hexdigest()[:8] in told.err


@pytest.mark.parametrize("room", ["q0", "=5", "q0=x", "q0=-1", "q0=1.5"])
def test_room_is_a_name_and_a_whole_number(run, who, double, room):
    told = run("approvals", *SIGN[:-1], room, "--yes", *who, "--json")
    assert (told.status, told.json["code"]) == (2, "USAGE")


def test_a_change_that_waits_is_told_in_its_own_words(run, who, double):
    row = {
        "change_id": ID,
        "person": "erin",
        "name": "",
        "key": "K",
        "by": "alice",
        "until": 1_800_000_000,
        "reason": "",
    }
    row |= {"confirmed": [], "declined": [], "state": "open", "login": "https://op.example sub", "passkey": False}
    kinds = {
        "key": "further key", "roles": "has the roles admin, and no others", "login": "may log in as https://op.example",
    }  # fmt: skip
    rows = [row | {"kind": kind, "roles": ["admin"]} for kind in kinds]
    rows.append(row | {"kind": "key", "roles": [], "passkey": True})
    double.answers = {"persons": [], "changes": rows}
    told = " ".join(run("person", "list", *who).out.split())
    for words in (*kinds.values(), "further passkey"):
        assert words in told, told
    assert "root key makes" not in told
