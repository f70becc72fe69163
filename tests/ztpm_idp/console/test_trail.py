"""The console's trail: the ledger searched, one request followed, everything exported; people and agents beside it."""

from __future__ import annotations

import base64
import json
import re

import pytest
import rfc8785
from msgspec import structs
from capabilities.values.scope import Tier
from pep.base.operations import MOVE_JOINT
from pep.request.authority import Credentials
from pep.request.call import Call
from policies.decision import pdp
from policies.evidence.evidence import Evidence, ToolReading
from policies.evidence.model import ApprovalUse
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.console.looking import AT, NAMED, Looking
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import SLOWER, World
from ztpm_idp.console import history, journey, pictures, plot, trail

from capabilities.keys import keys
from capabilities.log import tree_head
from capabilities.statements.people import picture
from pep.gate import records
from ztpm_idp.client import Operator


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A world with one story, which the questions of this module share; none of them changes it."""
    with World(tmp_path_factory.mktemp("trail"), settings_changes={"issuer": NAMED}) as world:
        cell = Cell(world)
        world.person("iris", "auditor")
        world.people["iris"] = world.caller(Operator, "iris")
        planner = world.agent("planner")
        journal = Journal(world, registered=True)
        first = world.people["alice"].issue(planner, world.scope(), purpose="p")
        hop = planner.delegate(first.token, world.agents["mover"], SLOWER, purpose="q")
        world.done = journal.acted(hop.token, tier=2)
        for _ in range(3):
            world.clock.at_s += 1
            world.refused = journal.refused(hop.token, reason="LIMIT_EXCEEDED_BY_REQUEST", tier=3)
        journal.ship()
        ask_id, text = cell.taken(token_id=first.token_id)
        assert cell.post("carol", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text)}).status_code == 201
        world.people["alice"].revoke("hop", hop.hop_id, "over")
        world.story = first, hop, ask_id
        yield world


@pytest.fixture(scope="module")
def iris(told):
    return Looking(told, "iris")


def numbers(text):
    return [int(number) for number in re.findall(rf'href="{AT}/trail/entries/(\d+)"', text)]


@pytest.mark.clause("CON-5")
def test_search_finds_by_who_what_when_reason_and_tier(told, iris):
    first, hop, ask_id = told.story
    every = numbers(iris.see("/trail"))
    assert every == sorted(every, reverse=True), "the newest first"
    size = told.sql("SELECT max(seq) FROM ledger")[0][0]
    assert every[0] == size
    kinds = {number: kind for number, kind in told.sql("SELECT seq, kind FROM ledger_index")}
    asked = {
        f"token={first.token_id}": None,
        "actor=carol": {"vote-cast"},
        "kind=revoked": {"revoked"},
        "reason=LIMIT_EXCEEDED_BY_REQUEST": {"decision"},
        "tier=2": {"decision"},
        "tier=3": {"decision", "ask-taken"},
        "reason=over&kind=revoked": {"revoked"},
        f"request={ask_id}": {"ask-taken", "vote-cast"},
        "agent=mover&kind=decision&tier=3": {"decision"},
    }
    for question, wanted in asked.items():
        found = numbers(iris.see(f"/trail?{question}&object=&trace="))
        assert found, question
        assert wanted is None or {kinds[number] for number in found} == wanted, question
    assert len(numbers(iris.see("/trail?reason=LIMIT_EXCEEDED_BY_REQUEST"))) == 3
    assert numbers(iris.see("/trail?reason=NO_SUCH_REASON")) == []
    assert numbers(iris.see("/trail?until=2020-01-01T00:00")) == []
    assert numbers(iris.see("/trail?since=2020-01-01T00:00")) == every
    older = numbers(iris.see(f"/trail?before={every[5]}"))
    assert older[0] == every[5] - 1


@pytest.mark.clause("CON-5")
def test_pages_follow_each_other_without_a_gap(told, iris, monkeypatch):
    monkeypatch.setattr(trail, "ROWS", 4)
    for question in ("", "tier=3", "reason=LIMIT_EXCEEDED_BY_REQUEST"):
        seen, path = [], f"/trail?{question}"
        while path is not None:
            shown = iris.see(path)
            seen += numbers(shown)
            found = re.search(rf'href="{AT}(/trail\?[^"]*before=\d+)"', shown)
            path = None if found is None else found[1].replace("&amp;", "&")
        assert seen == sorted(set(seen), reverse=True)
        assert len(seen) == (told.sql("SELECT count(*) FROM ledger")[0][0] if not question else len(seen))
        assert seen


@pytest.mark.clause("CON-5")
def test_a_requests_whole_way_is_on_one_page(told, iris):
    first, hop, _ = told.story
    shown = iris.see(f"/trail/requests/{told.done.request_id}")
    for part in ("move_joint of ur3e", "alice", "planner", "mover", hop.hop_id, first.token_id, "PERMIT", "done",
                 "300000", "token-delegated"):  # fmt: skip
        assert part in shown, part
    refused = iris.see(f"/trail/requests/{told.refused.request_id}")
    assert "LIMIT_EXCEEDED_BY_REQUEST" in refused and "DENY" in refused


@pytest.mark.clause("CON-5")
def test_a_decision_of_this_very_set_is_told_policy_by_policy(told):
    """The set's answers are computed again from the recorded case; a decision of another set is not judged by ours."""
    journal, policies = Journal(told, registered=True), told.provider.rules.policies
    token = told.people["alice"].issue(told.agents["planner"], told.scope(), purpose="p").token
    request = journal.request()
    tool = ToolReading(request.operation, "d" * 64, "d" * 64, Tier.REVERSIBLE)
    evidence = Evidence(at=request.at, at_ms=1, chain=journal.chain(token), proof=True, tool=tool, request_fault=None)
    decided = pdp.decide(request, evidence, policies)
    call = Call(request, MOVE_JOINT, tool, Credentials(b"", evidence.chain, True), 0, None)
    body = records.decision(call, evidence, decided)
    line = rfc8785.dumps({"seq": 1, "at_ms": 1, "body": {"record": {"kind": "decision", "body": body}}})
    way = journey.way_of([line], policies)
    assert {"robot", "perception"} <= set(way.missing) and ("proof", "True") in way.plain
    (found,) = way.decisions
    assert {row.what for row in found.judged if row.depth == 0} == {policy.id for policy in policies.policies}
    assert found.combined and found.effect == str(decided.effect)
    other = line.replace(policies.digest.encode(), b"0" * 64)
    (unexplained,) = journey.way_of([other], policies).decisions
    assert unexplained.judged == () and unexplained.reason == found.reason


@pytest.mark.clause("CON-5")
def test_everything_found_is_exported_whole(told, iris):
    lines = iris.get(f"{AT}/trail/export?kind=decision&form=lines")
    assert lines.headers["content-disposition"] == 'attachment; filename="ledger.ndjson"'
    found = [json.loads(line) for line in lines.text.splitlines()]
    assert len(found) == 4 and {entry["body"]["record"]["kind"] for entry in found} == {"decision"}
    assert len(iris.get(f"{AT}/trail/export?tier=3&kind=decision&form=cef").text.splitlines()) == 3
    whole = iris.get(f"{AT}/trail/export").text.splitlines()
    assert json.loads(whole[-1]).keys() == {"checkpoint"}
    assert len(whole) == told.sql("SELECT max(seq) FROM ledger")[0][0] + 1


@pytest.mark.clause("CON-8")
def test_a_permitted_motion_has_the_picture_of_its_ask_and_its_measured_end(tmp_path):
    with World(tmp_path, settings_changes={"issuer": NAMED}) as world:
        cell, text = Cell(world), picture.write(SHOWN)
        stated = cell.text(picture_digest=picture.digest_of(text))
        ask_id = cell.post("cell-1", "/approvals", {"ask": stated, "picture": text}).json()["ask_id"]
        journal = Journal(world, registered=True)
        token = world.people["alice"].issue(world.agents["mover"], world.scope(), purpose="p").token
        request, body = journal.decision(token)
        body["approval"] = records.use_body(ApprovalUse(ask_id, 1))
        digest = journal.record("decision", body)
        ended = {"outcome": "stopped", "stopped_at_urad": [17, 4, 0, 0, 0, 0]}
        journal.record("outcome", records.outcome(request, digest, "done", result=ended))
        journal.ship()
        alone = journal.acted(token)
        journal.ship()

        alice = Looking(world, "alice")
        shown = alice.see(f"/trail/requests/{request.request_id}")
        (number,) = [row["seq"] for row in world.rows("ledger_index") if row["kind"] == "ask-taken"]
        assert f'data-subject="{ask_id}"' in shown and f'data-number="{number}"' in shown
        assert picture.digest_of(text) in shown and "stopped_at_urad" in shown and "person-7" in shown
        own = re.search(r'data-picture="([^"]*)"', shown)[1]
        assert alice.get(own).text == text
        assert 'class="pictured"' not in alice.see(f"/trail/requests/{alone.request_id}")


@pytest.mark.clause("CON-9")
def test_a_motion_that_nobody_was_asked_about_has_the_picture_that_its_record_names(tmp_path):
    with World(tmp_path, settings_changes={"issuer": NAMED}) as world:
        cell, text = Cell(world), picture.write(SHOWN)
        journal = Journal(world, registered=True)
        token = world.people["alice"].issue(world.agents["mover"], world.scope(), purpose="p").token
        request, without = journal.acted(token), journal.acted(token)
        digest = journal.pictured(request, text)
        journal.record("picture", {"request_id": without.request_id, "reason": "PICTURE_QUEUE_FULL"})
        journal.ship()
        alice = Looking(world, "alice")
        where = f"/trail/requests/{request.request_id}"
        shown = alice.see(where)
        own = re.search(r'data-picture="([^"]*)"', shown)[1]
        assert own == f"{AT}/trail/pictures/{digest}" and f'data-subject="{request.request_id}"' in shown
        assert alice.get(own).json()["code"] == "PICTURE_AWAITED"
        assert cell.post("cell-1", "/ledger/pictures", {"picture": text}).status_code == 201
        assert alice.get(own).text == text
        told = alice.see(f"/trail/requests/{without.request_id}")
        assert "PICTURE_QUEUE_FULL" in told and "data-canvas" not in told

        for number in range(pictures.MOST + 2):
            journal.pictured(request, picture.write(structs.replace(SHOWN, omitted=number)))
        journal.ship()
        whole = alice.see(where)
        assert whole.count("data-canvas") == pictures.MOST
        last = world.sql("SELECT seq FROM ledger_index WHERE kind = 'picture' ORDER BY seq DESC LIMIT 3")
        assert re.findall(
            r"\d+", whole[whole.index("More pictures") : whole.index("</p>", whole.index("More pictures"))]
        )[1::2] == [str(seq) for (seq,) in reversed(last)]


@pytest.mark.clause("CON-6")
def test_an_entrys_bytes_and_proof_are_those_that_anybody_checks(told, iris):
    line = iris.get(f"{AT}/trail/entries/3/line").content
    proof = tree_head.read_proof(iris.get(f"{AT}/trail/entries/3/proof").text)
    head = tree_head.check_entry(line, proof, tree_head.origin_of(NAMED), told.trust.ledger)
    assert (proof.index, head.size) == (2, told.sql("SELECT max(seq) FROM ledger")[0][0])
    shown = iris.see("/trail/entries/3")
    assert all(keys.b64u(key) in shown for key in told.trust.ledger)
    assert base64.b64encode(head.root).decode() in proof.checkpoint


@pytest.mark.clause("CON-7")
def test_people_with_their_keys_and_who_is_leaving(told, iris):
    change = told.people["alice"].propose_end("carol", "has left")
    shown = iris.see("/people")
    carol = shown.partition("<h2>carol")[2].partition("</li>")[0]
    assert "is leaving" in carol and change[:11] in carol and "has left" in carol and "approver" in carol
    told.people["dan"].decline_change(change, "not yet")
    assert "is leaving" not in iris.see("/people").partition("<h2>carol")[2].partition("</li>")[0]


@pytest.mark.clause("CON-7")
def test_an_agents_attestation_trust_and_behaviour(told, iris):
    shown = iris.see("/agents/mover")
    assert 'class="plot"' in shown and "evidence of kind key" in shown
    # the last point of the picture is what enforcement points are told
    (row,) = [row for row in told.people["alice"].agents() if row["id"] == "mover"]
    (score,) = row["trust_by"].values()
    assert f"planner {score / 1000:.2f}" in shown
    assert "No enforcement point has recorded" in iris.see("/agents/planner")
    assert "mover" in iris.see("/agents")


@pytest.mark.clause("CON-7")
def test_the_picture_of_trust_is_the_reducers_own(told):
    lines = [bytes(row["line"]) for row in sorted(told.rows("ledger"), key=lambda row: row["seq"])]
    parameters = told.provider.rules.policies.parameters
    found = history.trust_over_time(lines, "mover", parameters, now=int(told.clock()))
    assert set(found) == {"planner"}
    values = [value for _, value in found["planner"]]
    assert values[0] == parameters.trust_prior_permille and min(values) < values[0]
    assert history.trust_over_time(lines, "planner", parameters, now=int(told.clock())) == {}


@pytest.mark.clause("CON-4")
def test_a_picture_escapes_its_words_and_has_no_style():
    drawn = plot.stairs({"<b>": [(0, 800), (5, 2_000)]}, levels={"<i>": 500}, begin='"', end="&", label='"><script>')
    assert "<b>" not in drawn and "<i>" not in drawn and "<script>" not in drawn and "style" not in drawn
    assert drawn.count("<svg") == 1


@pytest.mark.clause("CON-5")
@pytest.mark.parametrize("line", [b"{}", b'{"body":5}', b'{"body":{"decision":5,"ask":7,"request":[]}}',
                                  b'{"body":{"record":{"body":{"decision":{"findings":5,"tier":"x"}}}}}'])  # fmt: skip
def test_entries_of_any_shape_are_told(told, line):
    assert journey.told(line).tier is None
    assert pictures.pictures_of([line]) == pictures.ends_of([line]) == ()
    assert journey.way_of([line], told.provider.rules.policies).outcome == ""
