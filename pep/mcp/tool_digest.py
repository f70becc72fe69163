"""Digest of a tool, over all that a model and a client see of it.

Any change makes it another tool.
"""

from __future__ import annotations

import functools
import hashlib
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.values import strict_json
from policies.evidence.evidence import ToolReading

if TYPE_CHECKING:
    from mcp_types import Tool

    from capabilities.values.scope import Tier
    from pep.base.ports import RegisteredTool

SEEN: Final = {"name", "title", "description", "input_schema", "output_schema", "annotations", "icons", "execution"}
"""Fields that belong to the definition; `_meta` is transport."""
TEXTS: Final = 512
"""Definitions whose digest is remembered."""


@dataclass(frozen=True, slots=True)
class ToolPin:
    """A tool as it is to be registered: its definition, its operation, and the base tier that its author proposes."""

    name: str
    definition_digest: str
    operation: str
    base_tier: Tier


def tool_reading(name: str, registered: RegisteredTool | None, actual_digest: str) -> ToolReading:
    """The tool of this name as it is registered for its own operation, and as it is now.

    Args:
        name: of the tool and its operation.
        registered: of the registry; None where it knows no such tool.
        actual_digest: of the definition now; "" where the tool is not there.
    """
    if registered is None or registered.operation != name:
        return ToolReading(name=name, approved_digest=None, actual_digest=actual_digest, base_tier=None)
    return ToolReading(
        name=name,
        approved_digest=registered.definition_digest,
        actual_digest=actual_digest,
        base_tier=registered.base_tier,
    )


def definition_digest(tool: Tool) -> str:
    """SHA-256 (hex) over the RFC 8785 form of the tool's definition."""
    return _digest_of(tool.model_dump_json(by_alias=True, exclude_none=True, include=_seen(tool)))


def plain_definition(tool: Tool) -> dict[str, Any]:
    """The tool's definition, of which the digest is."""
    return tool.model_dump(by_alias=True, mode="json", exclude_none=True, include=_seen(tool))


def _seen(tool: Tool) -> set[str]:
    return SEEN & type(tool).model_fields.keys()


@functools.lru_cache(maxsize=TEXTS)
def _digest_of(definition: str) -> str:
    """Digest of a definition's JSON text; a tool's is asked for at each call, and rarely another one."""
    return hashlib.sha256(strict_json.canonical(json.loads(definition))).hexdigest()
