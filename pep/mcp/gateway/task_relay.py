"""Tasks of servers behind this one, passed on: their handles, and the three methods about them.

A server that guards itself knows whose a task is. Of any other one the guard in front keeps that, and gives each task a
name of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mcp import MCPError
from mcp_types import INTERNAL_ERROR, Request, RequestParams, Result
from pydantic import ConfigDict, Field

from pep.base.errors import UpstreamError
from pep.mcp.passed_task import EXTENSION, METHODS
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from mcp.server.context import ServerRequestContext
    from mcp.server.lowlevel.server import Server

    from pep.mcp.gateway.upstream import ToolUpstream

    Context = ServerRequestContext[Any, Any]

ID_LENGTH: Final = 256
"""Ours: longest id of a task that is passed on."""


class PassedAnswer(Result):
    """Answer about a task, whole."""

    model_config = ConfigDict(extra="allow")


class PassedParams(RequestParams):
    """Parameters about a task, whole."""

    model_config = ConfigDict(extra="allow")
    task_id: str = Field(alias="taskId", max_length=ID_LENGTH)


class PassedRequest(Request[PassedParams, str]):
    """Request about a task."""

    name_param = "taskId"


async def ask(upstream: ToolUpstream, method: str, params: PassedParams) -> PassedAnswer:
    """Answer of a server about one of its tasks, asked once: a look may be an act.

    Raises:
        MCPError: it refuses, or does not answer.
    """
    asked = PassedRequest(method=method, params=params)
    try:
        return await upstream.once(lambda session: session.send_request(asked, PassedAnswer))
    except UpstreamError as error:
        raise MCPError(INTERNAL_ERROR, str(Reason.UPSTREAM_UNREACHABLE)) from error


def pass_on(server: Server[Any], upstream: ToolUpstream, meta: Callable[[Context], dict[str, Any]]) -> None:
    """Lets clients of a server look after the tasks of the one behind it, which knows whose they are.

    Args:
        server: in front.
        upstream: the one behind it.
        meta: members of `_meta` that go on.
    """

    async def passed(ctx: Context, params: PassedParams) -> PassedAnswer:
        sent: Any = meta(ctx) or None
        return await ask(upstream, ctx.method, params.model_copy(update={"meta": sent}))

    for method in METHODS:
        server.add_request_handler(method, PassedParams, passed)
    server.extensions[EXTENSION] = {}
