"""A collector of the cell's own spans: identity provider, tool server and gateway send them by OTLP over HTTP."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, Final

from google.protobuf.message import DecodeError
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

if TYPE_CHECKING:
    from pathlib import Path

    from opentelemetry.proto.common.v1.common_pb2 import AnyValue
    from opentelemetry.proto.trace.v1.trace_pb2 import ResourceSpans

BODY_BYTES: Final = 4_194_304
"""Largest batch of spans."""
ERROR: Final = 2
"""STATUS_CODE_ERROR of OTLP."""
DELAY_MS: Final = 200
"""Time after which a process sends its spans (`OTEL_BSP_SCHEDULE_DELAY`)."""


class Collector:
    """Listens on loopback, and adds every span as a JSON line of `cobot_claw.telemetry.SpanFile`'s form.

    Args:
        path: of the file.
        host: loopback address to listen at.
    """

    def __init__(self, path: Path, host: str) -> None:
        lock = threading.Lock()

        class Batches(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                """One batch."""
                size = int(self.headers.get("content-length") or 0)
                batch, status = ExportTraceServiceRequest(), 400
                if self.path == "/v1/traces" and 0 < size <= BODY_BYTES:
                    try:
                        batch.ParseFromString(self.rfile.read(size))
                        with lock, path.open("a", encoding="utf-8") as file:
                            file.writelines(json.dumps(row) + "\n" for row in rows_of(batch))
                        status = 200
                    except DecodeError:
                        pass
                self.send_response(status)
                self.send_header("content-length", "0")
                self.end_headers()

            def log_message(self, format: str, *args: Any) -> None:
                """Says nothing."""

        self._server = ThreadingHTTPServer((host, 0), Batches)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="collector", daemon=True)
        self._thread.start()

    @property
    def environment(self) -> dict[str, str]:
        """Variables by which a process of the cell sends its spans here (docs/operation.md)."""
        host, port = self._server.server_address[:2]
        return {
            "OTEL_EXPORTER_OTLP_ENDPOINT": f"http://{host!s}:{port}",
            "OTEL_BSP_SCHEDULE_DELAY": str(DELAY_MS),
        }

    def close(self) -> None:
        """Ends the collector."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def rows_of(batch: ExportTraceServiceRequest) -> list[dict[str, Any]]:
    """The spans of a batch, as `cobot_claw.telemetry.SpanFile` writes its own."""
    return [
        {
            "trace": span.trace_id.hex(),
            "span": span.span_id.hex(),
            "parent": span.parent_span_id.hex() or None,
            "name": span.name,
            "service": _service(resource),
            "start_ns": span.start_time_unix_nano,
            "end_ns": span.end_time_unix_nano,
            "attributes": {each.key: _plain(each.value) for each in span.attributes},
            "error": span.status.code == ERROR,
        }
        for resource in batch.resource_spans
        for scope in resource.scope_spans
        for span in scope.spans
    ]


def _service(resource: ResourceSpans) -> str:
    return next((str(a.value.string_value) for a in resource.resource.attributes if a.key == "service.name"), "")


def _plain(value: AnyValue) -> object:
    kind = value.WhichOneof("value")
    return None if kind is None or kind.endswith(("list_value", "array_value")) else getattr(value, kind)
