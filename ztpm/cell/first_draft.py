"""First draft of a cell file, and scope of a first move, for a cell with its own controller."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Final

from pep.base.operations import MOVE_JOINT
from pep.pit.files.world_forms import FORM

TURN_URAD: Final = 3_000_000
"""Joint angles of a first move; ours: every usual posture lies within."""
SPEED_URAD_S: Final = 200_000
ACCELERATION_URAD_S2: Final = 1_000_000
WINDOW_S: Final = 900
"""Life of what is lent for it; `ztpm token issue --minutes` puts the window at now."""
CEILING: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class CellWish:
    """Word of a person on a cell that nobody has surveyed yet.

    Attributes:
        name: of the cell.
        author: the person who signs.
        tool: the mounted tool.
        sensors: ids of those that must be heard.
        table: centre and size of a box, m in the base frame; None: there is none.
        workspace: lowest and highest corner, likewise; None: no such limit.
    """

    name: str
    author: str
    tool: str
    sensors: tuple[str, ...]
    table: tuple[float, ...] | None = None
    workspace: tuple[float, ...] | None = None


def cell_draft(wish: CellWish, *, audience: str) -> str:
    """Draft, as `ztpm cell sign` takes it; a person completes it and signs again.

    Args:
        wish: of the cell.
        audience: canonical URL of the cell's tool server.
    """
    lines = [
        "# Draft of the cell file (docs/world.md). Add what stands in the cell, each measured in the base's frame, and",
        "# sign it anew: ztpm cell sign. Safety planes stand at the pendant: what they keep away from belongs into",
        "# `workspace` or `zones` here, too.",
        f"form = {json.dumps(FORM)}",
        'frame = "base"',
        "",
        "[cell]",
        f"name = {json.dumps(wish.name)}",
        f"author = {json.dumps(wish.author)}",
        f"audience = {json.dumps(audience)}",
        f"tool = {json.dumps(wish.tool)}",
        "payload_kg = 0.0",
        f"sensors = {json.dumps(list(wish.sensors))}",
    ]
    if wish.table is None:
        lines.append("objects = []")
    else:
        centre, half = list(wish.table[:3]), [size / 2 for size in wish.table[3:]]
        lines.append(
            f'objects = [{{ name = "table", kind = "rigid", box = {{ center_m = {centre}, half_m = {half} }} }}]'
        )
    if wish.workspace is not None:
        low, high = list(wish.workspace[:3]), list(wish.workspace[3:])
        lines.append(f"workspace = {{ low_m = {low}, high_m = {high} }}")
    return "\n".join([*lines, ""])


def first_scope(audience: str) -> bytes:
    """Scope of a first move, JSON: `move_joint` to any usual posture at up to 0.2 rad/s.

    Args:
        audience: canonical URL of the cell's tool server.
    """
    bounds = {"speed": (0, SPEED_URAD_S), "acceleration": (0, ACCELERATION_URAD_S2)}
    limits = [
        {"parameter": parameter.name, "unit": str(parameter.unit), "low": low, "high": high}
        for parameter in MOVE_JOINT.parameters
        for low, high in [bounds.get(parameter.name, (-TURN_URAD, TURN_URAD))]
    ]
    scope = {
        "grants": [{"object": MOVE_JOINT.object, "operation": MOVE_JOINT.name, "limits": limits}],
        "ceiling": CEILING,
        "audiences": [audience],
        "delegates": [],
        "depth": 0,
        "not_before": 0,
        "not_after": WINDOW_S,
    }
    return json.dumps(scope, indent=2).encode() + b"\n"
