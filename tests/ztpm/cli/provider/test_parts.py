"""`ztpm pep`, `sensor` and `tool`, and `agent rotate`: each end has its status and its code."""

import json

import pytest
from pep.mcp.tool_digest import definition_digest
from ztpm.base.layout import read_key

from capabilities.keys import keys
from ztpm_idp.client import ClientError

URL = "https://plant.example/mcp"
PUBLIC = keys.b64u(keys.public_raw(keys.generate()))
WHY = ("--reason", "looked at")
PASSPHRASE = b"a passphrase for tests"
ROWS = {
    "peps": {"id": "plant-1", "status": "active", "audiences": [URL, URL + "/2"], "key": "k" * 43},
    "sensors": {"id": "eye\x1b[2J", "status": "suspended", "audience": URL, "transit_ms": 20, "key": "k" * 43},
    "tools": {
        "name": "open_valve", "audience": URL, "status": "active", "operation": "open_valve", "base_tier": 2,
        "definition_digest": "ab" * 32,
    },
}  # fmt: skip
ACTS = {
    "pep suspend": (["pep", "suspend", "plant-1", *WHY], "suspend_part", None),
    "pep restore": (["pep", "restore", "plant-1", *WHY], "restore_part", None),
    "pep retire": (["pep", "retire", "plant-1", *WHY], "retire_part", 7),
    "pep rotate": (["pep", "rotate", "plant-1", *WHY, "--public", PUBLIC], "replace_key", 7),
    "sensor suspend": (["sensor", "suspend", "eye", *WHY], "suspend_part", None),
    "sensor rotate": (["sensor", "rotate", "eye", *WHY, "--public", PUBLIC], "replace_key", 7),
    "agent rotate": (["agent", "rotate", "mover", *WHY, "--public", PUBLIC], "replace_key", 7),
    "tool suspend": (["tool", "suspend", "open_valve", "--audience", URL, *WHY], "change_tool", None),
    "tool restore": (["tool", "restore", "open_valve", "--audience", URL, *WHY], "change_tool", None),
    "tool retire": (["tool", "retire", "open_valve", "--audience", URL, *WHY], "change_tool", None),
    "pep list": (["pep", "list"], "peps", [ROWS["peps"]]),
    "sensor list": (["sensor", "list"], "sensors", [ROWS["sensors"]]),
    "tool list": (["tool", "list"], "tools", [ROWS["tools"]]),
}


@pytest.fixture
def who(cell):
    return ("--data", cell.root, "--as", "alice")


@pytest.mark.parametrize("act", ACTS)
def test_done_refused_and_unreachable(run, who, double, act):
    arguments, method, answer = ACTS[act]
    double.answers = {method: answer}
    told = run(*arguments, *who)
    assert (told.status, "\x1b" in told.out) == (0, False)
    assert run(*arguments, *who, "--json").json["ok"] is True
    for code, http, status in (("NOT_PERMITTED", 403, 3), ("UNREACHABLE", 0, 1)):
        double.answers = {method: ClientError(code, http)}
        told = run(*arguments, *who, "--json")
        assert (told.status, told.json["code"]) == (status, code)


def test_a_list_that_is_empty_says_so(run, who, double):
    double.answers = {"peps": [], "tools": []}
    assert run("pep", "list", *who).out == "None is registered.\n"
    assert run("tool", "list", *who, "--json").json == {"ok": True, "tools": []}


def test_a_parts_key_is_made_once_and_kept_over_a_refusal_or_its_public_half_is_told(run, cell, who, double):
    register = ("pep", "register", "plant-9", "--audience", URL, *who, "--json")
    double.answers = {"register_pep": ClientError("REGISTRY_FULL", 409)}
    assert run(*register).status == 3
    made = keys.public_raw(read_key(cell.party_key("pep", "plant-9"), PASSPHRASE))
    double.answers = {"register_pep": None}
    assert run(*register).json["key"] == str(cell.party_key("pep", "plant-9"))
    assert "key" not in run(*register, "--public", PUBLIC).json
    assert [given for _, (_, given, _), _ in double.asked] == [made, made, keys.unb64u(PUBLIC)]
    assert run(*register, "--public", "short").json["code"] == "KEY_MALFORMED"


def test_a_rotation_that_was_cut_off_goes_on_with_the_same_key(run, cell, who, double):
    rotate = ("sensor", "rotate", "eye-9", *WHY, *who, "--json")
    path = cell.party_key("sensor", "eye-9")
    double.answers = {"replace_key": ClientError("UNREACHABLE", 0)}
    assert run(*rotate).status == 1
    waiting = keys.public_raw(read_key(path.with_name("eye-9.key.next"), PASSPHRASE))
    assert not path.exists()
    double.answers = {"replace_key": 4}
    assert run(*rotate).json == {"ok": True, "id": "eye-9", "epoch": 4, "key": str(path)}
    assert keys.public_raw(read_key(path, PASSPHRASE)) == waiting
    assert {given[2] for _, given, _ in double.asked} == {waiting}
    assert not path.with_name("eye-9.key.next").exists()


def test_without_a_directory_a_new_key_is_made_where_it_is_used(run, cell, double, monkeypatch):
    monkeypatch.setenv("ZTPM_ISSUER", "http://127.0.0.1:1/ztpm")
    monkeypatch.setenv("ZTPM_KEY", str(cell.operator_key("alice")))
    monkeypatch.setenv("ZTPM_AS", "alice")
    double.answers = {"register_pep": None}
    told = run("pep", "register", "plant-8", "--audience", URL, "--json")
    assert (told.status, told.json["code"]) == (2, "WHICH_KEY")
    assert run("pep", "register", "plant-8", "--audience", URL, "--public", PUBLIC, "--json").json["ok"] is True
    assert (double.id, double.issuer) == ("alice", "http://127.0.0.1:1/ztpm")


def test_the_directory_is_told_by_the_environment(run, cell, double, monkeypatch):
    monkeypatch.setenv("ZTPM_DATA", str(cell.root))
    double.answers = {"peps": []}
    assert run("pep", "list", "--as", "alice").status == 0
    told = run("pep", "list", "--as", "alice", "--issuer", "http://127.0.0.1:1/ztpm", "--json")
    assert told.json["code"] == "WHICH_KEY"  # a key is still missing
    key = cell.operator_key("bob")
    assert run("pep", "list", "--as", "bob", "--issuer", "http://127.0.0.1:1/ztpm", "--key", key).status == 0
    assert double.issuer == "http://127.0.0.1:1/ztpm"


DEFINITION = {"name": "open_valve", "inputSchema": {"type": "object", "properties": {"percent": {"type": "number"}}}}


def test_a_tool_is_registered_by_its_definition_or_its_digest(run, who, double, tmp_path):
    from mcp_types import Tool

    file = tmp_path / "open_valve.json"
    file.write_text(json.dumps(DEFINITION))
    double.answers = {"register_tool": None}
    stated = ("tool", "register", "open_valve", "--audience", URL, "--tier", "2", *who, "--json")
    digest = definition_digest(Tool.model_validate(DEFINITION))
    assert run(*stated, "--definition", file).json["definition_digest"] == digest
    assert run(*stated, "--digest", digest, "--operation", "open").json["ok"] is True
    assert [given["operation"] for _, _, given in double.asked] == ["open_valve", "open"]
    for wrong in ((), ("--digest", "AB" * 32), ("--digest", digest, "--definition", file)):
        assert run(*stated, *wrong).json["code"] == "USAGE"
    for text in ("{", "[]", '{"name": "another", "inputSchema": {}}', '{"name": "open_valve"}'):
        file.write_text(text)
        assert run(*stated, "--definition", file).json["code"] == "UNREADABLE"
