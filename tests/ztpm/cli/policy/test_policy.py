"""`ztpm policy` on files, good and bad, and on the journal of a real gate."""

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import rfc8785
from pep.base.operation_row import OperationKind
from pep.base.operations import OPERATIONS
from policies.decision.load import TEXT_LIMIT
from tests.pep.kit import MOVE, Rig, full_scope, reading
from tests.policies.decision.test_load import BAD, GOOD
from tests.policies.explain.test_advice import GATED
from ztpm.cli.policy.surroundings import operations

import policies.proof
from policies import Point, load, load_shipped

pytestmark = [pytest.mark.version, pytest.mark.long]


MINE = """
name = "mine"
version = 1

[parameters]
trust_theta_permille = 700
attestation_age_s = 3_600

[[policy]]
id = "authority"
subject = { agents = "any", sponsors = "any" }
object = { ids = "any", operations = "any", without = ["stop"] }
predicate = { all = ["AID-1", "AID-3", "TEA-1", "TEA-2"] }
ep = ["e4", "e5"]
effect = "PERMIT"
obligation = ["record"]
pit_bound = "none"

[[policy]]
id = "impact"
subject = { agents = "any", sponsors = "any" }
object = { ids = "any", operations = "any", without = ["read_state", "stop"] }
predicate = { all = ["TEA-4", "CATP-3"] }
ep = ["e4", "e5"]
effect = "PERMIT"
obligation = ["record"]
pit_bound = 3
"""
"""A set of this file's own: what is shipped may change."""


def mine(*changes):
    text = MINE
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


@pytest.fixture
def file(tmp_path):
    def file(text, name="set.toml"):
        path = tmp_path / name
        path.write_text(text, "utf-8")
        return path

    return file


def told(run, *arguments, status=0):
    ran = run("policy", *arguments, "--json")
    assert ran.status == status, ran.out + ran.err
    return ran.json


def refused(run, *arguments, status=2):
    body = told(run, *arguments, status=status)
    assert body["ok"] is False
    return body["code"]


# --- check


def test_the_shipped_set_is_told_with_digest_parameters_and_primitives(run):
    body = told(run, "check")
    assert (body["name"], body["digest"]) == ("paper-default", load_shipped("paper-default").digest)
    assert len(body["primitives"]) == 25
    assert {p["name"]: (p["value"], p["unit"], p["stated"]) for p in body["parameters"]}["skew_s"] == (5, "s", True)
    shown = run("policy", "check")
    assert shown.status == 0
    assert "trust_theta_permille" in shown.out


@pytest.mark.parametrize("name", BAD)
def test_a_bad_set_is_refused_with_its_fault_and_place(run, file, name):
    text, fault, where = BAD[name]
    body = told(run, "check", file(text), status=2)
    assert (body["code"], body["where"]) == (str(fault), where)


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("enormous.toml", b"#" * (TEXT_LIMIT * 4), "TOO_LARGE"),
        ("latin.toml", b'name = "\xe9"', "UNREADABLE"),
        ("utf16.toml", GOOD.encode("utf-16"), "UNREADABLE"),
        ("zeros.toml", bytes(64), "NOT_TOML"),
    ],
)
def test_a_file_that_is_no_text_is_refused(run, tmp_path, name, content, code):
    path = tmp_path / name
    path.write_bytes(content)
    assert refused(run, "check", path) == code


def test_all_that_a_robot_can_be_asked_is_known_where_policies_are_checked():
    known = {(each.object, each.operation): each for each in operations()}
    for each in OPERATIONS:
        assert known[each.object, each.name].moves is (each.kind in (OperationKind.MOTION, OperationKind.SWITCH))
        assert Point.ACTUATION in known[each.object, each.name].points
    assert len(known) == len(operations())


def test_what_is_not_there_is_refused(run, tmp_path):
    assert refused(run, "check", "paper-defualt") == "UNKNOWN_SET"
    assert refused(run, "check", tmp_path / "none.toml") == "UNREADABLE"
    (tmp_path / "directory.toml").mkdir()
    assert refused(run, "check", tmp_path / "directory.toml") == "UNREADABLE"


def test_warnings_are_no_failure_unless_they_are_wanted_to_be(run, file):
    path = file(GATED + "[parameters]\ntrust_theta_permille = 700\n")
    body = told(run, "check", path)
    assert body["ok"]
    found = {(warning["code"], warning["where"]) for warning in body["warnings"]}
    assert ("PARAMETER_UNUSED", "parameters.trust_theta_permille") in found
    strict = told(run, "check", path, "--strict", status=1)
    assert (strict["ok"], strict["warnings"]) == (False, body["warnings"])
    shown = run("policy", "check", path)
    assert (shown.status, "PARAMETER_UNUSED" in shown.out) == (0, True)


def test_the_terminal_is_spoken_to_by_nobody_else(run, file):
    shown = run("policy", "check", file(GATED.replace('"small"', '"[red]x[/red]"').replace('"one"', '"[link=x]"')))
    assert "[red]x[/red]" in shown.out
    assert "[link=x]" in shown.out


# --- explain


def test_the_example_is_explained_and_is_of_the_schema(run, file):
    example = run("policy", "schema", "--example").out
    path = file(example, "case.json")
    body = told(run, "explain", "paper-default", "--request", path)
    assert body["decision"]["effect"] == "PERMIT"
    assert {p["id"]: p["says"] for p in body["policies"]}["authority"] == "PERMIT"
    shown = run("policy", "explain", "paper-default", "--request", path)
    assert (shown.status, "TEA-4 holds" in shown.out) == (0, True)
    schema = json.loads(run("policy", "schema").out)
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(json.loads(example))
    assert list(validator.iter_errors(json.loads(example) | {"more": 1}))


def test_a_denial_is_explained_down_to_the_primitive(run, file):
    case = json.loads(run("policy", "schema", "--example").out)
    case["evidence"]["trust"]["score_permille"] = 100
    case["evidence"]["tool"]["base_tier"] = 2
    path = file(json.dumps(case), "case.json")
    body = told(run, "explain", "paper-default", "--request", path)
    assert (body["decision"]["effect"], body["decision"]["primitive"]) == ("DEFER", "CATP-3")
    assert body["decision"]["text"]
    impact = next(p for p in body["policies"] if p["id"] == "impact")
    trust = next(part for part in impact["predicate"]["parts"] if part["what"] == "CATP-3")
    assert (trust["verdict"], trust["findings"][0]["reason"]) == ("defers", "TRUST_TOO_LOW")
    change = body["changes"][0]
    assert (change["means"], change["lifts"], change["effect"]) == ("approval", ["TRUST_TOO_LOW"], "PERMIT")
    shown = run("policy", "explain", "paper-default", "--request", path)
    assert "what would change the answer" in shown.out


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "MALFORMED"),
        ("[]", "WRONG_TYPE"),
        ('{"form": 1, "form": 1}', "MALFORMED"),
        ('{"form": NaN}', "NOT_FINITE"),
        ("[" * 100, "MALFORMED"),
        (" " * 1_048_577, "TOO_LARGE"),
        ('{"form": "ztpm/case/1"}', "MISSING_KEY"),
    ],
)
def test_a_case_that_is_none_is_refused(run, file, text, code):
    assert refused(run, "explain", "paper-default", "--request", file(text, "case.json")) == code


def test_what_to_explain_is_said_once(run, file, journal):
    path = file("{}", "case.json")
    assert refused(run, "explain", "paper-default", status=2) == "USAGE"
    assert refused(run, "explain", "paper-default", "--record", "x", status=2) == "USAGE"
    assert refused(run, "explain", "paper-default", "--journal", journal, status=2) == "USAGE"
    assert refused(run, "explain", "paper-default", "--request", path, "--journal", journal, status=2) == "USAGE"


# --- a journal


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """The journal of a gate that permitted, deferred, denied and was busy."""
    rig = Rig(tmp_path_factory.mktemp("journal"))
    rig.gate.close()
    rig.policies = load(MINE)
    rig.build()
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=600_000))

    def go(**options):
        return asyncio.run(rig.gate.run(rig.call(holder, **options), rig.effect))

    go()
    rig.clock.advance(1_000)
    go(arguments={**MOVE, "speed_rad_s": 0.7})
    rig.physics.answer = reading(3, 2_500)
    go()
    rig.physics.answer = reading(2, 1_500)
    rig.registry.trust = {"robotic": 650}
    go()
    rig.slot.holder = "another"
    go()
    rig.gate.close()
    rig.journal.close()
    return rig.path


def lines(journal):
    return [json.loads(line) for line in journal.read_bytes().splitlines()]


def decided(journal):
    return [record for record in lines(journal) if record["kind"] == "decision"]


@pytest.fixture
def ledger(journal, tmp_path):
    """The same records as a ledger holds them."""
    path = tmp_path / "ledger.ndjson"
    entries = [
        {"v": 1, "seq": i, "prev": "0" * 64, "at_ms": 5, "actor": r["pep"], "kind": "pep-record", "body": {"record": r}}
        for i, r in enumerate(lines(journal), start=1)
    ]
    entries.append(
        {"v": 1, "seq": len(entries) + 1, "prev": "0" * 64, "at_ms": 5, "actor": "a", "kind": "revoked", "body": {}}
    )
    path.write_bytes(b"".join(rfc8785.dumps(entry) + b"\n" for entry in [*entries, {"checkpoint": "x"}]))
    return path


def test_a_recorded_decision_is_explained_by_its_request_or_hash(run, journal, ledger, file):
    own = file(MINE)
    record = decided(journal)[1]
    by_request = told(run, "explain", own, "--record", record["body"]["request"]["id"], "--journal", journal)
    assert by_request["decision"]["reason"] == record["body"]["decision"]["reason"] == "LIMIT_EXCEEDED_BY_REQUEST"
    assert by_request["recorded"]["decision"]["reason"] == "LIMIT_EXCEEDED_BY_REQUEST"
    assert by_request["recorded"]["decision"]["policy_digest"] == by_request["set"]["digest"]
    by_hash = told(run, "explain", own, "--record", by_request["recorded"]["record"], "--journal", ledger)
    assert by_hash["decision"] == by_request["decision"]
    shown = run("policy", "explain", own, "--record", record["body"]["request"]["id"], "--journal", journal)
    assert "recorded as DENY LIMIT_EXCEEDED_BY_REQUEST" in shown.out
    assert refused(run, "explain", own, "--record", "none", "--journal", journal) == "NO_DECISION"


def test_the_same_set_decides_a_journal_the_same(run, journal, ledger, file):
    own = file(MINE)
    for path in (journal, ledger):
        body = told(run, "simulate", own, "--journal", path)
        assert (body["direction"], body["cases"], body["changed"]) == ("same", 4, 0)
        assert body["of_the_gate"] == {"BUSY": 1}
        assert body["not_replayable"] == {}


def test_a_changed_set_says_what_would_have_been_decided_otherwise(run, journal, file):
    milder = file(mine(("trust_theta_permille = 700", "trust_theta_permille = 600")), "milder.toml")
    body = told(run, "simulate", milder, "--journal", journal)
    assert (body["direction"], body["changed"]) == ("milder", 1)
    (moved,) = body["moved"]
    assert (moved["was"]["reason"], moved["now"]["reason"], moved["count"]) == ("TRUST_TOO_LOW", "PERMITTED", 1)
    assert decided(journal)[3]["body"]["request"]["id"] in moved["examples"][0]
    stricter = file(mine(("attestation_age_s = 3_600", "attestation_age_s = 1")), "stricter.toml")
    assert told(run, "simulate", stricter, "--journal", journal)["direction"] == "stricter"
    shown = run("policy", "simulate", milder, "--journal", journal)
    assert (shown.status, "TRUST_TOO_LOW" in shown.out, "BUSY" in shown.out) == (0, True, True)


def test_only_what_was_decided_since_then_is_decided_again(run, journal, file):
    own = file(MINE)
    import datetime as dt

    at = dt.datetime.fromtimestamp(decided(journal)[1]["at_ms"] / 1000, dt.UTC)
    for since in (at.isoformat(), at.replace(tzinfo=None).isoformat()):
        assert told(run, "simulate", own, "--journal", journal, "--since", since)["cases"] == 3
    assert refused(run, "simulate", own, "--journal", journal, "--since", "yesterday", status=2) == "USAGE"
    assert refused(run, "simulate", own, status=2) == "USAGE"


def spoilt(journal, change):
    records = lines(journal)
    change(next(record["body"] for record in records if record["kind"] == "decision"))
    return b"".join(rfc8785.dumps(record) + b"\n" for record in records)


def older(body):
    del body["form"]


def forged(body):
    body["evidence"]["trust"]["score_permille"] = 1


def strange(body):
    body["evidence"]["oracle"] = "yes"


@pytest.mark.parametrize(
    ("change", "code"), [(older, "NO_REPLAY"), (forged, "EVIDENCE_DIFFERS"), (strange, "UNKNOWN_KEY")]
)
def test_a_record_that_cannot_be_decided_again_is_counted_and_not_guessed(run, journal, tmp_path, file, change, code):
    own = file(MINE)
    path = tmp_path / "journal.ndjson"
    path.write_bytes(spoilt(journal, change))
    body = told(run, "simulate", own, "--journal", path)
    assert (body["cases"], body["not_replayable"]) == (3, {code: 1})
    record = decided(journal)[0]["body"]["request"]["id"]
    assert refused(run, "explain", own, "--record", record, "--journal", path) == code


def test_a_file_that_is_no_journal_is_refused_and_a_torn_line_is_none(run, journal, tmp_path, file):
    own = file(MINE)
    path = tmp_path / "journal.ndjson"
    for content in (b"hello\n", b"[]\n", b'{"kind": "decision"}\n{"kind": 1, "pep": 1}\n', b"3\n", b"x" * 1_048_580):
        path.write_bytes(content)
        status = run("policy", "simulate", own, "--journal", path, "--json")
        assert (status.status, status.json["code"]) == (2, "LINE_MALFORMED"), content[:20]
    path.write_bytes(journal.read_bytes()[:-20])
    assert told(run, "simulate", own, "--journal", path)["cases"] == 4


# --- diff


def test_two_sets_are_compared_as_texts_and_over_a_journal(run, journal, file):
    own = file(MINE, "own.toml")
    changed = mine(("trust_theta_permille = 700", "trust_theta_permille = 600"), ('"authority"', '"who"'))
    body = told(run, "diff", own, file(changed), "--journal", journal)
    assert body["parameters"] == [{"name": "trust_theta_permille", "was": "700 permille", "now": "600 permille"}]
    assert {p["id"]: p["change"] for p in body["policies"]} == {
        "impact": "changed",
        "authority": "removed",
        "who": "added",
    }
    assert (body["direction"], body["changed"]) == ("milder", 1)
    shown = run("policy", "diff", own, file(changed), "--journal", journal)
    assert (shown.status, "milder" in shown.out) == (0, True)


def test_two_sets_are_compared_over_written_cases(run, file):
    example = json.dumps(json.loads(run("policy", "schema", "--example").out))
    corpus = file(f"{example}\n{example}\n", "cases.ndjson")
    own = file(MINE, "own.toml")
    nobody = file(
        mine(('without = ["stop"]', 'without = ["stop", "move_joint"]'), ('"read_state", "stop"', '"move_joint"')),
        "nobody.toml",
    )
    body = told(run, "diff", own, nobody, "--corpus", corpus)
    (moved,) = body["moved"]
    assert (body["cases"], body["changed"], moved["examples"][0]) == (2, 2, "line 1: ur3e/move_joint")
    # the first case of a class is there whole, to be explained
    path = file(json.dumps(moved["first"]), "first.json")
    assert told(run, "explain", nobody, "--request", path)["decision"]["reason"] == moved["now"]["reason"]
    assert told(run, "diff", own, own, "--corpus", corpus)["direction"] == "same"
    assert refused(run, "diff", own, nobody, "--corpus", file("{}\n", "bad.ndjson")) == "MISSING_KEY"
    assert refused(run, "diff", own, nobody, "--corpus", file("x\n", "bad.xz")) == "LINE_MALFORMED"
    assert refused(run, "diff", "none", nobody) == "UNKNOWN_SET"


# --- names that nobody has ----------------------------------------------------------------------------------------------

AGENTS = [
    {"id": "mover", "status": "active", "sponsor": "alice"},
    {"id": "gone", "status": "revoked", "sponsor": "carol"},
]


@pytest.mark.parametrize(
    ("old", "new", "warned"),
    [
        ('agents = "any"', 'agents = ["mover"]', set()),
        ('agents = "any"', 'agents = ["moverr", "mover"]', {"AGENT_UNKNOWN"}),
        ('agents = "any"', 'agents = ["gone"]', {"AGENT_UNKNOWN"}),
        ('sponsors = "any"', 'sponsors = ["alice"]', set()),
        ('sponsors = "any"', 'sponsors = ["carol"]', {"SPONSOR_UNKNOWN"}),
    ],
)
def test_the_registry_is_asked_whom_a_set_names(run, file, cell, double, old, new, warned):
    double.answers = {"agents": AGENTS}
    asked = ("check", file(mine((old, new))), "--registry", "--as", "bob", "--data", cell.root)
    codes = {warning["code"] for warning in told(run, *asked)["warnings"]}
    assert codes & {"AGENT_UNKNOWN", "SPONSOR_UNKNOWN"} == warned
    assert [name for name, *_ in double.asked] == ["agents"]


@pytest.mark.parametrize("options", [["--registry"], ["--as", "bob"]])
def test_the_registry_is_asked_by_a_person(run, options):
    assert refused(run, "check", *options, status=2) == "USAGE"


def test_a_set_that_begins_with_a_byte_order_mark_is_read(run, file):
    assert told(run, "check", file("\ufeff" + mine()))["name"] == "mine"


# --- sets that extend another one


def test_a_set_that_extends_another_file_is_read_beside_itself(run, file):
    path = file('name = "line"\nversion = 1\nextends = "plant.toml"\n')
    assert refused(run, "check", path) == "UNKNOWN_BASE"
    file('name = "plant"\nversion = 1\nextends = "tools"\nremove = ["drift"]\nloosens = ["drift"]\n', "plant.toml")
    body = told(run, "check", path)
    assert (body["extends"]["name"], sorted(body["extends"]["kept"])) == ("plant", sorted(body["policies"]))
    assert "extends plant 1, and keeps whole: authority" in run("policy", "check", path).out
    assert told(run, "check", "tools")["extends"] is None
    assert sorted([*body["policies"], "drift"]) == sorted(policy.id for policy in load_shipped("tools").policies)
    file('name = "plant"\nversion = 1\nextends = "tools"\nremove = ["drift"]\n', "plant.toml")
    body = told(run, "check", path, status=2)
    assert (body["code"], body["where"]) == ("LOSES_DENIAL", "extends(plant.toml).remove[0]")


# --- operations that a tool server declares

GUARD = """
audience = "http://127.0.0.1:8900/mcp"
pep_id = "plant"
issuer = "http://127.0.0.1:8898/ztpm"
trust_file = "trust.json"
pep_key_file = "pep.key"
folder = "state"
"""
PRESS = """
[tool.close_press]
object = "press"
base_tier = 1
[tool.close_press.when]
"zone-a/people" = { at_least = { 1 = 3 } }
[tool.read_press]
object = "press"
base_tier = 0
[tool.stop]
object = "press"
base_tier = 2
"""
NO_DELETION = """
name = "plant"
version = 1
extends = "tools"
[[policy]]
id = "no deletion"
subject = { agents = "any", sponsors = "any" }
object = { ids = ["records"], operations = ["delete_record"] }
predicate = "always"
ep = ["e4"]
effect = "DENY"
obligation = ["record"]
pit_bound = "none"
"""
PLANT = ("--server", "examples.plant:server")


def warned(body):
    return {(each["code"], each["where"]) for each in body["warnings"]}


@pytest.fixture
def unproven(monkeypatch):
    """Nothing is proven: what a proof is told to take for harmless, and what it warns of, needs no solver."""
    monkeypatch.setattr(policies.proof, "prove", lambda *given, **options: ())


@pytest.mark.usefixtures("unproven")
def test_declared_operations_take_the_place_of_the_robots(run, file):
    guard = file(GUARD + PRESS, "guard.toml")
    own = file(NO_DELETION)
    assert warned(told(run, "check", own, *PLANT)) == set()
    assert warned(told(run, "check", own, "--guard", guard)) == {
        ("OBJECT_UNKNOWN", "no deletion"), ("OPERATION_UNKNOWN", "no deletion"),
    }  # fmt: skip
    slip = file(NO_DELETION.replace('"delete_record"', '"delete_records"'), "slip.toml")
    for command in (("check", slip), ("prove", slip), ("explain", slip, "--request", a_case(file))):
        assert ("OPERATION_UNKNOWN", "no deletion") in warned(told(run, *command, *PLANT)), command
    shown = run("policy", "check", slip, *PLANT)
    assert "OPERATION_UNKNOWN no deletion" in shown.out


def a_case(file, **changes):
    example = Path(policies.__file__).with_name("cases") / "ordinary.json"
    case = json.loads(example.read_text("utf-8"))
    case["request"] |= changes
    case["request"].pop("digest", None)
    return file(json.dumps(case), "case.json")


def test_an_explained_request_for_what_nothing_declares_is_told(run, file):
    asked = ("explain", "tools", *PLANT, "--request")
    assert ("OPERATION_UNKNOWN", "request") in warned(told(run, *asked, a_case(file)))
    known = a_case(file, object="oven", operation="set_temperature")
    assert warned(told(run, *asked, known)) == set()
    assert told(run, "explain", "tools", "--request", known)["warnings"] == [], "nothing was named to compare with"


@pytest.mark.usefixtures("unproven")
def test_what_changes_nothing_is_harmless_in_a_proof(run, file):
    guard = file(GUARD + PRESS, "guard.toml")
    assert told(run, "prove", "--set", "tools", *PLANT)["harmless"] == ["read_sensor", "search_docs"]
    assert told(run, "prove", "--set", "tools", "--guard", guard)["harmless"] == ["read_press"], (
        "a stop of its own is an act"
    )
    assert told(run, "prove", "--set", "tools")["harmless"] == ["read_state", "stop"]
    assert refused(run, "prove", "--set", "tools", "--guard", guard, "--harmless", "stop") == "USAGE"


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (("--server", "examples.plant:nothing"), "UNREADABLE"),
        (("--server", "nowhere:server"), "UNREADABLE"),
        (("--guard", "GUARD"), "USAGE"),
        (("--guard", "GUARD", "--server", "examples.plant:server"), "TOOL_UNKNOWN"),
        (("--guard", "WRONG"), "ROW_LOWERS"),
        (("--guard", "GONE"), "CONFIG_INVALID"),
    ],
)
def test_a_server_that_declares_nothing_or_wrongly_is_refused(run, file, options, code):
    tools = PRESS if "--server" in options else ""
    files = {
        "GUARD": file(GUARD + tools, "guard.toml"),
        "WRONG": file(GUARD + PRESS.replace("1 = 3", "1 = 1"), "wrong.toml"),
        "GONE": file("", "gone.toml").with_name("nothing.toml"),
    }
    status = 3 if code == "TOOL_UNKNOWN" else 2
    assert refused(run, "check", "tools", *(files.get(each, each) for each in options), status=status) == code


@pytest.mark.usefixtures("unproven")
def test_what_is_declared_and_not_registered_is_told(run, file, cell, double, monkeypatch):
    """Tools and sensors come from the signed registry of the server that guard.toml names."""
    from ztpm.cell import enrolment

    guard = file(GUARD.replace('"trust.json"', json.dumps(str(cell.trust))) + PRESS, "guard.toml")
    asked = []

    def registered(issuer, audience, trust, *, auth):
        asked.append(audience)
        return SimpleNamespace(tools=[SimpleNamespace(operation="read_press")], sensors=[SimpleNamespace(id="zone-b")])

    monkeypatch.setattr(enrolment, "registered", registered)
    double.answers = {"agents": AGENTS}
    options = ("--guard", guard, "--registry", "--as", "bob", "--data", cell.root)
    found = warned(told(run, "check", "tools", *options))
    assert found == {
        ("TOOL_UNREGISTERED", "press/close_press"), ("TOOL_UNREGISTERED", "press/stop"),
        ("SENSOR_UNREGISTERED", "press/close_press"),
    }  # fmt: skip
    assert asked == ["http://127.0.0.1:8900/mcp"]
    ghost = file(NO_DELETION.replace('agents = "any"', 'agents = ["gone"]'), "ghost.toml")
    proven = told(run, "prove", ghost, *options)
    assert {("AGENT_UNKNOWN", "no deletion"), ("TOOL_UNREGISTERED", "press/stop")} <= warned(proven)
    monkeypatch.setattr(enrolment, "registered", raising(enrolment.EnrolmentError("the registry answers 503")))
    assert refused(run, "check", "tools", *options, status=1) == "REGISTRY_UNAVAILABLE"


def raising(error):
    def fails(*given, **options):
        raise error

    return fails
