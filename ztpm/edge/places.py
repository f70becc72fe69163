"""Places of connections at one listener: who has how many, and who goes when there are no more.

A connection is a stranger's until its caller is proven. Strangers share places by address, known callers have theirs by
party, and stops have some of their own; the three never take each other's. The oldest silent connection goes first:
that of the owner who has too many, else that of the owner who has most.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import Enum
from ipaddress import ip_address
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Callable

RESERVE: Final = 128
"""Descriptors that are no caller's: files, the database, connections of our own, and some accepted at once."""
GRACE_S: Final = 0.1
"""Time that every stranger has to say something, however many of its address follow: those are hung up on meanwhile.

It also bounds what one address can cost: so many connections in that time, and a bare close for each of the others.
"""
SITE_BITS: Final = 64  # RFC 6177: one site has at least the whole lower half of an IPv6 address


class Standing(Enum):
    """Standing of a connection."""

    STRANGER = "stranger"
    STOP = "stop"
    PARTY = "party"


@dataclass(frozen=True, slots=True)
class Bounds:
    """Most connections of each standing, and of one owner among them.

    Attributes:
        strangers, by_address: of callers who have proven nothing; a newcomer of a crowded address keeps its place for
            as long as that many others take to follow.
        stops, stops_by_address: of callers who only stop.
        parties, by_party: of proven callers.
    """

    strangers: int = 512
    by_address: int = 128
    stops: int = 64
    stops_by_address: int = 16
    parties: int = 256
    by_party: int = 32

    @property
    def whole(self) -> int:
        """Most connections at once."""
        return self.strangers + self.stops + self.parties

    def within(self, descriptors: int) -> Self:
        """The same bounds, or such in the same proportion that so many descriptors suffice for."""
        share = min(1.0, max(0, descriptors - RESERVE) / self.whole)
        return type(self)(*(max(1, int(most * share)) for most in (
            self.strangers, self.by_address, self.stops, self.stops_by_address, self.parties, self.by_party,
        )))  # fmt: skip


class ConnectionPlace:
    """Place of one connection. Made by `Places.take`.

    Attributes:
        standing, owner: the owner whose place it is.
        busy: true while a whole request of it is answered; else it is silent.
        since_s: time since which it is so.
        end: ends the connection at once.
    """

    __slots__ = ("busy", "end", "owner", "since_s", "standing")

    def __init__(self, standing: Standing, owner: str, end: Callable[[], None], since_s: float) -> None:
        self.standing = standing
        self.owner = owner
        self.end = end
        self.busy = False
        self.since_s = since_s


class _Owned:
    """Places of one owner, in the order in which they fell silent or became busy."""

    __slots__ = ("busy", "silent")

    def __init__(self) -> None:
        self.silent: dict[ConnectionPlace, None] = {}
        self.busy: dict[ConnectionPlace, None] = {}

    def __len__(self) -> int:
        return len(self.silent) + len(self.busy)

    def row(self, place: ConnectionPlace) -> dict[ConnectionPlace, None]:
        return self.busy if place.busy else self.silent

    def oldest(self, *, but: ConnectionPlace) -> ConnectionPlace | None:
        return next((place for row in (self.silent, self.busy) for place in row if place is not but), None)


class Places:
    """All places of one listener.

    Args:
        bounds: most connections.
        now: monotonic clock, seconds.

    Attributes:
        ended: connections that had to make room or found none, since the start.
    """

    def __init__(self, bounds: Bounds, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._bounds = {
            Standing.STRANGER: (bounds.strangers, bounds.by_address),
            Standing.STOP: (bounds.stops, bounds.stops_by_address),
            Standing.PARTY: (bounds.parties, bounds.by_party),
        }
        self._owners: dict[Standing, dict[str, _Owned]] = {standing: {} for standing in Standing}
        self._counts = dict.fromkeys(Standing, 0)
        self.ended = 0

    def __len__(self) -> int:
        return sum(self._counts.values())

    def take(self, address: str, end: Callable[[], None]) -> ConnectionPlace | None:
        """Place for a connection that begins; the oldest silent one ends for it where there is none left.

        None while its address has all its places, and each for less than `GRACE_S`.

        Args:
            address: of the caller.
            end: ends the connection at once; may be replaced in the place.
        """
        now_s, site = self._now(), _site(address)
        own = self._owners[Standing.STRANGER].get(site)
        if own is not None and len(own) >= self._bounds[Standing.STRANGER][1]:
            oldest = own.oldest(but=_NOBODY)
            if oldest is not None and now_s - oldest.since_s < GRACE_S:
                self.ended += 1
                return None
        place = ConnectionPlace(Standing.STRANGER, site, end, now_s)
        self._seat(place)
        return place

    def claim(self, place: ConnectionPlace, standing: Standing, owner: str) -> None:
        """Moves the connection to another owner's places; the oldest silent one there ends where there is none left."""
        if self._has(place) and (place.standing, place.owner) != (standing, owner):
            self._unseat(place)
            place.standing, place.owner = standing, owner
            self._seat(place)

    def turn(self, place: ConnectionPlace, *, busy: bool) -> None:
        """Notes that a whole request of the connection is being answered now, or that it is silent again."""
        if self._has(place):
            owned = self._owners[place.standing][place.owner]
            del owned.row(place)[place]
            place.busy, place.since_s = busy, self._now()
            owned.row(place)[place] = None

    def leave(self, place: ConnectionPlace) -> None:
        """Frees the place of a connection that has ended."""
        if self._has(place):
            self._unseat(place)

    def spare(self) -> None:
        """Ends one stranger's connection, as if there were a place too few."""
        owners = self._owners[Standing.STRANGER]
        if owners and (place := max(owners.values(), key=len).oldest(but=_NOBODY)) is not None:
            self._end(place)

    def _seat(self, newcomer: ConnectionPlace) -> None:
        owners = self._owners[newcomer.standing]
        own = owners.setdefault(newcomer.owner, _Owned())
        own.row(newcomer)[newcomer] = None
        self._counts[newcomer.standing] += 1
        whole, each = self._bounds[newcomer.standing]
        crowded = own if len(own) > each else None
        if crowded is None and self._counts[newcomer.standing] > whole:
            crowded = max(owners.values(), key=len)
        if crowded is not None and (place := crowded.oldest(but=newcomer)) is not None:
            self._end(place)

    def _has(self, place: ConnectionPlace) -> bool:
        owned = self._owners[place.standing].get(place.owner)
        return owned is not None and place in owned.row(place)

    def _unseat(self, place: ConnectionPlace) -> None:
        owners = self._owners[place.standing]
        owned = owners[place.owner]
        del owned.row(place)[place]
        self._counts[place.standing] -= 1
        if not owned:
            del owners[place.owner]

    def _end(self, place: ConnectionPlace) -> None:
        self._unseat(place)
        self.ended += 1
        place.end()


_NOBODY: Final = ConnectionPlace(Standing.STRANGER, "", lambda: None, 0.0)


def _site(address: str) -> str:
    """Address as it counts: of IPv6 the network of one site, and IPv4 in IPv6 as IPv4."""
    try:
        read = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if read.version == 4:
        return str(read)
    return str(read.ipv4_mapped or f"{read.packed[: SITE_BITS // 8].hex()}/{SITE_BITS}")
