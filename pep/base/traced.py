"""Trace of a request in records and spans of enforcement points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities import tracing
from capabilities.values import trace_context

if TYPE_CHECKING:
    from opentelemetry.trace import Span

    from policies.evidence.model import Decision


def traced(body: dict[str, object]) -> dict[str, object]:
    """The body of a record, with the current trace."""
    found = tracing.trace_id()
    if found is not None:
        body["trace_id"] = found
    return body


def tell(span: Span, decision: Decision) -> None:
    """Attributes of a span that say how a request was decided."""
    span.set_attributes(
        {
            trace_context.DECISION: str(decision.effect),
            trace_context.REASON: str(decision.reason),
            trace_context.PRIMITIVE: decision.primitive,
            trace_context.REQUEST_ID: decision.request_id,
        }
    )
    if decision.tier is not None:
        span.set_attribute(trace_context.PIT, int(decision.tier))
