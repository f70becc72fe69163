"""HTML that cannot be malformed: every text is escaped, and functions make all elements."""

from __future__ import annotations

from html import escape
from typing import Final

from capabilities.values.characters import shown

VOID: Final = frozenset({"meta", "link", "br"})


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def text(*content: object) -> Markup:
    """Contents as HTML, with text escaped and as `shown` spells it."""
    return Markup("".join(part if isinstance(part, Markup) else _shown(str(part)) for part in content))


def tag(name: str, /, *content: object, **attributes: str) -> Markup:
    """An element.

    Args:
        name: of the element, ours.
        content: escaped where it is no markup.
        attributes: escaped, an empty one left out; `class_` is spelled so, and an underscore within a name is a hyphen.
    """
    spelled = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_shown(value)}"' for key, value in attributes.items() if value
    )
    if name in VOID:
        return Markup(f"<{name}{spelled}>")
    return Markup(f"<{name}{spelled}>{text(*content)}</{name}>")


def _shown(raw: str) -> str:
    return escape("\n".join(map(shown, raw.split("\n"))))
