"""Configuration that every enforcement point has, read strictly; an insecure one is refused by name.

Nothing here knows a robot: a process that has none reads its configuration without loading physics.
"""

from __future__ import annotations

import ipaddress
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self
from urllib.parse import urlsplit

from capabilities.keys.trust import TrustBundle
from capabilities.values.errors import CapabilityError
from pep.base import key_file
from pep.base.errors import ConfigError, PepFault
from policies.decision.load import SHIPPED, load, load_shipped
from policies.words.errors import PolicyError

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from policies.decision.policy import PolicySet

CONFIG_BYTES: Final = 1_048_576
"""Largest configuration; ours."""


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


def spelled(form: type[PointConfig], text: str, *, optional: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Members of a configuration of this form, each of its type; tables as dicts.

    Args:
        form: a dataclass.
        text: of the whole configuration.
        optional: settings that may be left out.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, "not TOML") from error
    names = {field.name for field in fields(form)}
    for wrong in sorted((names - optional - set(table)) | (set(table) - names)):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{wrong} is {'missing' if wrong in names else 'unknown'}")
    given: dict[str, Any] = {}
    for field in fields(form):
        if field.name not in table:
            continue
        value, kind = table[field.name], str(field.type)
        wanted = int if kind == "int" else str if kind.startswith(("str", "Path")) else dict
        if type(value) is not wanted or value == "":
            raise ConfigError(PepFault.CONFIG_INVALID, f"{field.name} must be a {wanted.__name__}, and not empty")
        given[field.name] = Path(str(value)) if kind.startswith("Path") else value
    return given


def check_url(name: str, url: str) -> None:
    """Checks that it is a URL with a path, and a secure one.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    parts = urlsplit(url)
    if (
        parts.scheme not in {"http", "https"}
        or not parts.hostname
        or len(parts.path) < 2
        or parts.query
        or parts.fragment
    ):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name} must be a URL with a path")
    if parts.scheme == "http" and not is_loopback(parts.hostname):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name}: plain HTTP on loopback only")


def check_port(name: str, port: int) -> None:
    """Checks that it is a TCP port.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    if not 1 <= port <= 65_535:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name} is no port")


def is_loopback(host: str) -> bool:
    """True where the host is this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def read_text(path: Path) -> str:
    """The text of a configuration.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        raw = path.read_bytes()
        if len(raw) > CONFIG_BYTES:
            raise ConfigError(PepFault.CONFIG_INVALID, "too large")
        return raw.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{path}: {type(error).__name__}") from error


def read_trust(config: PointConfig) -> TrustBundle:
    """The trust bundle of the configured issuer.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        trust = TrustBundle.from_json(config.trust_file.read_bytes())
    except (OSError, CapabilityError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"trust_file: {type(error).__name__}") from error
    if trust.issuer != config.issuer:
        raise ConfigError(PepFault.CONFIG_INVALID, "trust_file is of another issuer")
    return trust


def read_key(config: PointConfig) -> PrivateKey:
    """The PEP's key.

    Raises:
        ConfigError: `CONFIG_INVALID` when it is missing, readable by others, or the passphrase is missing or wrong.
    """
    return key_file.read_key(config.pep_key_file, name="pep_key_file")


def read_policies(config: PointConfig) -> PolicySet:
    """The policy set.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        if config.policy in SHIPPED:
            return load_shipped(config.policy)
        return load(Path(config.policy).read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, PolicyError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"policy: {error}") from error
