"""Two calls make an agent and lend to it: the same comes of it as of a whole scope."""

import hashlib
from pathlib import Path

import pytest
from capabilities.statements.revocation import RevocationView
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Grant, Scope, Tier
from tests.house.pages import BLOCK
from tests.ztpm_idp.world import AUDIENCE, World

from capabilities import Range, Restriction, key_from_pem, token_from_text, verify
from capabilities.keys import keys
from pep import grant
from ztpm_idp.client import ClientError
from ztpm_idp.client.callers import LENT_S

PAGE = Path(__file__).parents[3] / "docs" / "guard.md"
VIEW = RevocationView(epoch=0, age_ms=0, revoked=frozenset())
STOP, MOVE = Grant("ur3e", "stop"), Grant("ur3e", "home")


def chain_of(world, text):
    token = token_from_text(text, DEFAULT)
    at = world.clock()
    return verify(token, at=at, audience=AUDIENCE, view=VIEW, lease_ms=1, trust=world.trust, caps=DEFAULT)


def test_a_new_agent_is_registered_attested_and_lends(world: World, tmp_path):
    software = tmp_path / "planner.py"
    software.write_text("pass")
    alice, now = world.people["alice"], int(world.clock())
    planner = alice.new_agent("planner", software, role="planner")
    worker = alice.new_agent("worker", str(software), role="worker", model="m")
    rows = {each["id"]: each for each in alice.agents()}
    assert {(rows[each]["sponsor"], rows[each]["status"]) for each in ("planner", "worker")} == {("alice", "active")}
    assert rows["planner"]["software_digest"] == hashlib.sha256(b"pass").hexdigest()
    assert (rows["planner"]["role"], rows["worker"]["model"]) == ("planner", "m")
    assert rows["planner"]["key"] != rows["worker"]["key"]

    lent = alice.lend(planner, (STOP, MOVE), AUDIENCE, purpose="tidy up", delegates=["worker"])
    assert chain_of(world, lent.token).scope == Scope(
        (MOVE, STOP), Tier.REVERSIBLE, frozenset({AUDIENCE}), frozenset({"worker"}), 1, now, now + LENT_S
    )
    narrower = planner.delegate(lent.token, worker, Restriction((STOP,)), purpose="wait")
    assert chain_of(world, narrower.token).leaf.agent == "worker"

    alone = chain_of(world, alice.lend(planner, [STOP], AUDIENCE, purpose="tidy up", lifetime_s=60).token).scope
    assert (alone.delegates, alone.depth, alone.not_after) == (frozenset(), 0, now + 60)


def test_an_id_that_is_taken_and_a_file_that_is_not_there(world: World, tmp_path):
    alice = world.people["alice"]
    alice.new_agent("planner", __file__, role="planner")
    with pytest.raises(ClientError) as refused:
        alice.new_agent("planner", __file__, role="planner")
    assert refused.value.code == "ALREADY_REGISTERED"
    with pytest.raises(FileNotFoundError):
        alice.new_agent("worker", tmp_path / "none.py", role="worker")
    assert "worker" not in {each["id"] for each in alice.agents()}


def test_the_page_on_guarding_lends_so(world: World, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    alice, passphrase = world.people["alice"], b"a passphrase for tests"
    Path("alice.key").write_bytes(keys.to_pem(world.private["alice"], passphrase))
    Path("planner.py").write_text("pass")
    blocks = [text for kind, text in BLOCK.findall(PAGE.read_text("utf-8")) if kind == "python"]
    names = {"__name__": "page", "Path": Path, "Range": Range, "grant": grant, "key_from_pem": key_from_pem}

    def operator(name, key, issuer):
        assert (name, keys.public_raw(key)) == ("alice", keys.public_raw(world.private["alice"]))
        assert issuer.endswith("/ztpm")
        return alice

    names |= {"Operator": operator, "passphrase": passphrase}
    for text in (blocks[0], next(text for text in blocks if "alice.lend" in text)):
        exec(compile(text, "docs/guard.md", "exec"), names)  # noqa: S102 - the page itself
    worker = alice.new_agent("worker", "planner.py", role="worker")
    kept = Restriction((grant(names["search_docs"]),))
    assert names["planner"].delegate(names["lent"].token, worker, kept, purpose="look it up").hop_id
