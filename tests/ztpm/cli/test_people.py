"""`ztpm revoke`, `ztpm agent`, `ztpm mcp pin`: each end of a command has its status and its code."""

import hashlib

import pytest
from ztpm.base.layout import read_key

from capabilities.keys import keys
from ztpm_idp.client import ClientError, Revocation

pytestmark = pytest.mark.long

ROW = {
    "id": "mover", "status": "active", "sponsor": "alice", "role": "mover", "model": "none", "software_digest": "00" * 32,
    "key": "k" * 43, "trust_permille": 900,
}  # fmt: skip


@pytest.fixture
def who(cell):
    return ("--data", cell.root, "--as", "alice")


@pytest.fixture
def software(tmp_path):
    path = tmp_path / "agent.py"
    path.write_text("print('moves')\n")
    return path


POINTS = {"line": 0, "epoch": 9, "now_ms": 1, "points": []}


def point(name, epoch, *, connected=True, confirmed_ms=1_000):
    return {"pep": name, "line": 0, "epoch": epoch, "confirmed_ms": confirmed_ms, "heard_ms": 1, "connected": connected}


def test_a_revocation_shows_who_confirms_it_and_waits_no_longer_than_asked(run, who, double):
    seen = [point("cell-1", 7, confirmed_ms=1_084), point("cell-2", 6), point("cell-3", -1, connected=False)]
    double.answers = {"revocation": Revocation(7, known=True, at_ms=1_000), "points": POINTS | {"points": seen}}
    told = run("revoke", "agent", "mover", "--reason", "gone", "--wait", 0.1, *who, "--json")
    assert told.json["points"] == {
        "confirmed_after_ms": {"cell-1": 84}, "waiting": ["cell-2"], "not_connected": ["cell-3"],
    }  # fmt: skip
    told = run("revoke", "agent", "mover", "--reason", "gone", "--wait", 0.1, *who)
    assert (told.status, "cell-1  confirmed after 0.084 s" in told.out, "cell-2  connected" in told.out) == (
        0,
        True,
        True,
    )
    double.answers["points"] = ClientError("PATH_UNKNOWN", 404)
    told = run("revoke", "agent", "mover", "--reason", "gone", *who, "--json")
    assert (told.status, told.json["points_unknown"]) == (0, "PATH_UNKNOWN"), "it is revoked all the same"


COMMANDS = {
    "revoke": (["revoke", "agent", "mover", "--reason", "gone"], "revocation", Revocation(7, known=True)),
    "retire": (["agent", "retire", "mover", "--reason", "gone"], "retire_agent", 7),
    "suspend": (["agent", "suspend", "mover", "--reason", "odd"], "suspend_agent", None),
    "list": (["agent", "list"], "agents", [ROW]),
    "restore": (["agent", "restore", "mover", "--reason", "looked into"], "restore_agent", None),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_done_refused_and_unreachable(run, who, double, command):
    arguments, method, answer = COMMANDS[command]
    assert run(*arguments, "--help").status == 0
    double.answers = {method: answer, "points": POINTS}
    assert run(*arguments, *who).status == 0
    assert run(*arguments, *who, "--json").json["ok"] is True
    for code, http, status in (("NOT_PERMITTED", 403, 3), ("UNREACHABLE", 0, 1)):
        double.answers = {method: ClientError(code, http)}
        told = run(*arguments, *who, "--json")
        assert (told.status, told.json["code"]) == (status, code)
    told = run(*arguments, "--data", who[1], "--as", "nobody", "--json")
    assert (told.status, told.json["code"]) == (2, "OPERATOR_UNKNOWN")


PUBLIC = keys.b64u(keys.public_raw(keys.generate()))
CHANGE = "c" * 32
WAITS = {
    "approver": (["person", "register", "erin", "--public", PUBLIC, "--role", "approver"], "propose_person", CHANGE),
    "key": (["person", "key", "--public", PUBLIC], "propose_key", CHANGE),
    "confirmed by one of two": (["person", "confirm", CHANGE], "confirm_change", "open"),
    "declined by one of two": (["person", "decline", CHANGE, "--reason", "who?"], "decline_change", "open"),
}
ENDS = {
    "sponsor": (["person", "register", "erin", "--public", PUBLIC, "--role", "sponsor"], "register_person", None),
    "end": (["person", "retire", "erin", "--reason", "left"], "disable_person", 7),
    "confirm": (["person", "confirm", CHANGE], "confirm_change", "done"),
    "decline": (["person", "decline", CHANGE, "--reason", "who?"], "decline_change", "declined"),
}


@pytest.mark.parametrize(("rows", "status"), [(WAITS, 4), (ENDS, 0)])
def test_a_change_of_people_is_done_or_waits_for_another(run, who, double, rows, status):
    for arguments, method, answer in rows.values():
        double.answers = {method: answer}
        told = run(*arguments, *who, "--json")
        assert (told.status, told.json["ok"]) == (status, True), arguments
        double.answers = {method: ClientError("CHANGE_YOURS", 403)}
        told = run(*arguments, *who, "--json")
        assert (told.status, told.json["code"]) == (3, "CHANGE_YOURS"), arguments
        assert [name for name, _, _ in double.asked] == [method, method]
        double.asked.clear()


def test_an_end_that_takes_two_is_proposed(run, who, double):
    double.answers = {"disable_person": ClientError("TWO_PEOPLE_NEEDED", 403), "propose_end": CHANGE}
    told = run("person", "retire", "bob", "--reason", "left", *who, "--json")
    assert (told.status, told.json["change_id"]) == (4, CHANGE)
    assert double.asked[-1] == ("propose_end", ("bob", "left"), {})


def test_people_and_changes_are_listed_and_foreign_text_moves_no_terminal(run, who, double):
    person = {"id": "erin", "name": "E\x1b[2J", "roles": ["admin"], "status": "active", "keys": ["k" * 43]}
    change = {
        "change_id": CHANGE, "kind": "recovery", "person": "erin", "name": "Erin", "roles": [], "key": "k" * 43, "reason": "",
        "by": "root key", "state": "open", "until": 1_800_000_000, "confirmed": [], "declined": [],
    }  # fmt: skip
    double.answers = {"persons": [person], "changes": [change]}
    told = run("person", "list", *who)
    assert told.status == 0
    assert CHANGE in told.out
    assert "\x1b" not in told.out
    assert run("person", "list", *who, "--json").json == {"ok": True, "people": [person], "changes": [change]}


def test_a_recovery_is_signed_by_the_root_key_of_the_cell(run, cell, double):
    double.answers = {"recover": CHANGE}
    told = run("idp", "recover", "erin", "--public", PUBLIC, "--data", cell.root, "--json")
    assert (told.status, told.json["change_id"]) == (4, CHANGE)
    assert double.asked == [("recover", ("erin", "erin", keys.unb64u(PUBLIC)), {})]
    double.answers = {"recover": ClientError("NOT_PERMITTED", 403)}
    assert run("idp", "recover", "erin", "--public", PUBLIC, "--data", cell.root, "--json").status == 3
    for wrong in (("--public", "short", "--data", cell.root), ("--public", PUBLIC, "--issuer", "http://127.0.0.1/z")):
        assert run("idp", "recover", "erin", *wrong, "--json").status == 2


def test_a_new_key_is_made_once_and_its_public_half_is_told(run, tmp_path):
    path = tmp_path / "erin.key"
    told = run("person", "new-key", path, "--json")
    assert told.status == 0
    assert keys.b64u(keys.public_raw(read_key(path, b"a passphrase for tests"))) == told.json["public"]
    assert run("person", "new-key", path, "--json").json["code"] == "EXISTS"


@pytest.mark.parametrize("kind", ["token", "hop", "agent", "key", "sponsor", "audience"])
def test_every_kind_is_revoked(run, who, double, kind):
    double.answers = {"revocation": Revocation(3, known=False)}
    told = run("revoke", kind, "some-id", "--reason", "why", "--wait", 0, *who, "--json")
    assert told.json == {"ok": True, "kind": kind, "id": "some-id", "epoch": 3, "known": False}
    assert double.asked == [("revocation", (kind, "some-id", "why"), {})]


@pytest.mark.parametrize("id_", ["-" + "a" * 42, "-" + "h" * 21, "-_" + "B" * 20])
def test_an_id_that_begins_with_a_dash_is_no_option(run, who, double, id_):
    double.answers = {"revocation": Revocation(3, known=True)}
    assert run("revoke", "key", id_, "--reason", "why", "--wait", 0, *who, "--json").json["id"] == id_
    assert run("revoke", "key", "--reason", id_, "--wait", 0, *who, "--json", "--", id_).json["id"] == id_
    assert run("revoke", "key", "some-id", "--reason", id_, "--wait", 0, *who).status == 0
    assert [given for _, given, _ in double.asked] == [("key", id_, "why"), ("key", id_, id_), ("key", "some-id", id_)]


def test_what_cannot_be_revoked_is_usage(run, who, double):
    assert run("revoke", "world", "x", "--reason", "y", *who).status == 2
    assert run("revoke", "agent", "x", *who).status == 2  # no reason
    assert double.asked == []


def test_register_makes_one_key_and_keeps_it_over_a_refusal(run, cell, who, double, software):
    arguments = ("agent", "register", "planner", "--software", software, "--role", "planner", *who, "--json")
    double.answers = {"register_agent": ClientError("SPONSOR_INACTIVE", 409)}
    told = run(*arguments)
    assert (told.status, told.json["code"]) == (3, "SPONSOR_INACTIVE")
    key = read_key(cell.agent_key("planner"), b"a passphrase for tests")
    double.answers = {"register_agent": None}
    told = run(*arguments)
    assert (told.status, told.json["status"]) == (0, "registered")
    ((_, positional, options),) = double.asked[1:]
    assert positional == ("planner", keys.public_raw(key))
    assert options == {
        "software_digest": hashlib.sha256(software.read_bytes()).hexdigest(), "model": "none", "role": "planner", "sponsor": None,
        "workload": "",
    }  # fmt: skip


def test_names_of_agents_are_no_paths(run, who, double, software):
    for arguments in (
        ("agent", "register", "../operators/bob", "--software", software, "--role", "x", *who),
        ("agent", "attest", "../operators/bob", "--software", software, "--data", who[1]),
        ("agent", "retire", "../operators/bob", "--reason", "x", *who),
    ):
        told = run(*arguments, "--json")
        assert (told.status, told.json["code"]) == (2, "NAME_MALFORMED")


def test_attest_needs_a_key_and_says_who_does_not_answer(run, cell, who, double, software):
    told = run("agent", "attest", "stranger", "--software", software, "--data", cell.root, "--json")
    assert (told.status, told.json["code"]) == (2, "AGENT_UNKNOWN")
    double.answers = {"register_agent": None}
    assert run("agent", "register", "painter", "--software", software, "--role", "painter", *who).status == 0
    told = run("agent", "attest", "painter", "--software", software, "--data", cell.root, "--json")
    assert (told.status, told.json["code"]) == (1, "UNREACHABLE")  # for real: nobody listens on the cell's address
    assert run("agent", "attest", "painter", "--software", software.parent / "missing", "--data", cell.root).status == 2


def test_pin_says_that_the_registry_does_not_answer(run, cell, double):
    assert run("mcp", "pin", "--help").status == 0
    told = run("mcp", "pin", "--data", cell.root, "--as", "carol", "--json")
    assert (told.status, told.json["code"]) == (1, "REGISTRY_UNAVAILABLE")
    assert double.asked == []


@pytest.fixture
def changed(cell, monkeypatch):
    """The registry knows an earlier definition of one tool, and nothing of another."""
    import ztpm.cell.enrolment
    from capabilities.statements.registry import RegistrySnapshot, ToolEntry
    from capabilities.values.scope import Tier
    from pep.mcp.arm_server import tool_definitions

    served = tool_definitions()
    entries = [ToolEntry(t.name, t.definition_digest, t.operation, Tier(t.base_tier)) for t in served]
    entries[0] = ToolEntry(served[0].name, "00" * 32, served[0].operation, Tier(served[0].base_tier))
    del entries[1]
    snapshot = RegistrySnapshot(
        "http://127.77.0.9:8700/ztpm", 1, "http://127.77.0.9:8800/mcp", 0, tuple(entries), (), (), (), ()
    )
    monkeypatch.setattr(ztpm.cell.enrolment, "registered", lambda issuer, audience, trust, *, auth: snapshot)
    return [served[0].name, served[1].name]


def test_pin_registers_what_changed_and_only_after_a_yes(run, cell, double, changed):
    who = ("--data", cell.root, "--as", "carol")
    told = run("mcp", "pin", *who, answer="n\n")
    assert (told.status, double.asked) == (1, [])
    assert all(name in told.out for name in changed)
    told = run("mcp", "pin", *who, "--json")
    assert (told.status, told.json["code"], double.asked) == (2, "USAGE", [])
    double.answers = {"register_tool": None}
    told = run("mcp", "pin", *who, "--yes", "--json")
    assert (told.status, sorted(told.json["pinned"])) == (0, sorted(changed))
    assert sorted(options["name"] for _, _, options in double.asked) == sorted(changed)


def test_restoring_says_whether_to_learn_anew(run, who, double):
    double.answers = {"restore_agent": None}
    assert run("agent", "restore", "mover", "--reason", "why", *who, "--json").json["status"] == "restored"
    assert run("agent", "restore", "mover", "--reason", "why", "--relearn", *who).status == 0
    assert run("agent", "restore", "mover", *who).status == 2  # no reason
    assert double.asked == [
        ("restore_agent", ("mover", "why"), {"relearn": False}),
        ("restore_agent", ("mover", "why"), {"relearn": True}),
    ]


CONDUCT = {"deviations": [], "deviated_at": None, "contracted": False, "samples": 12, "restored_at": None}
ODD = [{"feature": "refusals", "since": 1, "score_milli": 1_200}]


@pytest.mark.parametrize(
    ("known", "shown"),
    [
        ({}, ("90.0 %", "nothing reported")),
        ({"trust_by": {"planner": 640}, "conduct": CONDUCT}, ("64.0 % by planner", "12 acts")),
        ({"trust_by": {}, "conduct": CONDUCT | {"deviations": ODD}}, ("deviates", "refusals")),
        ({"trust_by": {}, "conduct": CONDUCT | {"deviations": ODD, "contracted": True}}, ("contracted", "refusals")),
        ({"trust_by": 7, "conduct": "\x1b[31m"}, ("90.0 %", "nothing reported")),
    ],
)
def test_the_list_shows_trust_and_behaviour(run, who, double, known, shown):
    double.answers = {"agents": [ROW | known]}
    assert run("agent", "list", *who, "--json").json["agents"] == [ROW | known]
    out = " ".join(run("agent", "list", *who).out.split())
    assert all(word in out for word in shown), out
