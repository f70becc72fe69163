"""Collector of traces: takes OTLP over HTTP, as any does, and keeps the spans."""

import contextlib
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import (
    ExportTraceServiceRequest,
    ExportTraceServiceResponse,
)


class Spans:
    """Spans that came, each with its service and attributes."""

    def __init__(self):
        self.came, self.url = [], ""

    def of(self, trace_id):
        return [span for span in list(self.came) if span["trace_id"] == trace_id]

    def take(self, raw):
        for resource in ExportTraceServiceRequest.FromString(raw).resource_spans:
            service = {each.key: each.value.string_value for each in resource.resource.attributes}["service.name"]
            for scope in resource.scope_spans:
                for span in scope.spans:
                    said = {each.key: each.value.string_value or each.value.int_value for each in span.attributes}
                    told = {"service": service, "name": span.name, "trace_id": span.trace_id.hex(), "said": said}
                    self.came.append(told | {"id": span.span_id.hex(), "parent": span.parent_span_id.hex()})


@contextlib.contextmanager
def collecting():
    """While it lasts, spans are taken at its `url`."""
    spans = Spans()

    class Taking(BaseHTTPRequestHandler):
        def do_POST(self):
            spans.take(self.rfile.read(int(self.headers["content-length"])))
            answer = ExportTraceServiceResponse().SerializeToString()
            self.send_response(200)
            self.send_header("content-length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Taking) as server:
        spans.url = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield spans
        finally:
            server.shutdown()
            thread.join(10)
