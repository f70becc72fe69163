"""Deferral over MCP: a structured error with the page of the ask, or URL elicitation where the client can.

What the client answers to an elicitation is never an approval: its host answers it. It only says that the page was
shown, and that the retry may wait a moment for people. The gate decides the retry like any other call. No state is
given to the client: what it waits for is found by the retry's own request, after a restart of either side as before.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Final

from mcp import UrlElicitationRequiredError
from mcp_types import ClientCapabilities, ElicitRequest, ElicitRequestURLParams, InputRequiredResult
from pydantic import ValidationError

from capabilities.values.chain import Chain
from pep.mcp.http_request import CREDENTIALS
from pep.people.deferral import AskState
from pep.request.authority import NOBODY
from policies.evidence.model import Effect

if TYPE_CHECKING:
    from mcp.server.context import CallNext, HandlerResult, ServerRequestContext
    from mcp_types import CallToolRequestParams, CallToolResult

    from pep.gate.gate import GateResult
    from pep.people.asks import Asks
    from policies.evidence.model import Request

RETRY_AFTER_S: Final = 1
"""Seconds before a retry is worthwhile; people do not answer sooner."""
INPUT_REQUIRED_SINCE: Final = "2026-07-28"
"""First protocol version in which a tool call may ask its client for input, and has extensions."""
URL_SINCE: Final = "2025-11-25"
"""First protocol version in which a client can show a page; until the next one by an error."""
APPROVAL: Final = "approval"
"""Our key among the input requests of one result."""
WAIT_S: Final = 20.0
"""Longest wait of a retry for people; the usual client gives up after 30 s."""
LOOK_S: Final = 0.05
WAITERS: Final = 8
"""Retries that wait at once. A wait holds a connection, and a cell has a handful of agents."""
CLIENTS: Final = 256
"""Ours: holders of whose clients it is remembered what they can do."""


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
    answer: GateResult,
    params: CallToolRequestParams,
    ctx: ServerRequestContext[Any, Any],
    *,
    declared: ClientCapabilities | None,
    otherwise: CallToolResult,
) -> InputRequiredResult | None:
    """Request to show people the page, once for each call, where the client declares the ability; else None.

    Args:
        answer: a deferral.
        params: of the call.
        ctx: likewise.
        declared: abilities of its client.
        otherwise: the structured error in its place, which the older protocol's error carries.

    Raises:
        UrlElicitationRequiredError: to a client of the older protocol, which has the page in an error.
    """
    ask = answer.ask
    able = declared is not None and declared.elicitation is not None and declared.elicitation.url is not None
    if ask is None or not able or is_retry(params):
        return None
    message = f"A person must approve this first: {ask.reason}."
    if ctx.protocol_version >= INPUT_REQUIRED_SINCE:
        shown = ElicitRequestURLParams(message=message, url=ask.url)
        return InputRequiredResult(input_requests={APPROVAL: ElicitRequest(params=shown)})
    if ctx.protocol_version < URL_SINCE:
        return None
    page = ElicitRequestURLParams(message=message, url=ask.url, elicitation_id=ask.ask_id)
    required = UrlElicitationRequiredError([page], f"{message} {ask.url}")
    required.error.data |= otherwise.meta or {}
    raise required


def is_retry(params: CallToolRequestParams) -> bool:
    """True where the call answers an elicitation of ours. The answer itself is not believed."""
    return bool(params.input_responses) or params.request_state is not None


class Declared:
    """Abilities of clients, also of those that stated them once, in a handshake that no session remembers.

    It is a middleware of the server, which hears each handshake. It is of a token's holder; two clients of one holder
    that can do different things may each get the other's form of a deferral, and nothing else depends on it.
    """

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, ClientCapabilities] = OrderedDict()

    async def __call__(self, ctx: ServerRequestContext[Any, Any], call_next: CallNext) -> HandlerResult:
        """One message."""
        if ctx.method == "initialize" and (holder := _holder(ctx)) is not None:
            try:
                stated = ClientCapabilities.model_validate((ctx.params or {}).get("capabilities"))
            except ValidationError:
                stated = ClientCapabilities()
            self._known[holder] = stated
            self._known.move_to_end(holder)
            while len(self._known) > CLIENTS:
                self._known.popitem(last=False)
        return await call_next(ctx)

    def of(self, ctx: ServerRequestContext[Any, Any]) -> ClientCapabilities | None:
        """Abilities of the client of a request, or None where it stated none."""
        stated = ctx.session.client_capabilities
        if stated is not None or ctx.protocol_version >= INPUT_REQUIRED_SINCE:
            return stated
        holder = _holder(ctx)
        return None if holder is None else self._known.get(holder)


def _holder(ctx: ServerRequestContext[Any, Any]) -> bytes | None:
    """Key of the holder who signed a request, or None."""
    credentials = NOBODY if ctx.request is None else ctx.request.scope.get(CREDENTIALS, NOBODY)
    chain = credentials.chain
    return chain.leaf.key if credentials.fault is None and isinstance(chain, Chain) else None


class Patience:
    """Retries that wait a moment for people's answers.

    Args:
        asks: state of each deferral.
    """

    def __init__(self, asks: Asks) -> None:
        self._asks = asks
        self._places = asyncio.Semaphore(WAITERS)

    async def wait(self, params: CallToolRequestParams, *, chain: object, request: Request) -> None:
        """Waits until the deferral for which a retry was shown the page is closed, or for long enough.

        Args:
            params: of the retry.
            chain: of its caller.
            request: that it makes; another's deferral is waited for not at all.
        """
        answers = (params.input_responses or {}).values()
        shown = any(getattr(answer, "action", None) == "accept" for answer in answers)
        if not shown or not isinstance(chain, Chain) or self._places.locked():
            return
        ask_id = self._asks.awaited(chain, request)
        if ask_id is None:
            return
        async with self._places:
            try:
                async with asyncio.timeout(WAIT_S):
                    while self._asks.state_of(ask_id) is AskState.OPEN:  # noqa: ASYNC110 - answers come on a thread
                        await asyncio.sleep(LOOK_S)
            except TimeoutError:
                return
