"""Addresses that never leave the machine, and those of the public Internet."""

from __future__ import annotations

import ipaddress
from typing import Final

_TRANSLATED: Final = (ipaddress.ip_network("64:ff9b::/96"), ipaddress.ip_network("64:ff9b:1::/48"))
"""Addresses behind which a translator has any other one (RFC 6052, RFC 8215)."""


def is_loopback(host: str) -> bool:
    """True for the names and addresses that never leave the machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_public(address: str) -> bool:
    """True for an address of the public Internet."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return False
    if any(found in network for network in _TRANSLATED if found.version == network.version):
        return False
    inner = getattr(found, "ipv4_mapped", None) or getattr(found, "sixtofour", None)
    if inner is not None and not inner.is_global:
        return False
    return found.is_global and not found.is_multicast
