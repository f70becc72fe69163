"""Export of traces to a collector, when the standard variables of OpenTelemetry ask for it, and only then."""

from __future__ import annotations

from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from ztpm.codes.unavailable import UnavailableError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ENDPOINTS: Final = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")
"""Variables that ask for it; the first that is there counts (OTLP exporter configuration)."""
PROTOCOLS: Final = ("OTEL_EXPORTER_OTLP_TRACES_PROTOCOL", "OTEL_EXPORTER_OTLP_PROTOCOL")
OURS: Final = "http/protobuf"
EXTRA: Final = ("opentelemetry.sdk.trace", "opentelemetry.exporter.otlp.proto.http.trace_exporter")
"""Modules of the extra `otel`."""
END_MS: Final = 2_000
"""Ours: longest wait at the end of the process for spans that are still to be sent."""
CODE: Final = "TRACES_UNUSABLE"


def endpoint(environment: Mapping[str, str]) -> str | None:
    """The collector that the environment names, where this installation can send to it; None: no traces are sent.

    Args:
        environment: of the process.

    Raises:
        UnavailableError: `TRACES_UNUSABLE`: it is asked for, and cannot be had.
    """
    name = next((each for each in ENDPOINTS if environment.get(each)), None)
    if name is None:
        return None
    url = environment[name]
    try:
        parts = urlsplit(url)
        fit = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        fit = False
    if not fit:
        raise UnavailableError(CODE, f"{name}: not an HTTP URL")
    protocol = next((found for each in PROTOCOLS if (found := environment.get(each))), OURS)
    if protocol != OURS:
        raise UnavailableError(CODE, f"{PROTOCOLS[1]}: {protocol[:32]}: traces go by {OURS}")
    try:
        absent = next((each for each in EXTRA if find_spec(each) is None), None)
    except ModuleNotFoundError as error:
        absent = error.name
    if absent is not None:
        raise UnavailableError(CODE, f"{name} is set, and the extra `otel` is not installed: no {absent}")
    return url


@contextmanager
def exporting(service: str, environment: Mapping[str, str]) -> Iterator[None]:
    """Spans of this process are sent while it lasts, where the environment asks for it.

    A collector that is away costs spans and nothing else: they wait in a bounded queue, in a thread of their own.

    Args:
        service: name of the process, unless OTEL_SERVICE_NAME says another.
        environment: of the process, from which the SDK itself reads too.

    Raises:
        UnavailableError: as `endpoint`.
    """
    if endpoint(environment) is None:
        yield
        return
    import requests
    from opentelemetry import trace
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import SERVICE_NAME, Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

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
