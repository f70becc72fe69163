"""Relay: a server with nothing of its own, which passes each request on to the one behind it.

It lists a tool that the configuration maps, and no other. Instructions, prompts and templates of resources go on where
they are as they were reviewed; a caller's credentials and this project's own members of `_meta` never do.
"""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final, TypeVar

from mcp import MCPError, UrlElicitationRequiredError
from mcp.server.lowlevel.server import NotificationOptions, Server
from mcp.shared.subscriptions import SUBSCRIPTION_ID_META_KEY, event_to_notification
from mcp_types import (
    INVALID_PARAMS,
    CallToolRequestParams,
    CompleteRequestParams,
    CompleteResult,
    Completion,
    ElicitRequestURLParams,
    EmptyResult,
    GetPromptRequestParams,
    GetPromptResult,
    InputRequiredResult,
    ListPromptsResult,
    ListResourcesResult,
    ListResourceTemplatesResult,
    ListToolsResult,
    NotificationParams,
    PaginatedRequestParams,
    PromptReference,
    ReadResourceRequestParams,
    ReadResourceResult,
    Result,
    SetLevelRequestParams,
    SubscribeRequestParams,
    SubscriptionFilter,
    SubscriptionsAcknowledgedNotification,
    SubscriptionsAcknowledgedNotificationParams,
    SubscriptionsListenRequestParams,
    SubscriptionsListenResult,
    UnsubscribeRequestParams,
)

from pep.base.errors import UpstreamError
from pep.mcp.deferred_result import APPROVAL, INPUT_REQUIRED_SINCE
from pep.mcp.deferred_task import is_look
from pep.mcp.gateway import task_relay
from pep.mcp.gateway.paired_session import WATCHED, PairedSession
from pep.mcp.gateway.upstream import DECLARED
from pep.mcp.passed_task import EXTENSION, PassedTask

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence

    from mcp.client.session import ClientSession
    from mcp.server.context import ServerRequestContext
    from mcp.server.models import InitializationOptions
    from mcp.shared.dispatcher import ProgressFnT
    from mcp.shared.subscriptions import ServerEvent
    from mcp_types import CallToolResult, InputResponseRequestParams, Prompt, Resource, ResourceTemplate, Tool

    from pep.mcp.gateway.lock import Lock
    from pep.mcp.gateway.upstream import ToolUpstream

    Context = ServerRequestContext[Any, Any]
    P = TypeVar("P", bound=InputResponseRequestParams)
    R = TypeVar("R")

Answer = TypeVar("Answer", bound=Result)
SERVER: Final = "ztpm-gateway"
MEMBERS: Final = "dev.ztpm/"
"""Beginning of the keys of this project's own members of `_meta`."""
OURS: Final = (MEMBERS, "io.modelcontextprotocol/")
"""Beginnings of the keys of `_meta` that are between the caller and this gateway alone."""


class UpstreamRelay:
    """All servers behind one gateway, as one.

    Args:
        upstreams: the servers.
        lock: reviewed definitions; None where the servers guard themselves, and all they say goes on.
        admitted: whether a tool, as it is now, may be listed and called.
        approved: whether it is as it was approved; by any other's schema no header is checked.

    Attributes:
        server: the SDK's server in front of them.
    """

    def __init__(
        self,
        upstreams: Sequence[ToolUpstream],
        lock: Lock | None,
        *,
        admitted: Callable[[Tool], bool],
        approved: Callable[[Tool], bool] = lambda _: True,
    ) -> None:
        self._upstreams = upstreams
        self._lock = lock
        self._admitted = admitted
        self._approved = approved
        self._listed: dict[str, list[Tool]] = {}
        self.server: Server[Any] = _TellingServer(
            SERVER,
            version=version("ztpm"),
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
            on_list_prompts=self._list_prompts,
            on_get_prompt=self._get_prompt,
            on_list_resources=self._list_resources,
            on_list_resource_templates=self._list_resource_templates,
            on_read_resource=self._read_resource,
            on_completion=self._complete,
            on_subscriptions_listen=self._listen,
            on_subscribe_resource=self._subscribe,
            on_unsubscribe_resource=self._unsubscribe,
            # As listed last: a check of headers would ask every server for its list once more.
            get_tool_input_schema=self._schema,
        )
        self.server.add_request_handler("logging/setLevel", SetLevelRequestParams, self._set_level)
        self.server.add_notification_handler(
            "notifications/roots/list_changed", NotificationParams, self._roots_changed
        )
        self._guarded = lock is None
        """They guard themselves, so a deferral is theirs to tell."""
        if self._guarded and len(upstreams) == 1:
            task_relay.pass_on(self.server, upstreams[0], partial(_passed_on, tasks=True))

    def introduce(self) -> None:
        """Lets clients have the instructions of the servers that are as they were reviewed."""
        told = [
            f"{each.config.name}: {said}"
            for each in self._upstreams
            if (said := each.about[1]) and (self._lock is None or self._lock.has_instructions(each.config.name, said))
        ]
        self.server.instructions = "\n\n".join(told) or None

    async def tools(self, name: str, ctx: Context) -> list[Tool]:
        """Definitions of the tools of that name, as its server lists them now to the caller of a request.

        Raises:
            UpstreamError: it does not answer.
        """
        home = self._home(name)
        if home is None:
            return []
        return [each for each in await self.mapped(home, await _at(ctx, home)) if each.name == name]

    # ---- tools

    async def _list_tools(self, ctx: Context, params: PaginatedRequestParams | None) -> ListToolsResult:  # noqa: ARG002
        """Tools of all servers that answer; those of another are not there to be called either."""
        listed = (self.mapped(each, _open_at(ctx, each)) for each in self._upstreams)
        found = await asyncio.gather(*listed, return_exceptions=True)
        return ListToolsResult(tools=[tool for tools in found for tool in _of(tools)])

    async def mapped(self, upstream: ToolUpstream, asked: ToolUpstream | None = None) -> list[Tool]:
        """Definitions of the tools of one server that are mapped and admitted, under their names here.

        Args:
            upstream: the server.
            asked: the connection to it over which it is asked; None for that of all.

        Raises:
            UpstreamError: it does not answer.
        """
        prefix, names = upstream.config.prefix, upstream.config.tool
        found = [
            _renamed(each, prefix) for each in await (asked or upstream).tools() if names is None or each.name in names
        ]
        kept = [each for each in found if self._admitted(each)]
        self._listed[upstream.config.name] = kept
        return kept

    def _schema(self, name: str) -> Mapping[str, Any] | None:
        """Schema of a tool's arguments, as its server listed it last."""
        return next((each.input_schema for each in self.listed(name) if self._approved(each)), None)

    def listed(self, name: str) -> list[Tool]:
        """Definitions of the tools of that name, as a server that is connected listed them last."""
        home = self._home(name)
        if home is None or not home.is_connected:
            return []
        return [each for each in self._listed.get(home.config.name, ()) if each.name == name]

    def latest(self, ctx: Context, name: str) -> list[Tool]:
        """The same; nothing before the caller of a request has a connection of its own, which no verdict waits for."""
        home, paired = self._home(name), PairedSession.of(ctx)
        return [] if home is None or not (paired is None or paired.is_open_at(home)) else self.listed(name)

    def _home(self, name: str) -> ToolUpstream | None:
        """The server that has the tool of that name."""
        for each in self._upstreams:
            own = name.removeprefix(each.config.prefix)
            if name.startswith(each.config.prefix) and (each.config.tool is None or own in each.config.tool):
                return each
        return None

    async def _call_tool(self, ctx: Context, params: CallToolRequestParams) -> CallToolResult | InputRequiredResult:
        home = self._home(params.name)
        if home is None:
            raise MCPError(INVALID_PARAMS, "unknown tool")
        given = params.input_responses or {}
        ours = not self._guarded and APPROVAL in given
        answers = {key: each for key, each in given.items() if self._guarded or key != APPROVAL}
        sent = CallToolRequestParams(
            name=params.name.removeprefix(home.config.prefix),
            arguments=params.arguments,
            input_responses=answers or None,
            request_state=None if ours else params.request_state,
        )
        tasks = self._guarded or (home.config.tasks and not is_look())
        meta, progress = _passed_on(ctx, tasks=tasks), _progress(ctx)
        answer: Any = await _served(
            ctx, home, sent, lambda server, asked: server.call(asked, meta=meta, progress=progress)
        )
        if self._guarded:
            _check_form(answer, ctx)
        elif isinstance(answer, PassedTask):
            answer = answer.model_copy(update={"upstream": home.config.name})
        return self._unforged(answer)  # type: ignore[no-any-return]  # a handle of a task, too, which the SDK passes on

    async def about_task(
        self, ctx: Context, name: str, task_id: str, responses: dict[str, Any] | None
    ) -> Mapping[str, Any]:
        """Answer of the server of that name about one of its tasks; the method is that of the request.

        Raises:
            MCPError: it refuses, or does not answer.
        """
        upstream = next((each for each in self._upstreams if each.config.name == name and each.config.tasks), None)
        if upstream is None:
            raise MCPError(INVALID_PARAMS, "Task not found")
        more = {} if responses is None else {"inputResponses": responses}
        params = task_relay.PassedParams.model_validate({"taskId": task_id, **more})
        sent: Any = _passed_on(ctx, tasks=True)
        answer = await task_relay.ask(upstream, ctx.method, params.model_copy(update={"meta": sent}))
        return answer.model_dump(by_alias=True, mode="json", exclude_none=True)

    def _unforged(self, answer: Answer) -> Answer:
        """The answer without members of ours, which only a server that guards itself may give."""
        if self._lock is None or not answer.meta:
            return answer
        kept = {key: value for key, value in answer.meta.items() if not key.startswith(MEMBERS)}
        return answer.model_copy(update={"meta": kept or None})

    # ---- what is not a tool

    async def _list_prompts(self, ctx: Context, _: PaginatedRequestParams | None) -> ListPromptsResult:
        found: list[Prompt] = []
        for each in self._with("prompts"):
            found += [
                _renamed(prompt, each.config.prefix)
                for prompt in _of(await _tried(_open_at(ctx, each).prompts()))
                if self._lock is None or self._lock.has_prompt(each.config.name, prompt)
            ]
        return ListPromptsResult(prompts=found)

    async def _get_prompt(self, ctx: Context, params: GetPromptRequestParams) -> GetPromptResult | InputRequiredResult:
        meta = _passed_on(ctx)
        for each in self._with("prompts"):
            name = params.name.removeprefix(each.config.prefix)
            known = params.name.startswith(each.config.prefix) and any(
                prompt.name == name and (self._lock is None or self._lock.has_prompt(each.config.name, prompt))
                for prompt in await (await _at(ctx, each)).prompts()
            )
            if known:
                sent = params.model_copy(update={"name": name})
                got = await _served(ctx, each, sent, lambda server, asked: server.prompt(asked, meta=meta))
                return self._unforged(got)
        raise MCPError(INVALID_PARAMS, "unknown prompt")

    async def _list_resources(self, ctx: Context, _: PaginatedRequestParams | None) -> ListResourcesResult:
        found: list[Resource] = []
        for each in self._with("resources"):
            found += _of(await _tried(_open_at(ctx, each).resources()))
        return ListResourcesResult(resources=found)

    async def _list_resource_templates(
        self, ctx: Context, _: PaginatedRequestParams | None
    ) -> ListResourceTemplatesResult:
        found: list[ResourceTemplate] = []
        for each in self._with("resources"):
            found += [
                template
                for template in _of(await _tried(_open_at(ctx, each).resource_templates()))
                if self._lock is None or self._lock.has_template(each.config.name, template)
            ]
        return ListResourceTemplatesResult(resource_templates=found)

    async def _read_resource(
        self, ctx: Context, params: ReadResourceRequestParams
    ) -> ReadResourceResult | InputRequiredResult:
        """Answer of the first server that has such a resource."""
        refused, meta = None, _passed_on(ctx)
        for each in self._with("resources"):
            try:
                read = await _served(ctx, each, params, lambda server, asked: server.resource(asked, meta=meta))
                return self._unforged(read)
            except MCPError as error:
                refused = refused or error
        raise refused or MCPError(INVALID_PARAMS, "unknown resource")

    async def _complete(self, ctx: Context, params: CompleteRequestParams) -> CompleteResult:
        """Completions of the first server that has some."""
        known = None if params.context is None else params.context.arguments
        argument = {"name": params.argument.name, "value": params.argument.value}
        for each in self._with("prompts" if isinstance(params.ref, PromptReference) else "resources"):
            ref = params.ref
            if isinstance(ref, PromptReference):
                if not ref.name.startswith(each.config.prefix):
                    continue
                ref = ref.model_copy(update={"name": ref.name.removeprefix(each.config.prefix)})

            def question(session: ClientSession, ref: Any = ref) -> Awaitable[CompleteResult]:
                return session.complete(ref, argument, context_arguments=known)

            found = await _tried(_open_at(ctx, each).asked(question))
            if isinstance(found, CompleteResult) and found.completion.values:
                return found
        return CompleteResult(completion=Completion(values=[]))

    # ---- what a client hears of

    async def _listen(self, ctx: Context, params: SubscriptionsListenRequestParams) -> SubscriptionsListenResult:
        """Changes that the client asks to hear of, on the stream of this request, until it goes."""
        wanted = params.notifications
        if len(wanted.resource_subscriptions or ()) > WATCHED:
            raise MCPError(INVALID_PARAMS, f"more than {WATCHED} resources")
        changed: dict[ServerEvent, None] = {}
        news = asyncio.Event()

        def told(event: ServerEvent) -> None:
            changed[event] = None
            news.set()

        meta: dict[str, Any] = {SUBSCRIPTION_ID_META_KEY: ctx.request_id}
        with ExitStack() as stack:
            for each in self._upstreams:
                stack.enter_context(each.changes.heard(_honored(wanted, (each,)), told))
            await asyncio.gather(*(each.changes.opened() for each in self._upstreams))
            honored = SubscriptionsAcknowledgedNotificationParams(
                notifications=_honored(wanted, self._upstreams), _meta=meta
            )
            await ctx.session.send_notification(
                SubscriptionsAcknowledgedNotification(params=honored), related_request_id=ctx.request_id
            )
            while True:
                await news.wait()
                news.clear()
                while changed:
                    event = next(iter(changed))
                    del changed[event]
                    await ctx.session.send_notification(
                        event_to_notification(event, meta), related_request_id=ctx.request_id
                    )

    async def _subscribe(self, ctx: Context, params: SubscribeRequestParams) -> EmptyResult:
        """Lets a client of the older protocol hear of a resource, at the first server that has it."""
        refused: MCPError | None = None
        paired = PairedSession.of(ctx)
        for each in self._with("resources"):
            try:
                if paired is not None:
                    await paired.watch(each, params.uri)
                    return EmptyResult()
            except UpstreamError:
                continue
            except MCPError as error:
                refused = refused or error
        raise refused or MCPError(INVALID_PARAMS, "unknown resource")

    async def _unsubscribe(self, ctx: Context, params: UnsubscribeRequestParams) -> EmptyResult:
        if (paired := PairedSession.of(ctx)) is not None:
            await paired.unwatch(params.uri)
        return EmptyResult()

    async def _set_level(self, ctx: Context, params: SetLevelRequestParams) -> EmptyResult:
        if (paired := PairedSession.of(ctx)) is not None:
            await paired.log_from(params.level)
        return EmptyResult()

    async def _roots_changed(self, ctx: Context, _: NotificationParams) -> None:
        if (paired := PairedSession.of(ctx)) is not None:
            await paired.roots_changed()

    def _with(self, what: str) -> Iterable[ToolUpstream]:
        """Servers of which the configuration passes these on."""
        return (each for each in self._upstreams if getattr(each.config, what))


class _TellingServer(Server[Any]):
    """Server that tells clients of the older protocol that it tells of changes."""

    def create_initialization_options(
        self, notification_options: NotificationOptions | None = None, *stated: Any, **others: Any
    ) -> InitializationOptions:
        """As the SDK's, with all changes announced."""
        told = notification_options or NotificationOptions(
            prompts_changed=True, resources_changed=True, tools_changed=True
        )
        return super().create_initialization_options(told, *stated, **others)


async def _at(ctx: Context, upstream: ToolUpstream) -> ToolUpstream:
    """Connection to a server for the caller of a request: its own, or that of all."""
    paired = PairedSession.of(ctx)
    return upstream if paired is None else await paired.at(upstream)


def _open_at(ctx: Context, upstream: ToolUpstream) -> ToolUpstream:
    """The same, for what is the same to all: a list opens no connection."""
    paired = PairedSession.of(ctx)
    return upstream if paired is None else paired.open_at(upstream)


async def _served(
    ctx: Context, upstream: ToolUpstream, params: P, send: Callable[[ToolUpstream, P], Awaitable[R]]
) -> R:
    """Answer of a server to a request.

    A client of the older protocol is asked what the server asks; one of the newer gets the questions as the answer.
    """
    paired = PairedSession.of(ctx)
    if paired is None:
        return await send(upstream, params)
    server = await paired.at(upstream)
    return await paired.served(ctx, upstream, params, lambda asked: send(server, asked))


def _honored(wanted: SubscriptionFilter, upstreams: Sequence[ToolUpstream]) -> SubscriptionFilter:
    """The wanted part of what the configuration passes on of these servers."""
    prompts = any(each.config.prompts for each in upstreams)
    resources = any(each.config.resources for each in upstreams)
    return SubscriptionFilter(
        tools_list_changed=wanted.tools_list_changed or None,
        prompts_list_changed=(prompts and wanted.prompts_list_changed) or None,
        resources_list_changed=(resources and wanted.resources_list_changed) or None,
        resource_subscriptions=(resources and wanted.resource_subscriptions) or None,
    )


async def _tried(answer: Any) -> Any:
    """The answer, or the error of a server that gives none."""
    try:
        return await answer
    except (UpstreamError, MCPError) as error:
        return error


def _of(listed: Any) -> list[Any]:
    return listed if isinstance(listed, list) else []


def _renamed(definition: Any, prefix: str) -> Any:
    return definition.model_copy(update={"name": prefix + definition.name}) if prefix else definition


def _passed_on(ctx: Context, *, tasks: bool = False) -> dict[str, Any]:
    """Members of `_meta` that go on, and the caller's abilities, tasks among them only where they are passed on."""
    meta: Mapping[str, Any] = (ctx.params or {}).get("_meta") or {}
    kept = {key: value for key, value in meta.items() if not key.startswith(OURS) and key != "progressToken"}
    known = ctx.session.client_capabilities
    declared = {} if known is None else known.model_dump(by_alias=True, mode="json", exclude_none=True)
    if not tasks and (others := declared.pop("extensions", {})):
        declared["extensions"] = {name: each for name, each in others.items() if name != EXTENSION}
    return {**kept, DECLARED: declared}


def _check_form(answer: Any, ctx: Context) -> None:
    """Checks that the caller's client can be given the answer as it is.

    Raises:
        UrlElicitationRequiredError: the client is of the older protocol, and has the pages of a server in an error.
    """
    if not isinstance(answer, InputRequiredResult) or ctx.protocol_version >= INPUT_REQUIRED_SINCE:
        return
    asked = [getattr(each, "params", None) for each in (answer.input_requests or {}).values()]
    pages = [each for each in asked if isinstance(each, ElicitRequestURLParams)]
    if pages and len(pages) == len(asked):
        named = [each.model_copy(update={"elicitation_id": each.elicitation_id or each.url}) for each in pages]
        raise UrlElicitationRequiredError(named, " ".join(f"{each.message} {each.url}" for each in pages))


def _progress(ctx: Context) -> ProgressFnT | None:
    """Way back for a call's progress, where its caller asks for it."""
    asked = ((ctx.params or {}).get("_meta") or {}).get("progressToken") is not None

    async def told(progress: float, total: float | None, message: str | None) -> None:
        await ctx.session.report_progress(progress, total, message)

    return told if asked else None
