"""Picture of a number over time as SVG, made here so that no script draws it. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from markupsafe import Markup, escape

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

WIDTH: Final = 640
HEIGHT: Final = 200
LEFT, RIGHT, TOP, BOTTOM = 36, 150, 10, 26
"""Room around the lines, in the units of the picture."""
FULL: Final = 1_000
"""Highest value, in permille."""
LINES: Final = 6
"""Most lines of one picture, each with a class of its own."""


def stairs(
    lines: Mapping[str, Sequence[tuple[int, int]]], *, levels: Mapping[str, int], begin: str, end: str, label: str
) -> Markup:
    """A picture of values that hold until the next one, from 0 to `FULL` permille.

    Args:
        lines: for each name its (time, value) pairs in order; the first `LINES` are drawn.
        levels: values that are drawn as lines across, with their names.
        begin: time at the left edge, in words.
        end: at the right one.
        label: sentence that says the whole to who does not see it.
    """
    every = [at for points in lines.values() for at, _ in points]
    first, last = (min(every), max(every)) if every else (0, 1)
    parts = [
        Markup('<svg class="plot" viewBox="0 0 {} {}" role="img" aria-label="{}">').format(WIDTH, HEIGHT, label),
        *(_level(name, value) for name, value in levels.items()),
        *(_axis(value) for value in (0, FULL // 2, FULL)),
        *(_line(number, points, first, last) for number, points in enumerate(list(lines.values())[:LINES])),
        Markup('<text x="{}" y="{}">{}</text>').format(LEFT, HEIGHT - 6, begin),
        Markup('<text class="end" x="{}" y="{}">{}</text>').format(WIDTH - RIGHT, HEIGHT - 6, end),
        Markup("</svg>"),
    ]
    return Markup("").join(parts)


def _x(at: int, first: int, last: int) -> float:
    return round(LEFT + (WIDTH - LEFT - RIGHT) * (at - first) / max(1, last - first), 1)


def _y(value: int) -> float:
    return round(TOP + (HEIGHT - TOP - BOTTOM) * (1 - min(max(value, 0), FULL) / FULL), 1)


def _axis(value: int) -> Markup:
    return Markup('<text class="axis" x="{}" y="{}">{}</text>').format(LEFT - 6, _y(value) + 4, f"{value / FULL:.1f}")


def _level(name: str, value: int) -> Markup:
    return Markup('<g class="level"><path d="M{} {}H{}"/><text x="{}" y="{}">{}</text></g>').format(
        LEFT, _y(value), WIDTH - RIGHT, WIDTH - RIGHT + 6, _y(value) + 4, escape(name)
    )


def _line(number: int, points: Sequence[tuple[int, int]], first: int, last: int) -> Markup:
    if not points:
        return Markup("")
    (at, value), *rest = points
    steps = "".join(f"H{_x(when, first, last)}V{_y(now)}" for when, now in rest)
    path = f"M{_x(at, first, last)} {_y(value)}{steps}"
    return Markup('<path class="line line-{}" d="{}"/>').format(number, path)
