"""The tasks extension (SEP-2663) of a stock client: looked after by hand, or to the end."""

from __future__ import annotations

import asyncio
import time
from typing import Any, Literal

import mcp_types
from mcp.client.extension import ClientExtension, ResultClaim
from pydantic import Field

TASKS = "io.modelcontextprotocol/tasks"
OVER = {"completed", "failed", "cancelled"}


class Created(mcp_types.Result):
    result_type: Literal["task"] = Field(alias="resultType")
    task_id: str = Field(alias="taskId")
    status: str
    created_at: str = Field(alias="createdAt")
    last_updated_at: str = Field(alias="lastUpdatedAt")
    ttl_ms: int = Field(alias="ttlMs")
    poll_interval_ms: int = Field(alias="pollIntervalMs")


class Looked(Created):
    result_type: Literal["complete"] = Field(alias="resultType")
    status_message: str = Field(default="", alias="statusMessage")
    result: dict[str, Any] | None = None
    error: dict[str, Any] | None = None


class Named(mcp_types.RequestParams):
    task_id: str = Field(serialization_alias="taskId")
    input_responses: dict[str, Any] | None = Field(default=None, serialization_alias="inputResponses")


class Asked(mcp_types.Request[Named, str]):
    params: Named
    name_param = "taskId"


class Tasks(ClientExtension):
    """Each task is looked after until it is over; `seen` is told of it first."""

    identifier = TASKS

    def __init__(self, seen=lambda task: None, deadline_s=60.0):
        self.seen, self.deadline_s = seen, deadline_s

    def claims(self):
        return [ResultClaim(result_type="task", model=Created, resolve=self.resolve)]

    async def resolve(self, task, ctx):
        self.seen(task)
        over = await ended(ctx.session, task.task_id, self.deadline_s)
        if over.status != "completed":
            return mcp_types.CallToolResult(
                content=[mcp_types.TextContent(type="text", text=over.status)], is_error=True
            )
        return mcp_types.CallToolResult.model_validate(over.result)


async def look(session, task_id, method="tasks/get", **more):
    asked = Asked(method=method, params=Named(task_id=task_id, **more))
    return await session.send_request(asked, Looked if method == "tasks/get" else mcp_types.Result)


async def ended(session, task_id, deadline_s=60.0):
    """The task once it is over."""
    until = time.monotonic() + deadline_s
    while (looked := await look(session, task_id)).status not in OVER:
        assert time.monotonic() < until, looked
        await asyncio.sleep(0.1)
    return looked


async def begun(client, tool, arguments):
    """The task that a call becomes."""
    return await client.session.call_tool(tool, arguments, allow_claimed=True)
