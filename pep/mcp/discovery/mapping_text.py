"""Text of a proposed mapping: tables of `guard.toml`, with comments on what a person has to look at.

Foreign text is in comments and in quoted words alone, made safe for a terminal and its reader.
"""

from __future__ import annotations

import json
import re
import textwrap
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.characters import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from pep.mcp.discovery.proposed_argument import ProposedArgument
    from pep.mcp.discovery.proposed_tool import ProposedTool

COLUMNS: Final = 100
REVIEW: Final = "REVIEW"
"""Begins the comment above a line that is not to be used as it is."""
HEAD: Final = (
    "A proposal, by `ztpm mcp discover`. A person must review each line before it is used.",
    "Names, texts, schemas and annotations are the server's own claims; nothing here was tried.",
    "A text is one line of at most 1024 bytes, without characters that no reader sees.",
    "Up to tier 1 a call happens, 2 wants trust, 3 asks a person, 4 needs a leave given before.",
)
_BARE: Final = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)


def mapping_text(tools: Iterable[ProposedTool], *, server: str) -> str:
    """The mapping as TOML; tools that are left out are comments.

    Args:
        tools: proposed, in the server's order.
        server: words about it, for the first lines.
    """
    lines = [*_comment(HEAD[0]), *_comment(f"Server: {server}"), *(f"# {each}" for each in HEAD[1:])]
    for tool in tools:
        lines.append("")
        lines += _left_out(tool) if tool.code else _proposed(tool)
    return "\n".join(lines) + "\n"


def _proposed(tool: ProposedTool) -> Iterator[str]:
    if tool.said:
        yield from _comment(f"Says of itself: {tool.said}")
    for doubt in tool.review:
        yield from _comment(f"{REVIEW}: {doubt}")
    key = f"tool.{_key(tool.name)}"
    yield f"[{key}]"
    yield f"object = {_value(tool.object)}"
    yield from _comment(tool.because)
    yield f"base_tier = {tool.base_tier}"
    if tool.arguments:
        yield f"[{key}.arguments]"
        for argument in tool.arguments:
            yield from _argument(argument)


def _argument(argument: ProposedArgument) -> Iterator[str]:
    for note in argument.notes:
        yield from _comment(note)
    for doubt in argument.review:
        yield from _comment(f"{REVIEW}: {doubt}")
    yield f"{_key(argument.name)} = {_value(argument.stated)}"


def _left_out(tool: ProposedTool) -> Iterator[str]:
    yield from _comment(f"LEFT OUT: {tool.name}. {tool.code}: {tool.reason}")
    if tool.said:
        yield from _comment(f"Says of itself: {tool.said}")


def _comment(text: str) -> list[str]:
    safe = " ".join(shown(text).split())
    return textwrap.wrap(safe, COLUMNS, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False)


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _value(name)


def _value(value: Any) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case str():
            # JSON's escapes are TOML's, too; it leaves one control character as it is.
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case list():
            return f"[{', '.join(map(_value, value))}]"
        case dict():
            return "{ " + ", ".join(f"{_key(key)} = {_value(each)}" for key, each in value.items()) + " }"
        case _:
            raise TypeError(f"{type(value).__name__} has no form in a mapping")
