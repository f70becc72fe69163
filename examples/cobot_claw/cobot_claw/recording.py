"""Pictures of a run: the terminal as SVG, and the spans of one request as bars over time."""

from __future__ import annotations

import re
from html import escape
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

ROW_PX: Final = 17
LEFT_PX: Final = 250
WIDE_PX: Final = 640
TOP_PX: Final = 64
COLOURS: Final = {
    "person": "#6b7280",
    "orchestrator": "#2563eb",
    "robotic": "#d97706",
    "vision": "#059669",
    "config": "#7c3aed",
    "point": "#db2777",
}
OTHER: Final = "#0e7490"
"""Colour of the cell's own processes: identity provider, tool server, gateway."""
_FETCHED: Final = re.compile(r"\s*@font-face \{.*?\}", re.DOTALL)
SHOWN: Final = ("request", "work of", "admit", "hand on", "execute_tool", "ztpm.decide", "ztpm.effect")
"""Beginnings of the names of those spans that a picture shows; the protocols between them are left out."""


def terminal(console: Console, title: str) -> str:
    """Picture (SVG) of all that was printed to a recording console; it fetches no font.

    Args:
        console: made with `record=True`.
        title: of the window.
    """
    return _FETCHED.sub("", console.export_svg(title=title))


def bars(spans: Sequence[dict[str, Any]], title: str) -> str:
    """Spans of one trace as an SVG picture: a row each, indented under its parent, coloured by process.

    Args:
        spans: as `System.spans` gives them.
        title: over the picture.
    """
    named = [each for each in spans if str(each["name"]).startswith(SHOWN)]
    kept = [each for each in named if "ask_" not in str(each["name"])]  # `hand on` says the same
    begin = min(int(each["start_ns"]) for each in spans)
    whole = max(int(each["end_ns"]) for each in spans) - begin or 1
    depth: dict[str, int] = {}
    parents = {each["span"]: each["parent"] for each in spans}
    known = {each["span"] for each in kept}
    rows = []
    for place, each in enumerate(kept):
        parent = each["parent"]
        while parent is not None and parent not in known:
            parent = parents.get(parent)
        depth[each["span"]] = 0 if parent is None else depth.get(parent, 0) + 1
        rows.append(_row(each, place, depth[each["span"]], begin=begin, whole=whole))
    high = TOP_PX + ROW_PX * len(kept) + 20
    services = list(dict.fromkeys(str(each["service"]).removeprefix("ztpm-") for each in kept))
    legend = "".join(
        f'<rect x="{14 + at * 120}" y="34" width="10" height="10" rx="2" fill="{COLOURS.get(name, OTHER)}"/>'
        f'<text x="{29 + at * 120}" y="43">{escape(name)}</text>'
        for at, name in enumerate(services)
    )
    width = max(LEFT_PX + WIDE_PX + 90, 40 + 120 * len(services))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{high}" viewBox="0 0 {width} {high}" '
        f'font-family="DejaVu Sans, Arial, sans-serif" font-size="11" fill="#111827">'
        f'<rect width="100%" height="100%" fill="#ffffff"/>'
        f'<text x="14" y="22" font-size="14" font-weight="bold">{escape(title)}</text>{legend}{"".join(rows)}</svg>\n'
    )


def _row(span: dict[str, Any], place: int, depth: int, *, begin: int, whole: int) -> str:
    service, y = str(span["service"]).removeprefix("ztpm-"), TOP_PX + place * ROW_PX
    start, end = (int(span[name]) - begin for name in ("start_ns", "end_ns"))
    x, wide = LEFT_PX + start / whole * WIDE_PX, max(2.0, (end - start) / whole * WIDE_PX)
    reason = str(span["attributes"].get("ztpm.reason", ""))
    refused = bool(reason) and reason not in ("PERMITTED", "None")
    colour = "#dc2626" if refused else COLOURS.get(service, OTHER)
    name = escape(str(span["name"])[: max(8, 38 - 2 * depth)])
    said = f"{(end - start) / 1e6:.0f} ms" + (f" {escape(reason)}" if refused else "")
    return (
        f'<text x="{14 + depth * 9}" y="{y + 10}">{name}</text>'
        f'<rect x="{x:.1f}" y="{y}" width="{wide:.1f}" height="{ROW_PX - 5}" rx="2" fill="{colour}"/>'
        f'<text x="{x + wide + 4:.1f}" y="{y + 10}" font-size="9" fill="#6b7280">{said}</text>'
    )
