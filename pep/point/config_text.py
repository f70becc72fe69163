"""Configuration of an enforcement point, read strictly; an insecure one is refused by name.

Nothing here knows a robot: a process that has none reads its configuration without loading physics.
"""

from __future__ import annotations

import ipaddress
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol
from urllib.parse import urlsplit

from capabilities.keys.trust import TrustBundle
from capabilities.values.errors import CapabilityError
from pep.base import key_file
from pep.base.errors import ConfigError, PepFault
from policies.decision.load import SHIPPED, TEXT_LIMIT, load, load_shipped
from policies.words.errors import PolicyError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey
    from policies.decision.policy import PolicySet

CONFIG_BYTES: Final = 1_048_576
"""Largest configuration; ours."""
_TYPES: Final[Mapping[str, type]] = {"int": int, "bool": bool}
"""Types in a file of the settings that are no texts and no tables."""


class PartsConfig(Protocol):
    """Settings that every enforcement point has, in any form of configuration."""

    @property
    def audience(self) -> str:
        """Canonical URL of the server; also the `htu` of every proof of a tool call."""
        ...

    @property
    def pep_id(self) -> str:
        """This PEP's registered id."""
        ...

    @property
    def issuer(self) -> str:
        """Base URL of the identity provider."""
        ...

    @property
    def trust_file(self) -> Path:
        """The provider's public trust bundle."""
        ...

    @property
    def pep_key_file(self) -> Path:
        """This PEP's key, encrypted."""
        ...

    @property
    def journal_file(self) -> Path:
        """The durable journal."""
        ...

    @property
    def state_dir(self) -> Path:
        """Directory of all other state over restarts."""
        ...

    @property
    def policy(self) -> str:
        """Name of a shipped set, or a path."""
        ...


def spelled(form: type[Any], text: str, *, optional: frozenset[str] = frozenset()) -> dict[str, Any]:
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
        wanted = _TYPES.get(kind) or (str if kind.startswith(("str", "Path")) else dict)
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


def read_trust(config: PartsConfig) -> TrustBundle:
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


def read_key(config: PartsConfig) -> PrivateKey:
    """The PEP's key.

    Raises:
        ConfigError: `CONFIG_INVALID` when it is missing, readable by others, or the passphrase is missing or wrong.
    """
    return key_file.read_key(config.pep_key_file, name="pep_key_file")


def read_set(name: str, place: str) -> tuple[str, str]:
    """Text of a policy set, and its place.

    Args:
        name: path of its file; a relative one begins at the folder of `place`.
        place: path of the file that names it; "" for none.
    """
    path = (Path(place).parent / name).resolve()
    with path.open(encoding="utf-8-sig") as file:
        return file.read(TEXT_LIMIT + 1), str(path)


def read_policies(config: PartsConfig) -> PolicySet:
    """The policy set.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        if config.policy in SHIPPED:
            return load_shipped(config.policy)
        text, place = read_set(config.policy, "")
        return load(text, place=place, read=read_set)
    except (OSError, UnicodeDecodeError, PolicyError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"policy: {error}") from error
