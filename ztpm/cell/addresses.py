"""Addresses of the embedded cell: a loopback address of its own, and the next one for the gateway."""

from __future__ import annotations

import hashlib
import ipaddress
from dataclasses import dataclass
from typing import Final

from pep.rtde.robot.connections import LEASED_PORTS, PORTS
from ztpm.base.loopback import free_host, is_free

LOOPBACK: Final = "127.0.0.1"
NAME: Final = "localhost"
"""The one name of a loopback address for which a browser keeps passkeys without TLS (W3C Secure Contexts 3.1)."""
NAMED_PORTS: Final = range(10_000, 30_000)
"""Ports of providers at that name: none that the system gives to connections (from 32768 on)."""


class SetupError(ValueError):
    """A cell that cannot be made as asked, or does not hold together; the text names the setting."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses of a cell: a loopback address of its own, since a robot's ports are fixed.

    Attributes:
        host: an address in 127.0.0.0/8.
        named: the identity provider is at `localhost` instead, since browsers keep a passkey for a name alone.
        idp_port, tools_port, perception_port, status_port: TCP ports on it.
        door_port, carriage_port: of the robot's gateway, on `gateway_host`.
    """

    host: str
    idp_port: int = 8700
    tools_port: int = 8800
    perception_port: int = 8801
    status_port: int = 8890
    door_port: int = 8900
    carriage_port: int = 8901
    named: bool = False

    @property
    def provider_host(self) -> str:
        """Address of the identity provider."""
        return LOOPBACK if self.named else self.host

    @property
    def gateway_host(self) -> str:
        """Address of the robot's gateway, the next one: its ports are as fixed as the robot's.

        Raises:
            SetupError: `host` is no IPv4 address, or the last one.
        """
        try:
            return str(ipaddress.IPv4Address(self.host) + 1)
        except ipaddress.AddressValueError as error:
            raise SetupError("host: no IPv4 address that has a next one") from error

    @property
    def controller_host(self) -> str:
        """Address of the controller."""
        return self.host

    @property
    def face_host(self) -> str:
        """Address at which the gateway stands in the controller's place."""
        return self.gateway_host

    @property
    def status_host(self) -> str:
        """Address of the status page, this machine's alone."""
        return self.host

    @property
    def ports(self) -> tuple[int, ...]:
        """Every port of the cell on `host`, the robot's fixed ones among them."""
        provider = () if self.named else (self.idp_port,)
        return (*provider, self.tools_port, self.status_port, *ROBOT_PORTS)

    @property
    def gateway_ports(self) -> tuple[int, ...]:
        """Every port of the robot's gateway."""
        return (self.door_port, self.carriage_port, self.perception_port, *PORTS)

    @property
    def taken(self) -> tuple[int, ...]:
        """Ports of the cell that are taken now."""
        own = (port for port in self.ports if not is_free(self.host, port))
        provider = (self.idp_port,) if self.named and not is_free(LOOPBACK, self.idp_port) else ()
        return (*provider, *own, *(port for port in self.gateway_ports if not is_free(self.gateway_host, port)))

    @property
    def issuer(self) -> str:
        """Base URL of the identity provider."""
        return f"http://{NAME if self.named else self.host}:{self.idp_port}/ztpm"

    @property
    def door(self) -> str:
        """Canonical URL where leases of the robot are asked for."""
        return f"http://{self.gateway_host}:{self.door_port}/leases"

    @property
    def well_known(self) -> str:
        """URL at which the cell's MCP server names its token issuer to all callers (RFC 9728)."""
        from pep.mcp.resource_description import WELL_KNOWN

        return f"http://{self.host}:{self.tools_port}{WELL_KNOWN}/mcp"

    @property
    def calls(self) -> str:
        """Canonical URL where the gateway takes the tool server's calls."""
        return f"http://{self.gateway_host}:{self.door_port}/calls"

    @property
    def audience(self) -> str:
        """Canonical URL of the cell's MCP server, and so of the cell."""
        return f"http://{self.host}:{self.tools_port}/mcp"


ROBOT_PORTS: Final = LEASED_PORTS
"""Fixed ports of a UR controller and its Robotiq gripper."""


def free_addresses(seed: bytes, *, named: bool = False) -> Addresses:
    """Addresses on a loopback host where every port of a cell is free now.

    Args:
        seed: random bytes; decides the order in which hosts are tried.
        named: the identity provider is at `localhost`, which all cells share: each has a port of its own there.

    Raises:
        OSError: when no host is found.
    """

    def at(host: str) -> Addresses:
        if not named:
            return Addresses(host=host)
        drawn = int.from_bytes(hashlib.sha256(host.encode()).digest()[:4])
        return Addresses(host=host, idp_port=NAMED_PORTS[drawn % len(NAMED_PORTS)], named=True)

    return at(free_host(seed, lambda host: not at(host).taken))
