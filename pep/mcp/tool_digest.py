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
from capabilities.values.errors import StatementError
from pep.base.errors import ActuationRefusedError, UpstreamError
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from mcp_types import Tool

    from capabilities.values.scope import Tier
    from policies.evidence.evidence import ToolReading

SEEN: Final = {
    "name",
    "title",
    "description",
    "input_schema",
    "output_schema",
    "annotations",
    "icons",
    "execution",
    "meta",
}
"""Fields of a definition; `_meta` too, by which some clients show it and let it be called."""
TEXTS: Final = 512
"""Definitions whose digest is remembered."""


@dataclass(frozen=True, slots=True)
class ToolPin:
    """A tool as it is to be registered: its definition, its operation, and the base tier that its author proposes."""

    name: str
    definition_digest: str
    operation: str
    base_tier: Tier


def definition_digest(tool: Tool) -> str:
    """SHA-256 (hex) over the one text of the tool's definition."""
    return _digest_of(tool.model_dump_json(by_alias=True, exclude_none=True, include=_seen(tool)))


def plain_definition(tool: Tool) -> dict[str, Any]:
    """The tool's definition, of which the digest is."""
    return tool.model_dump(by_alias=True, mode="json", exclude_none=True, include=_seen(tool))


async def refuse_changed(tool: ToolReading, look: Callable[[], Awaitable[ToolReading]]) -> None:
    """Refuses an effect whose tool is served as another one by now; a retry may have waited for people.

    Raises:
        ActuationRefusedError: `TOOL_DEFINITION_CHANGED`, or `UPSTREAM_UNREACHABLE` where nobody can say.
    """
    try:
        now = await look()
    except UpstreamError as error:
        raise ActuationRefusedError(Reason.UPSTREAM_UNREACHABLE, error.detail) from error
    if now.actual_digest != tool.actual_digest:
        raise ActuationRefusedError(Reason.TOOL_DEFINITION_CHANGED)


def _seen(tool: Tool) -> set[str]:
    return SEEN & type(tool).model_fields.keys()


@functools.lru_cache(maxsize=TEXTS)
def _digest_of(definition: str) -> str:
    """Digest of a definition's JSON text; a tool's is asked for at each call, and rarely another one."""
    return hashlib.sha256(canonical_definition(json.loads(definition))).hexdigest()


def canonical_definition(definition: Any) -> bytes:
    """The one text of a definition: its RFC 8785 form, with whole numbers beyond 2^53 in full.

    Servers state such bounds (of 64 bits), and what has no text cannot be compared.
    """
    try:
        return strict_json.canonical(definition)
    except StatementError:
        return json.dumps(definition, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
