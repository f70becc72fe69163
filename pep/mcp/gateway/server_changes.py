"""Changes of a server's lists and resources, as it tells them over the connection of all, for those who listen.

One stream of the server serves every listener. A change says "look again" and nothing more: who listens twice hears
it twice, and after a break all hear of every change that they listen to.
"""

from __future__ import annotations

import asyncio
from contextlib import contextmanager, suppress
from contextvars import Context
from typing import TYPE_CHECKING, Final

from mcp import MCPError
from mcp.client.subscriptions import SubscriptionLost, listen
from mcp.shared.subscriptions import (
    PromptsListChanged,
    ResourcesListChanged,
    ResourceUpdated,
    ToolsListChanged,
    event_from_wire,
    event_matches,
)
from mcp_types import (
    METHOD_NOT_FOUND,
    EmptyResult,
    SubscribeRequest,
    SubscribeRequestParams,
    UnsubscribeRequest,
    UnsubscribeRequestParams,
)
from mcp_types.version import MODERN_PROTOCOL_VERSIONS

from pep.base.errors import UpstreamError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

    from mcp.client.session import ClientSession, IncomingMessage
    from mcp.shared.subscriptions import ServerEvent
    from mcp_types import SubscriptionFilter

OPENED_S: Final = 3.0
"""Ours: longest wait of a listener for the server's stream."""
AGAIN_S: Final = 5.0
"""Ours: pause before another attempt at a stream that ended."""
RESOURCES: Final = 1024
"""Ours: most resources that are followed at once."""


class ServerChanges:
    """Changes of one server.

    Args:
        session: gives that of the connection of all; waits for one.
        lost: waits for that connection's end.
    """

    def __init__(self, session: Callable[[], Awaitable[ClientSession]], lost: Callable[[], Awaitable[None]]) -> None:
        self._session = session
        self._lost = lost
        self._listeners: dict[object, tuple[SubscriptionFilter, Callable[[ServerEvent], None]]] = {}
        self._followed: frozenset[str] | None = None
        self._watched: frozenset[str] = frozenset()
        self._modern = True
        self._wants, self._opens = asyncio.Event(), asyncio.Event()
        self._following: asyncio.Task[None] | None = None

    @contextmanager
    def heard(self, wanted: SubscriptionFilter, told: Callable[[ServerEvent], None]) -> Iterator[None]:
        """While it lasts, a listener is told of the changes that it wants.

        Args:
            wanted: kinds of changes, and resources.
            told: is called with each; it may be called more often than there was a change.
        """
        key = object()
        self._listeners[key] = wanted, told
        self._wants.set()
        if self._following is None:
            self._following = asyncio.create_task(self._follow(), context=Context())
        try:
            yield
        finally:
            del self._listeners[key]
            self._wants.set()
            if not self._listeners:
                self._following.cancel()
                self._following = self._followed = None

    async def opened(self) -> None:
        """Waits until the server tells what its listeners want now; not for long, for a server that is not there."""
        with suppress(TimeoutError):
            async with asyncio.timeout(OPENED_S):
                while self._followed is None or not self._followed >= self._wanted():
                    self._opens.clear()
                    await self._opens.wait()

    async def noticed(self, message: IncomingMessage) -> None:
        """Takes a message that a server of the protocol before 2026-07-28 sends on its own."""
        # At a newer one they come by the stream below, and once more here.
        if not self._listeners or self._modern or isinstance(message, Exception):
            return
        said = message.model_dump(by_alias=True, mode="json", exclude_none=True)
        if (event := event_from_wire(said["method"], said.get("params"))) is not None:
            self._tell(event)

    def _wanted(self) -> frozenset[str]:
        """Resources of all listeners together."""
        uris = {uri for wanted, _ in self._listeners.values() for uri in wanted.resource_subscriptions or ()}
        return frozenset(sorted(uris)[:RESOURCES])

    def _tell(self, event: ServerEvent) -> None:
        for wanted, told in list(self._listeners.values()):
            if event_matches(wanted, frozenset(wanted.resource_subscriptions or ()), event):
                told(event)

    async def _follow(self) -> None:
        """Keeps a stream of the server open that has all that is wanted, until it is cancelled."""
        current: asyncio.Task[None] | None = None
        broken = False
        try:
            while True:
                self._wants.clear()
                wanted, opened = self._wanted(), asyncio.Event()
                fresh = asyncio.create_task(self._stream(wanted, opened))
                await _first(fresh, opened)
                if current is not None:
                    current.cancel()
                current = fresh
                if opened.is_set():
                    self._followed = wanted
                    self._opens.set()
                    if broken:
                        self._tell_all()
                    broken = False
                await _first(current, self._wants)
                if current.done():
                    broken, self._followed = True, None
                    await asyncio.sleep(AGAIN_S)
        finally:
            if current is not None:
                current.cancel()

    async def _stream(self, wanted: frozenset[str], opened: asyncio.Event) -> None:
        """One stream, until it ends; of a server that has none, as long as the connection."""
        with suppress(UpstreamError, SubscriptionLost, TimeoutError):
            session = await self._session()
            self._modern = session.protocol_version in MODERN_PROTOCOL_VERSIONS
            if not self._modern:
                await self._watch(session, wanted)
            elif await self._listened(session, wanted, opened):
                return
            opened.set()
            await self._lost()

    async def _listened(self, session: ClientSession, wanted: frozenset[str], opened: asyncio.Event) -> bool:
        """False where the server has no such stream."""
        try:
            async with listen(
                session,
                tools_list_changed=True,
                prompts_list_changed=True,
                resources_list_changed=True,
                resource_subscriptions=sorted(wanted),
            ) as changes:
                opened.set()
                async for event in changes:
                    self._tell(event)
        except MCPError as error:
            return error.code != METHOD_NOT_FOUND
        return True

    async def _watch(self, session: ClientSession, wanted: frozenset[str]) -> None:
        """Asks a server of the older protocol to tell of these resources."""
        for uri in wanted:
            with suppress(MCPError):
                await subscribed(session, uri)
        for uri in self._watched - wanted:
            with suppress(MCPError):
                await unsubscribed(session, uri)
        self._watched = wanted

    def _tell_all(self) -> None:
        for event in (ToolsListChanged(), PromptsListChanged(), ResourcesListChanged()):
            self._tell(event)
        for uri in self._wanted():
            self._tell(ResourceUpdated(uri))


async def subscribed(session: ClientSession, uri: str) -> EmptyResult:
    """Asks a server of the protocol before 2026-07-28 to tell of changes of a resource."""
    return await session.send_request(SubscribeRequest(params=SubscribeRequestParams(uri=uri)), EmptyResult)


async def unsubscribed(session: ClientSession, uri: str) -> EmptyResult:
    """Asks it to tell of them no more."""
    return await session.send_request(UnsubscribeRequest(params=UnsubscribeRequestParams(uri=uri)), EmptyResult)


async def _first(task: asyncio.Task[None], event: asyncio.Event) -> None:
    """Waits until the task is done or the event is there."""
    waiting = asyncio.create_task(event.wait())
    try:
        await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        waiting.cancel()
