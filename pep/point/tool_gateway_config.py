"""Configuration of a gateway: that of a guard, and the servers behind it with their mappings, read strictly."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from pydantic import ValidationError

from pep.base.errors import ConfigError, PepFault
from pep.mcp.gateway.upstream_config import UpstreamConfig
from pep.point.config_text import is_loopback, read_text
from pep.point.guard_config import OPTIONAL, GuardConfig

if TYPE_CHECKING:
    from collections.abc import Mapping

LOCK: Final = "gateway.lock.json"


@dataclass(frozen=True, slots=True)
class ToolGatewayConfig(GuardConfig):
    """`gateway.toml`, checked: the lines of `guard.toml`, and a table for each server behind it.

    Attributes:
        upstream: tables of the servers, as they stand.
        lock: file of the reviewed definitions.
        upstreams: the servers.
    """

    upstream: Mapping[str, Any] = field(default_factory=dict)
    lock: Path = Path(LOCK)
    upstreams: tuple[UpstreamConfig, ...] = ()

    @classmethod
    def read(cls, path: Path | str) -> ToolGatewayConfig:
        """The configuration of a file.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        home = Path(path).absolute().parent

        def completed(given: dict[str, Any]) -> dict[str, Any]:
            if given.get("tool"):
                raise ConfigError(PepFault.CONFIG_INVALID, "tool: a gateway's tools are those of its servers")
            servers = tuple(_upstream(name, table, home) for name, table in given["upstream"].items())
            if not servers:
                raise ConfigError(PepFault.CONFIG_INVALID, "upstream: there is no server")
            tools: dict[str, Any] = {}
            for server in servers:
                for name, table in (server.tool or {}).items():
                    if server.prefix + name in tools:
                        said = f"upstream.{server.name}: a second tool {server.prefix}{name}; give it a prefix"
                        raise ConfigError(PepFault.CONFIG_INVALID, said)
                    tools[server.prefix + name] = table
            return {"lock": home / LOCK, **given, "upstreams": servers, "tool": tools}

        return cls.read_as(path, optional=OPTIONAL | {"lock", "upstreams"}, completed=completed)


def _upstream(name: str, table: Any, home: Path) -> UpstreamConfig:
    """The table of one server, checked, with the tools of its mapping file."""
    where = f"upstream.{name}"
    if not isinstance(table, dict):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{where} must be a table")
    stated = dict(table)
    mapping, folder, tools = stated.pop("mapping", ""), stated.pop("folder", "."), stated.pop("tool", {})
    if not isinstance(mapping, str) or not isinstance(folder, str) or not isinstance(tools, dict):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{where}: mapping and folder are texts, and tool is a table")
    mapped = _mapping(home / mapping, where) if mapping else {}
    try:
        made = UpstreamConfig(**stated, name=name, folder=home / folder, tool={**mapped, **tools})
    except (ValidationError, TypeError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else {"loc": (), "msg": "name is unknown"}
        place = ".".join([where, *(str(each) for each in first["loc"])])
        raise ConfigError(PepFault.CONFIG_INVALID, f"{place}: {first['msg']}") from error
    if made.url.startswith("http:") and not is_loopback(urlsplit(made.url).hostname or ""):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{where}.url: plain HTTP on loopback only")
    return made


def _mapping(path: Path, where: str) -> dict[str, Any]:
    """The tables `[tool.NAME]` of a mapping file, and nothing else."""
    try:
        tables = tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{where}.mapping: {path.name}: not TOML: {error}") from error
    tools = tables.pop("tool", {})
    if tables or not isinstance(tools, dict):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{where}.mapping: {path.name} has only tables [tool.NAME]")
    return tools
