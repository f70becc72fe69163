"""Lock file of a gateway: what its servers said of themselves when a person reviewed it.

The file has whole definitions, so that a change is seen as a change of text. Tools are registered besides, by the
person's signature, and compared with the registry at each call; the rest is compared with this file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Self

from pep.base.errors import ConfigError, PepFault
from pep.mcp.tool_digest import canonical_definition, plain_definition

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from mcp_types import Prompt, ResourceTemplate

    from pep.mcp.gateway.upstream import ToolUpstream

VERSION: Final = 1
"""Form of the file."""
LOCK_BYTES: Final = 8_388_608
"""Ours: largest lock file that is read."""
KINDS: Final = ("tools", "prompts", "resource_templates")


@dataclass(frozen=True, slots=True)
class Lock:
    """Reviewed definitions, by the name of their server; nothing of a server that was not reviewed."""

    servers: Mapping[str, Any]

    @classmethod
    def read(cls, path: Path) -> Self:
        """The lock of a file; an empty one where there is none.

        Raises:
            ConfigError: `CONFIG_INVALID`.
        """
        try:
            raw = path.read_bytes()
        except FileNotFoundError:
            return cls({})
        except OSError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, f"lock: {path.name}: {type(error).__name__}") from error
        try:
            read = json.loads(raw) if len(raw) <= LOCK_BYTES else None
        except (ValueError, RecursionError):
            read = None
        servers = read.get("servers") if isinstance(read, dict) and read.get("version") == VERSION else None
        if not isinstance(servers, dict) or not all(_is_server(each) for each in servers.values()):
            raise ConfigError(PepFault.CONFIG_INVALID, f"lock: {path.name} is no lock file of this version")
        return cls(servers)

    @classmethod
    async def of(cls, upstreams: tuple[ToolUpstream, ...]) -> Self:
        """The servers as they are now.

        Raises:
            UpstreamError: one does not answer.
        """
        found: dict[str, Any] = {}
        for each in upstreams:
            tools, prompts, templates = await each.tools(), await each.prompts(), await each.resource_templates()
            said, instructions = each.about
            found[each.config.name] = {
                "name": "" if said is None else said.name,
                "instructions": instructions or "",
                "tools": {tool.name: plain_definition(tool) for tool in tools},
                "prompts": {prompt.name: _plain(prompt) for prompt in prompts},
                "resource_templates": {template.uri_template: _plain(template) for template in templates},
            }
        return cls(found)

    def text(self) -> str:
        """Content of the file: sorted, one member a line, for a person and for a version control system."""
        body = {"version": VERSION, "servers": self.servers}
        return json.dumps(body, indent=2, sort_keys=True, ensure_ascii=True) + "\n"

    def has_instructions(self, server: str, said: str) -> bool:
        """True where these instructions were reviewed."""
        return self._of(server).get("instructions") == said

    def has_prompt(self, server: str, prompt: Prompt) -> bool:
        """True where this definition of a prompt was reviewed."""
        return self._has(server, "prompts", prompt.name, _plain(prompt))

    def has_template(self, server: str, template: ResourceTemplate) -> bool:
        """True where this definition of a template was reviewed."""
        return self._has(server, "resource_templates", template.uri_template, _plain(template))

    def _has(self, server: str, kind: str, name: str, definition: Mapping[str, Any]) -> bool:
        known = self._of(server).get(kind, {}).get(name)
        return known is not None and canonical_definition(known) == canonical_definition(definition)

    def _of(self, server: str) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.servers.get(server, {})
        return found


def _is_server(table: Any) -> bool:
    return isinstance(table, dict) and all(isinstance(table.get(kind, {}), dict) for kind in KINDS)


def _plain(definition: Prompt | ResourceTemplate) -> dict[str, Any]:
    """The whole definition."""
    return definition.model_dump(by_alias=True, mode="json", exclude_none=True)
