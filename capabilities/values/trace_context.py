"""Trace context (W3C Trace Context 1, `traceparent`): ids of a trace as they travel, and the names in its spans.

What a caller sends is its own word: only ids of the right form are taken, and nothing is decided on them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

HEADER: Final = "traceparent"
"""Header, and key in the `_meta` of a request of MCP."""
TRACE_BYTES: Final = 16
SPAN_BYTES: Final = 8
"""Lengths of the ids (section 3.2.2)."""
_FORM: Final = re.compile(r"([0-9a-f]{2})-([0-9a-f]{32})-([0-9a-f]{16})-[0-9a-f]{2}(-.*)?")
_TRACE: Final = re.compile(r"[0-9a-f]{32}")
_NONE: Final = "0"
_VERSION: Final = "00"
_INVALID: Final = "ff"
_SAMPLED: Final = "01"

# Span and attribute names: all there are. None has "auth" or "session" in it: exporters scrub such values.
REQUEST: Final = "ztpm.request"
COMMAND: Final = "ztpm.command"
DECIDE: Final = "ztpm.decide"
EFFECT: Final = "ztpm.effect"
FORWARD: Final = "ztpm.forward"
CALL: Final = "ztpm.call"
"""Spans: a request at a door, a provider's command, a decision, an effect, a request passed on, a call.

A call is an agent's, with all its tries.
"""
ROUTE: Final = "http.route"
METHOD: Final = "http.request.method"
STATUS: Final = "http.response.status_code"
"""Attributes by the semantic conventions of HTTP, which are stable."""
RESULT: Final = "ztpm.result"
DECISION: Final = "ztpm.decision"
REASON: Final = "ztpm.reason"
PRIMITIVE: Final = "ztpm.primitive"
PIT: Final = "ztpm.pit"
OPERATION: Final = "ztpm.operation"
REQUEST_ID: Final = "ztpm.request_id"
"""Attributes of our own."""


@dataclass(frozen=True, slots=True)
class TraceIds:
    """Ids of a trace and of one span in it, lower-case hex, neither of them zero."""

    trace_id: str
    span_id: str

    @property
    def header(self) -> str:
        """The `traceparent` of these ids; sampled, as a receiver decides for itself."""
        return f"{_VERSION}-{self.trace_id}-{self.span_id}-{_SAMPLED}"


def read(text: object) -> TraceIds | None:
    """The ids of a `traceparent`, or None for anything that is not one.

    Flags and further parts are not taken: whether a span is kept is not the caller's to say.
    """
    if not isinstance(text, str) or (found := _FORM.fullmatch(text)) is None:
        return None
    version, trace_id, span_id, more = found.groups()
    if version == _INVALID or (version == _VERSION and more is not None):
        return None
    return TraceIds(trace_id, span_id) if trace_id.strip(_NONE) and span_id.strip(_NONE) else None


def is_trace_id(text: object) -> bool:
    """True for the id of a trace."""
    return isinstance(text, str) and _TRACE.fullmatch(text) is not None and bool(text.strip(_NONE))


def new(random: Callable[[int], bytes]) -> TraceIds:
    """Ids of a new trace.

    Args:
        random: so many random bytes.
    """
    trace_id, span_id = random(TRACE_BYTES).hex(), random(SPAN_BYTES).hex()
    # All zeros mean "none"; with 64 random bits that is never seen, and still no id.
    return TraceIds(
        trace_id if trace_id.strip(_NONE) else f"{1:032x}", span_id if span_id.strip(_NONE) else f"{1:016x}"
    )


def of(trace_id: str, random: Callable[[int], bytes]) -> TraceIds | None:
    """A new place in a trace that is known by its id alone; None where that is no id."""
    return TraceIds(trace_id, new(random).span_id) if is_trace_id(trace_id) else None
