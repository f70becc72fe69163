"""Recording of a told story as one SVG picture that moves: the terminal's lines, each when it came.

The picture fetches nothing and runs no script; a reader who wants less motion sees its end.
"""

from __future__ import annotations

import io
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.style import Style

WIDTH: Final = 110
"""Columns, from which on a step has its sentence beside its figures."""
ROWS: Final = 26
LASTS_S: Final = 60.0
"""Length of the picture, of a long story and a short one."""
STANDS_S: Final = 6.0
"""Time for which its end is shown before it begins again."""
COLUMN, ROW, SIZE, EDGE = 7.83, 18.0, 13.0, 16.0
"""Pixels of a character, a line, its letters, and the frame."""
PAPER, INK, FAINT = "#14171c", "#d7dae0", "#8b93a1"
COLOURS: Final = {1: "#f07178", 2: "#7ec77b", 3: "#f2c66d", 4: "#7fb4f0"}
"""Red, green, yellow and blue, by the number that a terminal has them under."""


class Recording:
    """Console whose lines are kept with their times.

    Args:
        clock: monotonic, seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._file = io.StringIO()
        self._lines: list[tuple[float, str]] = []
        self._began_s = clock()
        self.console = Console(
            file=self._file, width=WIDTH, force_terminal=True, color_system="standard", highlight=False
        )

    def look(self) -> None:
        """Takes the lines that came since the last look, as of now."""
        at_s = self._clock() - self._began_s
        *whole, rest = self._file.getvalue().split("\n")
        self._lines += [(at_s, line) for line in whole]
        self._file.seek(0)
        self._file.truncate()
        self._file.write(rest)

    def svg(self) -> str:
        """The picture of all lines so far, one at least."""
        self.look()
        width, height = 2 * EDGE + WIDTH * COLUMN, 2 * EDGE + ROWS * ROW
        shown = "".join(
            f'<text y="{EDGE + (row + 1) * ROW - 5:.0f}">{"".join(_runs(Text.from_ansi(line)))}</text>\n'
            for row, (_, line) in enumerate(self._lines)
        )
        last = _up(len(self._lines))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" role="img"'
            f' aria-label="The terminal while ztpm demo runs, in {LASTS_S:.0f} seconds">\n<style>\n'
            f"text {{ font: {SIZE:.0f}px ui-monospace, Menlo, Consolas, 'DejaVu Sans Mono', monospace; fill: {INK};"
            " white-space: pre }\n"
            f"@keyframes told {{ {self._frames()} }}\n"
            f"#lines {{ transform: translateY({last}px) }}\n"
            "@media not (prefers-reduced-motion: reduce) "
            f"{{ #lines {{ animation: told {LASTS_S + STANDS_S:.0f}s step-end infinite }} }}\n"
            f'</style>\n<rect width="100%" height="100%" rx="8" fill="{PAPER}"/>\n'
            f'<clipPath id="window"><rect x="0" y="{EDGE}" width="{width:.0f}" height="{ROWS * ROW:.0f}"/></clipPath>\n'
            f'<g clip-path="url(#window)"><g id="lines">\n{shown}</g></g>\n</svg>\n'
        )

    def _frames(self) -> str:
        first_s, last_s = self._lines[0][0], self._lines[-1][0]
        scale = 100 * LASTS_S / (LASTS_S + STANDS_S) / ((last_s - first_s) or 1.0)
        frames = {round((at_s - first_s) * scale, 2): _up(count) for count, (at_s, _) in enumerate(self._lines, 1)}
        return " ".join(f"{part}% {{ transform: translateY({up}px) }}" for part, up in frames.items())


def _up(count: int) -> str:
    """Pixels by which so many lines are moved, so that the last one stands in the window's last row."""
    return f"{(ROWS - count) * ROW:.0f}"


def _runs(line: Text) -> Iterator[str]:
    """Runs of one style, each at its column."""
    marks = sorted({0, len(line), *(at for span in line.spans for at in (span.start, span.end))})
    console = Console(color_system="standard")
    for start, end in pairwise(marks):
        words = line.plain[start:end]
        if words.strip():
            style = line.get_style_at_offset(console, start)
            yield f'<tspan x="{EDGE + start * COLUMN:.1f}"{_looks(style)}>{escape(words)}</tspan>'


def _looks(style: Style) -> str:
    number = None if style.color is None else style.color.number
    colour = FAINT if style.dim else COLOURS.get(-1 if number is None else number, "")
    return (f' fill="{colour}"' if colour else "") + (' font-weight="bold"' if style.bold else "")
