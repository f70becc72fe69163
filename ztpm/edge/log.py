"""Log of a process: JSON lines, or readable ones on a terminal; without secrets, and equal lines once a minute.

It is no audit: that is journal and ledger. A line may be lost, a record may not.
"""

from __future__ import annotations

import logging
import traceback
from typing import TYPE_CHECKING, Any, Final, TextIO

import structlog

from ztpm.edge.rare_log import OnceAMinute
from ztpm.edge.redaction import redact

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, MutableMapping

FRAMES: Final = 6
"""Ours: innermost frames of an exception that are told."""


def tell(
    stream: TextIO,
    *,
    context: Callable[[], Mapping[str, str]],
    accesses: str | None = None,
    level: int = logging.WARNING,
) -> None:
    """Every logger of the process writes to the stream from now on.

    Args:
        stream: standard error.
        context: ids of request and trace, as they are current.
        accesses: logger whose lines are all told, from INFO on: it has one for each request. None: there is none.
        level: least level of the others.
    """
    formatter = _formatter(stream, context)
    root = logging.getLogger()
    for before in root.handlers[:]:
        root.removeHandler(before)
    rarely = logging.StreamHandler(stream)
    rarely.setFormatter(formatter)
    rarely.addFilter(OnceAMinute())
    root.addHandler(rarely)
    root.setLevel(level)
    if accesses is not None:
        always, log = logging.StreamHandler(stream), logging.getLogger(accesses)
        always.setFormatter(formatter)
        log.handlers, log.propagate = [always], False
        log.setLevel(logging.INFO)


def _formatter(stream: TextIO, context: Callable[[], Mapping[str, str]]) -> logging.Formatter:
    def placed(_: object, __: str, event: MutableMapping[str, Any]) -> Mapping[str, Any]:
        return {**event, **context()}

    renderer = structlog.dev.ConsoleRenderer() if stream.isatty() else structlog.processors.JSONRenderer()
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[
            structlog.stdlib.add_log_level,
            structlog.stdlib.add_logger_name,
            structlog.stdlib.ExtraAdder(),
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            placed,
            _without_message,
            redact,
        ],
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
    )


def _without_message(_: object, __: str, event: MutableMapping[str, Any]) -> Mapping[str, Any]:
    """An exception by its type and place: its message may hold a caller's text."""
    raised = event.pop("exc_info", None)
    error = raised[1] if isinstance(raised, tuple) else raised
    if isinstance(error, BaseException):
        frames = traceback.extract_tb(error.__traceback__)[-FRAMES:]
        event["error"] = type(error).__name__
        event["at"] = [f"{frame.filename}:{frame.lineno}" for frame in reversed(frames)]
    return event
