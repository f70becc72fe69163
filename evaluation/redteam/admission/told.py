"""Answers of the admission point, and of the tools beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from evaluation.redteam.parts import Came, Effect


class ToolRefusedError(RuntimeError):
    """Call of a tool that was refused.

    Attributes:
        reason: code of the refusal.
    """

    def __init__(self, tool: str, reason: str) -> None:
        super().__init__(f"{tool}: {reason}")
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Told:
    """Answer of the admission point.

    Attributes:
        admitted: whether there is anything for the agent.
        reason: code of the refusal.
        value: that was admitted.
        items: contents of a retrieval, each as the point told it.
        sequence: of a row that was written.
    """

    admitted: bool
    reason: str = ""
    value: Any = None
    items: tuple[dict[str, Any], ...] = ()
    sequence: int = 0

    def came(self, point: str) -> Came:
        """Outcome of saying it, at that enforcement point."""
        return Came(Effect.DONE) if self.admitted else Came(Effect.DENIED, point, self.reason)


@dataclass(frozen=True, slots=True)
class Vouched:
    """Answer of a tool, with its enforcement point's word on the call that it answers.

    Attributes:
        value: structured content.
        response: the signed word.
        proof: name of the call's proof, hexadecimal.
        request: digest of the request.
        tool: name of the tool.
    """

    value: dict[str, Any]
    response: str
    proof: str
    request: str
    tool: str

    def question(self) -> dict[str, object]:
        """Question of `respond` about it."""
        return {
            "value": self.value,
            "response": self.response,
            "proof": self.proof,
            "request": self.request,
            "tool": self.tool,
        }
