"""Configuration of a robot's gateway: that of its cell, and its listening address in the controller's place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from pep.base.errors import ConfigError, PepFault
from ztpm.base.stop_call import stop_url
from ztpm.point.cell_config import CellConfig, check_port, check_url, is_loopback, read_text

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayConfig(CellConfig):
    """`gateway.toml`, checked: the keys of a cell with a robot, and these.

    `audience` is that of the cell: authority is about what is done with the robot, not about the way there. `host` and
    `port` are those of the door for leases, `robot_host` is the controller.

    Attributes:
        url: canonical URL of the door; the `htu` of openings.
        calls_url: canonical URL at which tool servers' calls are taken.
        listen_host: address that has the controller's ports for everybody.
        carriage_port: TCP port for carriages of leases, on `host`.
    """

    url: str
    calls_url: str
    listen_host: str
    carriage_port: int

    def check(self) -> None:
        """Checks that nothing in it is insecure.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        CellConfig.check(self)  # a class with slots is another one than `super()` knows
        check_url("url", self.url)
        check_url("calls_url", self.calls_url)
        if urlsplit(stop_url(self.url)).path in {urlsplit(self.url).path, urlsplit(self.calls_url).path}:
            raise ConfigError(PepFault.CONFIG_INVALID, "url, calls_url: neither is at `stop`, the address of a stop")
        if urlsplit(self.url).scheme == "http" and not is_loopback(self.host):
            raise ConfigError(PepFault.CONFIG_INVALID, "host: plain HTTP on loopback only")
        check_port("carriage_port", self.carriage_port)
        if self.listen_host == self.robot_host:
            raise ConfigError(PepFault.CONFIG_INVALID, "listen_host is the controller's own address")


def read_gateway_config(path: Path) -> GatewayConfig:
    """The configuration at `path`; what it names by a relative path begins in its folder.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    return GatewayConfig.from_toml(read_text(path)).placed(path.absolute().parent)
