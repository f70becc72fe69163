"""Place of a caller at the listener, as an ASGI extension: a listener that bounds strangers offers it.

What verifies callers says here for each request to whom it belongs. A listener without places offers nothing, and
nothing is said.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

EXTENSION: Final = "dev.ztpm.place"
"""Name of the extension in the ASGI scope."""


class CallerPlace(Protocol):
    """Place of one request's connection. The first claim of a request counts."""

    def proven(self, party: str) -> None:
        """Counts the connection among those of the party from now on, which strangers cannot push out."""
        ...

    def stopping(self) -> None:
        """Counts the connection among those that stop from now on."""
        ...


def proven(scope: Mapping[str, Any], party: str) -> None:
    """Claims the connection of that request for the party whose proof was verified."""
    if (place := _offered(scope)) is not None:
        place.proven(party)


def stopping(scope: Mapping[str, Any]) -> None:
    """Claims one of the places of stops for the connection of that request."""
    if (place := _offered(scope)) is not None:
        place.stopping()


def _offered(scope: Mapping[str, Any]) -> CallerPlace | None:
    place: CallerPlace | None = (scope.get("extensions") or {}).get(EXTENSION)
    return place
