"""Rates: how many requests of one caller, or from one address, this process takes in a minute.

The window slides: of the minute before, the part counts that is less than a minute ago. Counts are in memory, by
process, so that a request costs no row and no third service: N processes take up to N times as many.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from ipaddress import ip_address
from typing import TYPE_CHECKING, Final

from limits import RateLimitItemPerMinute
from limits.storage.base import SlidingWindowCounterSupport, Storage
from limits.strategies import SlidingWindowCounterRateLimiter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from ipaddress import IPv4Address, IPv6Address

    from ztpm_idp.rate_settings import RateSettings

OWNERS: Final = 16_384
"""Most callers, and most addresses, that are counted at a time (about 300 bytes each); the longest silent is forgotten.

Who can send from more addresses than that in two minutes is bounded by the places of connections alone.
"""
HOPS: Final = 16
"""Most addresses of one `X-Forwarded-For` that are looked at, from its end."""
SITE_BITS: Final = 64  # RFC 6177: one site has at least the whole lower half of an IPv6 address


class Counts(Storage, SlidingWindowCounterSupport):
    """Counts of requests in the present window and the one before it, of so many owners at most.

    The storages in memory that `limits` brings keep every owner until its window is over, and look through all of them
    with each request: 11 µs for one owner, 1.9 ms for 16,384 (2 µs here).

    Args:
        now: monotonic clock, seconds.
        most: owners.
    """

    STORAGE_SCHEME = None

    def __init__(self, now: Callable[[], float], most: int = OWNERS) -> None:
        super().__init__()
        self._now = now
        self._most = most
        self._counts: OrderedDict[str, list[int]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._counts)

    @property
    def base_exceptions(self) -> type[Exception]:
        """No error of a storage: it is memory."""
        return ValueError

    def acquire_sliding_window_entry(self, key: str, limit: int, expiry: int, amount: int = 1) -> bool:
        """True where so many more are within the limit; they are counted then."""
        counted, into = self._at(key, expiry)
        _, before, present = counted
        if math.floor(before * (1 - into) + present) + amount > limit:
            return False
        counted[2] += amount
        return True

    def get_sliding_window(self, key: str, expiry: int) -> tuple[int, float, int, float]:
        """Count of the window before and seconds for which it counts still; the same of the present one."""
        (_, before, present), into = self._at(key, expiry)
        left_s = (1 - into) * expiry
        return before, left_s if before else 0.0, present, left_s + expiry

    def clear_sliding_window(self, key: str, expiry: int) -> None:  # noqa: ARG002  as the library has it
        """Forgets an owner."""
        self.clear(key)

    def incr(self, key: str, expiry: int, amount: int = 1) -> int:
        """Counts, within the limit or not; the count of the present window."""
        counted, _ = self._at(key, expiry)
        counted[2] += amount
        return counted[2]

    def get(self, key: str) -> int:
        """The count of the window in which the owner came last."""
        return self._counts.get(key, [0, 0, 0])[2]

    def get_expiry(self, key: str) -> float:  # noqa: ARG002  as the library has it
        """Now: windows end for all owners at once, and none is kept for its end."""
        return self._now()

    def check(self) -> bool:
        """True: memory is there."""
        return True

    def reset(self) -> int:
        """Forgets every owner; their number."""
        number = len(self._counts)
        self._counts.clear()
        return number

    def clear(self, key: str) -> None:
        """Forgets an owner."""
        self._counts.pop(key, None)

    def _at(self, key: str, expiry: int) -> tuple[list[int], float]:
        """Window of an owner, counts of the one before and of itself, and the part of it that is over."""
        window, into = divmod(self._now() / expiry, 1)
        counted = self._counts.get(key)
        if counted is None:
            counted = self._counts[key] = [int(window), 0, 0]
            if len(self._counts) > self._most:
                self._counts.popitem(last=False)
        else:
            self._counts.move_to_end(key)
            if counted[0] != window:
                counted[1] = counted[2] if counted[0] == window - 1 else 0
                counted[0], counted[2] = int(window), 0
        return counted, into


class Rate:
    """One rate for every owner.

    Args:
        a_minute: requests of one owner in any minute.
        now: monotonic clock, seconds.
    """

    def __init__(self, a_minute: int, now: Callable[[], float]) -> None:
        self._item = RateLimitItemPerMinute(a_minute)
        self.counts = Counts(now)
        self._limiter = SlidingWindowCounterRateLimiter(self.counts)

    @property
    def a_minute(self) -> int:
        """Requests of one owner in any minute."""
        return self._item.amount

    def wait_s(self, owner: str) -> int:
        """Whole seconds until one more request of the owner is taken; 0: this one is, and counts."""
        if self._limiter.hit(self._item, owner):
            return 0
        most, minute_s = self._item.amount, self._item.get_expiry()
        before, counts_s, present, over_s = self.counts.get_sliding_window(self._item.key_for(owner), minute_s)
        # The weighted sum must fall below the limit: within this window, or else in the next one.
        if present < most:
            wait_s = counts_s - minute_s * (most - present) / before
        else:
            wait_s = over_s - minute_s * most / present
        return max(1, math.floor(wait_s) + 1)


class Rates:
    """Rates of a deployment.

    Args:
        settings: say how many.
        now: monotonic clock, seconds.

    Attributes:
        callers: by id of the party.
        open, logins: by address, of the endpoints that take strangers, and of those where logins begin or end.
    """

    def __init__(self, settings: RateSettings, now: Callable[[], float]) -> None:
        self.callers = Rate(settings.caller_a_minute, now)
        self.open = Rate(settings.address_a_minute, now)
        self.logins = Rate(settings.login_a_minute, now)
        self._proxies = settings.proxies

    def address(self, peer: str, forwarded: Sequence[str]) -> str:
        """The address that a request came from: the last one that no trusted proxy has.

        Args:
            peer: other end of the connection.
            forwarded: values of `X-Forwarded-For`, in their order; of strangers they count for nothing.
        """
        at = _parsed(peer)
        if at is None or not self._proxied(at):
            return peer
        hops = [hop for value in forwarded for hop in value.split(",")][-HOPS:]
        for hop in reversed(hops):
            named = _parsed(_without_port(hop.strip()))
            if named is None:
                break  # what stands before it, anyone may have written
            at = named
            if not self._proxied(at):
                break
        return str(at)

    def _proxied(self, address: IPv4Address | IPv6Address) -> bool:
        return any(address.version == each.version and address in each for each in self._proxies)


def site(address: str) -> str:
    """An address as it counts: of IPv6 the network of one site, IPv4 in IPv6 as IPv4."""
    at = _parsed(address)
    if at is None or at.version == 4:
        return address if at is None else str(at)
    return f"{at.packed[: SITE_BITS // 8].hex()}/{SITE_BITS}"


def _parsed(address: str) -> IPv4Address | IPv6Address | None:
    try:
        at = ip_address(address.partition("%")[0])
    except ValueError:
        return None
    return at if at.version == 4 else at.ipv4_mapped or at


def _without_port(hop: str) -> str:
    """An address of `X-Forwarded-For`, to which some proxies add the port."""
    if hop.startswith("["):
        return hop[1:].partition("]")[0]
    return hop.partition(":")[0] if hop.count(":") == 1 else hop
