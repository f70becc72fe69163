"""Redaction of the log: by the name of a member, and by the form of a text in any place.

It is a second net. Nothing of ours logs a secret; a library, or a line of tomorrow, may.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

REDACTED: Final = "[redacted]"
SECRET_WORDS: Final = frozenset(
    {
        "assertion", "authorization", "bearer", "biscuit", "body", "capability", "content", "cookie", "cookies",
        "credential", "credentials", "dpop", "jwt", "key", "passphrase", "password", "private", "proof", "pem",
        "secret", "signature", "ticket", "token", "tokens", "verifier",
    }
)  # fmt: skip
"""Words of a member's name by which no value of it is told."""
_WORDS: Final = re.compile(r"[^a-z0-9]+")
_DEPTH: Final = 6
"""Ours: depth to which members are looked at; what is deeper is not told."""
RUN: Final = 65
"""Characters of a run of base64 that may be a secret: a signature or token has more.

A SHA-256 in hex has 64, a thumbprint 43, the id of a trace 32.
"""
SHAPES: Final = (
    re.compile(r"-----BEGIN [^-]*-----.*?(?:-----END [^-]*-----|\Z)", re.DOTALL),
    re.compile(r"\b(?:set-)?cookie\s*[:=]\s*\S[^\r\n]*", re.IGNORECASE),
    re.compile(r"\b(?:dpop|bearer|basic)[\s:=]+(?!\[)[A-Za-z0-9._~+/=-]{8,}", re.IGNORECASE),
    re.compile(r"\beyJ[A-Za-z0-9_-]{5,}(?:\.[A-Za-z0-9_-]*){0,4}"),
    re.compile(rf"[A-Za-z0-9_+=-]{{{RUN},}}"),
)
"""Forms of secrets: PEM, cookies, an Authorization header's value, JWTs and signed statements, runs of base64."""


def redacted_text(text: str) -> str:
    """The text without what has the form of a secret."""
    for shape in SHAPES:
        text = shape.sub(REDACTED, text)
    return text


def redacted(value: Any, depth: int = _DEPTH) -> Any:
    """The value as it may be logged; bytes and what is no plain value are told by their type alone."""
    match value:
        case None | bool() | int() | float():
            return value
        case str():
            return redacted_text(value)
        case dict():
            if not depth:
                return REDACTED
            return {
                redacted_text(str(name)): REDACTED if _secret(str(name)) else redacted(inner, depth - 1)
                for name, inner in value.items()
            }
        case list() | tuple() | set() | frozenset():
            return [redacted(inner, depth - 1) for inner in value] if depth else REDACTED
        case _:
            return f"<{type(value).__name__}>"


def redact(_: object, __: str, event: MutableMapping[str, Any]) -> Mapping[str, Any]:
    """Processor of structlog: the event as it may be logged; members of the library's own begin with `_`."""
    own = {name: value for name, value in event.items() if name.startswith("_")}
    return {**own, **redacted({name: value for name, value in event.items() if name not in own})}


def _secret(name: str) -> bool:
    return not SECRET_WORDS.isdisjoint(_WORDS.split(name.lower()))
