"""World files as TOML: a value written so that the reader gives it again, and a draft to begin with."""

from __future__ import annotations

import json
import math
import tomllib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pep.pit.robot.robot import Robot

BARE: Final = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")
GRID_M: Final = 0.1
"""Grid of the workspace that a new draft has."""

BEGUN: Final = """\
# A draft of a cell file. Measure, change what stands here, and then:
#   ztpm cell check FILE                              every fault, and what looks odd
#   ztpm cell show FILE --picture cell.html           look at it
#   ztpm cell sign FILE --key KEY --out cell.jws      a person signs it
# Everything is in metres, in the frame of the robot's base: x, y, and z upward; (0, 0, 0) is the middle of its flange.
# docs/world.md has all words.
form = "ztpm-world/1"
frame = "base"

[cell]
name = "{name}"
author = "alice"                          # id of the person who signs
audience = "http://127.0.0.1:8900/mcp"    # the enforcement point: `audience` of its configuration
robot = "{robot}"                         # for checks and pictures; the gateway's configuration has its own
tool = "{tool}"                           # one of: {tools}
payload_kg = 0.0                          # held by default: 0, a mass, or "unknown"
sensors = ["camera-1"]                    # those that must see the cell

# No part of the moving arm leaves this box. From its shoulder the arm with this tool reaches {reach_m:.2f} m.
[cell.workspace]
low_m = [-{side_m}, -{side_m}, -0.1]
high_m = [{side_m}, {side_m}, {side_m}]

# What stands there: "rigid" or "fragile", and one shape: box, sphere, capsule or convex.
[[cell.objects]]
name = "table"
kind = "rigid"
box = {{ center_m = [0.0, 0.0, -0.06], half_m = [0.6, 0.6, 0.05] }}   # its top is 10 mm below the base

# A part of space. With `tier` (1 to 4) entering it has that tier; without one nothing may enter.
# [[cell.zones]]
# name = "door"
# tier = 3
# sphere = {{ center_m = [0.5, -0.5, 0.3], radius_m = 0.15 }}

# What the tool, or a held part ("payload"), may touch on purpose; `observed` for what only sensors show.
# [[cell.contacts]]
# object = "table"
# by = "tool"

# Digital outputs that may be switched, and the tier of doing so.
# [[cell.outputs]]
# pin = 0
# name = "lamp"
# tier = 1
"""


def begun(robot: Robot, *, name: str = "cell-1") -> str:
    """A commented draft to begin with, as TOML.

    Args:
        robot: a shipped model with its tool.
        name: of the cell.
    """
    reach_m = sum(math.hypot(*joint.offset_m) for joint in robot.model.joints[1:]) + math.hypot(*robot.tool.tcp_m)
    return BEGUN.format(
        name=name,
        robot=robot.model.name,
        tool=robot.tool.name,
        tools=", ".join(tool.name for tool in robot.model.tools),
        reach_m=reach_m,
        side_m=round(math.ceil(reach_m / GRID_M) * GRID_M, 1),
    )


def begun_value(robot: Robot) -> dict[str, Any]:
    """The same draft as a plain value."""
    return tomllib.loads(begun(robot))


def toml_of(value: Mapping[str, Any]) -> str:
    """TOML text of a plain value, with headings for tables and rows; a member that is None is left out."""
    return "\n".join(_table(value, ())).strip() + "\n"


def _table(table: Mapping[str, Any], way: tuple[str, ...]) -> Iterator[str]:
    table = {key: each for key, each in table.items() if each is not None}
    for key, each in table.items():
        if not (_opens(each) or _rows(each)):
            yield f"{_key(key)} = {_inline(each)}"
    for key, each in table.items():
        head = ".".join(map(_key, (*way, key)))
        if _opens(each):
            yield f"\n[{head}]"
            yield from _table(each, (*way, key))
        elif _rows(each):
            for row in each:
                yield f"\n[[{head}]]"
                yield from (f"{_key(name)} = {_inline(inner)}" for name, inner in row.items() if inner is not None)


def _opens(value: object) -> bool:
    return isinstance(value, dict)


def _rows(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        members = [f"{_key(key)} = {_inline(each)}" for key, each in value.items() if each is not None]
        return f"{{ {', '.join(members)} }}" if members else "{}"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    if isinstance(value, float):
        return repr(value)
    return _text(value) if isinstance(value, str) else json.dumps(value)


def _key(key: str) -> str:
    return key if key and set(key) <= BARE else _text(key)


def _text(text: str) -> str:
    """A basic string of TOML: JSON's, but for the one control character that JSON leaves as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
