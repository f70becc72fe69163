"""The commands of people against a real identity provider, in a process of its own."""

import json
import secrets
import time
from dataclasses import replace

import pytest
from capabilities.values.scope_json import restriction_to_json, scope_to_json
from tests.ztpm.cli.conftest import PASSPHRASE
from ztpm.base.layout import Layout
from ztpm.cell.cell import Cell
from ztpm.cell.setup import free_addresses, initialise
from ztpm.stage.lending import arm_only, sweep_scope

from ztpm_idp.client import Operator

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A cell whose identity provider runs, and which is registered."""
    layout, addresses = Layout(tmp_path_factory.mktemp("live") / "cell"), free_addresses(secrets.token_bytes(8))
    initialise(layout, addresses, passphrase=PASSPHRASE.encode(), policy="paper-default", defer_timeout_s=60)
    with Cell(layout, addresses, PASSPHRASE.encode(), (0.0,) * 6) as cell:
        cell.start_idp()
        from ztpm.base.layout import read_key

        key = read_key(layout.operator_key("carol"), PASSPHRASE.encode())
        with Operator("carol", key, addresses.issuer) as carol:
            cell.register(carol)
        yield cell


def test_an_agents_life(run, live, tmp_path):
    data = ("--data", live.layout.root)
    software = tmp_path / "agent.py"
    software.write_text("print('moves')\n")

    def done(*arguments):
        told = run(*arguments, *data, "--json")
        assert told.status == 0, (told.out, told.err)
        return told.json

    def refused(*arguments):
        told = run(*arguments, *data, "--json")
        return told.status, told.json["code"]

    runs = ("--software", software)
    for name in ("planner", "mover"):
        done("agent", "register", name, *runs, "--role", name, "--as", "alice")
    assert refused("agent", "register", "mover", *runs, "--role", "mover", "--as", "alice") == (3, "ALREADY_REGISTERED")
    lend = ("token", "issue", "planner", *runs, "--purpose", "sweep", "--as", "alice", "--delegate", "mover")
    assert refused(*lend, "--out", tmp_path / "early.token")[0] == 3  # not attested yet
    assert not (tmp_path / "early.token").exists()
    for name in ("planner", "mover"):
        assert done("agent", "attest", name, *runs)["status"] == "active"
    other = tmp_path / "other.py"
    other.write_text("print('steals')\n")
    assert refused("agent", "attest", "mover", "--software", other) == (3, "ATTESTATION_INVALID")
    assert {row["id"]: row["status"] for row in done("agent", "list", "--as", "bob")["agents"]} == {
        "planner": "active",
        "mover": "active",
    }

    # lending, and lending on: narrower, or not at all
    first, second = tmp_path / "planner.token", tmp_path / "mover.token"
    issued = done(*lend, "--out", first)
    assert first.stat().st_mode & 0o777 == 0o600
    assert refused(*lend, "--out", first) == (2, "EXISTS")
    assert refused(*lend, "--out", tmp_path / "no" / "where") == (2, "UNWRITABLE")
    less = tmp_path / "less.json"
    less.write_text(json.dumps(restriction_to_json(arm_only(speed_high=600_000))))
    pass_on = ("token", "delegate", "planner", "mover", "--token", first, *runs, "--purpose", "move")
    narrower = done(*pass_on, "--restriction", less, "--out", second)
    nothing = tmp_path / "nothing.json"
    nothing.write_text("{}")
    assert refused(*pass_on, "--restriction", nothing, "--out", tmp_path / "x") == (3, "NOT_NARROWER")
    told = run(*pass_on, "--restriction", nothing, "--out", tmp_path / "x", *data, "--json").json
    assert told["explanation"]["could_narrow"] == ["grants", "limits", "budgets", "ceiling", "delegates"]
    more = arm_only(speed_high=9_000_000)
    nothing.write_text(json.dumps(restriction_to_json(more)))
    told = run(*pass_on, "--restriction", nothing, "--out", tmp_path / "x", *data)
    assert told.status == 3
    assert "NOT_NARROWER" in told.err
    assert "9000000" in told.err  # what was asked ...
    assert "1050000" in told.err  # ... and what is permitted
    explained = run(*pass_on, "--restriction", nothing, "--out", tmp_path / "x", *data, "--json").json["explanation"]
    (place,) = explained["places"]
    assert place["nearest"] == {"low": 0, "high": 1_050_000}
    assert json.dumps(explained["repaired"]) in told.err
    nothing.write_text(json.dumps(explained["repaired"]))
    done(*pass_on, "--restriction", nothing, "--out", tmp_path / "repaired.token")
    nothing.write_text('{"grants": 1, "grants": 2}')
    assert refused(*pass_on, "--restriction", nothing, "--out", tmp_path / "x") == (2, "UNREADABLE")
    told = run("token", "inspect", second, "--trust", live.layout.trust, "--json")
    assert [hop["hop_id"] for hop in told.json["hops"]] == [issued["hop_id"], narrower["hop_id"]]

    # at most so many acts
    where = f"at {live.addresses.audience}"
    few = tmp_path / "few.token"
    done(*pass_on, "--restriction", less, "--budget", f"ur3e/move_joint: 3 in 60 {where}", "--out", few)
    told = run("token", "inspect", few, "--trust", live.layout.trust, "--json").json
    assert [grant.get("budgets") for grant in told["hops"][-1]["scope"]["grants"]] == [
        [{"audience": live.addresses.audience, "most": 3, "per_s": 60}],
        None,
        None,
    ]
    assert refused(*lend, "--budget", "ur3e/fly: 3 in 60", "--out", tmp_path / "x") == (2, "UNREADABLE")

    # a scope of one's own
    own = tmp_path / "scope.json"
    own.write_text(
        json.dumps(scope_to_json(sweep_scope(live.addresses.audience, delegates=frozenset(), now=1, lifetime_s=60)))
    )
    assert refused(*lend, "--scope", own, "--out", tmp_path / "x")[0] == 3  # long over

    # a mandate: drawn from, looked at, and ended
    sign, drawn = ("mandate", "sign", "mover", "--purpose", "tidy", "--as", "alice"), tmp_path / "drawn.token"
    promise = done(*sign, "--days", "2")["mandate_id"]
    draw = ("mandate", "draw", promise, "mover", *runs, "--minutes", "5", "--out")
    token_id = done(*draw, drawn)["token_id"]
    assert drawn.stat().st_mode & 0o777 == 0o600
    assert run("token", "inspect", drawn, "--trust", live.layout.trust, "--json").json["mandate_id"] == promise
    (row,) = done("mandate", "list", "--as", "alice")["mandates"]
    assert (row["mandate_id"], row["state"], row["live"]) == (promise, "in force", 1)
    leasing = ("rtde", "connect", "mover", "--mandate", promise, *runs)
    assert refused(*leasing)[1] == "GATEWAY_UNREACHABLE"  # there is none, but a token for it was drawn
    assert done("mandate", "show", promise, "--as", "alice")["draws"][0]["token_id"] != token_id
    assert promise in run("mandate", "list", *data, "--as", "alice").out
    shown = run("mandate", "show", promise, *data, "--as", "alice").out
    assert token_id in shown and "in force" in shown
    assert done("mandate", "revoke", promise, "--reason", "done", "--as", "alice")["known"] is True
    assert refused(*draw, tmp_path / "x") == (3, "MANDATE_REVOKED")
    assert refused(*leasing) == (3, "MANDATE_REVOKED")
    assert refused("mandate", "show", "0" * 32, "--as", "alice") == (3, "MANDATE_UNKNOWN")
    for lifetime_s, code in ((700_000, "STATEMENT_MALFORMED"), (-1, "STATEMENT_MALFORMED")):
        long = sweep_scope(live.addresses.audience, delegates=frozenset(), now=int(time.time()), lifetime_s=1)
        own.write_text(json.dumps(scope_to_json(replace(long, not_before=1, not_after=int(time.time()) + lifetime_s))))
        assert refused(*sign, "--scope", own)[1] == code
    assert refused(*sign, "--scope", own, "--days", "8") == (2, "USAGE")

    # suspending, and back
    why = ("--reason", "it asks oddly", "--as", "alice")
    assert done("agent", "suspend", "mover", *why)["status"] == "suspended"
    assert refused("agent", "attest", "mover", *runs) == (3, "AGENT_SUSPENDED")
    assert refused(*pass_on, "--restriction", less, "--out", tmp_path / "x") == (3, "AGENT_SUSPENDED")
    assert done("agent", "restore", "mover", *why)["status"] == "restored"
    assert refused("agent", "restore", "mover", *why) == (3, "NOTHING_TO_RESTORE")
    assert done("agent", "attest", "mover", *runs)["status"] == "active"

    # ending
    first_epoch = done("revoke", "hop", narrower["hop_id"], "--reason", "done", "--as", "alice")["epoch"]
    assert refused("revoke", "token", "no-token-id", "--reason", "x", "--as", "alice") == (3, "BODY_MALFORMED")
    assert done("agent", "retire", "mover", "--reason", "gone", "--as", "alice")["epoch"] > first_epoch
    assert refused("agent", "attest", "mover", *runs)[0] == 3
    assert refused("agent", "restore", "mover", *why) == (3, "AGENT_INACTIVE")


def test_pin_with_nothing_to_do_and_after_a_change(run, live, monkeypatch):
    who = ("--data", live.layout.root, "--as", "carol")
    assert run("mcp", "pin", *who, "--json").json == {"ok": True, "pinned": []}
    import pep.mcp.arm_server

    before = pep.mcp.arm_server.tool_definitions()
    after = (replace(before[0], definition_digest="ab" * 32), *before[1:])
    monkeypatch.setattr(pep.mcp.arm_server, "tool_definitions", lambda: after)
    assert run("mcp", "pin", *who, "--yes", "--json").json == {"ok": True, "pinned": [before[0].name]}
    assert run("mcp", "pin", *who, "--json").json == {"ok": True, "pinned": []}
    assert run("mcp", "pin", "--data", live.layout.root, "--as", "nobody", "--json").status == 2
