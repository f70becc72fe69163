"""Addresses of a cell with a controller of its own: each part on an address that other machines reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from pep.rtde.robot.connections import PORTS
from ztpm.base.loopback import free_host, is_free
from ztpm.cell.addresses import LOOPBACK, Addresses, SetupError

if TYPE_CHECKING:
    from ztpm.base.layout import Layout

MACHINES: Final = ("provider", "gateway", "tools")
"""Machines of a cell, those that others use first; one machine may be all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteAddresses(Addresses):
    """Addresses of such a cell; `host` is the tool server's.

    Attributes:
        controller: of the robot.
        provider, gateway: hosts of identity provider and gateway.
        face: address at which the gateway stands in the controller's place.
        tls: every URL is https; plain HTTP is for loopback alone.
    """

    controller: str
    provider: str
    gateway: str
    face: str
    tls: bool

    @property
    def gateway_host(self) -> str:
        """Address of the robot's gateway."""
        return self.gateway

    @property
    def controller_host(self) -> str:
        """Address of the controller."""
        return self.controller

    @property
    def face_host(self) -> str:
        """Address at which the gateway stands in the controller's place."""
        return self.face

    @property
    def status_host(self) -> str:
        """Address of the status page, this machine's alone."""
        return LOOPBACK

    @property
    def taken(self) -> tuple[int, ...]:
        """Ports of the cell that cannot be listened on now: a program does, or the address is another machine's."""
        stated = (
            (self.provider, self.idp_port), (self.host, self.tools_port), (LOOPBACK, self.status_port),
            *((self.gateway, port) for port in (self.door_port, self.carriage_port, self.perception_port)),
            *((self.face, port) for port in PORTS),
        )  # fmt: skip
        return tuple(port for host, port in stated if not is_free(host, port))

    @property
    def issuer(self) -> str:
        """Base URL of the identity provider."""
        return self._url(self.provider, self.idp_port, "/ztpm")

    @property
    def door(self) -> str:
        """Canonical URL where leases of the robot are asked for."""
        return self._url(self.gateway, self.door_port, "/leases")

    @property
    def calls(self) -> str:
        """Canonical URL where the gateway takes the tool server's calls."""
        return self._url(self.gateway, self.door_port, "/calls")

    @property
    def audience(self) -> str:
        """Canonical URL of the cell's MCP server, and so of the cell."""
        return self._url(self.host, self.tools_port, "/mcp")

    @property
    def well_known(self) -> str:
        """URL at which the cell's MCP server names its token issuer to all callers (RFC 9728)."""
        from pep.mcp.resource_description import WELL_KNOWN

        return self._url(self.host, self.tools_port, f"{WELL_KNOWN}/mcp")

    @property
    def hosts(self) -> dict[str, str]:
        """Host of each of `MACHINES`."""
        return dict(zip(MACHINES, (self.provider, self.gateway, self.host), strict=True))

    def _url(self, host: str, port: int, path: str) -> str:
        named = f"[{host}]" if ":" in host else host
        return f"{'https' if self.tls else 'http'}://{named}:{port}{path}"


def free_loopback(controller: str, seed: bytes) -> SiteAddresses:
    """Addresses of a cell that this machine alone reaches, on one where every port of it is free now.

    Args:
        controller: address of the robot.
        seed: random bytes; decides the order in which hosts are tried.

    Raises:
        OSError: when no host is found.
    """

    def on(host: str) -> SiteAddresses:
        return SiteAddresses(host=host, controller=controller, provider=host, gateway=host, face=host, tls=False)

    def free(host: str) -> bool:
        # The status page has an address of its own: another cell's keeps no host from being free.
        return not set(on(host).taken) - {on(host).status_port}

    return on(free_host(seed, free))


def read_site(layout: Layout) -> SiteAddresses:
    """Addresses of the cell in a directory, by its configurations.

    Args:
        layout: made by `ztpm.cell.robot_setup`.

    Raises:
        SetupError: a configuration is refused, or two contradict each other; the setting is named.
    """
    from pep.base.errors import ConfigError
    from ztpm.point.gateway_config import read_gateway_config
    from ztpm.point.tool_proxy_config import read_door_config

    try:
        tools, gateway = read_door_config(layout.cell_config), read_gateway_config(layout.gateway_config)
    except ConfigError as error:
        raise SetupError(error.detail) from error
    issuer, audience, door = (urlsplit(url) for url in (tools.issuer, tools.audience, gateway.url))
    found = SiteAddresses(
        host=audience.hostname or "",
        idp_port=issuer.port or 443,
        tools_port=audience.port or 443,
        perception_port=gateway.perception_port,
        door_port=door.port or 443,
        carriage_port=gateway.carriage_port,
        controller=gateway.robot_host,
        provider=issuer.hostname or "",
        gateway=door.hostname or "",
        face=gateway.listen_host,
        tls=audience.scheme == "https",
    )
    stated = (
        ("gateway.toml: issuer", gateway.issuer, tools.issuer),
        ("gateway.toml: audience", gateway.audience, tools.audience),
        ("cell.toml: gateway_url", tools.gateway_url, gateway.calls_url),
    )
    for name, value, expected in stated:
        if value != expected:
            raise SetupError(f"{name} is {value}; the other configurations of the cell have {expected}")
    return found
