"""Settings of rates: how many requests of one caller, or from one address, are taken in a minute."""

from __future__ import annotations

from ipaddress import IPv4Network, ip_network
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, field_validator

if TYPE_CHECKING:
    from ipaddress import IPv6Network

MOST: Final = 10_000_000
"""Highest rate: it bounds nothing that one process can serve."""
WIDEST_4: Final = 8  # RFC 1918: 10.0.0.0/8 is the widest private network
WIDEST_6: Final = 32  # RFC 6177: a provider's whole allocation; no site is wider
PROXIES: Final = 32
"""Most networks of proxies: each is looked at for each request that came through one."""
Rate = Annotated[int, Field(ge=1, le=MOST)]


class RateSettings(BaseModel):
    """Requests that one process takes in any minute. Revocation, stop and the feed are in none of these.

    Attributes:
        caller_a_minute: of one registered caller, once its proof is verified.
        address_a_minute: from one IPv4 address or IPv6 network of 64 bits, before anything is verified, at the
            endpoints that ask for no registered key: metadata, token endpoint, pages, polling.
        login_a_minute: the same, at the endpoints where a login, an assent or a passkey begins or ends.
        trusted_proxies: networks, as "10.1.2.0/24", of the proxies whose `X-Forwarded-For` counts; none: nobody's.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    caller_a_minute: Rate = 12_000
    address_a_minute: Rate = 3_000
    login_a_minute: Rate = 300
    trusted_proxies: Annotated[tuple[str, ...], Field(max_length=PROXIES, strict=False)] = ()

    @field_validator("trusted_proxies")
    @classmethod
    def _narrow(cls, stated: tuple[str, ...]) -> tuple[str, ...]:
        for network in map(_network, stated):
            if network.prefixlen < (WIDEST_4 if isinstance(network, IPv4Network) else WIDEST_6):
                raise ValueError("a network this wide: its strangers would name their own addresses")
        return stated

    @property
    def proxies(self) -> tuple[IPv4Network | IPv6Network, ...]:
        """The networks of the proxies."""
        return tuple(map(_network, self.trusted_proxies))


def _network(stated: str) -> IPv4Network | IPv6Network:
    if "/" not in stated:
        raise ValueError("a network has a prefix, as 10.1.2.3/32")
    return ip_network(stated)
