"""Configuration of an enforcement point that opens a door of its own, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self
from urllib.parse import urlsplit

from pep.base.errors import ConfigError, PepFault
from pep.point.config_text import check_url, is_loopback, spelled

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class PointConfig:
    """Configuration of every enforcement point, checked.

    Attributes:
        audience: canonical URL of the cell; also the `htu` of every proof of a tool call.
        host, port: address of its door.
        pep_id: this PEP's registered id.
        issuer: base URL of the identity provider.
        trust_file: its public trust bundle.
        pep_key_file: this PEP's key, encrypted.
        journal_file: the durable journal.
        state_dir: directory of all other state over restarts.
        policy: name of a shipped set, or a path.
    """

    audience: str
    host: str
    port: int
    pep_id: str
    issuer: str
    trust_file: Path
    pep_key_file: Path
    journal_file: Path
    state_dir: Path
    policy: str

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """The configuration that a TOML text spells: every key given, none unknown.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        config = cls(**spelled(cls, text))
        config.check()
        return config

    def check(self) -> None:
        """Checks that nothing in it is insecure.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        for name, url in (("audience", self.audience), ("issuer", self.issuer)):
            check_url(name, url)
        if urlsplit(self.audience).scheme == "http" and not is_loopback(self.host):
            raise ConfigError(PepFault.CONFIG_INVALID, "host: plain HTTP on loopback only")
        check_port("port", self.port)


def check_port(name: str, port: int) -> None:
    """Checks that it is a TCP port.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    if not 1 <= port <= 65_535:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name} is no port")
