"""The ledger for auditors: tree and index follow it, proofs hold for strangers, search finds everything."""

from __future__ import annotations

import json

import pytest
from tests.capabilities.log.test_log import defined
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import SLOWER, World
from ztpm_idp.client.auditing import LedgerKeys
from ztpm_idp.domain import audit as rows
from ztpm_idp.provider import cef
from ztpm_idp.provider.audit import LedgerFollower
from ztpm_idp.store import audit as tables

from capabilities.log import merkle, tree_head
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.long


def ledger_of(world: World) -> LedgerKeys:
    return LedgerKeys(world.trust.issuer, world.trust.ledger)


def lines_of(world: World) -> list[bytes]:
    return world.people["alice"].export_ledger().splitlines()[:-1]


def refused(code, call, *given, **more):
    with pytest.raises(ClientError) as caught:
        call(*given, **more)
    assert caught.value.code == code


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A world that the questions of this module share; none of them changes it."""
    with World(tmp_path_factory.mktemp("told")) as made:
        yield made


@pytest.fixture(scope="module")
def lent(told):
    """A token, a hop, and acts with it, one of them asked for: one story for an auditor."""
    world = told
    cell = Cell(world)
    journal = Journal(world, registered=True)
    planner, mover = world.agent("planner"), world.agents["mover"]
    first = world.people["alice"].issue(planner, world.scope(), purpose="p")
    hop = planner.delegate(first.token, mover, SLOWER, purpose="q")
    done = journal.acted(hop.token)
    journal.refused(hop.token)
    journal.ship()
    ask_id, text = cell.taken(token_id=first.token_id)
    assert cell.post("carol", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text)}).status_code == 201
    world.people["alice"].revoke("hop", hop.hop_id, "over")
    return first, hop, done, ask_id


def test_every_entry_is_proven_to_whoever_has_the_key_alone(told, lent):
    lines, ledger = lines_of(told), ledger_of(told)
    monitor = told.people["bob"]
    head = ledger.open(monitor.checkpoint())
    assert (head.size, head.root) == (len(lines), defined(lines)), "against the definition, with no code of ours"
    for number, line in enumerate(lines, start=1):
        proof = monitor.entry_proof(number)
        assert proof.index == number - 1
        assert tree_head.check_entry(line, proof, ledger.origin, ledger.keys) == head
    assert told.people["alice"].entry(3) == lines[2]
    digest = json.loads(lines[4])["prev"]
    assert monitor.entry_proof(digest).index == 3
    for missing in (0, len(lines) + 1, "0" * 64):
        refused("ENTRY_UNKNOWN", monitor.entry_proof, missing)
    refused("ENTRY_UNKNOWN", told.people["alice"].entry, len(lines) + 1)
    refused("NOT_PERMITTED", monitor.entry, 1)


def test_the_ledger_goes_on_from_every_checkpoint_that_was_held(world):
    ledger, bob = ledger_of(world), world.people["bob"]
    held = [ledger.open(bob.checkpoint())]
    for number in range(5):
        world.person(f"p{number}", "sponsor")
        held.append(ledger.open(bob.checkpoint()))
    for each in held:
        assert ledger.open(bob.goes_on(each, ledger)).size == held[-1].size
    shorter = tree_head.TreeHead(ledger.origin, held[-1].size + 1, bytes(32))
    refused("ENTRY_UNKNOWN", bob.goes_on, shorter, ledger)


def test_tiles_at_their_edges(world):
    """Tree and index of many entries, followed in steps by two at once, are those of all at once."""
    entries = 600
    import asyncio

    import sqlalchemy as sa
    from ztpm_idp.domain.ledger import FIRST_PREV, seal
    from ztpm_idp.store import schema as t

    async def filled():
        store = world.provider.store
        size = (await counted(store)).ledger_size
        prev = FIRST_PREV
        made = []
        for seq in range(size + 1, entries + 1):
            entry = seal(
                seq=seq, prev=prev, at_ms=seq, actor="a", kind="revoked", body={"kind": "token", "id": f"t{seq % 7}"}
            )
            made.append({"seq": seq, "hash": entry.digest, "line": entry.line})
            prev = entry.digest
        followers = [LedgerFollower(store), LedgerFollower(store)]
        for begin in range(0, len(made), 100):  # and so over the edges of tiles
            async with store.write() as transaction:
                await transaction._connection.execute(sa.insert(t.ledger), made[begin : begin + 100])
            await asyncio.gather(*(follower.through() for follower in followers))
        async with store.read() as view:
            lines = [
                bytes(line)
                for line in await view._connection.scalars(sa.select(t.ledger.c.line).order_by(t.ledger.c.seq))
            ]
            index = (
                await view._connection.scalars(sa.select(t.ledger_index.c.seq).order_by(t.ledger_index.c.seq))
            ).all()
            heads = []
            for size in (1, 200, 255, 256, 257, 511, 512, 513, entries):
                wanted = set()
                merkle.root(size, lambda level, index: wanted.add((level, index)) or bytes(32))
                node = await view.audit.node(wanted)
                heads.append((merkle.root(size, node), defined(lines[:size])))
        return lines, index, heads

    async def counted(store):
        async with store.read() as view:
            return await view.counters()

    lines, index, heads = world.on_loop(filled())
    assert len(lines) == entries and list(index) == list(range(1, entries + 1))
    assert all(found == expected for found, expected in heads)


def test_a_ledger_that_lacks_an_entry_has_no_checkpoint(world):
    """Changed by hand: nothing is signed over what is left, and nobody waits for what never comes."""
    import sqlalchemy as sa
    from ztpm_idp.store import schema as t

    async def lose():
        async with world.provider.store.write() as transaction:
            await transaction._connection.execute(sa.delete(t.ledger).where(t.ledger.c.seq == 2))

    world.on_loop(lose())
    refused("STORE_UNAVAILABLE", world.people["bob"].checkpoint)


def test_one_key_finds_the_whole_story_of_a_token(told, lent):
    first, hop, done, ask_id = lent
    alice = told.people["alice"]
    kinds = [row["kind"] for row in alice.search_rows({"token": first.token_id})]
    assert kinds == [
        "token-issued", "token-delegated", "decision", "outcome", "decision", "ask-taken", "vote-cast", "revoked",
    ]  # fmt: skip
    story = list(alice.search_rows({"request": done.request_id}))
    assert [(row["kind"], row["effect"], row["token"], row["agent"], row["object"]) for row in story] == [
        ("decision", "PERMIT", first.token_id, "mover", "ur3e"), ("outcome", "done", first.token_id, "mover", "ur3e"),
    ]  # fmt: skip
    asked = [(row["kind"], row["actor"], row.get("effect")) for row in alice.search_rows({"request": ask_id})]
    assert asked == [("ask-taken", "cell-1", None), ("vote-cast", "carol", "approve")]


@pytest.mark.parametrize("change, found", [
    ({"kind": "agent-registered"}, {"planner", "mover"}), ({"kind": "nothing"}, set()), ({"actor": "alice", "kind": "pep-registered"}, {"cell-1"}),
    ({"object": "mover"}, {"mover"}), ({"since_ms": 1_800_000_000_001}, set()), ({"until_ms": 1_800_000_000_000}, set()),
    ({"since_ms": 1_800_000_000_000, "until_ms": 1_800_000_000_001, "kind": "pep-registered"}, {"cell-1"}), ({"trace": "0" * 32}, set()),
])  # fmt: skip
def test_filters(told, lent, change, found):
    assert {row.get("object") for row in told.people["alice"].search_rows(change)} == found


def test_an_agent_is_found_by_what_it_did_and_what_was_done_to_it(told, lent):
    kinds = {row["kind"] for row in told.people["alice"].search_rows({"agent": "planner"})}
    assert kinds == {"agent-registered", "agent-attested", "token-issued", "token-delegated"}


def test_pages_meet_without_gap_or_repetition(told, lent):
    alice, lines = told.people["alice"], lines_of(told)
    with told.known("alice") as http:
        seen, after = [], 0
        while True:
            answer = http.get(f"/ledger/search?most=4&after={after}&form=lines")
            seen += answer.content.splitlines()
            if (more := answer.headers.get("ztpm-more-after")) is None:
                break
            after = int(more)
    assert seen == lines, "the entries as they are, so that their hashes can be computed"
    assert b"".join(alice.search_pages({}, form="lines", after=5)).splitlines() == lines[5:]


@pytest.mark.parametrize("query", [
    "kind=", "kind=a&kind=b", "most=0", "most=1001", "most=-1", "after=x", "form=xml", "who=alice", "since_ms=1e3", "agent=" + "a" * 257, "agent=%00", "after=9007199254740992",
])  # fmt: skip
def test_questions_that_are_none(told, query):
    with told.known("alice") as http:
        assert http.get(f"/ledger/search?{query}").json()["code"] == "QUERY_MALFORMED"


@pytest.mark.parametrize(
    "query", ["", "?entry=x", "?entry=1&hash=" + "0" * 64, "?hash=zz", "?entry=1&entry=2", "?size=1"]
)
def test_proofs_of_nothing(told, query):
    with told.known("bob") as http:
        assert http.get(f"/ledger/proofs/inclusion{query}").json()["code"] == "QUERY_MALFORMED"


def test_who_reads(told, lent):
    for name, allowed in (
        ("alice", True),
        ("carol", True),
        ("dan", True),
        ("bob", False),
        ("cell-1", False),
        ("mover", False),
    ):
        with told.known(name) as http:
            assert (http.get("/ledger/search").status_code == 200) is allowed
            assert (http.get("/ledger/entries/1").status_code == 200) is allowed
            assert http.get("/ledger/checkpoint").status_code == 200
    with told.anonymous() as http:
        for path in ("search", "entries/1", "checkpoint", "proofs/inclusion?entry=1", "proofs/consistency?old=1"):
            assert http.get(f"/ledger/{path}").json()["code"] == "PROOF_MISSING"


def test_an_answer_is_bounded_in_bytes(told, lent, monkeypatch):
    from ztpm_idp.provider import audit

    monkeypatch.setattr(audit, "ANSWER_BYTES", 1_000)
    with told.known("alice") as http:
        first = http.get("/ledger/search?form=lines")
    assert len(first.content.splitlines()) >= 1
    assert len(first.content) < 4_000 and "ztpm-more-after" in first.headers
    assert b"".join(told.people["alice"].search_pages({}, form="lines")).splitlines() == lines_of(told)


# --- CEF -------------------------------------------------------------------------------------------------------------


def read_cef(line: str) -> tuple[list[str], dict[str, str]]:
    """Header and extension of an event, read as the format's document says; shares no code with its writer."""
    fields, field, at = [], "", 0
    while len(fields) < 7:
        if line[at] == "\\":
            field, at = field + line[at + 1], at + 2
        elif line[at] == "|":
            fields.append(field)
            field, at = "", at + 1
        else:
            field, at = field + line[at], at + 1
    import re

    found = {}
    for key, value in re.findall(r"(\w+)=((?:[^=\\]|\\.)*?)(?=\s\w+=|$)", line[at:]):
        found[key] = re.sub(r"\\(.)", lambda m: {"n": "\n", "r": "\r"}.get(m[1], m[1]), value)
    return fields, found


def test_events_of_a_siem(told, lent):
    alice = told.people["alice"]
    rows_, text = list(alice.search_rows({})), b"".join(alice.search_pages({}, form="cef")).decode()
    events = [read_cef(line) for line in text.splitlines()]
    assert len(events) == len(rows_)
    for row, (header, extension) in zip(rows_, events, strict=True):
        assert header[:5] == ["CEF:0", "ZTPM", "ztpm_idp", "1", row["kind"]]
        assert (extension["externalId"], extension["rt"], extension["suser"]) == (
            str(row["seq"]),
            str(row["at_ms"]),
            row["actor"],
        )
        assert extension.get("cs1") == row.get("token") and extension["cs6"] == row["hash"]
    denied = next(event for event in events if event[0][5] == "decision DENY")
    assert denied[1]["reason"] == "NOT_GRANTED" and denied[0][6] == "5"


@pytest.mark.parametrize("hostile", [
    "a|b", "a\\b", "a=b", "a\nb", "a\rb", "a\r\nCEF:0|x|y", "x cs1=forged", "\\", "=", "a\u2028b", "a\x85b", "\x0b", "ä|=\\",
])  # fmt: skip
def test_no_value_ends_its_event_or_forges_a_field(hostile):
    line = json.dumps({"body": {"reason": hostile}}).encode()
    row = rows.AuditRow(7, 1, hostile, hostile, agent=hostile, token="T", effect=hostile)
    event = cef.event(row, "0" * 64, line)
    assert len(event.splitlines()) == 1
    header, extension = read_cef(event)
    assert len(header) == 7
    assert (extension["externalId"], extension["cs1"]) == ("7", "T")
    if not set(hostile) & set("\n\r\u2028\x85\x0b"):
        assert header[4] == hostile and extension["reason"] == hostile and extension["cs2"] == hostile


def test_strange_entries_have_a_row():
    for body in (
        {},
        {"request": 1, "evidence": [], "decision": None, "ask": "x.y", "agent": 5},
        {"evidence": {"chain": {"hops": [1, "a"]}}},
    ):
        line = json.dumps({"seq": 1, "at_ms": 2, "kind": "odd", "actor": "a", "body": body}).encode()
        assert rows.row_of(line).kind == "odd"
    assert tables.TILE == 1 << tables.TILE_LEVELS
