"""Faults of the feed that were found from outside, each as a test that fails without its mend."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest
from capabilities.values import text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.scope import Tier
from tests.ztpm_idp.test_revoking import forest, index
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World, drop_latest_columns
from ztpm_idp.domain import commands
from ztpm_idp.domain.events import PartyRegistered, RevocationKind, ToolRegistered
from ztpm_idp.domain.parties import RegisteredAgent, RegisteredSensor, RegisteredTool, Standing
from ztpm_idp.provider import provider as at_work
from ztpm_idp.provider.feed import SNAPSHOTS
from ztpm_idp.provider.problems import Problem
from ztpm_idp.store import rows

from capabilities.keys import keys
from capabilities.statements import registry
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.long

BASE = "http://h.example/mcp"
SIGNS = [chr(number) for number in range(0x21, 0x7F)] + ["é", "\u2028", "\U0001f600", "%2F", "//", "/..", ":80"]


def is_url(value):
    try:
        text.url(value, most_bytes=DEFAULT.text_bytes)
    except ScopeError:
        return False
    return True


def test_no_revoked_audience_bricks_the_feed(world):
    """Every spelling is either refused, or told to enforcement points as it was meant; the feed is read after each."""
    dan, told = world.people["dan"], set()
    for sign in SIGNS:
        named = f"{BASE}{sign}arm"
        try:
            dan.revoke("audience", named, "r")
        except ClientError as error:
            assert (error.code, error.status) == ("BODY_MALFORMED", 400), sign
            assert not is_url(named), sign
        else:
            told.add(named)
    assert f"{BASE},arm" in told, "a comma stands in a canonical URL, so a token can name it"
    assert not told & {f"{BASE}{sign}arm" for sign in "?#(é"}
    found = {entry.id for entry in index(world).entries}
    assert found == told
    world.stop()
    world.start()
    assert {entry.id for entry in index(world).entries} == told
    dan.revoke("audience", AUDIENCE, "after it all")
    assert AUDIENCE in {entry.id for entry in index(world).entries}


@pytest.mark.parametrize(
    ("kind", "id_"),
    [
        ("token", "A" * 21 + "B"),
        ("token", "A" * 64),
        ("hop", "a" * 31 + "\u0664"),
        ("hop", "a" * 33),
        ("key", "A" * 42 + "B"),
        ("agent", "role:mover"),
        ("agent", "m\u043ever"),
        ("agent", "mover,"),
        ("sponsor", "bob\n"),
        ("sponsor", ""),
        ("audience", "HTTP://h.example/mcp"),
        ("audience", "http://h.example:80/mcp"),
        ("audience", "http://h.example/mcp/"),
    ],
)
def test_an_id_has_the_grammar_of_what_a_token_names(world, kind, id_):
    with pytest.raises(ClientError) as caught:
        world.people["dan"].revoke(kind, id_, "r")
    assert caught.value.code == "BODY_MALFORMED"
    assert index(world).entries == ()


def test_a_revocation_that_no_reader_takes_is_not_committed(world):
    """Past the edge, too: what cannot be told is refused before the commit, and the next one is told."""
    command = commands.Revoke("dan", RevocationKind.AUDIENCE, "http://h.example/mcp?x", "r")
    with pytest.raises(Problem) as caught:
        world.on_loop(world.provider.run(command, actor="dan"))
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED
    assert (index(world).epoch, index(world).entries) == (0, ())
    assert world.people["dan"].revoke("audience", AUDIENCE, "r") == 1


SENSOR = RegisteredSensor(
    "camera", keys.public_raw(keys.generate()), "A" * 43, Standing.ACTIVE, bytes(32), 20, AUDIENCE
)


@pytest.mark.parametrize(
    "event",
    [
        PartyRegistered(replace(SENSOR, id="cam era")),
        PartyRegistered(replace(SENSOR, transit_ms=10_001)),
        ToolRegistered(RegisteredTool(AUDIENCE, "mo ve", bytes(32), "move", Tier(1))),
        ToolRegistered(RegisteredTool(AUDIENCE + "?", "move", bytes(32), "move", Tier(1))),
    ],
)
def test_a_registry_that_no_reader_takes_is_not_committed(world, monkeypatch, event):
    """The registry is read before the commit that changes it, for all input that the domain lets through."""
    monkeypatch.setattr(at_work, "decide", lambda *_: (event,))
    with pytest.raises(Problem) as caught:
        world.on_loop(world.provider.run(commands.GiveNonce("dan", "n" * 32), actor="dan"))
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED
    assert index(world).registry_version == START_VERSION


START_VERSION = 2
"""Two approvers are registered first."""


def test_a_feed_that_was_bricked_is_read_again(tmp_path):
    """A database in which an earlier release acknowledged an audience that nobody can read."""
    with World(tmp_path, database="sqlite") as world:
        dan = world.people["dan"]
        dan.revoke("audience", AUDIENCE, "r")
        dan.revoke("hop", "a" * 32, "r")
        world.stop()
        with closing(sqlite3.connect(tmp_path / "idp.sqlite")) as base, base:
            base.execute("UPDATE revocations SET id = 'http://h.example/mcp?x' WHERE epoch = 1")
            base.execute("DROP TABLE refusals")
            drop_latest_columns(base)
            base.execute("UPDATE alembic_version SET version_num = 'v0005'")
        world.start()
        first, second = index(world).entries
        assert (first.epoch, first.kind, second.id) == (1, "audience", "a" * 32)
        assert first.id.startswith("http://unreadable.invalid/")
        assert dan.revoke("audience", AUDIENCE, "again") == 3
        assert index(world, since=2).entries[0].id == AUDIENCE


@pytest.mark.parametrize(
    ("kind", "id_"), [("token", "A" * 22), ("hop", "a" * 32), ("key", "A" * 43), ("audience", "http://h.example/mcp")]
)
def test_a_revocation_of_what_never_was_is_told_as_such(world, kind, id_):
    made = world.people["dan"].revocation(kind, id_, "r")
    assert (made.epoch, made.known) == (1, False)
    assert world.people["dan"].revocation(kind, id_, "again").known is False


def test_a_revocation_of_what_is_known_is_told_as_such(world):
    ids, dan = forest(world), world.people["dan"]
    found = {
        (kind, name): dan.revocation(kind, id_, "r").known
        for (kind, name), id_ in ids.items()
        if (kind, name) not in {("agent", "unknown"), ("sponsor", "unknown"), ("sponsor", "alice")}
    }
    assert {name for name, known in found.items() if not known} == {
        ("token", "unknown"),
        ("hop", "unknown"),
        ("key", "unknown"),
    }


def references(value):
    match value:
        case dict():
            return {*([value["$ref"]] if "$ref" in value else []), *(r for v in value.values() for r in references(v))}
        case list():
            return {found for inner in value for found in references(inner)}
        case _:
            return set()


def test_the_openapi_has_no_dangling_reference_and_describes_refusals(world):
    with world.anonymous() as http:
        described = http.get(ISSUER + "/openapi.json").json()
        for reference in references(described):
            place = described
            for step in reference.removeprefix("#/").split("/"):
                place = place[step]
        for path, operations in described["paths"].items():
            for method, operation in operations.items():
                assert {"4XX", "5XX"} <= operation["responses"].keys(), (method, path)
                # no caller ever gets the framework's own
                assert "422" not in operation["responses"], (method, path)


def test_another_method_is_told_which_there_are(world):
    with world.anonymous() as http:
        for path, allowed in (("/tokens", "POST"), ("/revocations", "GET, POST"), ("/agents/x/retire", "POST")):
            answer = http.put(ISSUER + path)
            assert (answer.status_code, answer.headers["allow"]) == (405, allowed)
            assert answer.json()["code"] == "METHOD_NOT_ALLOWED"


def test_a_stranger_is_told_both_algorithms(world):
    with world.anonymous() as http:
        told = http.post(ISSUER + "/tokens").headers["www-authenticate"]
    assert 'algs="EdDSA ES256"' in told


def test_strangers_read_neither_registry_nor_conduct(world):
    asked = {"/registry": {"audience": AUDIENCE}, "/conduct": {"since": "0", "nonce": "n" * 16}}
    with world.anonymous() as stranger, world.known() as person:
        for path, query in asked.items():
            refused = stranger.get(ISSUER + path, params=query)
            assert (refused.status_code, refused.json()["code"]) == (401, "PROOF_MISSING")
            assert person.get(ISSUER + path, params=query).status_code == 200
    world.private["eve"] = keys.generate()
    with world.known("eve") as unknown:
        for path, query in asked.items():
            assert unknown.get(ISSUER + path, params=query).json()["code"] == "CALLER_UNKNOWN"


def test_a_registry_loads_no_agent_and_is_made_once_for_a_version(world, monkeypatch):
    for number in range(12):
        world.agent(f"agent-{number}", attested=False)
    world.agent("trusted")
    world.people["alice"].set_trust("trusted", 700)
    world.pep()
    made, inner = [], rows.party
    monkeypatch.setattr(rows, "party", lambda row: made.append(inner(row)) or made[-1])
    with world.known() as http:
        ask = lambda: http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
        first = ask()
        # the caller, the approvers and the enforcement point: as many however many agents there are
        assert not [party for party in made if isinstance(party, RegisteredAgent)]
        snapshot = registry.open(first, world.trust.registry, DEFAULT)
        assert (snapshot.trust_permille("trusted"), len(snapshot.trust), len(snapshot.peps)) == (700, 1, 1)
        made.clear()
        world.clock.at_s += 5
        assert ask() == first
        assert [party.id for party in made] == ["dan"], "the caller alone"
        world.people["alice"].revoke("agent", "trusted", "r")
        assert registry.open(ask(), world.trust.registry, DEFAULT).trust == ()


def test_no_more_registries_are_kept_than_are_bounded(world):
    with world.known() as http:
        for number in range(SNAPSHOTS + 3):
            http.get(ISSUER + "/registry", params={"audience": f"http://h{number}.example/mcp"})
    assert len(world.provider.snapshots) == SNAPSHOTS
