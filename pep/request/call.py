"""Call: one request of a caller, with the credentials and the tool it came with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from policies.evidence.evidence import NOT_COLLECTED, NotCollected, ToolReading

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.base.operation_row import Operation
    from pep.base.ports import Readiness, RegisteredTool
    from pep.request.authority import Credentials
    from policies.evidence.content_readings import ContextReading
    from policies.evidence.model import Request


@dataclass(frozen=True, slots=True)
class Call:
    """One request with the shell's knowledge of it.

    Attributes:
        request: in integers.
        operation: of it.
        tool: as it is registered and as it is served now.
        credentials: the caller's credentials, after steps 1 to 10.
        arrived_ms: monotonic time of arrival.
        readiness: of the robot, for those who command it the way of this call; None without one.
        context: provenance of its parameters.
        renewed: gives the caller's credentials of now, where others may take the place of these while the request is
            carried out; None where none can.
    """

    request: Request
    operation: Operation
    tool: ToolReading
    credentials: Credentials
    arrived_ms: int
    readiness: Readiness | None
    context: ContextReading | NotCollected = NOT_COLLECTED
    renewed: Callable[[], Credentials] | None = None


def tool_reading(name: str, registered: RegisteredTool | None, actual_digest: str) -> ToolReading:
    """The tool of this name as it is registered for its own operation, and as it is now.

    Args:
        name: of the tool and its operation.
        registered: of the registry; None where it knows no such tool.
        actual_digest: of the definition now; "" where the tool is not there.
    """
    if registered is None or registered.operation != name:
        return ToolReading(name=name, approved_digest=None, actual_digest=actual_digest, base_tier=None)
    return ToolReading(
        name=name,
        approved_digest=registered.definition_digest,
        actual_digest=actual_digest,
        base_tier=registered.base_tier,
    )
