"""Denials and deferrals of a tool server, as errors that say what would be permitted."""

from __future__ import annotations

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
        parameter, value, unit, limit: of the parameter that is outside of a limit, where there is one.
        set_by: hop, agent and sponsor that set the limit.
        nearest_permitted: the nearest value that is permitted.
        remedy: what may help.
        told: everything that the server told.
    """

    def __init__(self, reason: str, told: Mapping[str, Any]) -> None:
        self.reason = reason
        self.told = dict(told)
        self.primitive = str(told.get("primitive") or "")
        self.parameter = told.get("parameter")
        self.value = told.get("value")
        self.unit = told.get("unit")
        self.limit = told.get("limit")
        self.set_by = told.get("set_by")
        self.nearest_permitted = told.get("nearest_permitted")
        self.remedy = str(told.get("remedy") or "")
        super().__init__(": ".join(part for part in (reason, self.remedy) if part))


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
