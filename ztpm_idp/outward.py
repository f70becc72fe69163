"""Hosts of the public Internet, asked at the very address that was looked at."""

from __future__ import annotations

import asyncio
import socket
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import httpx2

from ztpm_idp.domain.addresses import is_public

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_HTTPS: Final = 443


class Resolver(Protocol):
    """Port to the names of hosts."""

    async def __call__(self, host: str) -> Sequence[str]:
        """Every address of the host, as text."""


@dataclass(frozen=True, slots=True)
class Pinned:
    """URL of an https host whose name is looked up no more.

    Attributes:
        url: with the address in place of the name.
        headers: with the name, as the URL had it.
        extensions: of the request: the name that the certificate is for.
    """

    url: httpx2.URL
    headers: Mapping[str, str]
    extensions: Mapping[str, str]


async def resolve(host: str) -> Sequence[str]:
    """Every address of the host, by the operating system."""
    found = await asyncio.get_running_loop().getaddrinfo(host, _HTTPS, type=socket.SOCK_STREAM)
    return [str(address[0]) for *_, address in found]


async def pinned(url: str, resolver: Resolver) -> Pinned | None:
    """The URL at an address of its host.

    None: an address of the host is not of the public Internet, or it has none.

    Args:
        url: absolute, https.
        resolver: of names.

    Raises:
        OSError: the name is not known, or nobody says.
    """
    stated = httpx2.URL(url)
    addresses = await resolver(stated.host)
    if not addresses or not all(map(is_public, addresses)):
        return None
    name = {"Host": stated.netloc.decode("ascii")}
    return Pinned(stated.copy_with(host=addresses[0]), name, {"sni_hostname": stated.host})
