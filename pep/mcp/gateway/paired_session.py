"""Session of a client of the protocol before 2026-07-28, with connections of its own to the servers behind.

There a server keeps what one client set: how much is logged, which changes it hears of. And it may ask its client for
something while it works. So what comes over such a connection is this client's, and nobody else's.
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar, assert_never, get_args

from mcp import MCPError
from mcp.shared.message import ServerMessageMetadata
from mcp_types import (
    INTERNAL_ERROR,
    INVALID_REQUEST,
    METHOD_NOT_FOUND,
    CreateMessageRequest,
    CreateMessageResult,
    CreateMessageResultWithTools,
    ElicitCompleteNotification,
    ElicitRequest,
    ElicitRequestURLParams,
    ElicitResult,
    EmptyResult,
    ErrorData,
    InputRequiredResult,
    ListRootsRequest,
    ListRootsResult,
    LoggingLevel,
    LoggingMessageNotification,
    PromptListChangedNotification,
    ResourceListChangedNotification,
    ResourceUpdatedNotification,
    RootsListChangedNotification,
    SetLevelRequest,
    SetLevelRequestParams,
    ToolListChangedNotification,
)
from mcp_types.version import HANDSHAKE_PROTOCOL_VERSIONS
from pydantic import ValidationError

from pep.base.errors import UpstreamError
from pep.mcp.gateway.server_changes import subscribed, unsubscribed
from pep.mcp.gateway.upstream import SoleCaller, ToolUpstream

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from mcp.client.session import ClientSession, IncomingMessage
    from mcp.server.context import ServerRequestContext
    from mcp_types import (
        ClientCapabilities,
        CreateMessageRequestParams,
        ElicitRequestParams,
        InputRequest,
        InputResponseRequestParams,
    )

    Asking = ServerRequestContext[Any, Any]
    P = TypeVar("P", bound=InputResponseRequestParams)
    R = TypeVar("R")

STATE: Final = "ztpm.paired"
"""Key in the state of the SDK's connection."""
QUESTIONS: Final = 16
"""Ours: most questions of a server to the client within one request of the client."""
QUESTION_BYTES: Final = 65_536
"""Ours: largest question."""
NOTICE_BYTES: Final = 16_384
"""Ours: largest message that a server sends on its own; a larger one is left out."""
NOTICES: Final = 100
"""Ours: most of them in a second; more are left out."""
WATCHED: Final = 64
"""Ours: most resources whose changes one client hears of."""
ASKED: Final = ("roots", "sampling", "elicitation")
"""Abilities of a client that a server is told of: what it can be asked for."""
LEVELS: Final = get_args(LoggingLevel)


@dataclass(slots=True, eq=False)
class _Work:
    """One request of the client that a server is serving, and the number of questions within it."""

    ctx: Asking
    upstream: ToolUpstream
    questions: int = 0


class PairedSession:
    """Connections for one client.

    Args:
        ctx: of the client's first request to a server.
    """

    def __init__(self, ctx: Asking) -> None:
        self._client = ctx.session
        self._can: ClientCapabilities | None = ctx.session.client_capabilities
        self._open = AsyncExitStack()
        self._opening: dict[str, asyncio.Lock] = {}
        self._own: dict[str, ToolUpstream | None] = {}
        self._working: list[_Work] = []
        self._level: LoggingLevel | None = None
        self._watched: dict[str, dict[str, None]] = {}
        self._second, self._notices = 0, 0

    @staticmethod
    def of(ctx: Asking) -> PairedSession | None:
        """The session of a request; None for a client of a newer protocol, and one that keeps none."""
        # The SDK shows the connection's own state and end in no public way yet.
        connection = getattr(ctx.session, "_connection", None)
        if connection is None or ctx.protocol_version not in HANDSHAKE_PROTOCOL_VERSIONS:
            return None
        if not connection.has_standalone_channel:
            return None
        found: PairedSession | None = connection.state.get(STATE)
        if found is None:
            found = connection.state[STATE] = PairedSession(ctx)
            connection.exit_stack.push_async_callback(found._open.aclose)
        return found

    async def at(self, upstream: ToolUpstream) -> ToolUpstream:
        """The client's own connection to a server; the one of all where it has none."""
        name = upstream.config.name
        async with self._opening.setdefault(name, asyncio.Lock()):
            if name not in self._own:
                self._own[name] = await self._open.enter_async_context(upstream.alone(self._caller(upstream)))
        return self._own[name] or upstream

    def open_at(self, upstream: ToolUpstream) -> ToolUpstream:
        """The same, and the one of all also while the client has none of its own yet."""
        return self._own.get(upstream.config.name) or upstream

    def is_open_at(self, upstream: ToolUpstream) -> bool:
        """True when the client has a connection of its own to a server, or cannot have one."""
        return upstream.config.name in self._own

    async def served(self, ctx: Asking, upstream: ToolUpstream, params: P, send: Callable[[P], Awaitable[R]]) -> R:
        """Answer to a request of the client; what the server asks for it, the client is asked on its stream.

        Args:
            ctx: of the request.
            upstream: the server.
            params: of the request.
            send: gives the server's answer to such params.

        Raises:
            MCPError: the server refuses, or the client does not answer its questions.
        """
        work = _Work(ctx, upstream)
        self._working.append(work)
        try:
            result = await send(params)
            # A server of the newer protocol asks by its answer, and is asked once more.
            for _ in range(QUESTIONS):
                if not isinstance(result, InputRequiredResult):
                    break
                answers = {
                    key: await self._answered(question, upstream, work)
                    for key, question in (result.input_requests or {}).items()
                }
                again = {"input_responses": answers or None, "request_state": result.request_state}
                result = await send(params.model_copy(update=again))
            return result
        finally:
            self._working.remove(work)

    # ---- what the client sets

    async def log_from(self, level: LoggingLevel) -> None:
        """Lets servers log for the client from that level on."""
        self._level = level
        for own in self._owned():
            await _tolerated(own.asked(partial(_set_level, level=level)))

    async def watch(self, upstream: ToolUpstream, uri: str) -> None:
        """Lets the client hear of changes of a resource.

        Raises:
            UpstreamError: the server does not answer.
            MCPError: it refuses, or there is no connection for it.
        """
        own = await self.at(upstream)
        if own is upstream:
            raise MCPError(METHOD_NOT_FOUND, "there is no connection for this client alone")
        if sum(map(len, self._watched.values())) >= WATCHED:
            raise MCPError(INVALID_REQUEST, f"more than {WATCHED} resources")
        await own.asked(partial(subscribed, uri=uri))
        self._watched.setdefault(upstream.config.name, {})[uri] = None

    async def unwatch(self, uri: str) -> None:
        """Ends that."""
        for name, uris in self._watched.items():
            own = self._own.get(name)
            if uri in uris:
                del uris[uri]
                if own is not None:
                    await own.asked(partial(unsubscribed, uri=uri))

    async def roots_changed(self) -> None:
        """Tells servers that the client's roots are others."""
        for own in self._owned():
            await _tolerated(own.asked(lambda session: session.send_notification(RootsListChangedNotification())))

    def _owned(self) -> list[ToolUpstream]:
        return [own for own in self._own.values() if own is not None]

    # ---- what a server sends

    def _caller(self, upstream: ToolUpstream) -> SoleCaller:
        name = upstream.config.name

        async def connected(session: ClientSession) -> None:
            if self._level is not None:
                await _tolerated(_set_level(session, self._level))
            for uri in self._watched.get(name, ()):
                await _tolerated(subscribed(session, uri))

        async def sample(_: Any, params: CreateMessageRequestParams) -> Any:
            return await self._asked(CreateMessageRequest(params=params), upstream)

        async def elicit(_: Any, params: ElicitRequestParams) -> Any:
            return await self._asked(ElicitRequest(params=params), upstream)

        async def roots(_: Any) -> Any:
            return await self._asked(ListRootsRequest(), upstream)

        known = {} if self._can is None else self._can.model_dump(by_alias=True, mode="json", exclude_none=True)
        declared: dict[str, Any] = {key: known[key] for key in ASKED if key in known}
        answers = {"sampling_callback": sample, "elicitation_callback": elicit, "list_roots_callback": roots}
        return SoleCaller(declared, answers, connected, noticed=partial(self._noticed, upstream))

    async def _answered(self, question: InputRequest, upstream: ToolUpstream, work: _Work) -> Any:
        """The client's answer to a question within a request.

        Raises:
            MCPError: it gives none.
        """
        answer = await self._asked(question, upstream, work)
        if isinstance(answer, ErrorData):
            raise MCPError.from_error_data(answer)
        return answer

    async def _asked(self, question: InputRequest, upstream: ToolUpstream, work: _Work | None = None) -> Any:
        """The client's answer to a question, or an error for the server that asks.

        Args:
            question: of a server.
            upstream: that server.
            work: the request that leads to it; None for the latest one there.
        """
        if not able(self._can, question):
            return ErrorData(code=METHOD_NOT_FOUND, message="the client cannot be asked for this")
        work = work or self._latest(upstream)
        if work is None or work.questions >= QUESTIONS:
            return ErrorData(code=INVALID_REQUEST, message="no request of the client leads to this question")
        if len(question.model_dump_json(by_alias=True)) > QUESTION_BYTES:
            return ErrorData(code=INVALID_REQUEST, message="the question is too long")
        work.questions += 1
        if question.params is not None:
            question = question.model_copy(update={"params": question.params.model_copy(update={"meta": None})})
        try:
            return await work.ctx.session.send_request(
                question,
                _answer_to(question),
                request_read_timeout_seconds=upstream.config.timeout_s,
                metadata=ServerMessageMetadata(related_request_id=work.ctx.request_id),
            )
        except MCPError as error:
            return error.error
        except ValidationError:
            return ErrorData(code=INTERNAL_ERROR, message="the client's answer is none")

    def _latest(self, upstream: ToolUpstream) -> _Work | None:
        """The latest request of the client that this server is serving."""
        return next((work for work in reversed(self._working) if work.upstream is upstream), None)

    async def _noticed(self, upstream: ToolUpstream, message: IncomingMessage) -> None:
        """Passes on what the client is to hear, of the right size, and not too much of it."""
        if isinstance(message, Exception) or not self._heard(upstream, message):
            return
        second = int(asyncio.get_running_loop().time())
        if second != self._second:
            self._second, self._notices = second, 0
        self._notices += 1
        if self._notices > NOTICES or len(message.model_dump_json(by_alias=True)) > NOTICE_BYTES:
            return
        if message.params is not None:
            message = message.model_copy(update={"params": message.params.model_copy(update={"meta": None})})
        work = self._latest(upstream)
        if isinstance(message, LoggingMessageNotification) and work is not None:
            await work.ctx.session.send_notification(message, related_request_id=work.ctx.request_id)
        else:
            await self._client.send_notification(message)

    def _heard(self, upstream: ToolUpstream, message: Any) -> bool:
        config = upstream.config
        match message:
            case LoggingMessageNotification(params=said):
                return self._level is None or LEVELS.index(said.level) >= LEVELS.index(self._level)
            case ToolListChangedNotification():
                return True
            case PromptListChangedNotification():
                return config.prompts
            case ResourceListChangedNotification():
                return config.resources
            case ResourceUpdatedNotification():
                return bool(self._watched.get(config.name))
            case ElicitCompleteNotification():
                return self._can is not None and self._can.elicitation is not None
            case _:
                return False


def able(can: ClientCapabilities | None, question: InputRequest) -> bool:
    """True where a client declared that it can be asked this.

    Args:
        can: its declared abilities.
        question: of a server.
    """
    match question:
        case CreateMessageRequest(params=params):
            sampling = None if can is None else can.sampling
            with_tools = bool(params.tools) or params.tool_choice is not None
            return sampling is not None and (sampling.tools is not None or not with_tools)
        case ElicitRequest(params=ElicitRequestURLParams()):
            return can is not None and can.elicitation is not None and can.elicitation.url is not None
        case ElicitRequest():
            elicitation = None if can is None else can.elicitation
            # One without a mode is of forms alone, as it was before there were modes.
            return elicitation is not None and (elicitation.form is not None or elicitation.url is None)
        case ListRootsRequest():
            return can is not None and can.roots is not None
        case _:
            assert_never(question)


def _answer_to(question: InputRequest) -> type[Any]:
    """Form of the answer to a question."""
    match question:
        case CreateMessageRequest(params=params):
            return CreateMessageResultWithTools if params.tools else CreateMessageResult
        case ElicitRequest():
            return ElicitResult
        case ListRootsRequest():
            return ListRootsResult
        case _:
            assert_never(question)


async def _set_level(session: ClientSession, level: LoggingLevel) -> EmptyResult:
    return await session.send_request(SetLevelRequest(params=SetLevelRequestParams(level=level)), EmptyResult)


async def _tolerated(answer: Awaitable[Any]) -> None:
    """Waits for an answer; a server that has no such thing, or is not there, is none the worse."""
    with suppress(MCPError, UpstreamError):
        await answer
