"""`ztpm client`: clients and scopes are made and listed, and what was lent is taken back, at a real provider."""

import json

import pytest
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.oauth.speaking import StockClient, limits, looked_at
from tests.ztpm_idp.oauth.test_code_flow import BACK, Flow
from tests.ztpm_idp.world import AUDIENCE, World
from ztpm_idp.client import Operator

from capabilities.keys import keys
from ztpm.cli.provider import person


@pytest.fixture
def world(tmp_path, monkeypatch):
    with World(tmp_path) as made:
        monkeypatch.setattr(person, "operator", lambda **asked: made.caller(Operator, asked["name"]))
        made.pep()
        yield made


def test_from_registering_a_client_to_taking_back(run, world, tmp_path):
    key = keys.b64u(keys.public_raw(keys.generate()))
    assert run("client", "list", "--as", "alice").out == "Nothing.\n"
    told = run("client", "register", "viewer", "--name", "The viewer", "--redirect", BACK, "--as", "alice", "--json")
    assert told.json == {"ok": True, "client_id": "viewer"}
    assert run("client", "register", "job", "--name", "Job", "--public", key, "--as", "alice").status == 0
    assert run("client", "register", "job-2", "--name", "Job", "--public", "x", "--as", "alice").status != 0
    assert run("client", "register", "job-3", "--name", "Job", "--as", "carol").status == 3
    listed = run("client", "list", "--as", "alice", "--json").json["clients"]
    assert [row["token_endpoint_auth_method"] for row in listed] == ["private_key_jwt", "none"]
    assert "The viewer" in run("client", "list", "--as", "alice").out

    file = tmp_path / "limits.json"
    file.write_text(json.dumps(limits()))
    declared = ("client", "scope", "camera.read", file, "--words", "use the camera", "--audience", AUDIENCE)
    assert run(*declared, "--as", "alice").status == 0
    assert run("client", "scopes", "--as", "alice", "--json").json["scopes"][0]["ceiling"] == 1
    file.write_text(json.dumps({"ceiling": 1}))
    assert run(*declared, "--as", "alice").status == 3

    browser = Browser(world)
    browser.log_in(world.people["alice"])
    flow = Flow(world, browser, StockClient(world))
    given = flow.redeem(flow.code()).json()
    (lent,) = run("client", "lent", "--as", "alice", "--json").json["lent"]
    assert run("client", "take-back", lent["id"], "--reason", "enough", "--as", "bob").status == 3
    assert run("client", "take-back", lent["id"], "--reason", "enough", "--as", "alice").status == 0
    assert looked_at(world, given["access_token"]) == {"active": False}
    assert "ended" in run("client", "lent", "--as", "alice").out
    assert run("client", "end-scope", "camera.read", "--as", "alice").status == 0
    assert run("client", "end-scope", "camera.read", "--as", "alice").status == 3
