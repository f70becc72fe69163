"""Window and role in which a key of the identity provider is trusted. Clauses [TRB-1] to [TRB-3] in docs/spec.md."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import b64u, unb64u
from capabilities.values.errors import BadKeyError, FaultCode
from capabilities.values.form import Form, converted, plain, read

FOREVER: Final = 253_402_300_799
"""The last time that there is, seconds since the epoch (docs/spec.md 1.1)."""
KEYS_OF_A_ROLE: Final = 16
"""Most keys of one role: a rotation needs two, an overlap with a taint three."""


class Role(StrEnum):
    """Role of an identity provider's key: the statements that it may sign.

    The value is the member of the bundle. A key keeps its one role for ever.
    """

    ROOT = "roots"
    ATTESTER = "attesters"
    FEED = "feed"
    REGISTRY = "registry"
    LEDGER = "ledger"


@dataclass(frozen=True, slots=True)
class Window:
    """Time in which a key is trusted.

    Attributes:
        not_before, not_after: its signatures are accepted at `not_before <= t < not_after`, seconds since the epoch.
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
    """Standing of a key at one moment, for a text signed at another."""

    TRUSTED = "trusted"
    UNKNOWN = "no key of this bundle"
    NOT_YET = "not trusted yet"
    OVER = "no longer trusted"
    TAINTED = "tainted before it signed"


# --- as JSON [TRB-1] -------------------------------------------------------------------------------------------------


if TYPE_CHECKING:
    _Raw = bytes
else:
    _Raw = converted(bytes, lambda value: unb64u(read(str, value)))


class TrustedKey(Form, frozen=True):
    """A key and its window, as a bundle states them."""

    key: _Raw
    not_before: int
    not_after: int
    tainted_at: int | None

    @property
    def window(self) -> Window:
        """The window.

        Raises:
            BadKeyError: as `Window`.
        """
        return Window(self.not_before, self.not_after, self.tainted_at)


def entry(raw: bytes, window: Window) -> dict[str, object]:
    """The JSON object of a key and its window."""
    return {"key": b64u(raw), **plain(window)}
