"""Deferral as a task of MCP (extension `io.modelcontextprotocol/tasks`, SEP-2663).

A deferred call is kept, and its caller looks after it with `tasks/get`. The look that finds people's approval decides
the kept call anew, with the credentials and the proof of that look, and carries it out before it answers: nothing
happens but on a signed request of the holder. Another caller finds no task. Each task acts at most once.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
from contextvars import ContextVar
from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final, assert_never, cast

import anyio
from mcp import MCPError
from mcp.shared.inbound import MCP_NAME_HEADER, decode_header_value
from mcp_types import (
    HEADER_MISMATCH,
    INTERNAL_ERROR,
    INVALID_PARAMS,
    MISSING_REQUIRED_CLIENT_CAPABILITY,
    CallToolRequestParams,
    CallToolResult,
    RequestParams,
)
from pydantic import BaseModel, Field

from capabilities.keys import keys
from capabilities.values.chain import Chain
from pep.base.errors import JournalError
from pep.journal.task_store import ANSWER_BYTES, KeptTask, TaskState, TaskStore
from pep.mcp.decision_result import DECISION_META, DeniedCalls
from pep.mcp.deferred_result import INPUT_REQUIRED_SINCE, RETRY_AFTER_S
from pep.mcp.http_request import CREDENTIALS, HTTP_REQUEST, HttpRequest
from pep.mcp.passed_task import EXTENSION, PassedTask
from pep.people.asks import KEPT_S
from pep.people.deferral import AskState
from pep.request.authority import NOBODY
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from mcp.server.context import HandlerResult, ServerRequestContext
    from mcp.server.lowlevel.server import Server

    from pep.base.ports import Clock
    from pep.gate.gate import GateResult
    from pep.people.asks import Asks
    from pep.request.authority import Credentials

    Context = ServerRequestContext[Any, Any]
    AboutTask = Callable[[Context, str, str, dict[str, Any] | None], Awaitable[Mapping[str, Any]]]
    """Answer of the server of a name about its task of an id, to a request; with responses, where it has some."""

RELAYED_MS: Final = 86_400_000
"""Ours: longest time for which a server's own task is passed on."""
PROTOCOL: Final = "io.modelcontextprotocol/"
"""Beginning of the keys of `_meta` that each request states for itself."""
_ENDED_AS: Final = {
    AskState.DENIED: Reason.APPROVAL_DENIED,
    AskState.WITHDRAWN: Reason.APPROVAL_DENIED,
    AskState.EXPIRED: Reason.APPROVAL_TIMEOUT,
    AskState.REFUSED: Reason.ASK_BUDGET_SPENT,
    None: Reason.APPROVAL_TIMEOUT,
}
"""Reason of a task's end, by the end of its question."""
_NOT_NOW: Final = frozenset({Reason.VERDICT_EXPIRED, Reason.BUSY})
"""Reasons of a denial that the next look may not have: nothing was sent."""
_looking: ContextVar[bool] = ContextVar("_looking", default=False)
"""True while a look decides its call: it makes no other task."""


def is_look() -> bool:
    """True while a look carries a kept call out, whose end it waits for."""
    return _looking.get()


class TaskNamed(RequestParams):
    """Parameters of `tasks/get` and `tasks/cancel`."""

    task_id: str = Field(alias="taskId", max_length=64)


class TaskUpdate(TaskNamed):
    """Parameters of `tasks/update`."""

    input_responses: dict[str, Any] = Field(default_factory=dict, alias="inputResponses")


class DeferredTasks:
    """Deferred calls as tasks, and the three methods about them.

    Args:
        store: keeps them.
        asks: state of each question.
        denied: denials, each on record.
        clock: both clocks.
        about: answers of servers behind this one about tasks of theirs; None where there are none.
    """

    def __init__(
        self, store: TaskStore, *, asks: Asks, denied: DeniedCalls, clock: Clock, about: AboutTask | None = None
    ) -> None:
        self._about = about
        self._store = store
        self._asks = asks
        self._denied = denied
        self._clock = clock
        self._acting: dict[str, anyio.CancelScope] = {}
        self._call: Callable[[Any, Any], Awaitable[HandlerResult]] | None = None

    def serve(self, server: Server[Any]) -> None:
        """Lets clients of a server look after its deferred calls, unless it has tasks of its own.

        Args:
            server: with the guard before its tools.
        """
        called = server.get_request_handler("tools/call")
        if called is None or server.get_request_handler("tasks/get") is not None:
            return  # no call is a task then
        self._call = called.handler
        server.add_request_handler("tasks/get", TaskNamed, self._get)
        server.add_request_handler("tasks/cancel", TaskNamed, self._cancel)
        server.add_request_handler("tasks/update", TaskUpdate, self._update)
        server.extensions[EXTENSION] = {}

    async def opened(
        self, answer: GateResult, params: CallToolRequestParams, ctx: Context, told: CallToolResult
    ) -> dict[str, Any] | None:
        """The task of a deferred call, durable, where its client can look after one and there is room; else None.

        Args:
            answer: a deferral.
            params: of the call, as it came.
            ctx: likewise.
            told: the structured error in its place.
        """
        ask, caller = answer.ask, _caller(ctx)
        if ask is None or caller is None or self._call is None or _looking.get() or not _declares(ctx):
            return None
        kept = params.model_dump(by_alias=True, mode="json", exclude={"input_responses", "request_state", "meta"})
        kept["_meta"] = {
            key: value
            for key, value in dict(params.meta or {}).items()
            if not key.startswith(PROTOCOL) and key not in {"progressToken", "progress_token"}
        }
        keep = self._store.keep
        try:
            task = await asyncio.to_thread(
                keep,
                caller=caller,
                ask_id=ask.ask_id,
                call=json.dumps(kept),
                at_ms=self._now_ms(),
                ends_ms=int((ask.expires_at + KEPT_S) * 1000),
            )
        except (JournalError, ValueError, TypeError):
            return None
        if task is None:
            return None
        return {**self._shown(task), "resultType": "task", "_meta": dict(told.meta or {})}

    async def adopted(self, task: PassedTask, ctx: Context) -> dict[str, Any]:
        """The handle of another server's task, under a name of ours that its caller alone can use.

        Args:
            task: as the server gave it.
            ctx: of the permitted call.

        Raises:
            MCPError: there is no room for it; the server is asked to end it.
        """
        now_ms, caller, kept = self._now_ms(), _caller(ctx), None
        with contextlib.suppress(JournalError):
            if caller is not None:
                kept = await asyncio.to_thread(
                    self._store.keep,
                    caller=caller,
                    ask_id=json.dumps([task.upstream, task.task_id]),
                    call=json.dumps((task.meta or {}).get(DECISION_META)),
                    at_ms=now_ms,
                    ends_ms=now_ms + min(RELAYED_MS if task.ttl_ms is None else task.ttl_ms, RELAYED_MS),
                    state=TaskState.RELAYED,
                )
        if kept is None:
            if self._about is not None:
                await self._about(replace(ctx, method="tasks/cancel"), task.upstream, task.task_id, None)
            raise MCPError(INTERNAL_ERROR, "There is no room for a task.")
        return {**_plain(task), "taskId": kept.task_id}

    async def _passed(self, ctx: Context, task: KeptTask, responses: dict[str, Any] | None = None) -> dict[str, Any]:
        """Answer of the server whose task it is, under our name for it, with what was decided."""
        if self._about is None:
            raise MCPError(INVALID_PARAMS, "Task not found")
        name, task_id = json.loads(task.ask_id)
        answer = dict(await self._about(ctx, name, task_id, responses))
        if "taskId" in answer:
            answer["taskId"] = task.task_id
        if isinstance(result := answer.get("result"), dict):
            answer["result"] = {
                **result,
                "_meta": {**(result.get("_meta") or {}), DECISION_META: json.loads(task.call)},
            }
        return answer

    # -- the three methods

    async def _get(self, ctx: Context, params: TaskNamed) -> dict[str, Any]:
        """State of a task; its act has happened where this is the look that found the approval."""
        task = await self._found(ctx, params)
        if task.state is TaskState.RELAYED:
            return await self._passed(ctx, task)
        if task.state is TaskState.WAITING:
            ended = await self._look(ctx, task)
            task = await self._found(ctx, params)
            if ended is not None and task.state is TaskState.ENDED:
                task = replace(task, answer=json.dumps(ended))  # also where it is too long to be kept
        elif task.state is TaskState.ACTING and task.task_id not in self._acting:
            # The process or the caller went away in between: nothing is done a second time.
            await self._conclude(ctx, task, Reason.EFFECT_FAILED)
            task = await self._found(ctx, params)
        return self._shown(task)

    async def _update(self, ctx: Context, params: TaskUpdate) -> dict[str, Any]:
        """Nothing, of a task of ours: it asks for no input, and a host's answer is no approval."""
        task = await self._found(ctx, params)
        return await self._passed(ctx, task, params.input_responses) if task.state is TaskState.RELAYED else {}

    async def _cancel(self, ctx: Context, params: TaskNamed) -> dict[str, Any]:
        """Withdraws a waiting call, so that it can never happen; an act that has begun is stopped."""
        task = await self._found(ctx, params)
        if task.state is TaskState.RELAYED:
            return await self._passed(ctx, task)
        await self._kept(self._store.cancel, task.task_id, at_ms=self._now_ms())
        if (scope := self._acting.get(task.task_id)) is not None:
            scope.cancel()
        return {}

    async def _found(self, ctx: Context, params: TaskNamed) -> KeptTask:
        """The caller's own task.

        Raises:
            MCPError: the client cannot look after tasks, a header names another one, or there is none for this caller.
        """
        if not _declares(ctx):
            wanted: dict[str, Any] = {"requiredCapabilities": {"extensions": {EXTENSION: {}}}}
            raise MCPError(MISSING_REQUIRED_CLIENT_CAPABILITY, "Missing required client capability", wanted)
        headers = {} if ctx.request is None else ctx.request.headers
        named = headers.get(MCP_NAME_HEADER)
        if named is not None and decode_header_value(named) != params.task_id:
            raise MCPError(HEADER_MISMATCH, f"{MCP_NAME_HEADER} is not the body's taskId")
        caller = _caller(ctx)
        task = None
        if caller is not None:
            task = await self._kept(self._store.find, params.task_id, caller=caller, at_ms=self._now_ms())
        if task is None:
            raise MCPError(INVALID_PARAMS, "Task not found")
        return cast("KeptTask", task)

    # -- one look

    async def _look(self, ctx: Context, task: KeptTask) -> dict[str, Any] | None:
        """End of a task whose question is over, or whose call was decided since; else None.

        It is decided once people have approved it, and again, so asked anew, where its question never reached them.
        """
        state = self._asks.state_of(task.ask_id)
        match state:
            case AskState.OPEN:
                return None
            case AskState.GRANTED | AskState.LOST:
                return await self._act(ctx, task)
            case AskState.DENIED | AskState.WITHDRAWN | AskState.EXPIRED | AskState.REFUSED | None:
                return await self._conclude(ctx, task, _ENDED_AS[state])
            case _:
                assert_never(state)

    async def _act(self, ctx: Context, task: KeptTask) -> dict[str, Any] | None:
        """End of the kept call, decided as one of this look; None where people are to be asked once more."""
        if not await self._kept(self._store.begin, task.task_id, at_ms=self._now_ms()):
            return None  # another look has it
        ended: dict[str, Any] | None = None
        with anyio.CancelScope() as scope:
            self._acting[task.task_id] = scope
            try:
                ended = await self._again(ctx, json.loads(task.call))
            finally:
                del self._acting[task.task_id]
        if ended is None:
            await self._kept(self._store.end, task.task_id, state=TaskState.CANCELLED, answer="", at_ms=self._now_ms())
            return None
        told = ((ended.get("result") or {}).get("_meta") or {}).get(DECISION_META) or {}
        if told.get("decision") == "DEFER" or (told.get("decision") == "DENY" and told.get("reason") in _NOT_NOW):
            ask_id = str(told.get("ask_id") or task.ask_id)
            await self._kept(self._store.wait_on, task.task_id, ask_id=ask_id, at_ms=self._now_ms())
            return None
        return await self._end(task, ended)

    async def _again(self, ctx: Context, kept: dict[str, Any]) -> dict[str, Any]:
        """End of the kept call: its result, or the error of the protocol with which it failed."""
        assert self._call is not None
        meta = {**kept["_meta"], **{k: v for k, v in _meta_of(ctx).items() if k.startswith(PROTOCOL)}}
        raw = {**kept, "_meta": meta}
        params = CallToolRequestParams.model_validate(raw)
        looked_by = cast("Any", ctx.request)
        scope = dict(looked_by.scope)
        looked = scope[HTTP_REQUEST]
        scope[HTTP_REQUEST] = HttpRequest(looked.method, looked.headers, b"", {"method": "tools/call", "params": kept})
        request = type(looked_by)(scope)
        called = replace(ctx, method="tools/call", params=raw, meta=cast("Any", params.meta), request=request)
        token = _looking.set(True)
        try:
            answer = await self._call(called, params)
        except MCPError as error:
            return {"error": error.error.model_dump(by_alias=True, mode="json", exclude_none=True)}
        finally:
            _looking.reset(token)
        plain = _plain(answer)
        if plain.get("resultType", "complete") != "complete":
            return {"error": {"code": INTERNAL_ERROR, "message": "The tool asked for input, which a task has not."}}
        return {"result": {key: value for key, value in plain.items() if key != "resultType"}}

    async def _conclude(self, ctx: Context, task: KeptTask, reason: Reason) -> dict[str, Any]:
        """Ends a task with a denial, on record."""
        where: dict[str, object] = {"task": task.task_id, "ask": task.ask_id}
        refused = await self._denied.deny(reason, "", _credentials(ctx), where)
        return await self._end(task, {"result": _plain(refused)})

    async def _end(self, task: KeptTask, ended: dict[str, Any]) -> dict[str, Any]:
        answer = json.dumps(ended)
        if len(answer) > ANSWER_BYTES:
            answer = json.dumps({"error": {"code": INTERNAL_ERROR, "message": "Done; its result is not kept."}})
        await self._kept(self._store.end, task.task_id, state=TaskState.ENDED, answer=answer, at_ms=self._now_ms())
        return ended

    # -- forms

    def _shown(self, task: KeptTask) -> dict[str, Any]:
        """The task as its client sees it."""
        shown: dict[str, Any] = {
            "taskId": task.task_id,
            "createdAt": _iso(task.made_ms),
            "lastUpdatedAt": _iso(task.changed_ms),
            "ttlMs": task.ends_ms - task.made_ms,
            "pollIntervalMs": RETRY_AFTER_S * 1000,
        }
        match task.state:
            case TaskState.WAITING:
                ask = self._asks.notice_of(task.ask_id)
                words = "People have answered." if ask is None else f"People are asked at {ask.url}: {ask.reason}."
                return {**shown, "status": "working", "statusMessage": words}
            case TaskState.ACTING | TaskState.RELAYED:
                return {**shown, "status": "working", "statusMessage": "It is being carried out."}
            case TaskState.CANCELLED:
                return {**shown, "status": "cancelled"}
            case TaskState.ENDED:
                ended = json.loads(task.answer)
                if "error" in ended:
                    said = str(ended["error"].get("message", ""))
                    return {**shown, "status": "failed", "statusMessage": said, "error": ended["error"]}
                return {**shown, "status": "completed", "result": ended["result"]}
            case _:
                assert_never(task.state)

    async def _kept(self, write: Callable[..., Any], *args: Any, **named: Any) -> Any:
        """Answer of the store, which is asked beside the event loop.

        Raises:
            MCPError: it cannot answer, so nothing may happen.
        """
        try:
            # Shielded: what has happened is on file also where its caller goes now.
            return await asyncio.shield(asyncio.to_thread(write, *args, **named))
        except JournalError as error:
            raise MCPError(INTERNAL_ERROR, str(Reason.RECORD_FAILED)) from error

    def _now_ms(self) -> int:
        return int(self._clock.wall_s() * 1000)


def _credentials(ctx: Context) -> Credentials:
    return NOBODY if ctx.request is None else cast("Credentials", ctx.request.scope.get(CREDENTIALS, NOBODY))


def _caller(ctx: Context) -> str | None:
    """Digest of the caller's whole chain: its person, mandate, and each hop's agent and key. None without one.

    A later token of the same people and agents is the same caller; any other way to the leaf is another.
    """
    credentials = _credentials(ctx)
    chain = credentials.chain
    if credentials.fault is not None or not isinstance(chain, Chain):
        return None
    hops = [[hop.agent, keys.thumbprint(hop.key)] for hop in chain.hops]
    named = [chain.sponsor.issuer, chain.sponsor.subject, chain.mandate_id, hops]
    return hashlib.sha256(json.dumps(named).encode()).hexdigest()


def _declares(ctx: Context) -> bool:
    """True where the request states that its client can look after tasks."""
    known = ctx.session.client_capabilities
    return ctx.protocol_version >= INPUT_REQUIRED_SINCE and known is not None and EXTENSION in (known.extensions or {})


def _meta_of(ctx: Context) -> Mapping[str, Any]:
    meta = (ctx.params or {}).get("_meta")
    return meta if isinstance(meta, dict) else {}


def _plain(answer: HandlerResult) -> dict[str, Any]:
    if isinstance(answer, BaseModel):
        return answer.model_dump(by_alias=True, mode="json", exclude_none=True)
    return dict(answer or {})


def _iso(at_ms: int) -> str:
    return datetime.fromtimestamp(at_ms / 1000, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
