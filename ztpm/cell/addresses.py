"""Addresses of the embedded cell: a loopback address of its own, and the next one for the gateway."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import Final

from pep.rtde.robot.connections import LEASED_PORTS, PORTS
from ztpm.base.loopback import free_host, is_free


class SetupError(ValueError):
    """A cell that cannot be made as asked, or does not hold together; the text names the setting."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses of a cell: a loopback address of its own, since a robot's ports are fixed.

    Attributes:
        host: an address in 127.0.0.0/8.
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
        """Every port of the cell, the robot's fixed ones among them."""
        return (self.idp_port, self.tools_port, self.status_port, *ROBOT_PORTS)

    @property
    def gateway_ports(self) -> tuple[int, ...]:
        """Every port of the robot's gateway."""
        return (self.door_port, self.carriage_port, self.perception_port, *PORTS)

    @property
    def taken(self) -> tuple[int, ...]:
        """Ports of the cell that are taken now."""
        own = (port for port in self.ports if not is_free(self.host, port))
        return (*own, *(port for port in self.gateway_ports if not is_free(self.gateway_host, port)))

    @property
    def issuer(self) -> str:
        """Base URL of the identity provider."""
        return f"http://{self.host}:{self.idp_port}/ztpm"

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


def free_addresses(seed: bytes) -> Addresses:
    """Addresses on a loopback host where every port of a cell is free now.

    Args:
        seed: random bytes; decides the order in which hosts are tried.

    Raises:
        OSError: when no host is found.
    """
    return Addresses(host=free_host(seed, lambda host: not Addresses(host=host).taken))
