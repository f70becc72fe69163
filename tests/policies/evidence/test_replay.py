"""A case decided again from its record gets the same decision; any other form is refused with its place."""

import asyncio
import copy
import hashlib
import json
import math
import random
from dataclasses import fields, replace

import pytest
import rfc8785
from capabilities.values.arguments import argument
from capabilities.values.chain import Refusal
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Each, Range, Stems, Tier
from capabilities.values.units import kind_of
from policies.conduct import journal_reports
from policies.decision.load import load_shipped
from policies.evidence.shape import fault
from policies.words.canonical import EXACT
from tests.model import triples
from tests.pep.kit import MOVE, full_scope, reading
from tests.pep.people.test_approvals import Critical, People
from tests.policies import world

from policies import NOT_COLLECTED, Effect, Evidence, ImpactFault, PolicyError, PolicyFault, Reason, decide
from policies.evidence import case_json
from policies.words import canonical

F = PolicyFault
SHIPPED = load_shipped("paper-default")


def carried(request, evidence):
    """The document after a way through canonical JSON."""
    return json.loads(rfc8785.dumps(case_json.to_plain(request, evidence)))


def ordinary():
    return carried(*world.asked())


@pytest.mark.long
@pytest.mark.parametrize("count", [300, pytest.param(5_000, marks=pytest.mark.campaign)])
def test_random_triples_are_decided_the_same_from_their_record(count):
    for seed in range(count):
        request, evidence, policies = triples.triple(random.Random(seed).choice)
        again = case_json.read(carried(request, evidence))
        assert again.request == request, seed
        assert again.evidence.digest == evidence.digest, seed
        assert decide(again.request, again.evidence, policies) == decide(request, evidence, policies), seed


def test_of_a_scope_the_record_has_the_grant_that_was_asked_for():
    request, evidence = world.asked()
    again = case_json.read(carried(request, evidence)).evidence
    for hop, kept in zip(evidence.chain.hops, again.chain.hops, strict=True):
        assert [(g.object, g.operation) for g in kept.scope.grants] == [(request.object, request.operation)]
        assert kept.scope.find(request.object, request.operation) == hop.scope.find(request.object, request.operation)
        assert replace(kept, scope=replace(kept.scope, grants=hop.scope.grants)) == hop
    bare = case_json.read_evidence(json.loads(json.dumps(case_json.evidence_to_plain(evidence, None))))
    assert {hop.scope.grants for hop in bare.chain.hops} == {()}


def test_the_digest_of_readings_is_that_of_their_map_and_takes_them_plain():
    request, evidence = world.asked()
    for each in (evidence, replace(evidence, chain=Fault(FaultCode.REVOKED, "TOK-9"))):
        chain = each.chain
        if chain is evidence.chain:
            chain = ("verified", chain.token_id, chain.digest, chain.root_key_id, chain.epoch, chain.view_age_ms)
        readings = {field.name: getattr(each, field.name) for field in fields(each)}
        assert each.digest == canonical.digest("evidence", {**readings, "chain": chain})
        assert each.digest == each.digest_of(case_json.evidence_to_plain(each, request))


def test_what_a_value_remembers_for_itself_is_not_written():
    request, evidence = world.asked()
    evidence.chain.scope.find(request.object, request.operation)
    assert '"_' not in json.dumps(case_json.to_plain(request, evidence))


@pytest.mark.parametrize("at", [0.1, 1e9, 1_000_000.000_001, -0.0, 5e-324, math.inf, -math.inf, math.nan])
def test_times_are_exact(at):
    request, _ = world.asked()
    again = case_json.read(carried(request, Evidence(at=at, at_ms=EXACT + 2))).evidence
    assert again.at.hex() == at.hex()
    assert again.at_ms == EXACT + 2


def test_a_person_may_write_plain_numbers_and_leave_out_what_was_not_collected():
    document = ordinary()
    document["evidence"] = {"type": "Evidence", "at": 1000, "at_ms": 5}
    document["request"] |= {"at": 1000.5}
    del document["request"]["digest"]
    read = case_json.read(document)
    assert (read.request.at, read.evidence.at, type(read.evidence.at)) == (1000.5, 1000.0, float)
    assert read.evidence.chain is read.evidence.impact is NOT_COLLECTED


def at(document, path):
    *steps, last = path.split(".")
    for step in steps:
        document = document[int(step)] if isinstance(document, list) else document[step]
    return document, int(last) if isinstance(document, list) else last


BAD = {
    "another form": ("form", "ztpm/case/2", F.UNKNOWN_VALUE, "form"),
    "a form that is a number": ("form", 1, F.UNKNOWN_VALUE, "form"),
    "no table": ("request", [], F.WRONG_TYPE, "request"),
    "a digest of another request": ("request.operation", "stop", F.UNKNOWN_VALUE, "request.digest"),
    "a point that does not exist": ("request.points.0", "e9", F.UNKNOWN_VALUE, "request.points[0]"),
    "a value without unit": ("request.values.0", ["q0", 1], F.OUT_OF_RANGE, "request.values[0]"),
    "a value that is a fraction": ("request.values.0.2", 1.5, F.WRONG_TYPE, "request.values[0][2]"),
    "a value that is true": ("request.values.0.2", True, F.WRONG_TYPE, "request.values[0][2]"),
    "an unknown unit": ("request.values.0.1", "deg", F.UNKNOWN_VALUE, "request.values[0][1]"),
    "an id that is no text": ("request.id", 7, F.WRONG_TYPE, "request.id"),
    "evidence that is a word": ("evidence", "not collected", F.WRONG_TYPE, "evidence"),
    "another record": ("evidence.type", "Request", F.UNKNOWN_VALUE, "evidence.type"),
    "a tier that does not exist": ("evidence.tool.base_tier", 5, F.WRONG_TYPE, "evidence.tool.base_tier"),
    "a tier that is true": ("evidence.tool.base_tier", True, F.WRONG_TYPE, "evidence.tool.base_tier"),
    "a reading of another kind": ("evidence.tool.type", "TrustReading", F.WRONG_TYPE, "evidence.tool"),
    "a reading that is a word": ("evidence.trust", "unknown", F.WRONG_TYPE, "evidence.trust"),
    "no reading where there must be one": ("evidence.trust", None, F.WRONG_TYPE, "evidence.trust"),
    "a proof that is a number": ("evidence.proof", 1, F.WRONG_TYPE, "evidence.proof"),
    "a float in decimal text": ("evidence.at", {"float": "1.5"}, F.WRONG_TYPE, "evidence.at"),
    "a float and more": ("evidence.at", {"float": "0x1.8p+0", "unit": "s"}, F.WRONG_TYPE, "evidence.at"),
    "a number beyond a double": ("evidence.at", 10**400, F.OUT_OF_RANGE, "evidence.at"),
    "an integer in text": ("evidence.at_ms", {"int": "5"}, F.WRONG_TYPE, "evidence.at_ms"),
    "an integer with a zero in front": ("evidence.at_ms", {"int": "09007199254740993"}, F.WRONG_TYPE, "evidence.at_ms"),
    "an integer that no reader keeps": ("evidence.at_ms", 2**53, F.WRONG_TYPE, "evidence.at_ms"),
    "bytes in capital letters": ("evidence.chain.digest", {"hex": "AA"}, F.WRONG_TYPE, "evidence.chain.digest"),
    "bytes that are none": ("evidence.chain.digest", {"hex": "0"}, F.WRONG_TYPE, "evidence.chain.digest"),
    "a set that is a list": ("evidence.chain.hops.0.scope.audiences", [], F.WRONG_TYPE, "evidence.chain.hops[0].scope.audiences"),
    "a member twice": ("evidence.chain.hops.0.scope.audiences", {"set": ["a", "a"]}, F.DUPLICATE_VALUE, "evidence.chain.hops[0].scope.audiences"),
    "a remembered hash": ("evidence.chain.hops.0.scope.grants.0._hash", 1, F.UNKNOWN_KEY, "evidence.chain.hops[0].scope.grants[0]._hash"),
    "something opaque": ("evidence.proof", {"opaque": "object"}, F.WRONG_TYPE, "evidence.proof"),
    "an attestation of an unknown kind": ("evidence.chain.hops.0.attestation.kind", "oath", F.UNKNOWN_VALUE, "evidence.chain.hops[0].attestation.kind"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_of_the_form_is_refused_with_its_place(name):
    path, value, fault, where = BAD[name]
    document = ordinary()
    table, last = at(document, path)
    table[last] = value
    with pytest.raises(PolicyError) as error:
        case_json.read(document)
    assert (error.value.code, error.value.where) == (fault, where)


@pytest.mark.parametrize(
    ("path", "where"),
    [
        ("request", "request"),
        ("form", "form"),
        ("request.at", "request.at"),
        ("evidence.at", "evidence.at"),
        ("evidence.chain.sponsor", "evidence.chain.sponsor"),
        ("evidence.impact.type", "evidence.impact"),
    ],
)
def test_what_is_missing_is_refused(path, where):
    document = ordinary()
    table, last = at(document, path)
    del table[last]
    with pytest.raises(PolicyError) as error:
        case_json.read(document)
    assert (error.value.code in {F.MISSING_KEY, F.WRONG_TYPE}, error.value.where) == (True, where)


@pytest.mark.long
@pytest.mark.parametrize("count", [600, pytest.param(10_000, marks=pytest.mark.campaign)])
def test_mutilated_documents_are_refused_or_read_and_nothing_else(count):
    chance = random.Random(4)
    strange = [None, True, -1, 2**60, 1.5, "", "not collected", [], {}, {"set": [{}]}, {"hex": "zz"}, {"type": []}]
    for _ in range(count):
        document = ordinary()
        where = document
        while isinstance(where, (dict, list)) and where:
            key = chance.choice(list(where) if isinstance(where, dict) else range(len(where)))
            if chance.random() < 0.3 or not isinstance(where[key], (dict, list)):
                where[key] = copy.deepcopy(chance.choice(strange))
                break
            where = where[key]
        try:
            read = case_json.read(document)
        except PolicyError:
            continue
        decide(read.request, read.evidence, world.load_shipped("paper-default"))


@pytest.mark.parametrize("document", [None, 7, "x", [], {}, {1: 2}, {"form": case_json.FORM}])
def test_what_is_no_document_is_refused(document):
    with pytest.raises(PolicyError):
        case_json.read(document)


# --- a gate's own journal --------------------------------------------------------------------------------------------


def replayed(rig):
    """Every decision of the journal as (its body, the decision on what the record holds)."""
    for record in rig.records("decision"):
        body = json.loads(json.dumps(record["body"]))
        read = case_json.read({key: body[key] for key in ("form", "request", "evidence")})
        yield body, decide(read.request, read.evidence, rig.policies)


def same(body, again):
    from pep.gate.records import decision_body

    return {k: v for k, v in decision_body(again).items() if k != "by"} == {
        k: v for k, v in body["decision"].items() if k != "by"
    }


def a_day(rig):
    """Day of a cell: most of the possible decisions, and most of the possible faults."""
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=600_000))

    def go(who=holder, **options):
        return asyncio.run(rig.gate.run(rig.call(who, **options), rig.effect))

    rig.physics.answer = reading()
    go()
    go(tool="read_state")
    go(tool="gripper_move", arguments={"width_m": 0.05, "speed_m_s": 0.05, "force_n": 30.0})
    go(arguments={**MOVE, "speed_rad_s": 0.7})  # over the token's limit
    go(arguments={**MOVE, "q_rad": [6.4, 0.0, 0.0, 0.0, 0.0, 0.0]})  # over the robot's
    go(digest="e" * 64)
    for answer in (
        reading(2, 1_500), reading(3, 2_500), reading(4, 3_500), reading(1, 900, violations=("person",)),
        reading(1, 900, perception="stale"), ImpactFault("PERCEPTION_INVALID"), RuntimeError("boom"),
    ):  # fmt: skip
        rig.physics.answer = answer
        go()
    rig.physics.answer = reading(2, 1_500)
    rig.registry.trust = {"robotic": 650}
    go()
    rig.registry.trust = {}
    rig.readiness.answer = replace(rig.readiness.answer, safety_mode=3, remote_control=None)
    go()
    rig.readiness.answer = replace(rig.readiness.answer, safety_mode=1, remote_control=True)
    go()
    # what the gate itself denies
    rig.slot.holder = "another"
    go()
    rig.slot.holder = None
    rig.before_effect = lambda: rig.clock.advance(51)
    go()
    rig.before_effect = lambda: None
    rig.physics.answer = reading(3, 2_500)
    go()
    rig.clock.advance(61_000)
    rig.asks.expire()
    go()
    rig.physics.answer = reading()
    rig.feed.age_ms = 2_001
    go()
    rig.feed.age_ms = 0
    rig.feed.revoke("hop", holder.hop_id)
    go()
    rig.clock.advance(700_000)
    go()


def test_every_decision_of_a_gate_is_decided_the_same_from_its_record(tmp_path):
    rig = People(tmp_path)
    try:
        a_day(rig)
        own = {}
        seen = set()
        for body, again in replayed(rig):
            seen.add((body["decision"]["effect"], body["decision"]["reason"]))
            if body["decision"]["by"] == "gate":
                own[body["decision"]["reason"]] = again.reason
            else:
                assert same(body, again), body["decision"]["reason"]
        assert {str(effect) for effect, _ in seen} == {"PERMIT", "DENY", "DEFER"}
        assert len(seen) >= 14, seen
        # behind the gate's own denial stands what the policies said
        assert set(own) == {"BUSY", "APPROVAL_TIMEOUT", "EVIDENCE_MISSING"}
        assert own["APPROVAL_TIMEOUT"] is Reason.TIER_NEEDS_APPROVAL
        sizes = [len(rfc8785.dumps(record)) for record in rig.records("decision")]
        assert max(sizes) < 8_000, sizes
    finally:
        rig.gate.close()
        rig.journal.close()


@pytest.mark.parametrize("kind", [People, Critical])
def test_what_people_answered_is_decided_the_same_from_its_record(tmp_path, kind):
    rig = kind(tmp_path)
    try:
        rig.ask()
        rig.cast(*(rig.vote(person) for person in ("bob", "carol")))
        assert rig.go().decision.effect is Effect.PERMIT
        rig.go()
        for body, again in replayed(rig):
            assert same(body, again)
            assert (again.approval is None) == ("approval" not in body)
        assert rig.records("decision")[1]["body"]["decision"]["tier"] == int(Tier(rig.tier))
    finally:
        rig.gate.close()
        rig.journal.close()


# --- values of each kind ---------------------------------------------------------------------------------------------

KINDS = {
    "text": ("text", "é pump"), "path": ("path", "/srv/a"), "url": ("url", "https://a.example/x"), "flag": ("flag", True),
    "free": ("free", {"a": [1, None]}), "texts": ("[text]", ["a", ""]), "bars": ("[x-bar/1000]", [1, 2]),
    "bar": ("x-bar/1000", 7),
}  # fmt: skip


def of_each_kind():
    request, evidence = world.asked()
    values = tuple(argument(name, kind_of(kind), value) for name, (kind, value) in KINDS.items())
    text = values[0]
    stems = Stems(frozenset({"pump"}), "")
    refused = Refusal(
        FaultCode.LIMIT_EXCEEDED_BY_REQUEST, parameter="text", value=text.value, unit=text.kind, bound=stems,
        nearest="pump", hop=0, hop_id="0" * 32, agent="a", sponsor="s",
    )  # fmt: skip
    listed = replace(refused, unit=kind_of("[x-bar/1000]"), value=(1, 2), bound=Each(Range(0, 1), 0, 9), nearest=(1, 1))
    return replace(request, values=values), [replace(evidence, request_fault=each) for each in (None, refused, listed)]


def test_a_request_with_values_of_each_kind_is_read_as_it_was_and_is_decided_the_same():
    request, seen = of_each_kind()
    assert [value.name for value in request.quantities] == ["bar"]
    for evidence in seen:
        assert fault(request, evidence) is None
        again = case_json.read(carried(request, evidence))
        assert (again.request, again.evidence.digest) == (request, evidence.digest)
        decided, before = decide(again.request, again.evidence, SHIPPED), decide(request, evidence, SHIPPED)
        assert replace(decided, evidence=None) == replace(before, evidence=None)
    told = decide(request, seen[2], SHIPPED).findings[0].detail
    assert (told["kind"], told["member"], told["nearest_permitted"]) == ("[x-bar/1000]", 1, (1, 1))


def test_a_report_has_the_numbers_of_a_request_alone():
    request, (evidence, *_) = of_each_kind()
    decision = {"tier": 1, "effect": "PERMIT", "reason": "PERMITTED"}
    body = {**case_json.to_plain(request, evidence), "decision": decision}
    found = journal_reports.decided(body, reporter="pep-1", at_ms=1_000_000)
    assert found.report.values == (("bar", 7),)
    body["request"]["values"][0][1] = "word"
    assert journal_reports.decided(body, reporter="pep-1", at_ms=1_000_000) is None, "no kind is called so"


def test_the_digest_is_of_the_canonical_form_of_every_value():
    request, _ = of_each_kind()
    stated = case_json.request_to_plain(request)
    content = {each: stated[each] for each in ("audience", "object", "operation", "values")}
    assert request.digest == hashlib.sha256(rfc8785.dumps(content)).hexdigest()
    assert len({replace(request, values=(value,)).digest for value in request.values}) == len(KINDS)


@pytest.mark.parametrize(
    ("stated", "code"),
    [
        (["x", "text", "a\u200b"], F.OUT_OF_RANGE), (["x", "text", 1], F.WRONG_TYPE), (["x", "path", "/a/"], F.OUT_OF_RANGE),
        (["x", "flag", 1], F.WRONG_TYPE), (["x", "free", "abc"], F.WRONG_TYPE), (["x", "x-bar", 1], F.UNKNOWN_VALUE),
        (["x", "free", {"sha256": "AB" * 32, "size_bytes": 9}], F.WRONG_TYPE), (["x", "[free]", []], F.UNKNOWN_VALUE),
        (["x", "free", {"sha256": "ab" * 32, "size_bytes": 0}], F.WRONG_TYPE), (["x", "[text]", "a"], F.WRONG_TYPE),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_or_spelling_is_not_read(stated, code):
    with pytest.raises(PolicyError) as refused:
        case_json.read_request({**case_json.request_to_plain(world.asked()[0]), "values": [stated]})
    assert (refused.value.code, refused.value.where.startswith("request.values[0]")) == (code, True)
