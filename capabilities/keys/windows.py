"""For how long, and for what, a key of the identity provider is trusted. Clauses [TRB-1] to [TRB-3] in docs/spec.md."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Final

from capabilities.keys.keys import b64u, unb64u
from capabilities.values.errors import BadKeyError, FaultCode

FOREVER: Final = 253_402_300_799
"""The last time that there is, seconds since the epoch (docs/spec.md 1.1)."""
KEYS_OF_A_ROLE: Final = 16
"""Most keys of one role: a rotation needs two, an overlap with a taint three."""


class Role(StrEnum):
    """What a key of the identity provider may sign; the value is the member of the bundle. A key has one, for ever."""

    ROOT = "roots"
    ATTESTER = "attesters"
    FEED = "feed"
    REGISTRY = "registry"
    LEDGER = "ledger"


@dataclass(frozen=True, slots=True)
class Window:
    """For how long a key is trusted.

    Attributes:
        not_before, not_after: what it signed is accepted at `not_before <= t < not_after`, seconds since the epoch.
        tainted_at: nothing that it signed at or after this time is accepted; None: it is not tainted.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a window without a moment in it.
    """

    not_before: int = 0
    not_after: int = FOREVER
    tainted_at: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.not_before < self.not_after <= FOREVER or not 0 <= (self.tainted_at or 0) <= FOREVER:
            raise BadKeyError(FaultCode.KEY_MALFORMED, "a key that is trusted at no time")


class Standing(Enum):
    """How a key stands at one moment, for what it signed at another."""

    TRUSTED = "trusted"
    UNKNOWN = "no key of this bundle"
    NOT_YET = "not trusted yet"
    OVER = "no longer trusted"
    TAINTED = "tainted before it signed"


# --- as JSON [TRB-1] -------------------------------------------------------------------------------------------------


def entry(raw: bytes, window: Window) -> dict[str, object]:
    """The JSON object of a key and its window."""
    return {
        "key": b64u(raw),
        "not_before": window.not_before,
        "not_after": window.not_after,
        "tainted_at": window.tainted_at,
    }


def entry_of(value: object) -> tuple[bytes, Window]:
    """The key and window of their JSON object.

    Raises:
        BadKeyError: `KEY_MALFORMED` for other members or forms.
    """
    if not isinstance(value, dict) or value.keys() != {"key", "not_before", "not_after", "tainted_at"}:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a key with its window")
    spelled, tainted_at = value["key"], value["tainted_at"]
    if not isinstance(spelled, str):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a base64url text")
    return unb64u(spelled), Window(
        whole(value["not_before"]),
        whole(value["not_after"]),
        None if tainted_at is None else whole(tainted_at),
    )


def entries_of(value: object) -> dict[bytes, Window]:
    """The keys and windows of a JSON list of at most `KEYS_OF_A_ROLE`, each key once.

    Raises:
        BadKeyError: `KEY_MALFORMED` for anything else.
    """
    if not isinstance(value, list) or len(value) > KEYS_OF_A_ROLE:
        raise BadKeyError(FaultCode.KEY_MALFORMED, f"not a list of at most {KEYS_OF_A_ROLE} keys")
    found = dict(map(entry_of, value))
    if len(found) != len(value):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a key twice")
    return found


def whole(value: object) -> int:
    """The value, an integer.

    Raises:
        BadKeyError: `KEY_MALFORMED` for anything else.
    """
    if not isinstance(value, int) or isinstance(value, bool):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not an integer")
    return value
