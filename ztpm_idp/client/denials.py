"""Denials and deferrals of a tool server, as errors that say what would be permitted."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

    import httpx2

DECISION_META: Final = "dev.ztpm/decision"
"""Key in a result's `_meta` under which a server tells its decision."""
REFUSED_CODE: Final = -32_003
"""JSON-RPC code of a request that a server refused before any tool; the message is the reason."""


class Denied(Exception):  # noqa: N818 - the word of a decision
    """A call that was denied: nothing of it has happened.

    Attributes:
        reason: the code; `ztpm explain CODE` tells about it.
        primitive: id of the policy primitive that denied, or "".
        parameter, value, unit, limit: of the parameter that is outside of a limit, where there is one; `unit` is its
            kind where it is no quantity. Of an argument that is no value of its kind only its name, as `tags[1]`.
        set_by: hop, agent and sponsor that set the limit.
        nearest_permitted: the nearest value that is permitted.
        left, more_at: of a spent budget: its rest; when there is enough, seconds since the epoch, or None for never.
        remedy: what may help.
        told: everything that the server told.
    """

    def __init__(self, reason: str, told: Mapping[str, Any]) -> None:
        self.reason = reason
        self.told = dict(told)
        self.primitive = str(told.get("primitive") or "")
        self.parameter = told.get("parameter") or told.get("argument")
        self.value = told.get("value")
        self.unit = told.get("unit") or told.get("kind")
        self.limit = told.get("limit")
        self.set_by = told.get("set_by")
        self.nearest_permitted = told.get("nearest_permitted")
        self.left = told.get("left")
        self.more_at = told.get("more_at")
        self.remedy = str(told.get("remedy") or "")
        super().__init__(": ".join(part for part in (reason, self.remedy) if part))

    @property
    def words(self) -> str:
        """The denial in sentences, for a model to go on from."""
        unit = f" {self.unit}" if self.unit else ""
        said = [f"Denied: {self.reason}."]
        if self.parameter is not None and self.value is not None:
            by = self.set_by if isinstance(self.set_by, dict) else {}
            who = f", set by {by['agent']} for {by['sponsor']}" if {"agent", "sponsor"} <= by.keys() else ""
            said.append(f"{self.parameter} is {self.value}{unit}; the limit is {_limit(self.limit)}{unit}{who}.")
        elif self.told.get("argument") is not None:
            said.append(f"{self.told['argument']}: {self.told.get('detail', '')}.")
        if self.nearest_permitted is not None:
            said.append(f"The nearest permitted is {_limit(self.nearest_permitted)}{unit}.")
        return " ".join([*said, "Nothing has happened.", self.remedy]).strip()


class Deferred(Exception):  # noqa: N818 - the word of a decision
    """A call that waits for people: the same call again uses their answer, once.

    Attributes:
        reason: the code.
        ask_id: of the question.
        page: where people answer.
        until: when the question ends, seconds since the epoch.
        retry_after_s: seconds before the same call is worthwhile.
        told: everything that the server told.
    """

    def __init__(self, reason: str, told: Mapping[str, Any]) -> None:
        self.reason = reason
        self.told = dict(told)
        self.ask_id = str(told.get("approval_id") or told.get("ask_id") or "")
        self.page = str(told.get("url") or "")
        self.until = int(told.get("expires_at") or 0)
        self.retry_after_s = int(told.get("retry_after_s") or 1)
        super().__init__(f"{reason}: people are asked at {self.page}")

    @property
    def words(self) -> str:
        """The deferral in sentences, for a model to go on from."""
        return (
            f"Deferred: {self.reason}. People are asked at {self.page}. Nothing has happened; "
            "exactly the same call again uses their answer, once."
        )


def _limit(limit: object) -> str:
    """A bound or value in words."""
    if isinstance(limit, dict) and limit.keys() == {"low", "high"}:
        return f"{limit['low']} to {limit['high']}"
    return limit if isinstance(limit, str) else json.dumps(limit)


def error_of(told: object) -> Denied | Deferred | None:
    """The error that a server's decision is; None for a PERMIT, and for what is no decision.

    Args:
        told: a JSON value.
    """
    if not isinstance(told, dict) or not isinstance(reason := told.get("reason"), str):
        return None
    match told.get("decision"):
        case "DENY":
            return Denied(reason, told)
        case "DEFER":
            return Deferred(reason, told)
        case _:
            return None


def refusal_in(error: BaseException) -> Denied | Deferred | None:
    """The denial or deferral that an error holds as its `told`, message, cause or group.

    Args:
        error: of a framework's own client of MCP, such as pydantic-ai's, or of a guarded function.
    """
    if isinstance(error, Denied | Deferred):
        return error
    if (told := error_of(getattr(error, "told", None))) is not None:
        return told
    if isinstance(members := getattr(error, "data", None), dict):  # the page of a deferral in an error of MCP
        found = error_of(members.get(DECISION_META))
        if found is not None:
            return found
    held = error.exceptions if isinstance(error, BaseExceptionGroup) else ()
    for each in (*held, error.__cause__):
        if each is not None and (found := refusal_in(each)) is not None:
            return found
    try:
        return error_of(json.loads(str(getattr(error, "message", error))))
    except ValueError:
        return None


async def raise_refused(response: httpx2.Response) -> None:
    """Hook for responses of an `httpx2.AsyncClient`: a request that a server refused raises.

    Example::

        httpx2.AsyncClient(auth=agent.auth(token), event_hooks={"response": [raise_refused]})

    Raises:
        Denied: the server refused the request.
    """
    if response.status_code < 400:
        return
    await response.aread()
    try:
        error = error_of(response.json())
    except ValueError:
        return
    if error is not None:
        raise error
