"""Journal as the status page knows it: written by the real one, followed as it grows, rubbish passed over."""

import json

import pytest
from pep.base.clock import SystemClock
from pep.journal.file_journal import FileJournal
from ztpm.status.decisions import Decisions

from ztpm.status import decisions as module


def decision(request_id, effect="PERMIT", *, ask=None, reason="PERMITTED", tier=1, agent="mover"):
    body = {
        "request": {"id": request_id, "operation": "move_joint"},
        "decision": {"effect": effect, "reason": reason, "tier": tier},
        "evidence": {"chain": {"hops": [{"agent": "planner"}, {"agent": agent}]}},
    }
    return body | ({"ask": ask} if ask else {})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.ndjson"


@pytest.fixture
def journal(path):
    opened = FileJournal.open(path, pep_id="cell-1", clock=SystemClock())
    yield opened
    opened.close()


def test_newest_first_with_outcome_and_leaf(path, journal):
    seen = Decisions(path)
    seen.follow()
    assert seen.newest() == ()
    journal.append("decision", decision("r1"))
    journal.append("decision", decision("r2", "DENY", reason="BUSY", tier=None))
    seen.follow()
    assert [(d.request_id, d.effect, d.outcome, d.agent) for d in seen.newest()] == [
        ("r2", "DENY", "", "mover"),
        ("r1", "PERMIT", "", "mover"),
    ]
    journal.append("outcome", {"request_id": "r1", "decision": "", "outcome": "done"})
    journal.append(
        "refusal", {"effect": "DENY", "reason": "REVOKED", "where": {"path": "/mcp"}, "evidence": {"chain": {}}}
    )
    journal.append("outcome", {"request_id": "stop", "outcome": "done", "stop": {"operation": "stop", "caller": None}})
    seen.follow()
    assert [(d.operation, d.effect, d.reason, d.outcome, d.tier) for d in seen.newest()] == [
        ("stop", "PERMIT", "PERMITTED", "done", 0),
        ("/mcp", "DENY", "REVOKED", "", None),
        ("move_joint", "DENY", "BUSY", "", None),
        ("move_joint", "PERMIT", "PERMITTED", "done", 1),
    ]


@pytest.mark.parametrize("kind", ["ask-answered", "ask-expired", "ask-refused"])
def test_asks_are_open_until_their_time_or_their_end(path, journal, kind):
    seen = Decisions(path)
    for n, until in ((1, 1_000), (2, 2_000), (3, 3_000)):
        ask = {"ask_id": f"a{n}", "expires_at_ms": until}
        journal.append("decision", decision(f"r{n}", "DEFER", ask=ask, reason="TIER_NEEDS_APPROVAL", tier=3))
    journal.append("decision", decision("r4", "DENY", ask={"ask_id": "a9", "expires_at_ms": 9_000}))
    seen.follow()
    assert [ask.ask_id for ask in seen.open_asks(at_ms=999)] == ["a1", "a2", "a3"]
    assert [ask.ask_id for ask in seen.open_asks(at_ms=1_000)] == ["a2", "a3"]
    journal.append(kind, {"ask_id": "a2"})
    seen.follow()
    assert [(ask.ask_id, ask.agent, ask.tier) for ask in seen.open_asks(at_ms=1_000)] == [("a3", "mover", 3)]


def test_a_line_that_is_being_written_is_taken_when_it_is_whole(path):
    line = json.dumps({"kind": "decision", "at_ms": 1, "body": decision("r1")}).encode() + b"\n"
    path.write_bytes(line[:40])
    seen = Decisions(path)
    seen.follow()
    assert seen.newest() == ()
    path.write_bytes(line)
    seen.follow()
    seen.follow()
    assert [d.request_id for d in seen.newest()] == ["r1"]


def test_rubbish_is_passed_over(path):
    good = json.dumps({"kind": "decision", "at_ms": 1, "body": decision("r1")})
    rubbish = ["", "{", "[]", "null", '{"kind": 1}', '{"kind":"decision","at_ms":1,"body":[]}', "[" * 100_000, "\udcff"]
    rubbish += [
        json.dumps({"kind": kind, "at_ms": 1, "body": {}}) for kind in ("decision", "outcome", "refusal", "ask-expired")
    ]
    path.write_bytes("\n".join([*rubbish, good, *rubbish, ""]).encode("utf-8", "surrogateescape"))
    seen = Decisions(path)
    seen.follow()
    assert [d.request_id for d in seen.newest()] == ["r1"]


def test_only_the_end_of_a_long_journal_is_read_at_first(path, monkeypatch):
    monkeypatch.setattr(module, "FIRST_BYTES", 2_000)
    monkeypatch.setattr(module, "READ_BYTES", 700)
    lines = [json.dumps({"kind": "decision", "at_ms": n, "body": decision(f"r{n}")}) for n in range(100)]
    path.write_text("\n".join(lines) + "\n")
    seen = Decisions(path)
    seen.follow()
    newest = [d.request_id for d in seen.newest()]
    assert newest == [f"r{n}" for n in range(99, 99 - len(newest), -1)]
    assert 3 <= len(newest) < 20


def test_a_journal_that_is_not_there_is_told(tmp_path):
    with pytest.raises(OSError, match="journal"):
        Decisions(tmp_path / "journal").follow()
