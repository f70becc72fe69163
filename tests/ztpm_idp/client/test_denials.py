"""Denials in words, and out of the errors in which frameworks wrap them."""

import json

import pytest
from mcp import MCPError

from ztpm_idp.client import Deferred, Denied, refusal_in

LIMIT = {
    "decision": "DENY", "reason": "LIMIT_EXCEEDED_BY_REQUEST", "parameter": "percent", "value": 950, "unit": "permille",
    "limit": {"low": 0, "high": 900}, "set_by": {"hop": 1, "agent": "worker", "sponsor": "alice"},
    "nearest_permitted": 900, "remedy": "Stay inside the limit.",
}  # fmt: skip
ASK = {"decision": "DEFER", "reason": "TIER_NEEDS_APPROVAL", "url": "https://idp.example/approvals/1/page"}


class Failed(Exception):  # noqa: N818 - as a framework names it
    """An error of a framework, whose text for the model is `message`."""

    def __init__(self, message):
        super().__init__("a tool has failed")
        self.message = message


def caused(cause):
    error = RuntimeError("no connection")
    error.__cause__ = cause
    return error


def test_a_denial_says_what_is_permitted_and_who_says_so():
    assert Denied(LIMIT["reason"], LIMIT).words == (
        "Denied: LIMIT_EXCEEDED_BY_REQUEST. percent is 950 permille; the limit is 0 to 900 permille, set by worker for "
        "alice. The nearest permitted is 900 permille. Nothing has happened. Stay inside the limit."
    )


@pytest.mark.parametrize("spoiled", [{"limit": None}, {"set_by": "x"}, {"set_by": {}}, {"value": None}, {"unit": 3}])
def test_a_server_that_tells_less_is_told_of_all_the_same(spoiled):
    assert Denied("NOT_GRANTED", LIMIT | spoiled).words.startswith("Denied: NOT_GRANTED. ")


def test_a_misfit_is_named():
    told = {"decision": "DENY", "reason": "NOT_A_NUMBER", "argument": "percent", "detail": "str is not a number"}
    assert "percent: str is not a number." in Denied("NOT_A_NUMBER", told).words


def test_a_deferral_says_where_people_answer():
    assert ASK["url"] in Deferred(ASK["reason"], ASK).words


@pytest.mark.parametrize(
    "error",
    [
        Denied(LIMIT["reason"], LIMIT),
        RuntimeError(json.dumps(LIMIT)),
        Failed(json.dumps(LIMIT)),
        caused(Denied(LIMIT["reason"], LIMIT)),
        ExceptionGroup("tasks", [ValueError("other"), Failed(json.dumps(LIMIT))]),
        type("NotPermittedError", (Exception,), {"told": LIMIT})(),
    ],
)
def test_a_denial_is_found_in_any_wrapping(error):
    assert refusal_in(error).told == LIMIT


@pytest.mark.parametrize(
    "error", [RuntimeError("{"), RuntimeError("[1]"), Failed('{"decision": "PERMIT"}'), Failed(None)]
)
def test_any_other_error_is_none(error):
    assert refusal_in(error) is None


def test_the_page_in_an_error_of_the_protocol_is_a_deferral():
    found = refusal_in(MCPError(-32_042, "A person must approve this first.", {"dev.ztpm/decision": ASK}))
    assert isinstance(found, Deferred)
    assert found.page == ASK["url"]
    assert refusal_in(MCPError(-32_042, "another server's page", {"elicitations": []})) is None
