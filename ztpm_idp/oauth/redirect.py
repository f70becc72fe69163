"""Redirect URIs: which may be registered, and which one a request may name. Compared as texts, never by prefix."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode, urlsplit

if TYPE_CHECKING:
    from collections.abc import Collection

REDIRECT_BYTES: Final = 512
REDIRECTS: Final = 16
"""Most redirect URIs of one client."""
LOOPBACK: Final = frozenset({"127.0.0.1", "[::1]", "localhost"})
"""Hosts of a client on the person's own machine, where the operating system chooses the port (RFC 8252, 7.3)."""


def may_be_registered(uri: str) -> bool:
    """True for an https URI, or an http one of loopback, without fragment, user or odd character."""
    if not 1 <= len(uri) <= REDIRECT_BYTES or not uri.isascii() or any(not "!" <= each <= "~" for each in uri):
        return False
    if any(each in uri for each in '\\"<>^`{|}#'):
        return False
    try:
        parts = urlsplit(uri)
        _ = parts.port
    except ValueError:
        return False
    if "@" in parts.netloc or not parts.hostname:
        return False
    return parts.scheme == "https" or (parts.scheme == "http" and _host(parts.netloc) in LOOPBACK)


def is_one_of(uri: str, registered: Collection[str]) -> bool:
    """True for a URI that is registered, character by character; the port of a loopback one is free."""
    return uri in registered or (may_be_registered(uri) and _without_port(uri) in map(_without_port, registered))


def origin_of(uri: str) -> str:
    """Scheme and authority, for a page's `form-action` and for people."""
    parts = urlsplit(uri)
    return f"{parts.scheme}://{parts.netloc}"


def answered(uri: str, parameters: dict[str, str]) -> str:
    """The redirect URI with the parameters of an authorization response behind its own."""
    return f"{uri}{'&' if '?' in uri else '?'}{urlencode(parameters)}"


def _host(netloc: str) -> str:
    return netloc.rpartition(":")[0] if not netloc.endswith("]") and ":" in netloc else netloc


def _without_port(uri: str) -> str:
    """A loopback URI without its port, marked so that it equals no whole one; any other one as it is."""
    scheme, divider, rest = uri.partition("://")
    netloc, slash, path = rest.partition("/")
    if scheme != "http" or _host(netloc) not in LOOPBACK:
        return uri
    return f"loopback {scheme}{divider}{_host(netloc)}{slash}{path}"
