"""Deferral over MCP: a structured error with the page of the ask, or URL elicitation where the client can.

What the client answers to an elicitation is never an approval: its host answers it. It only says that the page was
shown, and that the retry may wait a moment for people. The gate decides the retry like any other call.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

from mcp_types import ElicitRequest, ElicitRequestURLParams, InputRequiredResult

from pep.people.deferral import AskState
from policies.evidence.model import Effect

if TYPE_CHECKING:
    from mcp.server.context import ServerRequestContext
    from mcp_types import CallToolRequestParams

    from pep.gate.gate import GateResult
    from pep.people.asks import Asks

RETRY_AFTER_S: Final = 1
"""Seconds before a retry is worthwhile; people do not answer sooner."""
INPUT_REQUIRED_SINCE: Final = "2026-07-28"
"""First protocol version in which a tool call may ask its client for input."""
APPROVAL: Final = "approval"
"""Our key among the input requests of one result."""
WAIT_S: Final = 20.0
"""Longest wait of a retry for people; the usual client gives up after 30 s."""
LOOK_S: Final = 0.05
WAITERS: Final = 8
"""Retries that wait at once. A wait holds a connection, and a cell has a handful of agents."""


def told(answer: GateResult) -> dict[str, object]:
    """Members about the deferral behind an answer, for the holder, besides the decision."""
    ask = answer.ask
    if ask is None:
        return {}
    known: dict[str, object] = {"ask_id": ask.ask_id}
    if answer.decision.effect is Effect.DEFER:
        known |= {
            "approval_id": ask.ask_id,
            "url": ask.url,
            "expires_at": int(ask.expires_at),
            "retry_after_s": RETRY_AFTER_S,
        }
    return known


def elicitation(
    answer: GateResult, params: CallToolRequestParams, ctx: ServerRequestContext[Any, Any]
) -> InputRequiredResult | None:
    """Request to show people the page, once for each call, where the client declares the ability; else None."""
    ask = answer.ask
    if ask is None or answer.decision.effect is not Effect.DEFER or is_retry(params):
        return None
    capabilities = ctx.session.client_capabilities
    declared = None if capabilities is None else capabilities.elicitation
    if ctx.protocol_version < INPUT_REQUIRED_SINCE or declared is None or declared.url is None:
        return None
    message = f"A person must approve this first: {ask.reason}."
    shown = ElicitRequestURLParams(message=message, url=ask.url)
    return InputRequiredResult(input_requests={APPROVAL: ElicitRequest(params=shown)}, request_state=ask.ask_id)


def is_retry(params: CallToolRequestParams) -> bool:
    """True where the call answers an elicitation of ours. The answer itself is not believed."""
    return bool(params.input_responses) or params.request_state is not None


class Patience:
    """Retries that wait a moment for people's answers.

    Args:
        asks: state of each deferral.
    """

    def __init__(self, asks: Asks) -> None:
        self._asks = asks
        self._places = asyncio.Semaphore(WAITERS)

    async def wait(self, params: CallToolRequestParams) -> None:
        """Waits until the deferral that the call's state names is closed, or for long enough.

        The state came from the client and only says what to wait for: an unknown one is waited for not at all.
        """
        ask_id = params.request_state
        answers = (params.input_responses or {}).values()
        shown = any(getattr(answer, "action", None) == "accept" for answer in answers)
        if ask_id is None or not shown or self._places.locked():
            return
        async with self._places:
            try:
                async with asyncio.timeout(WAIT_S):
                    while self._asks.state_of(ask_id) is AskState.OPEN:  # noqa: ASYNC110 - answers come on a thread
                        await asyncio.sleep(LOOK_S)
            except TimeoutError:
                return
