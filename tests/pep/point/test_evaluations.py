"""Evaluations of AuthZEN: the gate's own verdict, as advice that changes nothing, and DENY for all that is not known."""

import asyncio
import json
import secrets
from dataclasses import replace

import pytest
from capabilities.proof.evaluation import asked, prove_evaluation
from capabilities.statements.revocation import Revoked
from capabilities.token.mint import mint
from capabilities.token.token_text import token_to_text
from capabilities.values.scope import Scope, Tier
from pep.base.access_token import Looked
from pep.gate import gate as gate_module
from pep.base.errors import ConfigError
from pep.mcp.http_request import BODY_BYTES
from pep.point.evaluation_form import EVALUATIONS
from pep.point.evaluation_layer import DEADLINE_MS, ONE, SEVERAL, WELL_KNOWN, EvaluationLayer
from policies.evidence.model import Obligation, ObligationKind
from tests.hostile_bodies import HOSTILE_BODIES
from tests.pep.kit import AUDIENCE, CAPS, ISSUER, MOVE, FailingJournal
from tests.pep.point.asking_gateway import GATEWAY, LIMIT, ORIGIN, Asked, few, pouring, why

from capabilities.keys import keys
from capabilities.values.chain import Attestation, EvidenceKind, HopGrant, Sponsor

DENIED = {"effect", "reason"}
"""All that a stranger is told."""


@pytest.fixture
def point(tmp_path):
    made = Asked(tmp_path)
    yield made
    made.gate.close()
    made.journal.close()


# -- advice


@pytest.mark.clause("AZN-5")
def test_an_answer_is_advice_and_the_act_is_decided_anew(point):
    """Nothing is spent by asking, and nothing that was said holds later."""
    point.holder = point.held(few(1))
    for _ in range(3):
        told = point.ask(pouring(), holder=point.holder)
        assert why(told) == (True, "PERMITTED")
    assert (told["context"]["effect"], told["context"]["tier"]) == ("PERMIT", 1)
    assert {"kind": "record"} in told["context"]["obligations"]
    assert point.kinds() == ["advice"] * 3
    assert point.sent == []
    assert point.pour().effect == "PERMIT"
    spent = point.ask(pouring(), holder=point.holder)
    assert why(spent) == (False, "BUDGET_SPENT")
    assert (spent["context"]["left"], spent["context"]["set_by"]["agent"]) == (0, "robotic")
    assert point.kinds() == ["advice"] * 3 + ["decision", "outcome", "advice"]


@pytest.mark.clause("AZN-5", "AZN-7")
def test_advice_is_on_record_as_such_with_all_that_it_rests_on(point):
    """It is no intent: it is left open for no outcome, and counts for nobody's conduct."""
    point.ask(pouring(7), holder=point.holder, headers={"x-request-id": "q-1"})
    (record,) = point.records("advice")
    body = record["body"]
    assert body["decision"]["effect"] == "PERMIT"
    assert body["request"]["values"] == [["volume", "mL", 7]]
    assert (body["asked"]["caller"], body["asked"]["request"]) == ("agent robotic", "q-1")
    assert "approval" not in body
    assert body["evidence"]["chain"]["hops"][0]["agent"] == "robotic"
    point.gate.conduct.hear()
    assert not point.gate.conduct._open
    point.restart()
    assert point.kinds() == ["advice"], "no outcome is missing"


def test_a_denial_says_which_limit_who_set_it_and_what_would_be_permitted(point):
    told = point.ask(pouring(LIMIT + 1), holder=point.holder)
    assert why(told) == (False, "LIMIT_EXCEEDED_BY_REQUEST")
    context = told["context"]
    assert (context["parameter"], context["value"], context["unit"], context["nearest_permitted"]) == (
        "volume", LIMIT + 1, "mL", LIMIT,
    )  # fmt: skip
    assert (context["primitive"], context["set_by"]["sponsor"]) == ("TEA-2", "alice")
    assert context["remedy"]


@pytest.mark.clause("AZN-5")
def test_a_question_opens_no_question(point):
    """DEFER is a decision of false; people are asked by the act, and an evaluation then says so."""
    told = point.ask(pouring(LIMIT), holder=point.holder)
    assert why(told) == (False, "TIER_NEEDS_APPROVAL")
    assert (told["context"]["effect"], told["context"]["asked"]) == ("DEFER", False)
    assert (point.kinds(), point.issuer.asks) == (["advice"], {})
    assert point.pour(LIMIT).effect == "DEFER"
    (ask_id,) = point.issuer.asks
    told = point.ask(pouring(LIMIT), holder=point.holder)["context"]
    assert (told["asked"], told["approval_id"]) == (True, ask_id)
    assert told["url"].endswith(f"/approvals/{ask_id}/page")
    assert point.ask(pouring(LIMIT - 1), holder=point.holder)["context"]["asked"] is False

    # an approval is seen as often as it is asked for, and used by the act alone
    point.issuer.cast(ask_id, point.people["bob"].vote(point.issuer.asks[ask_id], at=point.clock.wall_s()))
    point.pull()
    for _ in range(3):
        told = point.ask(pouring(LIMIT), holder=point.holder)
        assert told["decision"] is True
        assert {"kind": "consume approval"} in told["context"]["obligations"]
        assert "approval" not in point.records("advice")[-1]["body"], "no use is taken"
    assert point.pour(LIMIT).approval.ask_id == ask_id
    assert why(point.ask(pouring(LIMIT), holder=point.holder)) == (False, "APPROVAL_USED")


def test_what_ended_since_denies(point):
    assert point.ask(pouring(), holder=point.holder)["decision"] is True
    given = point.forwarded(pouring())
    point.feed.revoke(Revoked.HOP, point.holder.hop_id)
    assert point.ask(given)["context"] == {"effect": "DENY", "reason": "REVOKED"}
    assert point.post(pouring(), holder=point.holder).json()["code"] == "REVOKED"
    point.feed.age_ms = 60_000
    assert why(point.ask(point.forwarded(pouring(), point.held()))) == (False, "REVOCATION_VIEW_STALE")


@pytest.mark.parametrize("digests", [{"pour": "e" * 64}, {"pour": ""}, {}])
def test_a_tool_that_is_not_as_approved_denies(point, digests):
    point.digests = digests
    assert why(point.ask(pouring(), holder=point.holder)) == (False, "TOOL_DEFINITION_CHANGED")


@pytest.mark.clause("AZN-5")
def test_a_robot_is_not_touched_by_a_question(point):
    """Physics is of the instant of a motion; a stop waits for nobody, not for a gateway either."""
    action = {"name": "move_joint", "properties": MOVE}
    move = pouring(action=action, resource={"type": "object", "id": "ur3e"})
    told = point.ask(move, holder=point.holder)
    assert why(told) == (False, "EVIDENCE_MISSING")
    point.slot.reserve("another")
    assert why(point.ask(move, holder=point.holder)) == (False, "EVIDENCE_MISSING"), "it asks for no slot"
    assert (point.physics.asked, point.slot.holder) == (0, "another")
    stop = pouring(action={"name": "stop"}, resource={"type": "object", "id": "ur3e"})
    assert why(point.ask(stop)) == (True, "PERMITTED")
    assert point.kinds() == ["advice"] * 3


# -- who asks, and of whom


@pytest.mark.clause("AZN-3", "PRF-12")
def test_a_gateway_passes_on_what_the_agent_signed(point):
    told = point.ask(point.forwarded(pouring(7)))
    assert why(told) == (True, "PERMITTED")
    assert point.records("advice")[0]["body"]["asked"]["caller"] == f"pep {GATEWAY}"


@pytest.mark.clause("AZN-3", "PRF-12")
@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        ({"over": pouring(8)}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"over": pouring(7, resource={"type": "object", "id": "sink"})}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"audience": "http://127.0.0.1:9/mcp"}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"token": "AAAA"}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"key": keys.generate()}, "PROOF_WRONG_KEY"),
        ({"at": 1_000}, "PROOF_STALE"),
    ],
)
def test_another_proof_than_the_holders_over_this_question_denies(point, spoil, reason):
    told = point.ask(point.forwarded(pouring(7), **spoil))
    assert (told["decision"], told["context"]) == (False, {"effect": "DENY", "reason": reason})
    assert point.records("advice")[0]["body"]["reason"] == reason


@pytest.mark.clause("AZN-3")
def test_a_gateway_without_the_agents_word_is_told_the_code_alone(point):
    assert point.ask(pouring())["context"] == {"effect": "DENY", "reason": "TOKEN_MISSING"}
    token = {"credentials": {"token": point.holder.text}}
    assert point.ask(pouring(context=token))["context"] == {"effect": "DENY", "reason": "PROOF_MISSING"}
    # a proof of a call is none of a question, be it over the same bytes
    for body in (asked(pouring()), json.dumps(pouring()).encode()):
        call = {"token": point.holder.text, "proof": point.holder.proof(body, at=point.clock.wall_s())}
        told = point.ask(pouring(context={"credentials": call}))
        assert why(told) == (False, "PROOF_NOT_FOR_THIS_REQUEST")
        assert set(told["context"]) == DENIED


def test_a_proof_is_used_once_also_within_one_request(point):
    given = point.forwarded(pouring())
    told = point.ask({"evaluations": [given, given]}, path=SEVERAL)["evaluations"]
    assert [why(each) for each in told] == [(True, "PERMITTED"), (False, "REPLAYED")]
    assert why(point.ask(given)) == (False, "REPLAYED")


@pytest.mark.clause("AZN-3")
@pytest.mark.parametrize(
    "subject",
    [{"type": "agent", "id": "navigator"}, {"type": "user", "id": "robotic"}, {"type": "user", "id": "alice"}],
)
def test_a_subject_other_than_the_holder_is_denied(point, subject):
    for told in (
        point.ask(pouring(subject=subject), holder=point.holder),
        point.ask(point.forwarded(pouring(subject=subject))),
    ):
        assert why(told) == (False, "SUBJECT_NOT_HOLDER")


@pytest.mark.clause("AZN-4")
@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"action": {"name": "drain"}}, "TOOL_UNKNOWN"),
        ({"resource": {"type": "object", "id": "sink"}}, "TOOL_UNKNOWN"),
        ({"resource": {"type": "account", "id": "tank"}}, "TOOL_UNKNOWN"),
        ({"action": {"name": "pour"}}, "PARAMETERS_WRONG"),
        ({"action": {"name": "pour", "properties": {"volume": 1, "more": 1}}}, "PARAMETERS_WRONG"),
        ({"action": {"name": "pour", "properties": {"volume": "1"}}}, "NOT_A_NUMBER"),
        ({"action": {"name": "pour", "properties": {"volume": 1.5}}}, "NOT_ON_GRID"),
    ],
)
def test_an_act_that_is_none_is_denied(point, changes, reason):
    told = point.ask(pouring(**changes), holder=point.holder)
    assert why(told) == (False, reason)
    assert told["context"]["remedy"]
    assert point.kinds() == ["advice"]


def client_of(point, jkt=None):
    """An access token of a client whose capability pours at tier 1, as the identity provider answers about it."""
    at, hop_id = int(point.clock.wall_s()), secrets.token_hex(16)
    scope = point.authority.verifier.verify(
        point.holder.token, at=at, audience=AUDIENCE, view=point.feed.view(), lease_ms=30_000
    ).scope
    grants = tuple(each for each in scope.grants if each.operation == "pour")
    hop = HopGrant(
        hop_id=hop_id, agent="viewer", key=keys.public_raw(keys.generate()), delegator="alice", purpose="look",
        request_digest=b"\1" * 32, attestation=Attestation(EvidenceKind.CLIENT, b"\2" * 32, at - 1), role="",
    )  # fmt: skip
    token = mint(
        root=point.made["root"], root_key_id=1, token_id=keys.b64u(secrets.token_bytes(16)),
        sponsor=Sponsor(ISSUER, "alice", "operator-key", at - 1), hop=hop, caps=CAPS,
        scope=Scope(grants, Tier(1), frozenset({AUDIENCE}), frozenset(), 0, at - 5, at + 300),
    )  # fmt: skip
    text = f"header.{secrets.token_hex(4)}.signature"
    point.access.known[text] = Looked(hop_id, AUDIENCE, "alice", ("viewer",), at + 300, jkt, token_to_text(token))
    return text


@pytest.mark.clause("AZN-1", "AZN-3")
def test_an_access_token_is_worth_tier_1_and_a_bearer_may_not_ask(point):
    bearer = client_of(point)
    given = {"credentials": {"token": bearer}}
    assert why(point.ask(pouring(agent="viewer", context=given))) == (True, "PERMITTED")
    above = point.ask(pouring(LIMIT, agent="viewer", context=given))
    assert why(above) == (False, "ABOVE_CEILING")
    assert why(point.ask(pouring(context=given))) == (False, "SUBJECT_NOT_HOLDER")
    key = point.held().key
    bound = client_of(point, keys.thumbprint(keys.public_raw(key)))
    question = pouring(agent="viewer")
    proof = prove_evaluation(
        key, question, audience=AUDIENCE, token=bound, at=int(point.clock.wall_s()), jti=secrets.token_urlsafe(16)
    )
    for given, reason in (({"token": bound}, "PROOF_MISSING"), ({"token": bound, "proof": proof}, "PERMITTED")):
        assert point.ask({**question, "context": {"credentials": given}})["context"]["reason"] == reason
    unknown = {"credentials": {"token": "a.b.c"}}
    assert point.ask(pouring(agent="viewer", context=unknown))["context"]["reason"] == "TOKEN_MALFORMED"
    # who asks proves a key
    refused = point.post(pouring(agent="viewer"), headers={"authorization": f"Bearer {bearer}", "dpop": None})
    assert (refused.status_code, refused.json()["code"]) == (401, "PROOF_MISSING")
    bound = client_of(point, keys.thumbprint(keys.public_raw(point.key)))
    body = json.dumps(pouring(agent="viewer")).encode()
    sent = {"authorization": f"DPoP {bound}", **point.headers(body, path=ONE, token=bound)}
    assert why(point.ask(body, headers=sent)) == (True, "PERMITTED")
    other = point.headers(body, path=ONE, token=bound, key=keys.generate())
    assert point.post(body, headers={**sent, **other}).json()["code"] == "PROOF_WRONG_KEY"


def sent_raw(point, raw, headers, *, query=b""):
    """Status and code of a request whose headers a client would not send."""
    sent = []

    async def given():
        return {"type": "http.request", "body": raw, "more_body": False}

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "path": ONE, "method": "POST", "headers": headers, "query_string": query}
    asyncio.run(point.layer(scope, given, send))
    return sent[0]["status"], json.loads(sent[1]["body"])["code"]


@pytest.mark.clause("AZN-1")
def test_who_asks_has_a_registered_key_and_proves_it_over_these_bytes(point):
    stranger = point.post(pouring(), key=keys.generate())
    assert (stranger.status_code, stranger.json()["code"]) == (401, "PROOF_WRONG_KEY")
    assert stranger.headers["www-authenticate"].startswith('DPoP error="invalid_dpop_proof"')
    assert "decision" not in stranger.json()
    for spoil, code in (
        ({"body": b"{}"}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"url": ORIGIN + SEVERAL}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"url": AUDIENCE}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"token": "AAAA"}, "PROOF_NOT_FOR_THIS_REQUEST"),
        ({"headers": {"dpop": None}}, "PROOF_MISSING"),
        ({"headers": {"dpop": "x"}}, "PROOF_MALFORMED"),
        ({"headers": {"authorization": "Basic YTpi"}}, "TOKEN_MALFORMED"),
        ({"headers": {"authorization": "DPoP"}}, "TOKEN_MALFORMED"),
        ({"headers": {"authorization": "DPoP !"}}, "TOKEN_MALFORMED"),
    ):
        refused = point.post(pouring(), **spoil)
        assert (refused.status_code, refused.json()["code"]) == (401, code), spoil
    told, raw = [], json.dumps(pouring()).encode()
    twice = [(name.encode(), value.encode()) for name, value in point.headers(raw, path=ONE).items()]
    for extra in ("dpop", "authorization", "content-type", "x-request-id"):
        told.append(sent_raw(point, raw, [*twice, (extra.encode(), b"a"), (extra.encode(), b"a")]))
    assert told == [
        (401, "PROOF_MALFORMED"),
        (401, "TOKEN_MALFORMED"),
        (400, "BODY_MALFORMED"),
        (400, "BODY_MALFORMED"),
    ]
    assert sent_raw(point, raw, twice, query=b"a=b") == (400, "BODY_MALFORMED")
    once = point.headers(raw := json.dumps(pouring()).encode(), path=ONE)
    assert [point.post(raw, headers=once).status_code for _ in range(2)] == [200, 401]
    point.feed.revoke(Revoked.KEY, keys.b64u(keys.thumbprint_bytes(point.peps[GATEWAY])))
    assert point.post(pouring()).json()["code"] == "REVOKED"
    point.peps.clear()
    assert point.post(pouring()).json()["code"] == "PROOF_WRONG_KEY"
    assert {each["body"]["status"] for each in point.records("refusal")} == {400, 401}


# -- several at once


@pytest.mark.clause("AZN-6")
@pytest.mark.parametrize(
    ("options", "volumes", "expected"),
    [
        ({}, (1, 999, 2), (True, False, True)),
        ({"options": {"evaluations_semantic": "execute_all"}}, (1, 999, 2), (True, False, True)),
        ({"options": {"evaluations_semantic": "deny_on_first_deny"}}, (1, 999, 2), (True, False)),
        ({"options": {"evaluations_semantic": "deny_on_first_deny"}}, (1, LIMIT, 2), (True, False)),
        ({"options": {"evaluations_semantic": "permit_on_first_permit"}}, (999, 1, 2), (False, True)),
        ({"options": {"evaluations_semantic": "permit_on_first_permit"}}, (999, 998), (False, False)),
        ({"options": {}}, (1,), (True,)),
    ],
)
def test_evaluations_are_answered_in_order_up_to_the_one_that_ends_them(point, options, volumes, expected):
    common = pouring()
    del common["action"]
    each = [{"action": pouring(volume)["action"]} for volume in volumes]
    told = point.several(each, **common, **options)
    assert tuple(answer["decision"] for answer in told) == expected
    assert point.kinds() == ["advice"] * len(expected)


@pytest.mark.clause("AZN-6")
def test_an_evaluations_own_member_takes_the_whole_place_of_the_requests(point):
    context = {"credentials": {"token": "AAAA"}}
    told = point.several([{}, {"context": {}}, {"action": {"name": "pour"}}], **pouring(), context=context)
    reasons = [answer["context"]["reason"] for answer in told]
    assert reasons == ["TOKEN_MALFORMED", "PERMITTED", "TOKEN_MALFORMED"]
    told = point.several([{"action": {"name": "pour"}}], **pouring())
    assert why(told[0]) == (False, "PARAMETERS_WRONG"), "no property of another action"


@pytest.mark.clause("AZN-6")
@pytest.mark.parametrize("given", [{}, {"evaluations": []}])
def test_several_with_none_are_one(point, given):
    told = point.ask({**pouring(), **given}, path=SEVERAL, holder=point.holder)
    assert why(told) == (True, "PERMITTED")


def test_many_are_on_record_with_one_sync(point):
    syncs = []
    settle = point.journal._settle
    point.journal._settle = lambda through: (syncs.append(through), settle(through))
    told = point.several([{}] * EVALUATIONS, **pouring())
    assert [answer["decision"] for answer in told] == [True] * EVALUATIONS
    assert (point.kinds(), len(syncs)) == (["advice"] * EVALUATIONS, 1)


@pytest.mark.clause("AZN-6")
def test_what_is_late_is_denied(point):
    """The time of a request is bounded, however slow one evaluation is."""
    advise = point.gate.advise

    async def slow(call):
        point.clock.advance(DEADLINE_MS)
        return await advise(call)

    point.gate.advise = slow
    told = point.several([{}] * 3, **pouring())
    assert [why(answer) for answer in told] == [(True, "PERMITTED"), (False, "NOT_EVALUATED"), (False, "NOT_EVALUATED")]
    assert point.kinds() == ["advice"] * 3


@pytest.mark.clause("AZN-7")
def test_what_is_not_on_record_is_not_said(point):
    point.gate._journal = FailingJournal(point.journal)
    told = point.ask(pouring(), holder=point.holder)
    assert (told["decision"], told["context"]) == (False, {"effect": "DENY", "reason": "RECORD_FAILED"})


def test_what_a_call_could_not_fulfil_is_no_advice_to_go_on(point, monkeypatch):
    honest, notify = gate_module.decide, Obligation(ObligationKind.NOTIFY)
    monkeypatch.setattr(gate_module, "decide", lambda *a: replace(honest(*a), obligations=(notify,)))
    assert why(point.ask(pouring(), holder=point.holder)) == (False, "OBLIGATION_UNMET")


def test_what_breaks_on_the_way_denies(point):
    def breaks(*_, **__):
        raise RuntimeError

    point.asks.witness = breaks
    assert why(point.ask(pouring(), holder=point.holder)) == (False, "EVIDENCE_MISSING")
    point.authority.check = breaks
    assert point.ask(point.forwarded(pouring()))["context"] == {"effect": "DENY", "reason": "TOKEN_MALFORMED"}


# -- bad input

FORMS = {
    "no_subject": pouring(subject=None),
    "subject_text": pouring(subject="robotic"),
    "subject_empty": pouring(subject={}),
    "subject_id_number": pouring(subject={"type": "agent", "id": 7}),
    "subject_id_empty": pouring(subject={"type": "agent", "id": ""}),
    "subject_id_long": pouring(subject={"type": "agent", "id": "a" * 257}),
    "subject_member": pouring(subject={"type": "agent", "id": "a", "role": "b"}),
    "subject_properties": pouring(subject={"type": "agent", "id": "a", "properties": []}),
    "action_list": pouring(action=[]),
    "action_nameless": pouring(action={"properties": {}}),
    "action_properties": pouring(action={"name": "pour", "properties": "volume"}),
    "resource_typeless": pouring(resource={"id": "tank"}),
    "context_list": pouring(context=[]),
    "credentials_text": pouring(context={"credentials": "AAAA"}),
    "credentials_empty": pouring(context={"credentials": {}}),
    "credentials_token": pouring(context={"credentials": {"token": 1}}),
    "credentials_proof": pouring(context={"credentials": {"token": "a", "proof": 1}}),
    "credentials_more": pouring(context={"credentials": {"token": "a", "key": "b"}}),
    "member": pouring(subjects=[]),
}
BATCHES = {
    "evaluations_object": {"evaluations": {}},
    "evaluations_null": {"evaluations": None},
    "evaluation_text": {"evaluations": ["pour"]},
    "evaluation_member": {"evaluations": [{"options": {}}]},
    "evaluation_nested": {"evaluations": [{"evaluations": []}]},
    "options_list": {"evaluations": [{}], "options": []},
    "option_unknown": {"evaluations": [{}], "options": {"evaluation_semantics": "execute_all"}},
    "semantic_unknown": {"evaluations": [{}], "options": {"evaluations_semantic": "any"}},
    "semantic_list": {"evaluations": [{}], "options": {"evaluations_semantic": ["execute_all"]}},
    "semantic_null": {"evaluations": [{}], "options": {"evaluations_semantic": None}},
    "semantic_of_none": {"options": {"evaluations_semantic": "any"}},
}


@pytest.mark.clause("AZN-2")
def test_a_request_of_another_form_is_refused_whole_with_its_place(point):
    cases = {name: (ONE, body) for name, body in FORMS.items()}
    cases |= {f"{name}_in_batch": (SEVERAL, {"evaluations": [pouring(), body]}) for name, body in FORMS.items()}
    cases |= {name: (SEVERAL, {**pouring(), **body}) for name, body in BATCHES.items()}
    cases["batch_at_one"] = ONE, {"evaluations": [pouring()]}
    cases["options_at_one"] = ONE, pouring(options={})
    for name, (path, body) in cases.items():
        refused = point.post(body, path=path)
        problem = refused.json()
        assert (refused.status_code, problem["code"]) == (400, "BODY_MALFORMED"), name
        assert refused.headers["content-type"] == "application/problem+json"
        assert problem["detail"].partition(":")[0].split(".")[0].split("[")[0] in {
            "subject", "action", "resource", "context", "evaluations", "options", "the body",
        }, name  # fmt: skip
        assert "decision" not in problem
    assert point.kinds() == ["refusal"] * len(cases), "and nothing was decided"


@pytest.mark.clause("AZN-2")
@pytest.mark.parametrize("count", [EVALUATIONS + 1, 1_000])
def test_too_many_are_refused_whole(point, count):
    refused = point.post({**pouring(), "evaluations": [{}] * count}, path=SEVERAL)
    assert (refused.status_code, refused.json()["code"]) == (400, "BODY_TOO_LARGE")
    assert str(EVALUATIONS) in refused.json()["detail"]


@pytest.mark.clause("AZN-2")
def test_no_hostile_body_gets_in(point):
    for name, body, reasons in HOSTILE_BODIES:
        for path in (ONE, SEVERAL):
            refused = point.post(body, path=path)
            assert (refused.status_code, refused.json()["code"] in reasons) == (400, True), name
    wide = json.dumps(pouring(context={"x": "y" * BODY_BYTES})).encode()
    assert point.post(wide).json()["code"] == "BODY_TOO_LARGE"
    assert set(point.kinds()) == {"refusal"}


@pytest.mark.clause("AZN-2")
@pytest.mark.parametrize(
    "headers",
    [
        {"content-type": None},
        {"content-type": "text/plain"},
        {"content-type": "application/jsonp"},
        {"content-type": "application/json; charset=latin-1"},
        {"x-request-id": "a" * 257},
        {"x-request-id": "a\tb"},
    ],
)
def test_a_request_with_other_headers_is_refused(point, headers):
    refused = point.post(pouring(), headers=headers)
    assert (refused.status_code, refused.json()["code"]) == (400, "BODY_MALFORMED")
    assert "x-request-id" not in refused.headers


def test_the_requests_id_comes_back_with_every_answer(point):
    given = {"x-request-id": "bfe9eb29-ab87-4ca3-be83-a1d5d8305716", "content-type": "application/json; charset=UTF-8"}
    for body, options, status in (
        (pouring(), {}, 200),
        ({}, {}, 400),
        (b"{", {}, 400),
        (pouring(), {"key": keys.generate()}, 401),
        (pouring(), {"method": "PUT"}, 405),
    ):
        answer = point.post(body, headers=given, **options)
        assert (answer.status_code, answer.headers["x-request-id"]) == (status, given["x-request-id"])
        assert answer.headers["cache-control"] == "no-store"
    assert "x-request-id" not in point.post(pouring()).headers


def test_its_metadata_is_where_the_standard_says(point):
    told = point.post(b"", path=WELL_KNOWN, method="GET")
    assert (told.status_code, told.json()) == (
        200,
        {
            "policy_decision_point": ORIGIN,
            "access_evaluation_endpoint": ORIGIN + ONE,
            "access_evaluations_endpoint": ORIGIN + SEVERAL,
        },
    )
    assert point.post(b"", path=WELL_KNOWN).status_code == 405
    assert point.post(b"", path="/mcp").text == "inner", "all else is the server's own"
    known = {name: getattr(point.layer, f"_{name}") for name in ("gate", "authority", "registry", "peps", "tools")}
    for path in (ONE, SEVERAL, WELL_KNOWN):
        with pytest.raises(ConfigError):
            EvaluationLayer(
                None, **known, served=point.served, audience=ORIGIN + path, access=point.access, clock=point.clock
            )


def test_a_caller_who_has_gone_is_answered_nothing(point):
    async def gone():
        return {"type": "http.disconnect"}

    sent = []
    scope = {"type": "http", "path": ONE, "method": "POST", "headers": [], "query_string": b""}
    asyncio.run(point.layer(scope, gone, sent.append))
    assert (sent, point.kinds()) == ([], [])
