"""Spans of every process in one trace, to a file of the run, and to Logfire on request."""

from __future__ import annotations

import json
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from opentelemetry import context as current
from opentelemetry import propagate, trace
from opentelemetry.sdk.trace.export import SimpleSpanProcessor, SpanExporter, SpanExportResult

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from opentelemetry.sdk.trace import ReadableSpan
    from opentelemetry.trace import Span

_TRACER: Final = trace.get_tracer("cobot_claw")


class SpanFile(SpanExporter):
    """Spans as JSON lines: trace, id, parent, name, service, start and end in nanoseconds, attributes, error.

    Args:
        path: of the file; lines are added to it.
        service: name of this process.
    """

    def __init__(self, path: Path, service: str) -> None:
        self._path = path
        self._service = service
        self._lock = threading.Lock()

    def export(self, spans: Sequence[ReadableSpan]) -> SpanExportResult:
        """The spans are in the file."""
        lines = [json.dumps(self._plain(span), default=str) + "\n" for span in spans]
        with self._lock, self._path.open("a", encoding="utf-8") as file:
            file.writelines(lines)
        return SpanExportResult.SUCCESS

    def _plain(self, span: ReadableSpan) -> dict[str, object]:
        here = span.get_span_context()
        assert here is not None
        return {
            "trace": f"{here.trace_id:032x}",
            "span": f"{here.span_id:016x}",
            "parent": None if span.parent is None else f"{span.parent.span_id:016x}",
            "name": span.name,
            "service": self._service,
            "start_ns": span.start_time,
            "end_ns": span.end_time,
            "attributes": dict(span.attributes or {}),
            "error": not span.status.is_ok,
        }


def begin(service: str, path: Path) -> None:
    """Spans of this process go to the file from now on, and to Logfire where `LOGFIRE_TOKEN` is set.

    Args:
        service: name of this process.
        path: of the file.
    """
    import logfire

    logfire.configure(
        send_to_logfire="if-token-present",
        service_name=f"cobot-claw-{service}",
        console=False,
        inspect_arguments=False,
        distributed_tracing=True,
        additional_span_processors=[SimpleSpanProcessor(SpanFile(path, service))],
        metrics=False,
    )


def traced(name: str, **attributes: str) -> AbstractContextManager[Span]:
    """A span around a block; attributes are put under `claw.`."""
    return _TRACER.start_as_current_span(name, attributes={f"claw.{key}": value for key, value in attributes.items()})


def carried() -> dict[str, str]:
    """Headers that carry the trace to another process (W3C Trace Context)."""
    headers: dict[str, str] = {}
    propagate.inject(headers)
    return headers


@contextmanager
def within_trace(headers: Mapping[str, str]) -> Iterator[None]:
    """Spans made within belong to the trace that the headers of a request name."""
    token = current.attach(propagate.extract(dict(headers)))
    try:
        yield
    finally:
        current.detach(token)
