"""Addresses that never leave the machine."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """True for the names and addresses that never leave the machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
