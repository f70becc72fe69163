"""[PRF-10]: token and proof in `_meta`: the whole request is covered, nothing of the credentials leaks, no proof changes carriage."""

from __future__ import annotations

import json

import pytest
from capabilities.proof.mcp_meta import (
    META,
    PROOF,
    TOKEN,
    UNCOVERED,
    UnverifiedRequest,
    attach,
    detach,
    stray,
    stripped,
)
from capabilities.proof.proof import Proof, check_proof, prove
from capabilities.token.token_text import token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode, StatementError
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import CELL, NOW, OTHER_CELL, chain_of_four, key_of, raw_of

from capabilities.proof import mcp_meta
from capabilities.values import strict_json

pytestmark = pytest.mark.clause("PRF-10")

TOKEN_TEXT = token_to_text(chain_of_four())
JTI = "jti-0123456789abcdef"
PARAMS = {
    "name": "move_joint",
    "arguments": {"q_rad": [0.1, -1.5, 0, 1e-7, 3.0, 2], "speed_rad_s": 0.25, "ünïcode": "„ä“\n"},
    "_meta": {"progressToken": 7, "dev.ztpm/receipt": True, "io.modelcontextprotocol/protocolVersion": "2026-07-28"},
}


def attached(params=PARAMS, **other):
    wanted = {
        "rpc_method": "tools/call",
        "audience": CELL,
        "key": key_of("gripper"),
        "token": TOKEN_TEXT,
        "at": NOW,
        "jti": JTI,
    }
    return attach(params, **{**wanted, **other})


def received(params, rpc_method="tools/call"):
    """As a server has it: out of its bytes again, by the strict reader."""
    return detach(
        strict_json.read(json.dumps(params).encode(), limit_bytes=32_768, limit_depth=32), rpc_method=rpc_method
    )


def judged(params, *, rpc_method="tools/call", audience=CELL) -> Proof | Fault:
    carried = received(params, rpc_method)
    if isinstance(carried, Fault):
        return carried
    return check_proof(
        carried.proof or "",
        key=raw_of("gripper"),
        method=carried.method,
        url=audience,
        body=carried.body,
        token=carried.token,
        at=NOW,
        caps=DEFAULT,
    )


def code(found):
    assert isinstance(found, Fault), found
    return found.code


def test_a_request_with_credentials_holds_and_comes_out_without_them():
    sent = attached()
    assert isinstance(judged(sent), Proof)
    carried = received(sent)
    assert isinstance(carried, UnverifiedRequest)
    assert (carried.token, carried.method, carried.params) == (TOKEN_TEXT, "mcp:tools/call", PARAMS)
    assert carried.proof == sent[META][PROOF]
    assert TOKEN_TEXT not in json.dumps(carried.params)
    assert sent[META] == {**PARAMS[META], TOKEN: TOKEN_TEXT, PROOF: carried.proof}


def test_what_is_signed_is_the_canonical_form_less_the_two_members_and_those_of_an_sdk():
    carried = received(attached())
    assert json.loads(carried.body) == {**PARAMS, META: {"dev.ztpm/receipt": True}}
    assert carried.body.startswith(b'{"_meta":{"dev.ztpm/receipt":true},"arguments":{"q_rad":[0.1,-1.5,0,1e-7,3,2]')
    assert received(attached({"name": "stop"})).body == b'{"_meta":{},"name":"stop"}', "as docs/spec.md says"


@pytest.mark.parametrize("name", sorted(UNCOVERED))
def test_what_an_sdk_writes_afterwards_voids_nothing_and_goes_on(name):
    sent = attached({"name": "stop"})
    sent[META][name] = {"any": ["thing"]}
    assert isinstance(judged(sent), Proof)
    assert received(sent).params == {"name": "stop", META: {name: {"any": ["thing"]}}}


@pytest.mark.parametrize("name", ["io.modelcontextprotocol/related-task", "progresstoken", "progressToken ", "x"])
def test_any_other_member_is_covered(name):
    sent = attached({"name": "stop"})
    sent[META][name] = 1
    assert code(judged(sent)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST


def test_an_uncovered_member_counts_in_meta_alone():
    sent = attached({"name": "stop"})
    sent["progressToken"] = 1
    assert code(judged(sent)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST


@pytest.mark.parametrize("params", [{}, {"_meta": None}, {"_meta": [TOKEN]}, {"_meta": {"x": 1}, "name": "y"}])
def test_params_without_credentials_are_stripped_of_nothing(params):
    assert stripped(params) == params
    if isinstance(params.get(META), dict):
        assert stripped({**params, META: {**params[META], TOKEN: 1, PROOF: None}}) == params


@pytest.mark.parametrize("params", [{}, {"_meta": {}}, {"name": "stop"}])
def test_an_empty_meta_stays(params):
    sent = attached(params)
    assert isinstance(judged(sent), Proof)
    assert received(sent).params == {**params, META: {}}


def test_attaching_again_replaces_the_credentials():
    again = attached(attached(), jti="another-0123456789")
    assert isinstance(judged(again), Proof)
    assert again[META][PROOF] != attached()[META][PROOF]


def test_the_order_of_members_and_the_spelling_of_numbers_do_not_matter():
    sent = attached()
    turned = {name: sent[name] for name in reversed(sent)}
    turned["arguments"] = {**turned["arguments"], "q_rad": [0.1, -1.5, 0.0, 0.0000001, 3, 2.0]}
    assert isinstance(judged(turned), Proof)


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p.update(name="stop"),
        lambda p: p.update(extra=None),
        lambda p: p.pop("arguments"),
        lambda p: p["arguments"].update(speed_rad_s=0.250001),
        lambda p: p["arguments"]["q_rad"].append(0),
        lambda p: p["arguments"]["q_rad"].reverse(),
        lambda p: p["arguments"].update(speed_rad_s="0.25"),
        lambda p: p[META].pop("dev.ztpm/receipt"),
        lambda p: p[META].update({"dev.ztpm/receipt": False}),
        lambda p: p[META].update({"dev.ztpm/decision": "PERMIT"}),
        lambda p: p[META].update({"dev.ztpm/Token": TOKEN_TEXT}),
    ],
)
def test_whatever_changes_voids_the_proof(change):
    sent = strict_json.parse_object(strict_json.canonical({"p": 0})) and json.loads(json.dumps(attached()))
    change(sent)
    assert code(judged(sent)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST


def test_another_method_audience_token_or_key():
    assert code(judged(attached(), rpc_method="tools/list")) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    assert code(judged(attached(), audience=OTHER_CELL)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    assert code(judged(attached(key=key_of("eve")))) is FaultCode.PROOF_WRONG_KEY
    sent = attached()
    sent[META][TOKEN] = TOKEN_TEXT[:-4]
    assert code(judged(sent)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST


def test_no_proof_holds_on_both_carriages():
    """Same key, address, bytes and token; what stands for the method tells them apart."""
    carried = received(attached())
    http = prove(key_of("gripper"), method="POST", url=CELL, body=carried.body, token=TOKEN_TEXT, at=NOW, jti=JTI)
    sent = attached()
    sent[META][PROOF] = http
    assert code(judged(sent)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    for method in ("POST", "tools/call"):
        found = check_proof(
            carried.proof,
            key=raw_of("gripper"),
            method=method,
            url=CELL,
            body=carried.body,
            token=TOKEN_TEXT,
            at=NOW,
            caps=DEFAULT,
        )
        assert code(found) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    assert ":" in mcp_meta.method("POST")


@pytest.mark.parametrize("value", [None, 1, True, [], {}, [TOKEN_TEXT]])
def test_a_credential_is_a_text(value):
    assert code(received({"_meta": {TOKEN: value, PROOF: "x"}})) is FaultCode.TOKEN_MALFORMED
    assert code(received({"_meta": {TOKEN: "x", PROOF: value}})) is FaultCode.PROOF_MALFORMED


@pytest.mark.parametrize(
    "params", [None, [], "x", 7, {}, {"_meta": None}, {"_meta": []}, {"_meta": {"x": 1}}, {TOKEN: "x", PROOF: "y"}]
)
def test_no_credentials_are_none(params):
    carried = detach(params, rpc_method="tools/call")
    assert carried == UnverifiedRequest(None, None, "mcp:tools/call", b"", params)
    assert stray(params) is None


def test_one_of_the_two_alone_is_told_as_it_is():
    sent = attached()
    token, proof = sent[META].pop(TOKEN), sent[META][PROOF]
    assert received(sent).token is None
    assert code(judged(sent)) is FaultCode.PROOF_NOT_FOR_THIS_REQUEST
    sent[META] = {TOKEN: token}
    assert (received(sent).token, received(sent).proof) == (token, None)
    assert code(judged(sent)) is FaultCode.PROOF_MISSING
    assert proof


@pytest.mark.parametrize("name", [TOKEN, PROOF])
@pytest.mark.parametrize("value", ["x", None, 1])
def test_over_http_meta_carries_no_credentials(name, value):
    assert code(stray({"_meta": {name: value}})) is FaultCode.TOKEN_MALFORMED


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 2**53, -(2**53), "\ud800", b"x", {1: 2}])
def test_params_without_a_canonical_form(value):
    with pytest.raises(StatementError):
        attached({"x": value})
    assert code(detach({"x": value, "_meta": {TOKEN: "t", PROOF: "p"}}, rpc_method="m")) is FaultCode.PROOF_MALFORMED


def test_meta_that_is_no_object_takes_no_credentials():
    with pytest.raises(StatementError):
        attached({"_meta": []})


def larger(inner):
    return st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53) + 1, 2**53 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8),
    larger,
    max_leaves=12,
)


@pytest.mark.long
@given(st.dictionaries(st.text(max_size=5).filter(lambda name: name != META), JSON, max_size=4), JSON, st.data())
def test_any_params_hold_as_sent_and_in_no_other_form(params, other, data):
    sent = attached(params)
    assert isinstance(judged(sent), Proof)
    name = data.draw(st.sampled_from([*params, "new"]))
    if name not in params or strict_json.canonical(params[name]) != strict_json.canonical(other):
        assert isinstance(judged({**sent, name: other}), Fault)
