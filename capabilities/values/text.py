"""Text that may stand in a token or statement: closed grammars, so that two readers never see two different words.

Values are bound into Datalog and JSON, never formatted, so injection is stopped without these rules. They stop
look-alikes: two names that a person or a database would take for one, control and bidirectional characters, and one
address spelled in several ways.
"""

from __future__ import annotations

import functools
import re
import unicodedata
from ipaddress import IPv4Address, IPv6Address
from typing import TYPE_CHECKING, Final, cast
from urllib.parse import unquote_to_bytes, urlsplit

from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.invisible import INVISIBLE
from capabilities.values.units import Sort

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from capabilities.values.units import Kind

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:@/|+=~%-]*", re.ASCII)
REGISTERED: Final = r"^[a-z0-9][a-z0-9._-]{0,62}$"
"""Id of a registered party: lower-case ASCII, so that two ids that look alike are alike."""
OPERATION: Final = r"^[A-Za-z][A-Za-z0-9_.-]{0,62}$"
"""Name of a registered tool or operation."""
_HOST: Final = re.compile(r"[a-z0-9][a-z0-9.-]*|\[[0-9a-f:.]+\]", re.ASCII)
_PATH: Final = re.compile(r"(/[A-Za-z0-9._~:@+=,%-]+)*", re.ASCII)
_SCHEME: Final = re.compile(r"[a-z][a-z0-9+.-]*", re.ASCII)
_DEFAULT_PORT: Final = {"http": 80, "https": 443}
_OTHER_DEFAULT_PORT: Final = {"ws": 80, "wss": 443, "ftp": 21}
_LABELS: Final = re.compile(r"[a-z0-9]([a-z0-9-]*[a-z0-9])?(\.[a-z0-9]([a-z0-9-]*[a-z0-9])?)*", re.ASCII)
_NUMBER: Final = re.compile(r"[0-9]+|0x[0-9a-f]*", re.ASCII)
"""Last label of a host that a reader takes for an IPv4 address (WHATWG URL, "ends in a number")."""
_ESCAPE: Final = re.compile(r"%([0-9A-F]{2})", re.ASCII)
_NEEDLESS: Final = re.compile(r"[A-Za-z0-9._~:@+=,/\\%-]", re.ASCII)
"""Signs that a URL's segment spells plainly, and slash, backslash and percent sign, which have no one spelling."""
_ESCAPED_PART: Final = re.compile(r"%(2[eEfF]|5[cC]|00)", re.ASCII)
"""Spelling of a dot, slash, backslash or NUL for readers that decode a path."""
_HIDDEN: Final = frozenset({"Cc", "Cf", "Co", "Cn", "Cs", "Zl", "Zp"})
"""Unicode categories that no reader sees, beside `INVISIBLE`: controls, formats, private, unassigned, surrogates."""

_TRUST_DOMAIN: Final = re.compile(r"[a-z0-9._-]{1,255}", re.ASCII)
_WORKLOAD_ID: Final = re.compile(r"spiffe://[a-z0-9._-]{1,255}(/(?!\.{1,2}(/|\Z))[A-Za-z0-9._-]+)+", re.ASCII)
"""SPIFFE ID section 2: trust domain, then at least one segment, none of them `.` or `..`."""
_ACCOUNT_ID: Final = re.compile(
    r"k8s://[a-z0-9._-]{1,255}/[a-z0-9]([a-z0-9-]*[a-z0-9])?/[a-z0-9]([a-z0-9.-]*[a-z0-9])?"
)
"""Cluster, namespace (a DNS label) and service account (a DNS subdomain), as Kubernetes names them."""
WORKLOAD_BYTES: Final = 256
"""Longest workload id (as `Caps.text_bytes`; SPIFFE ID section 2.3 allows 2048)."""
THUMBPRINT: Final = re.compile(r"[A-Za-z0-9_-]{42}[AEIMQUYcgkosw048]", re.ASCII)
"""A SHA-256 in base64url, as RFC 7638 writes it: the last character has four bits."""
TOKEN_ID: Final = re.compile(r"[A-Za-z0-9_-]{21}[AQgw]", re.ASCII)
"""16 bytes in base64url: the last character has two bits."""

ROLE_PREFIX: Final = "role:"
"""Starts a delegate entry that names a role; no agent id may start so."""


def name(value: object, *, most_bytes: int) -> str:
    """The value, an identifier: ASCII letters, digits and ``._:@/|+=~%-``, a letter or digit first.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    names((value,), most_bytes=most_bytes)
    return cast("str", value)


def names(values: Iterable[object], *, most_bytes: int) -> None:
    """Checks that each value is a name (see `name`).

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    for value in values:
        if not isinstance(value, str) or len(value) > most_bytes or NAME.fullmatch(value) is None:
            raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a name")


def agent_id(value: object, *, most_bytes: int) -> str:
    """The value, a name that is not taken for a role.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    agent = name(value, most_bytes=most_bytes)
    if agent.startswith(ROLE_PREFIX):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "an agent id must not start with 'role:'")
    return agent


def delegate(value: object, *, most_bytes: int) -> str:
    """The value, an agent id, or ``role:`` and the name of a role.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    entry = name(value, most_bytes=most_bytes)
    if entry.startswith(ROLE_PREFIX):
        name(entry.removeprefix(ROLE_PREFIX), most_bytes=most_bytes)
    return entry


def is_trust_domain(value: object) -> bool:
    """True where the value is the name of a SPIFFE trust domain."""
    return isinstance(value, str) and _TRUST_DOMAIN.fullmatch(value) is not None


def workload_id(value: object) -> str:
    """The value, a workload's SPIFFE ID or a service account of a cluster, of at most `WORKLOAD_BYTES`.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    if not isinstance(value, str) or len(value) > WORKLOAD_BYTES:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a workload id")
    if _WORKLOAD_ID.fullmatch(value) is None and _ACCOUNT_ID.fullmatch(value) is None:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a workload id")
    return value


def url(value: object, *, most_bytes: int) -> str:
    """The value, a URL in its one canonical spelling.

    Lower-case scheme and host, no user, no default port, no query, no fragment, no trailing slash, no dot segments,
    ASCII.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    if not isinstance(value, str) or len(value) > most_bytes or not _is_url(value):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a canonical URL")
    return value


@functools.lru_cache(maxsize=1_024)  # servers are few
def _is_url(value: str) -> bool:
    try:
        parts = urlsplit(value)
        host, port = parts.hostname or "", parts.port
    except ValueError:
        return False
    shown_host = f"[{host}]" if ":" in host else host
    respelled = f"{parts.scheme}://{shown_host}{'' if port is None else f':{port}'}{parts.path}"
    return (
        value.isascii()
        and respelled == value
        and _SCHEME.fullmatch(parts.scheme) is not None
        and _HOST.fullmatch(shown_host) is not None
        and not shown_host.endswith(".")
        and _PATH.fullmatch(parts.path) is not None
        and not any(segment in {".", ".."} for segment in parts.path.split("/"))
        and (port is None or 0 < port != _DEFAULT_PORT.get(parts.scheme))
    )


def prose(value: object, *, most_bytes: int) -> str:
    """The value, a sentence for people: Unicode in normal form C, nothing invisible, at most `most_bytes` of UTF-8.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    if not isinstance(value, str) or len(value) > most_bytes:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a text, or too long")
    if value.isascii() and value.isprintable():
        return value
    if any(each in INVISIBLE or unicodedata.category(each) in _HIDDEN for each in value):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "text with invisible characters")
    if not unicodedata.is_normalized("NFC", value) or len(value.encode()) > most_bytes:
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "text not in normal form C, or too long")
    return value


def path(value: object, *, most_bytes: int) -> str:
    """The value, an absolute path in its one spelling: a text whose components are none of "", `.` and `..`.

    It begins with a slash and ends with none but for `/` itself; no backslash, no percent-encoded dot, slash,
    backslash or NUL.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    spelled = prose(value, most_bytes=most_bytes)
    first, *components = spelled.split("/")
    if (
        first
        or not components
        or (spelled != "/" and any(each in {"", ".", ".."} for each in components))
        or "\\" in spelled
        or _ESCAPED_PART.search(spelled)
    ):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a canonical path")
    return spelled


def address(value: object, *, most_bytes: int) -> str:
    """The value, a URL as of `url` that has no second spelling for any reader.

    Its host is of labels, an IPv4 address of four decimals, or an IPv6 address of RFC 5952 without an IPv4 part; a
    percent-encoding is upper-case, of a character that needs one, and decodes to canonical text.

    Raises:
        ScopeError: `STATEMENT_MALFORMED` otherwise.
    """
    spelled = url(value, most_bytes=most_bytes)
    parts = urlsplit(spelled)
    if (
        not _is_host(parts.hostname or "")
        or parts.port == _OTHER_DEFAULT_PORT.get(parts.scheme, 0)
        or ("%" in parts.path and not _is_escaped(parts.path, most_bytes))
    ):
        raise ScopeError(FaultCode.STATEMENT_MALFORMED, "not a canonical URL of a parameter")
    return spelled


def _is_host(host: str) -> bool:
    if ":" in host:
        try:
            at = IPv6Address(host)
        except ValueError:
            return False
        return at.ipv4_mapped is None and host == _compressed(at)
    if _NUMBER.fullmatch(host.rpartition(".")[2]):
        try:
            return str(IPv4Address(host)) == host
        except ValueError:
            return False
    return _LABELS.fullmatch(host) is not None


def _compressed(at: IPv6Address) -> str:
    """RFC 5952, in hexadecimal alone: the first of the longest runs of two or more zeros is left out."""
    groups = [f"{int.from_bytes(at.packed[i : i + 2], 'big'):x}" for i in range(0, 16, 2)]
    spelled = ":".join(groups)
    for length in range(8, 1, -1):
        found = re.search(rf"(^|:)0(:0){{{length - 1}}}(:|$)", spelled)
        if found is not None:
            return f"{spelled[: found.start()]}::{spelled[found.end() :]}"
    return spelled


def _is_escaped(spelled: str, most_bytes: int) -> bool:
    escapes = _ESCAPE.findall(spelled)
    if len(escapes) != spelled.count("%") or any(_NEEDLESS.fullmatch(chr(int(each, 16))) for each in escapes):
        return False
    try:
        prose(unquote_to_bytes(spelled).decode(), most_bytes=most_bytes)
    except (UnicodeDecodeError, ScopeError):
        return False
    return True


WORD: Final[dict[Kind, Callable[..., str]]] = {Sort.TEXT: prose, Sort.PATH: path, Sort.URL: address}
"""Grammar of the words of each kind that has words."""
