"""Results that tell a decision: the tool's own with what was decided, or a denial or deferral in its place."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from mcp_types import CallToolResult, TextContent

from pep.base.errors import JournalError
from pep.gate import records
from pep.gate.gate import EffectResult
from pep.gate.observe_only import OBSERVED
from pep.mcp import deferred_result
from pep.mcp.passed_task import PassedTask
from policies.evidence.model import Effect
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from mcp.server.context import HandlerResult

    from pep.base.ports import Clock
    from pep.gate.gate import GateResult
    from pep.request.authority import Credentials
    from pep.request.edge import Edge
    from policies.evidence.evidence import ToolReading

DECISION_META: Final = "dev.ztpm/decision"
"""Key in a result's `_meta` under which the decision stands, also for a PERMIT."""


class DeniedCalls:
    """Denials before there was a request to decide, each on record.

    Args:
        edge: takes records; the gate.
        clock: both clocks.
    """

    def __init__(self, edge: Edge, clock: Clock) -> None:
        self._edge = edge
        self._clock = clock

    async def deny(
        self, reason: Reason, primitive: str, credentials: Credentials, where: dict[str, object]
    ) -> CallToolResult:
        """The denial for the caller, once it is on record.

        Args:
            reason: the code.
            primitive: id of the one that denies, or "".
            credentials: as far as they were verified.
            where: known parts of the call.
        """
        body = records.refusal(
            at=self._clock.wall_s(),
            at_ms=self._clock.monotonic_ms(),
            reason=reason,
            status=200,
            credentials=credentials,
            where={**where, "primitive": primitive},
        )
        try:
            await self._edge.record("refusal", body)
        except JournalError:
            reason = Reason.RECORD_FAILED
        detail = {k: v for k, v in where.items() if k in {"argument", "detail"} and v and credentials.fault is None}
        told = {**detail, "decision": "DENY", "reason": str(reason), "primitive": primitive, "tier": None}
        return denied(told | _remedy(reason, detail))


def told_result(answer: GateResult, *, tool: ToolReading, rounded: Mapping[str, Any]) -> HandlerResult:
    """Result for the holder: its own, or the reason of a denial with what would be permitted.

    Args:
        answer: of the gate.
        tool: as it is registered and was served.
        rounded: arguments that were decided as other numbers than the given ones.
    """
    decision = answer.decision
    detail = decision.findings[0].detail if decision.findings else {}
    told = records.told(decision)
    if decision.index is not None:
        told["index_milli"] = decision.index
    if rounded:
        told["rounded"] = dict(rounded)
    if not answer.recorded:
        told["outcome_recorded"] = False
    if answer.observed:
        told[OBSERVED] = True
    if (decision.effect is Effect.PERMIT or answer.observed) and answer.result is not None:
        # The response is that to this very request, of the tool as it was approved.
        told |= {"request_digest": decision.request_digest, "tool_digest": tool.approved_digest}
        return with_meta(answer.result.carried, {DECISION_META: told})
    if answer.ask is not None:
        told |= deferred_result.told(answer)
    return denied(told | _remedy(decision.reason, detail))


def denied(told: dict[str, object]) -> CallToolResult:
    """Result in place of the tool's: a text for models to read, the same in `_meta` for programs.

    Structured content has the form that the tool declares, and many clients hold an error against that, too.
    """
    return CallToolResult(
        is_error=True, content=[TextContent(type="text", text=json.dumps(told))], _meta={DECISION_META: told}
    )


def with_meta(outcome: HandlerResult, members: Mapping[str, object]) -> HandlerResult:
    """The result with these members of `_meta` besides its own."""
    if not isinstance(outcome, CallToolResult | PassedTask):
        return outcome
    return outcome.model_copy(update={"meta": {**(outcome.meta or {}), **members}})


def untold(outcome: HandlerResult) -> HandlerResult:
    """Result of a stop for a stranger: it says that the arm stopped, not where it is."""
    if not isinstance(outcome, CallToolResult) or not isinstance(outcome.structured_content, dict):
        return outcome
    told = {**outcome.structured_content, "q_rad": [], "reason": ""}
    return outcome.model_copy(
        update={"structured_content": told, "content": [TextContent(type="text", text=json.dumps(told))]}
    )


def effect_of(outcome: HandlerResult) -> EffectResult:
    """Report of a tool's effect out of its result; a server's own task is known to have begun."""
    if isinstance(outcome, PassedTask):
        return EffectResult(value={"task": "begun"}, carried=outcome)
    if not isinstance(outcome, CallToolResult):
        return EffectResult(value={}, carried=outcome, failed=True)
    content = outcome.structured_content
    return EffectResult(
        value=content if isinstance(content, dict) else {}, carried=outcome, failed=bool(outcome.is_error)
    )


def _remedy(reason: Reason, detail: Mapping[str, object]) -> dict[str, object]:
    """Remedy for the caller, where the finding itself names none."""
    return {} if "remedy" in detail else {"remedy": REASONS[reason].remedy}
