"""Configuration of an enforcement point that opens a door of its own, checked."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, Self
from urllib.parse import urlsplit

from pep.base.errors import ConfigError, PepFault
from pep.point.config_text import check_url, is_loopback, spelled
from policies.decision.load import SHIPPED

TLS: Final = frozenset({"tls_certificate_file", "tls_key_file"})
"""Settings of a door that speaks TLS itself; both, or neither."""


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
        tls_certificate_file, tls_key_file: PEM files with which its door speaks TLS itself; None: a TLS proxy stands
            before it, or it is on loopback.
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
    tls_certificate_file: Path | None = field(default=None, kw_only=True)
    tls_key_file: Path | None = field(default=None, kw_only=True)

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """The configuration that a TOML text spells: every key given but those of TLS, none unknown.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        config = cls(**spelled(cls, text, optional=TLS))
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
        if (self.tls_certificate_file is None) is not (self.tls_key_file is None):
            raise ConfigError(PepFault.CONFIG_INVALID, "tls_certificate_file and tls_key_file belong together")
        if self.tls_key_file is not None and urlsplit(self.audience).scheme == "http":
            raise ConfigError(PepFault.CONFIG_INVALID, "audience: plain HTTP, and the door speaks TLS")

    def placed(self, folder: Path) -> Self:
        """The configuration of a file in this folder: a relative path begins there, wherever the process was started.

        Args:
            folder: of the file.
        """
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        paths: dict[str, Any] = {name: folder / value for name, value in given.items() if isinstance(value, Path)}
        if self.policy not in SHIPPED:
            paths["policy"] = str(folder / self.policy)
        return replace(self, **paths)


def check_port(name: str, port: int) -> None:
    """Checks that it is a TCP port.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    if not 1 <= port <= 65_535:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name} is no port")
