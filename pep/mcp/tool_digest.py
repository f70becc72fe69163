"""Digest of a tool, over all that a model and a client see of it.

Any change makes it another tool.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import rfc8785

if TYPE_CHECKING:
    from mcp_types import Tool

    from capabilities.values.scope import Tier

SEEN: Final = {"name", "title", "description", "input_schema", "output_schema", "annotations", "icons", "execution"}
"""Fields that belong to the definition; `_meta` is transport."""


@dataclass(frozen=True, slots=True)
class ToolPin:
    """A tool as it is to be registered: its definition, its operation, and the base tier that its author proposes."""

    name: str
    definition_digest: str
    operation: str
    base_tier: Tier


def definition_digest(tool: Tool) -> str:
    """SHA-256 (hex) over the RFC 8785 form of the tool's definition."""
    definition = tool.model_dump(
        mode="json", by_alias=True, exclude_none=True, include=SEEN & set(type(tool).model_fields)
    )
    return hashlib.sha256(rfc8785.dumps(definition)).hexdigest()
