"""Current trace of a process: the one module that knows OpenTelemetry. Without its SDK there are ids alone."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from opentelemetry import trace
from opentelemetry.context import Context
from opentelemetry.trace import NonRecordingSpan, SpanContext, SpanKind, TraceFlags

from capabilities.values import trace_context
from capabilities.values.trace_context import TraceIds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from opentelemetry.trace import Span

_TRACER: Final = trace.get_tracer("ztpm")


@contextmanager
def entered(name: str, caller: TraceIds | None, *, random: Callable[[int], bytes]) -> Iterator[Span]:
    """Span of a request that comes in: in its caller's trace, where that says one, else in a new one.

    Args:
        name: of the span.
        caller: ids that the caller sent.
        random: so many random bytes, for a new trace where no SDK makes one.
    """
    # What is current here is of another request, or of nobody.
    within = Context() if caller is None else trace.set_span_in_context(_remote(caller), Context())
    span = _TRACER.start_span(name, within, kind=SpanKind.SERVER)
    if not span.get_span_context().is_valid:
        span = _remote(trace_context.new(random))
    # An exception's message may hold a caller's text.
    with trace.use_span(span, end_on_exit=True, record_exception=False, set_status_on_exception=False):
        yield span


@contextmanager
def step(name: str, attributes: Mapping[str, str | int]) -> Iterator[Span]:
    """Span of a step of what is current."""
    with _TRACER.start_as_current_span(
        name, attributes=dict(attributes), record_exception=False, set_status_on_exception=False
    ) as span:
        yield span


@contextmanager
def begun(name: str, *, random: Callable[[int], bytes]) -> Iterator[Span]:
    """Span of work of our own: in the current trace, else in a new one."""
    with entered(name, None, random=random) if current() is None else step(name, {}) as span:
        yield span


@contextmanager
def rejoined(ids: TraceIds | None) -> Iterator[None]:
    """Inside, the trace of these ids is current: where a task of its own goes on with a request."""
    if ids is None or ids.trace_id == trace_id():
        yield
        return
    with trace.use_span(_remote(ids), end_on_exit=False, record_exception=False, set_status_on_exception=False):
        yield


def current() -> TraceIds | None:
    """Ids of the trace and span that are current; None outside of every request."""
    found = trace.get_current_span().get_span_context()
    if not found.is_valid:
        return None
    return TraceIds(trace.format_trace_id(found.trace_id), trace.format_span_id(found.span_id))


def trace_id() -> str | None:
    """Id of the current trace."""
    ids = current()
    return None if ids is None else ids.trace_id


def context() -> dict[str, str]:
    """Id of the current trace, for each line of the log; empty outside of every request."""
    ids = current()
    return {} if ids is None else {"trace_id": ids.trace_id}


def carried() -> dict[str, str]:
    """The header by which a request of ours goes on in the current trace; nothing outside of one."""
    ids = current()
    return {} if ids is None else {trace_context.HEADER: ids.header}


def _remote(ids: TraceIds) -> Span:
    return NonRecordingSpan(
        SpanContext(
            int(ids.trace_id, 16), int(ids.span_id, 16), is_remote=True, trace_flags=TraceFlags(TraceFlags.SAMPLED)
        )
    )
