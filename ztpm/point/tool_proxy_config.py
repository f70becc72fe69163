"""Configuration of a tool server without a robot: that of every enforcement point, and the gateway's address."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pep.point.config_text import check_url, read_text
from ztpm.point.point_config import PointConfig

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolProxyConfig(PointConfig):
    """`door.toml`, checked: the keys of every enforcement point, and this one.

    Attributes:
        gateway_url: canonical URL at which the robot's gateway takes calls; plain HTTP on loopback only.
    """

    gateway_url: str

    def check(self) -> None:
        """Checks that nothing in it is insecure.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        PointConfig.check(self)  # a class with slots is another one than `super()` knows
        check_url("gateway_url", self.gateway_url)


def read_door_config(path: Path) -> ToolProxyConfig:
    """The configuration at `path`; what it names by a relative path begins in its folder.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    return ToolProxyConfig.from_toml(read_text(path)).placed(path.absolute().parent)
