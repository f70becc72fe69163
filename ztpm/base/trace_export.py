"""Export of traces to a collector, when the standard variables of OpenTelemetry ask for it, and only then."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from ztpm.codes.unavailable import UnavailableError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ENDPOINTS: Final = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")
"""Variables that ask for it; the first that is there counts (OTLP exporter configuration)."""
PROTOCOLS: Final = ("OTEL_EXPORTER_OTLP_TRACES_PROTOCOL", "OTEL_EXPORTER_OTLP_PROTOCOL")
OURS: Final = "http/protobuf"
END_MS: Final = 2_000
"""Ours: longest wait at the end of the process for spans that are still to be sent."""
CODE: Final = "TRACES_UNUSABLE"


@contextmanager
def exporting(service: str, environment: Mapping[str, str]) -> Iterator[None]:
    """Spans of this process are sent while it lasts, where the environment asks for it.

    A collector that is away costs spans and nothing else: they wait in a bounded queue, in a thread of their own.

    Args:
        service: name of the process, unless OTEL_SERVICE_NAME says another.
        environment: of the process.

    Raises:
        UnavailableError: `TRACES_UNUSABLE`: it is asked for, and cannot be had.
    """
    name = next((each for each in ENDPOINTS if environment.get(each)), None)
    if name is None:
        yield
        return
    parts = urlsplit(environment[name])
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        raise UnavailableError(CODE, f"{name}: not an HTTP URL")
    protocol = next((found for each in PROTOCOLS if (found := environment.get(each))), OURS)
    if protocol != OURS:
        raise UnavailableError(CODE, f"{PROTOCOLS[1]}: {protocol[:32]}: traces go by {OURS}")
    try:
        import requests
        from opentelemetry import trace
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import SERVICE_NAME, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError as error:
        raise UnavailableError(CODE, f"{name} is set, and the extra `otel` is not installed: {error.name}") from None
    straight = requests.Session()
    straight.trust_env = False  # as everywhere here: no proxy and no password of the environment
    stated = {SERVICE_NAME: environment.get("OTEL_SERVICE_NAME") or service}
    provider = TracerProvider(resource=Resource.create(stated), shutdown_on_exit=False)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(session=straight)))
    trace.set_tracer_provider(provider)
    try:
        yield
    finally:
        provider.force_flush(END_MS)
