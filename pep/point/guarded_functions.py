"""Guard of a program's own functions and HTTP endpoints: each act runs through the same gate as a tool's.

    point = GuardedFunctions(GuardConfig.read("guard.toml"), [delete_record])

    async with point.living():                         # the feeds run
        await point.enforced(delete_record)(presented, id=3)

`point.carried(function)` is the same for an agent framework: the credentials are those of the block `acting` around it.
`permitted(point, function)` is the same as a dependency of an ASGI framework: the endpoint runs inside the permit.
"""

from __future__ import annotations

import asyncio
import inspect
import json
import secrets
from contextlib import asynccontextmanager
from contextvars import copy_context
from functools import wraps
from typing import TYPE_CHECKING, Any, Self, TypeVar, cast
from urllib.parse import urlsplit

from starlette.exceptions import HTTPException
from starlette.requests import Request as HttpRequest  # noqa: TC002 - a framework reads the annotation at run time

from capabilities import tracing
from capabilities.values import trace_context
from capabilities.values.chain import Chain
from pep.base.declaration import declared
from pep.base.errors import ActuationRefusedError, DeclarationError, JournalError, PepFault
from pep.base.traced import tell
from pep.gate import records
from pep.gate.gate import EffectResult, GateResult
from pep.mcp import deferred_result
from pep.mcp.body_screen import Unfit, screen
from pep.mcp.declared_tools import definition_of
from pep.mcp.http_request import headers_of, token_in
from pep.mcp.mapping import Misfit, bare_request, checked_defaults, decided_arguments
from pep.mcp.provenance import unvouched
from pep.mcp.real_paths import resolved_request
from pep.mcp.tool_digest import ToolPin, definition_digest
from pep.point import carriage
from pep.point.deciding_point import DecidingPoint
from pep.request.authority import PresentedRequest
from pep.request.call import Call, tool_reading
from policies.evidence.evidence import NOT_COLLECTED
from policies.evidence.model import Effect
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
    from contextlib import AbstractAsyncContextManager
    from types import TracebackType

    from pep.base.operation_row import Operation
    from pep.point.guard_config import GuardConfig
    from pep.request.authority import Credentials
    from pep.request.permit import Permit

    F = TypeVar("F", bound="Callable[..., Any]")


class NotPermittedError(Exception):
    """An act that did not happen: refused, or deferred to people. `told` is for the holder, `answer` the gate's."""

    def __init__(self, told: Mapping[str, object], answer: GateResult | None = None) -> None:
        super().__init__(str(told.get("reason", "")))
        self.told = dict(told)
        self.answer = answer


def function_pins(functions: Iterable[Callable[..., Any]]) -> tuple[ToolPin, ...]:
    """Declared functions as a person is to review and register them.

    Raises:
        DeclarationError: `TOOL_UNDECLARED` or `TOOL_TWICE`.
    """
    return tuple(
        ToolPin(row.name, definition_digest(definition_of(row, text)), row.name, row.base_tier)
        for row, text in _rows(functions).values()
    )


def _rows(functions: Iterable[Callable[..., Any]]) -> dict[str, tuple[Operation, str]]:
    """Row and description of each function, by name."""
    rows: dict[str, tuple[Operation, str]] = {}
    for function in functions:
        row = declared(function)
        if row is None:
            raise DeclarationError(PepFault.TOOL_UNDECLARED, function.__name__)
        if row.name in rows:
            raise DeclarationError(PepFault.TOOL_TWICE, row.name)
        rows[row.name] = checked_defaults(row), function.__doc__ or ""
    return rows


class GuardedFunctions(DecidingPoint):
    """Functions of a program, each declared by `operation`, with all parts of an enforcement point.

    Args:
        config: of the guard.
        functions: all of them.
    """

    def __init__(self, config: GuardConfig, functions: Iterable[Callable[..., Any]]) -> None:
        stated = _rows(functions)
        self._rows = {name: row for name, (row, _) in stated.items()}
        self._digests = {name: definition_digest(definition_of(*each)) for name, each in stated.items()}
        self._loop: asyncio.AbstractEventLoop | None = None
        super().__init__(config)

    @asynccontextmanager
    async def living(self) -> AsyncIterator[None]:
        """The feeds run inside, and threads may call; everything is released afterwards.

        Raises:
            DeclarationError: as `declare`.
        """
        async with super().living():
            self._loop = asyncio.get_running_loop()
            try:
                yield
            finally:
                self._loop = None

    async def declare(self) -> None:
        """Checks that every function is registered as it is now.

        Raises:
            DeclarationError: one is not.
        """
        for name, digest in self._digests.items():
            self.check_registered(name, digest)
        await self.hear(self._rows.values())

    def enforced(self, function: Callable[..., Any]) -> Callable[..., Awaitable[Any]]:
        """The function behind the gate: it takes the caller's credentials first, and its arguments by name.

        Args:
            function: one of this point's.
        """
        row = self._row(function)

        @wraps(function)
        async def run(presented: PresentedRequest, **arguments: Any) -> Any:
            async with self.act(row, presented, arguments) as decided:
                with carriage.nobody():
                    found = function(**decided)
                    return await found if asyncio.iscoroutine(found) else found

        return run

    def carried(self, function: F, *, refused: Callable[[NotPermittedError], Any] | None = None) -> F:
        """The function behind the gate, called as it was: with the credentials of the block `acting`, or with none.

        A coroutine function stays one. Any other runs in the thread that calls it, which must not be the event loop's
        own; agent frameworks call such functions in threads.

        Args:
            function: one of this point's; each of its parameters is declared.
            refused: gives the result of a call that did not happen, such as words for a model; without it the error
                is raised.

        Raises:
            DeclarationError: `TOOL_UNDECLARED`, or `TOOL_SCHEMA_DIFFERS` for a parameter that nothing would decide on.
        """
        row, signature = self._row(function), inspect.signature(function)
        for name in signature.parameters.keys() ^ {each.name for each in row.arguments or ()}:
            raise DeclarationError(PepFault.TOOL_SCHEMA_DIFFERS, f"{row.name}.{name}: not declared")

        def begun(given: tuple[Any, ...], named: dict[str, Any]) -> _Act:
            bound = signature.bind(*given, **named)
            bound.apply_defaults()
            arguments, at = bound.arguments, self.clock.wall_s()
            shown = carriage.presented(row.name, arguments, audience=self.config.audience, at=at)
            return _Act(self.act(row, shown, arguments), refused)

        @wraps(function)
        async def run(*given: Any, **named: Any) -> Any:
            async with begun(given, named) as act:
                if act.decided is None:
                    return act.found
                with carriage.nobody():
                    act.found = await function(**act.decided)
            return act.found

        @wraps(function)
        def run_here(*given: Any, **named: Any) -> Any:
            with carriage.from_thread(self._loop, begun(given, named)) as act, carriage.nobody():
                if act.decided is not None:
                    act.found = function(**act.decided)
            return act.found

        return cast("F", run if inspect.iscoroutinefunction(function) else run_here)

    @asynccontextmanager
    async def act(
        self, row: Operation, presented: PresentedRequest, arguments: Mapping[str, Any]
    ) -> AsyncIterator[dict[str, Any]]:
        """The act happens inside, with the decided arguments; its outcome is on record afterwards.

        Args:
            row: of the operation.
            presented: the caller's credentials, unverified.
            arguments: as they were given.

        Raises:
            NotPermittedError: nothing must happen.
        """
        with tracing.begun(trace_context.REQUEST, random=secrets.token_bytes):
            # What runs of its own from here on is in the trace; the act itself is its caller's, and may end elsewhere.
            context = copy_context()
            call = await self._call(row, presented, arguments)
        decided = decided_arguments(row, call.request, arguments)
        loop = asyncio.get_running_loop()
        entered: asyncio.Future[Permit] = loop.create_future()
        left: asyncio.Future[None] = loop.create_future()

        async def effect(permit: Permit) -> EffectResult:
            entered.set_result(permit)
            await left
            return EffectResult(value={})

        running = loop.create_task(self._decided(call, effect), context=context)
        try:
            ends: set[asyncio.Future[Any]] = {running, entered}
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if entered.done():
                try:
                    # Here and not in the effect: nothing waits between this and the act.
                    entered.result().spend_act(digest=call.request.digest)
                except ActuationRefusedError as refused:
                    left.set_exception(refused)
            if not entered.done() or left.done():
                raise NotPermittedError(_told(answer := await running), answer)
            try:
                yield decided
            except Exception as error:
                left.set_exception(error)
                await running
                raise
            left.set_result(None)
            await running
        finally:
            running.cancel()  # a caller who has gone; one that has ended notices nothing

    async def _decided(self, call: Call, effect: Callable[[Permit], Awaitable[EffectResult]]) -> GateResult:
        with tracing.step(trace_context.DECIDE, {trace_context.OPERATION: call.operation.name}) as span:
            answer = await self.gate.run(call, effect)
            tell(span, answer.decision)
        return answer

    def _row(self, function: Callable[..., Any]) -> Operation:
        row = declared(function)
        if row is None or self._rows.get(row.name) is not row:
            raise DeclarationError(PepFault.TOOL_UNDECLARED, function.__name__)
        return row

    async def _call(self, row: Operation, presented: PresentedRequest, arguments: Mapping[str, Any]) -> Call:
        arrived_ms, at = self.clock.monotonic_ms(), self.clock.wall_s()
        audience = self.config.audience
        lease_ms = self.gate.lease_ms(bare_request(row, audience=audience))
        credentials = self.authority.check(presented, lease_ms=lease_ms)
        request = resolved_request(row, arguments, request_id=secrets.token_hex(16), audience=audience, at=at)
        if isinstance(request, Misfit):
            raise await self._refused(row, credentials, request)
        chain = credentials.chain
        return Call(
            request=request,
            operation=row,
            tool=tool_reading(row.name, self.follower.tool(row.name), self._digests[row.name]),
            credentials=credentials,
            arrived_ms=arrived_ms,
            readiness=None,
            context=unvouched(request, (), operation=row, chain=chain, at=at)
            if isinstance(chain, Chain)
            else NOT_COLLECTED,
        )

    async def unfit(self, row: Operation, presented: PresentedRequest, unfit: Unfit) -> str:
        """The reason for a body that is no object of arguments, once it is on record.

        Args:
            row: of the operation.
            presented: the caller's credentials, unverified.
            unfit: fault of the body.
        """
        lease_ms = self.gate.lease_ms(bare_request(row, audience=self.config.audience))
        credentials = self.authority.check(presented, lease_ms=lease_ms)
        refused = await self._refused(row, credentials, Misfit(unfit.reason, "", unfit.detail))
        return str(refused.told["reason"])

    async def _refused(self, row: Operation, credentials: Credentials, misfit: Misfit) -> NotPermittedError:
        """The refusal of arguments that are no request, once it is on record."""
        where: dict[str, object] = {"argument": misfit.argument, "detail": misfit.detail}
        # A stranger hears of its credentials alone, as at a tool server.
        fault = credentials.fault
        reason, primitive = (misfit.reason, "TEA-2") if fault is None else (Reason(fault.code), "AID-1")
        body = records.refusal(
            at=self.clock.wall_s(),
            at_ms=self.clock.monotonic_ms(),
            reason=reason,
            status=200,
            credentials=credentials,
            where={"tool": row.name, **where, "primitive": primitive},
        )
        try:
            await self.gate.record("refusal", body)
        except JournalError:
            reason = Reason.RECORD_FAILED
        told = {"decision": "DENY", "reason": str(reason), "primitive": primitive, "remedy": REASONS[reason].remedy}
        return NotPermittedError(told if fault is not None else {**where, **told})


class _Act:
    """One carried call: its way in and out, and its result.

    Attributes:
        decided: the arguments; None for a call that does not happen.
        found: the function's result, or that of `refused`.
    """

    def __init__(
        self, act: AbstractAsyncContextManager[dict[str, Any]], refused: Callable[[NotPermittedError], Any] | None
    ) -> None:
        self._act = act
        self._refused = refused
        self.decided: dict[str, Any] | None = None
        self.found: Any = None

    async def __aenter__(self) -> Self:
        try:
            self.decided = await self._act.__aenter__()
        except NotPermittedError as error:
            if self._refused is None:
                raise
            self.found = self._refused(error)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.decided is not None:
            await self._act.__aexit__(kind, error, trace)


def permitted(
    point: GuardedFunctions, function: Callable[..., Any]
) -> Callable[[HttpRequest], AsyncIterator[dict[str, Any]]]:
    """Dependency of an endpoint: it runs inside a permit for the function's operation, with the decided arguments.

    The arguments are the members of the request's JSON body. Token and proof come as at a guarded tool server; the
    proof's URL is that of the request's path at the origin of the audience.

    Args:
        point: has the function.
        function: declares the operation.
    """
    row = point._row(function)  # noqa: SLF001 - one module
    parts = urlsplit(point.config.audience)

    async def within(request: HttpRequest) -> AsyncIterator[dict[str, Any]]:
        headers, body = headers_of(request.scope), await request.body()
        presented = PresentedRequest(
            token=token_in(headers),
            proof=headers.get("dpop"),
            method=request.method,
            url=f"{parts.scheme}://{parts.netloc}{request.url.path}",
            body=body,
        )
        arguments = screen(body)
        if isinstance(arguments, Unfit):
            raise HTTPException(400, await point.unfit(row, presented, arguments))
        try:
            async with point.act(row, presented, arguments) as decided:
                yield decided
        except NotPermittedError as refused:
            deferred = refused.told["decision"] == Effect.DEFER
            raise HTTPException(409 if deferred else 403, json.dumps(refused.told)) from refused

    return within


def _told(answer: GateResult) -> dict[str, object]:
    told = records.told(answer.decision)
    return told | deferred_result.told(answer)
