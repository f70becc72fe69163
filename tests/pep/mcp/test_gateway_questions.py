"""Questions of a server behind a gateway to a client: asked only as far as the client declared."""

from __future__ import annotations

import pytest
from mcp import types
from pep.mcp.gateway.paired_session import able

MESSAGE = types.SamplingMessage(role="user", content=types.TextContent(type="text", text="hello"))
TOOL = types.Tool(name="t", input_schema={"type": "object"})
QUESTIONS = {
    "sample": types.CreateMessageRequest(params=types.CreateMessageRequestParams(messages=[MESSAGE], max_tokens=9)),
    "sample with tools": types.CreateMessageRequest(
        params=types.CreateMessageRequestParams(messages=[MESSAGE], max_tokens=9, tools=[TOOL])
    ),
    "form": types.ElicitRequest(
        params=types.ElicitRequestFormParams(message="who?", requested_schema={"type": "object", "properties": {}})
    ),
    "page": types.ElicitRequest(
        params=types.ElicitRequestURLParams(message="look", url="https://a.example/", elicitation_id="1")
    ),
    "roots": types.ListRootsRequest(),
}


@pytest.mark.parametrize(
    ("declared", "asked"),
    [
        (None, set()),
        ({}, set()),
        ({"sampling": {}}, {"sample"}),
        ({"sampling": {"tools": {}}}, {"sample", "sample with tools"}),
        ({"elicitation": {}}, {"form"}),
        ({"elicitation": {"form": {}}}, {"form"}),
        ({"elicitation": {"url": {}}}, {"page"}),
        ({"elicitation": {"form": {}, "url": {}}}, {"form", "page"}),
        ({"roots": {}}, {"roots"}),
        ({"extensions": {"io.example/all": {}}, "experimental": {"sampling": {}}}, set()),
    ],
)
def test_a_client_is_asked_for_what_it_declared(declared, asked):
    can = None if declared is None else types.ClientCapabilities.model_validate(declared)
    assert {name for name, question in QUESTIONS.items() if able(can, question)} == asked
