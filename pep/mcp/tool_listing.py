"""Tools that a caller is shown: those that its token may use, each as a person approved it.

A tool that is not shown may still be called by its name; the gate refuses it. The list spares a model what it cannot
do, and tells a stranger nothing.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.chain import Chain
from pep.base.operation_row import OperationKind
from pep.mcp.tool_digest import definition_digest

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, Mapping

    from mcp.server.context import ServerRequestContext
    from mcp_types import ListToolsResult, PaginatedRequestParams, Tool

    from pep.base.operation_row import Operation
    from pep.base.ports import Registry
    from pep.request.authority import Credentials

    Context = ServerRequestContext[Any, Any]
    ListTools = Callable[[Context, PaginatedRequestParams], Awaitable[ListToolsResult]]

PRIVATE: Final = "private"
"""Scope of a list that no cache may give to another caller."""


def usable(operation: Operation, credentials: Credentials) -> bool:
    """True for a stop, and for an operation that the token grants and whose tier it reaches."""
    if operation.kind is OperationKind.STOP:
        return True
    if credentials.fault is not None or not isinstance(credentials.chain, Chain):
        return False
    scope = credentials.chain.leaf.scope
    return scope.find(operation.object, operation.name) is not None and operation.base_tier <= scope.ceiling


def shown(
    served: Iterable[Tool], credentials: Credentials, *, tools: Mapping[str, Operation], registry: Registry
) -> frozenset[str]:
    """Names of the tools to show a caller.

    Args:
        served: definitions as the server lists them now.
        credentials: of the caller.
        tools: operations of the tools that may be called, by name.
        registry: approved definitions.
    """
    listed = list(served)
    times = Counter(each.name for each in listed)
    return frozenset(
        each.name
        for each in listed
        if times[each.name] == 1
        and (operation := tools.get(each.name)) is not None
        and usable(operation, credentials)
        and (registered := registry.tool(each.name)) is not None
        and registered.definition_digest == definition_digest(each)
    )


class ShownTools:
    """Answer to `tools/list` of one of the SDK's servers.

    Args:
        own: the server's own answer.
        chosen: names of the tools that the caller of a request is shown, of those that are served.

    Attributes:
        own: the same.
    """

    def __init__(self, own: ListTools, chosen: Callable[[Context, Iterable[Tool]], frozenset[str]]) -> None:
        self.own = own
        self._chosen = chosen

    async def __call__(self, ctx: Context, params: PaginatedRequestParams) -> ListToolsResult:
        """The server's answer, with the tools of this caller alone; no cache may give it to another."""
        listed = await self.own(ctx, params)
        names = self._chosen(ctx, listed.tools)
        kept = [each for each in listed.tools if each.name in names]
        return listed.model_copy(update={"tools": kept, "cache_scope": PRIVATE})
