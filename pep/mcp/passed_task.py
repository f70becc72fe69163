"""Handle of a task of the tasks extension (SEP-2663) that another server made, and the extension's names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

from mcp.client.extension import ClientExtension, ResultClaim
from mcp_types import Result
from pydantic import ConfigDict, Field

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mcp.client.extension import ClaimContext
    from mcp_types import CallToolResult

EXTENSION: Final = "io.modelcontextprotocol/tasks"
METHODS: Final = ("tasks/get", "tasks/update", "tasks/cancel")


class PassedTask(Result):
    """Handle of a task, whole.

    Attributes:
        upstream: name of the server whose task it is; it goes to nobody.
    """

    model_config = ConfigDict(extra="allow")
    result_type: Literal["task"] = Field(alias="resultType")
    task_id: str = Field(alias="taskId", max_length=256)
    ttl_ms: int | None = Field(default=None, alias="ttlMs")
    upstream: str = Field(default="", exclude=True)


class PassedTasks(ClientExtension):
    """The extension, for a client that passes handles on; it is declared where the caller's own client declares it."""

    identifier = EXTENSION

    def claims(self) -> Sequence[ResultClaim[Any]]:
        """The handle."""
        return [ResultClaim(result_type="task", model=PassedTask, resolve=self._unresolved)]

    async def _unresolved(self, task: PassedTask, ctx: ClaimContext) -> CallToolResult:  # noqa: ARG002 - the SDK's form
        raise RuntimeError("a handle is passed on as it is")
