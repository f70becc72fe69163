"""A picture of an assessment as PNG: from above, from the side and from a corner."""

from __future__ import annotations

import importlib
import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.pit.scene.scene import Box
from ztpm.pit_picture import COLOURS, MICRO_PER_MILLI, corners
from ztpm.pit_picture_views import ABOVE, aslant, frame, level, outline, patches_of, rgb_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ztpm.pit_picture import Picture
    from ztpm.pit_picture_views import Camera, Flat, Patch

PAPER: Final = "#ffffff"
INK: Final = "#1c2733"
FAINT: Final = "#8b98a5"
SOFT: Final = "#4a5763"
EDGED: Final = 0.3
"""An outline that is less opaque than this may lie below a label."""
SIZE_INCH: Final = (16.0, 9.4)


class NoMatplotlibError(RuntimeError):
    """The drawing library is not installed."""


def draw(shown: Picture, file: Path, *, subtitle: str) -> None:
    """The picture, written to `file`.

    Raises:
        NoMatplotlibError: without matplotlib.
        OSError: the file cannot be written.
    """
    try:
        matplotlib: Any = importlib.import_module("matplotlib")
        matplotlib.use("Agg")
        plots: Any = importlib.import_module("matplotlib.pyplot")
        collections: Any = importlib.import_module("matplotlib.collections")
    except ImportError as error:
        raise NoMatplotlibError("a PNG needs matplotlib: pip install 'ztpm[viz]'") from error
    figure = plots.figure(figsize=SIZE_INCH, facecolor=PAPER)
    grid = figure.add_gridspec(
        2, 2, width_ratios=(1, 1.7), left=0.045, right=0.985, top=0.865, bottom=0.135, wspace=0.08, hspace=0.27
    )
    side = level(shown)
    for place, camera, name, units in (
        (grid[0, 0], ABOVE, "from above", ("x, m", "y, m")),
        (grid[1, 0], side, "from the side, level", ("to the right, m", "z, m")),
        (grid[:, 1], aslant(side), "from a corner", None),
    ):
        axes = figure.add_subplot(place)
        axes.set_title(name, loc="left", fontsize=11, color=SOFT)
        patches = sorted(patches_of(shown, camera), key=lambda patch: patch.depth)
        axes.add_collection(
            collections.PolyCollection(
                [patch.outline for patch in patches],
                facecolors=[patch.fill for patch in patches],
                edgecolors=[patch.edge for patch in patches],
                linewidths=0.7,
                zorder=2,
            )
        )
        _view(axes, shown, camera, patches)
        _scale(axes, camera, units)
    figure.text(0.045, 0.945, _short(shown.title, 110), fontsize=19, fontweight="bold", color=INK, parse_math=False)
    figure.text(0.045, 0.912, _short(subtitle, 190), fontsize=11.5, color=SOFT, parse_math=False)
    _legend(figure, plots, shown)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")  # a name in another script
        figure.savefig(file, dpi=110, format="png", metadata={"Software": None})
    plots.close(figure)


# --- one view --------------------------------------------------------------------------------------------------------


def _view(axes: Any, shown: Picture, camera: Camera, patches: Sequence[Patch]) -> None:
    """Lines, points and names over the outlines."""
    _workspace(axes, shown, camera)
    _path_of_the_tip(axes, shown, camera)
    place = axes.get_position()
    ratio = place.width * SIZE_INCH[0] / (place.height * SIZE_INCH[1])
    limits = frame(shown, camera, ratio, whole=camera.eye[2] not in (0.0, 1.0))
    (left, bottom), (right, top) = limits
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    named = _names(axes, shown, camera, limits)
    drawn = [point for patch in patches if patch.edge[3] >= EDGED for point in patch.outline]
    _pairs(axes, shown, camera, limits, _Taken(drawn, named))


def _scale(axes: Any, camera: Camera, units: tuple[str, str] | None) -> None:
    """Metres along both edges, or the base's axes where there are no such edges."""
    if units is None:
        axes.set_axis_off()
        _axes_cross(axes, camera)
        return
    axes.set_xlabel(units[0], fontsize=9)
    axes.set_ylabel(units[1], fontsize=9)
    axes.tick_params(labelsize=8, colors=SOFT)
    axes.grid(visible=True, color="#e6eaee", linewidth=0.8, zorder=0)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color("#cfd6dc")


def _workspace(axes: Any, shown: Picture, camera: Camera) -> None:
    if shown.workspace is None:
        return
    low, high = shown.workspace
    middle = tuple(0.5 * (x + y) for x, y in zip(low, high, strict=True))
    half = tuple(0.5 * (y - x) for x, y in zip(low, high, strict=True))
    at = corners(Box((middle[0], middle[1], middle[2]), (half[0], half[1], half[2])))
    for k in range(8):
        for bit in (1, 2, 4):
            if not k & bit:
                (x0, y0), (x1, y1) = camera.flat(at[k]), camera.flat(at[k | bit])
                axes.plot(
                    (x0, x1), (y0, y1), color=COLOURS["workspace"], linewidth=1.0, linestyle=(0, (5, 4)), zorder=1
                )


def _path_of_the_tip(axes: Any, shown: Picture, camera: Camera) -> None:
    """Where the tool point goes, from a ring at the start to an arrow at the end."""
    points = [camera.flat(posture.tcp_m) for posture in shown.postures]
    if len(points) < 2:
        return
    x, y = zip(*points, strict=True)
    axes.plot(x, y, color=INK, linewidth=1.6, zorder=6)
    axes.plot(x[0], y[0], "o", color=PAPER, markeredgecolor=INK, markersize=6, zorder=7)
    if math.hypot(x[-1] - x[-4], y[-1] - y[-4]) > 1e-3:
        arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.6, "mutation_scale": 15}
        axes.annotate("", (x[-1], y[-1]), (x[-4], y[-4]), arrowprops=arrow, zorder=7)


@dataclass(frozen=True, slots=True)
class _Taken:
    """Where a label should not lie: points of outlines, and middles of other labels."""

    drawn: list[Flat]
    named: list[Flat]


def _pairs(axes: Any, shown: Picture, camera: Camera, limits: tuple[Flat, Flat], taken: _Taken) -> None:
    """The nearest points of what decides, and of what else is met at that instant."""
    colour = COLOURS["witness"]
    leading = shown.witnesses[:1]
    for witness in (w for w in shown.witnesses if w.posture == leading[0].posture):
        (x0, y0), (x1, y1) = camera.flat(witness.near.on_part_m), camera.flat(witness.near.on_thing_m)
        first = witness is leading[0]
        alpha = 1 if first else 0.4
        axes.plot((x0, x1), (y0, y1), color=colour, linewidth=2.4 if first else 1, zorder=8, alpha=alpha)
        axes.plot((x0, x1), (y0, y1), "o", color=colour, markersize=5 if first else 3, zorder=8, alpha=alpha)
    for witness in leading:
        a, b = camera.flat(witness.near.on_part_m), camera.flat(witness.near.on_thing_m)
        middle = (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]))
        axes.annotate(
            f"{witness.contribution.clearance_um / MICRO_PER_MILLI:.0f} mm",
            middle,
            xytext=_free(middle, limits, taken),
            ha="center",
            va="center",
            fontsize=12,
            fontweight="bold",
            color=colour,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": PAPER, "edgecolor": colour, "linewidth": 1.1},
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 1.0},
            zorder=12,
        )


def _free(middle: Flat, limits: tuple[Flat, Flat], taken: _Taken) -> Flat:
    """A place near `middle` for a label that covers as little as can be of what is drawn there."""
    (left, bottom), (right, top) = limits
    across, high = right - left, top - bottom
    wide, tall = 0.075 * across, 0.05 * high

    def cost(at: Flat) -> float:
        inside = left + wide <= at[0] <= right - wide and bottom + tall <= at[1] <= top - tall
        covered = sum(abs(x - at[0]) < wide and abs(y - at[1]) < tall for x, y in taken.drawn)
        covered += 100 * sum(abs(x - at[0]) < 2 * wide and abs(y - at[1]) < 2 * tall for x, y in taken.named)
        return covered + 40 * math.dist(at, middle) / across + (0 if inside else 1e6)

    ways = [(r, math.pi * k / 12) for r in (0.12, 0.17, 0.23, 0.3) for k in range(24)]
    return min(((middle[0] + r * across * math.cos(w), middle[1] + r * high * math.sin(w)) for r, w in ways), key=cost)


def _names(axes: Any, shown: Picture, camera: Camera, limits: tuple[Flat, Flat]) -> list[Flat]:
    """One name for each person and zone, above it in this view; of each object, below it. Where they are."""
    ends: dict[str, Flat] = {}
    kinds: dict[str, str] = {}
    told: dict[str, str] = {}
    for body in shown.bodies:
        name = body.name.split("/")[0] if body.kind == "person" else body.name
        sign = 1 if body.kind in ("person", "zone") else -1
        for x, y in outline(body.shape, camera):
            if name not in ends or sign * y > sign * ends[name][1]:
                ends[name] = (x, y)
        kinds[name], told[name] = body.kind, body.told
    (left, bottom), (right, top) = limits
    edge = 0.06 * (top - bottom)
    places: list[Flat] = []
    for name, (x, y) in ends.items():
        if not left < x < right:
            continue
        at = (x, min(max(y, bottom + edge), top - edge))
        above = kinds[name] in ("person", "zone")
        axes.annotate(
            _said(name, told[name]), at, xytext=(0, 4 if above else -4), textcoords="offset points", ha="center",
            va="bottom" if above else "top", fontsize=9, color=INK, zorder=11, parse_math=False,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": PAPER, "edgecolor": COLOURS[kinds[name]], "alpha": 0.85},
        )  # fmt: skip
        places.append((x, at[1] + (0.5 if above else -0.5) * edge))
    return places


def _said(name: str, told: str) -> str:
    """A name, and who says so."""
    return f"{_short(name)} ({_short(told)})" if told else _short(name)


def _short(text: str, limit: int = 24) -> str:
    kept = "".join(c if c.isprintable() else "?" for c in text)
    return kept if len(kept) <= limit else f"{kept[: limit - 1]}…"


def _axes_cross(axes: Any, camera: Camera) -> None:
    """The base's axes, 0.25 m long."""
    for way, colour, name in (
        ((0.25, 0.0, 0.0), "#b03030", "x"), ((0.0, 0.25, 0.0), "#2e8b57", "y"), ((0.0, 0.0, 0.25), "#3455b0", "z"),
    ):  # fmt: skip
        x, y = camera.flat(way)
        axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.3}, zorder=9)
        axes.annotate(name, (x, y), fontsize=9, color=colour, zorder=9, ha="left", va="bottom")


def _legend(figure: Any, plots: Any, shown: Picture) -> None:
    patch = importlib.import_module("matplotlib.patches").Patch
    kinds = [*dict.fromkeys(shown.parts), *dict.fromkeys(body.kind for body in shown.bodies)]
    words = {"base": "base", "arm": "arm", "tool": "tool", "payload": "held object", "zone": "zone"}
    handles = [
        patch(facecolor=COLOURS[kind], edgecolor=INK, alpha=0.35 if kind == "zone" else 1, label=words.get(kind, kind))
        for kind in kinds
    ]
    if len(shown.postures) > 1:
        handles.append(patch(facecolor=(*rgb_of(COLOURS["arm"]), 0.40), edgecolor=FAINT, label="at start and end"))
        handles.append(patch(facecolor=(*rgb_of(COLOURS["arm"]), 0.12), edgecolor=FAINT, label="swept path"))
        handles.append(plots.Line2D([], [], color=INK, marker="o", mfc=PAPER, label="tool point, from start to end"))
    if shown.witnesses:
        handles.append(
            plots.Line2D([], [], color=COLOURS["witness"], marker="o", label="nearest points where it decides")
        )
    if shown.workspace is not None:
        handles.append(plots.Line2D([], [], color=COLOURS["workspace"], linestyle="--", label="workspace"))
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 6), frameon=False, fontsize=10.5)
