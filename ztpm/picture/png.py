"""Picture of a cell or an assessment as PNG: from above, the side and a corner, drawn by matplotlib."""

from __future__ import annotations

import importlib
import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from capabilities.values.characters import shown
from pep.pit.picture.words import MICRO_PER_MILLI, sentence
from ztpm.picture.bodies import CELL_M, COLOURS, bodies_of, extent, triangles_of

if TYPE_CHECKING:
    from pathlib import Path

    from pep.pit.base.motion import Floats
    from pep.pit.picture.picture import Picture
    from ztpm.picture.bodies import Filled

PAPER, INK, FAINT, SOFT = "#ffffff", "#1c2733", "#8b98a5", "#4a5763"
TIERS: Final = ("#566270", "#18703a", "#7d6200", "#a84600", "#b3261e")
"""Colours of the tiers, as in `console.css`."""
SIZE_INCH: Final = (16.0, 9.4)
EDGE: Final = 0.045
"""Edge left and right of words, a share of the figure's width."""
ARROW: Final = 0.004
"""Length of the arrow at the end of the tool point's way, a share of the view."""
ZOOM: Final = (1.42, 1.2)
"""Size of a level view in its axes, and of the one from a corner."""
CELL_ZOOM: Final = (1.3, 1.0)
"""The same for a cell, of which nothing is cut off."""
STEPS_M: Final = ((2.5, 0.25), (5.0, 0.5), (math.inf, 2.0))
"""Extent up to which a level view's scale has this step."""
LETTER_PT, LINE_PT = 5.4, 17.0
"""Width of a letter and height of a label, points."""
AWAY: Final = 78.0
"""Points between a gap's middle and the label with its width."""


class NoMatplotlibError(RuntimeError):
    """The drawing library is not installed."""


@dataclass(frozen=True, slots=True)
class View:
    """A direction of view, degrees as matplotlib counts them: the eye's height and its way round from +x."""

    name: str
    elevation: float
    azimuth: float

    @property
    def eye(self) -> Floats:
        """Unit vector towards the eye."""
        e, a = math.radians(self.elevation), math.radians(self.azimuth)
        return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def plots_in_space() -> Any:
    """Plots of matplotlib into files, in three dimensions.

    Raises:
        NoMatplotlibError: without matplotlib.
    """
    try:
        matplotlib: Any = importlib.import_module("matplotlib")
        matplotlib.use("Agg")
        plots = importlib.import_module("matplotlib.pyplot")
        importlib.import_module("mpl_toolkits.mplot3d")
    except ImportError as error:
        raise NoMatplotlibError("a PNG needs matplotlib: pip install 'ztpm[viz]'") from error
    return plots


def draw(shown: Picture, file: Path, *, subtitle: str) -> None:
    """Draws the picture and writes it to `file`.

    Raises:
        NoMatplotlibError: without matplotlib.
        OSError: the file cannot be written.
    """
    plots = plots_in_space()
    figure = plots.figure(figsize=SIZE_INCH, facecolor=PAPER)
    bodies = list(bodies_of(shown))
    level = level_azimuth(shown)
    for view, place in (
        (View("from above", 90.0, -90.0), (0.0, 0.51, 0.40, 0.37)),
        (View("from the side, level", 0.0, level), (0.0, 0.095, 0.40, 0.37)),
        (View("from a corner", 26.0, level + 34.0), (0.38, 0.09, 0.61, 0.79)),
    ):
        axes = figure.add_axes(place, projection="3d", computed_zorder=False, proj_type="ortho", facecolor=PAPER)
        top = place[1] + place[3] + (0.012 if view.elevation == 0 else -0.012)
        figure.text(
            place[0] + 0.045,
            top,
            view.name,
            fontsize=11,
            color=SOFT,
        )
        _draw_view(axes, shown, view, bodies)
    _legend(figure, plots, shown)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")  # a name in another script
        _heading(figure, shown, subtitle)
        figure.savefig(file, dpi=160, format="png", metadata={"Software": None})
    plots.close(figure)


def _heading(figure: Any, shown: Picture, subtitle: str) -> None:
    """The index large, its tier, and what decides in words; of a cell its name. Words are broken, never cut."""
    left, said = EDGE, shown.assessment
    words = shown.title
    if said is not None:
        words = sentence(said)
        words = f"{words[:1].upper()}{words[1:]}."
        number = figure.text(left, 0.985, f"{said.index:.2f}", va="top", fontsize=38, fontweight="bold", color=INK)
        left += number.get_window_extent().width / figure.bbox.width + 0.012
        tier = int(said.tier)
        box = {"boxstyle": "round,pad=0.3", "facecolor": TIERS[tier], "edgecolor": "none"}
        chip = figure.text(left, 0.977, f"Tier {tier}", va="top", fontsize=13, fontweight="bold", color=PAPER, bbox=box)
        figure.text(left, 0.943, "index", va="top", fontsize=11, color=SOFT)
        left += chip.get_window_extent().width / figure.bbox.width + 0.018
    said_lines = lines_of(figure, words, 17.0, 1.0 - EDGE - left, most=2)
    figure.text(
        left, 0.978, said_lines, va="top", fontsize=17, fontweight="bold", color=INK, parse_math=False, linespacing=1.25
    )
    figure.text(
        EDGE, 0.908, lines_of(figure, subtitle, 11.0, 1.0 - 2 * EDGE, most=2),
        va="top", fontsize=11, color=SOFT, parse_math=False,
    )  # fmt: skip


def lines_of(figure: Any, text: str, size_pt: float, width: float, *, most: int) -> str:
    """The text in lines that fit a share of the figure's width; an ellipsis stands for the rest.

    Args:
        figure: that it will stand on.
        text: as others wrote it.
        size_pt: height of its letters, points.
        width: of a line, as a share of the figure's.
        most: greatest number of lines.
    """
    ruler = figure.text(0, 0, "", fontsize=size_pt, fontweight="bold", parse_math=False)
    widest = width * figure.bbox.width

    def fits(line: str) -> bool:
        ruler.set_text(line)
        return bool(ruler.get_window_extent().width <= widest)

    lines, line = [], ""
    for word in shown(text).split(" "):
        longer = f"{line} {word}".strip()
        if line and not fits(longer):
            lines.append(line)
            longer = word
        while not fits(longer):  # one word that is wider than a line
            part = next(n for n in range(len(longer) - 1, 0, -1) if fits(longer[:n]) or n == 1)
            lines.append(longer[:part])
            longer = longer[part:]
        line = longer
    lines.append(line)
    if len(lines) > most:
        kept = lines[most - 1]
        while kept and not fits(f"{kept}…"):
            kept = kept[:-1]
        lines = [*lines[: most - 1], f"{kept}…"]
    ruler.remove()
    return "\n".join(lines)


def level_azimuth(shown: Picture) -> float:
    """Azimuth from which the first witness's gap is seen in full, level, +x to the right; else -y. Degrees."""
    for witness in shown.witnesses:
        (x0, y0, _), (x1, y1, _) = witness.near.on_part_m, witness.near.on_thing_m
        if math.hypot(x1 - x0, y1 - y0) > 0.02:
            azimuth = math.degrees(math.atan2(y1 - y0, x1 - x0)) - 90.0
            return azimuth + 180.0 if math.sin(math.radians(azimuth)) > 0 else azimuth
    return -90.0


# --- one view --------------------------------------------------------------------------------------------------------


def _draw_view(axes: Any, shown: Picture, view: View, bodies: list[Filled]) -> None:
    collection = importlib.import_module("mpl_toolkits.mplot3d.art3d").Poly3DCollection
    corner = 0.0 < view.elevation < 90.0
    low, high = extent(shown, whole=corner)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.view_init(elev=view.elevation, azim=view.azimuth)
    axes.set_box_aspect(high - low, zoom=(CELL_ZOOM if shown.assessment is None else ZOOM)[corner])
    _scale(axes, corner=corner)
    turned = [body.normals @ view.eye > 0 for body in bodies]
    if bodies:
        faces = np.concatenate([body.triangles[seen] for body, seen in zip(bodies, turned, strict=True)])
        colours = np.concatenate([body.colours[seen] for body, seen in zip(bodies, turned, strict=True)])
        inside = ((faces >= low) & (faces <= high)).all(axis=(1, 2))
        fill = colours[inside]
        # Seams between opaque pieces are drawn over in their own colour; others are too faint to see.
        line = np.column_stack([fill[:, :3], fill[:, 3] >= 1])
        axes.add_collection3d(collection(faces[inside], facecolors=fill, edgecolors=line, linewidths=0.4, zorder=2))
    _lines(axes, shown)
    named = _names(axes, shown, low, high)
    _gap(axes, shown, named)


def _scale(axes: Any, *, corner: bool) -> None:
    """Scale of a level view in metres along the edges; in the other one the base's axes."""
    if corner:
        axes.set_axis_off()
        for way, colour, name in zip(0.25 * np.eye(3), ("#b03030", "#2e8b57", "#3455b0"), "xyz", strict=True):
            axes.quiver(0, 0, 0, *way, color=colour, linewidth=1.3, arrow_length_ratio=0.15, zorder=9)
            axes.text(*(1.1 * way), name, color=colour, fontsize=9, zorder=9)
        return
    for axis, name in ((axes.xaxis, "x, m"), (axes.yaxis, "y, m"), (axes.zaxis, "z, m")):
        axis.pane.set(facecolor=PAPER, edgecolor="#cfd6dc")
        far = max(axes.get_w_lims()[1::2]) - min(axes.get_w_lims()[0::2])
        step = next(step for most, step in STEPS_M if far < most)
        axis.set_major_locator(importlib.import_module("matplotlib.ticker").MultipleLocator(step))
        axis.set_tick_params(labelsize=7, colors=SOFT, pad=-1)
        axis.set_label_text(name, fontsize=9)
        axis.labelpad = -5
        axis._axinfo["grid"].update(color="#e6eaee", linewidth=0.8)  # noqa: SLF001 - matplotlib has no other way
    for axis in (axes.zaxis,) if axes.elev else (axes.xaxis, axes.yaxis):
        axis.set_ticks([])
        axis.set_label_text("")


def _lines(axes: Any, shown: Picture) -> None:
    """Draws the workspace, the tool point's way, and the nearest points of contributions."""
    if shown.workspace is not None:
        ends = np.array(shown.workspace)
        at = [ends[[k & 1, k >> 1 & 1, k >> 2], [0, 1, 2]] for k in range(8)]
        for k, bit in ((k, bit) for k in range(8) for bit in (1, 2, 4) if not k & bit):
            axes.plot(*zip(at[k], at[k | bit], strict=True), color=COLOURS["workspace"], lw=1, ls=(0, (5, 4)), zorder=1)
    tips = [posture.tcp_m for posture in shown.postures]
    if len(tips) > 1:
        axes.plot(*zip(*tips, strict=True), color=INK, linewidth=1.6, zorder=6)
        axes.plot(*([x] for x in tips[0]), "o", color=PAPER, markeredgecolor=INK, markersize=6, zorder=7)
        end, *earlier = (_flat(axes, tip) for tip in reversed(tips))
        arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.6, "mutation_scale": 15}
        for before in [place for place in earlier if math.dist(place, end) > ARROW][:1]:
            axes.annotate("", end, before, arrowprops=arrow, zorder=7)
    for witness in (w for w in shown.witnesses if w.posture == shown.witnesses[0].posture):
        ends, first = np.array([witness.near.on_part_m, witness.near.on_thing_m]).T, witness is shown.witnesses[0]
        look = {"alpha": 1.0 if first else 0.4, "linewidth": 2.4 if first else 1, "markersize": 5 if first else 3}
        axes.plot(*ends, "-o", color=COLOURS["witness"], zorder=8, **look)


def _flat(axes: Any, point: object) -> tuple[float, float]:
    """Point in the view's own plane."""
    project = importlib.import_module("mpl_toolkits.mplot3d.proj3d").proj_transform
    x, y, _ = project(*np.asarray(point, dtype=float), axes.get_proj())
    return float(x), float(y)


def _names(axes: Any, shown: Picture, low: Floats, high: Floats) -> list[tuple[float, float]]:
    """Draws each body's name at its highest or lowest visible place; returns the places."""
    points: dict[tuple[str, str, str, bool], list[Floats]] = {}
    for body in shown.bodies:
        name = body.name.split("/")[0] if body.kind == "person" else body.name
        visible = points.setdefault((name, body.kind, body.told, body.armless), [])
        visible += [each.reshape(-1, 3) for each in triangles_of(body.shape, CELL_M)]
    places: list[tuple[float, float]] = []
    labels: list[tuple[float, float, float]] = []
    for (name, kind, told, armless), each in points.items():
        every = np.concatenate(each)
        inside = every[((every >= low) & (every <= high)).all(axis=1)]
        if len(inside):
            above = kind in ("person", "zone")
            flat = np.array([_flat(axes, point) for point in inside[:: max(1, len(inside) // 400)]])
            x, y = flat[flat[:, 1].argmax() if above else flat[:, 1].argmin()]
            said = f"{_short(name)} ({_short(told)})" if told else _short(name)
            said += ", arms not seen" if armless else ""
            box = {"boxstyle": "round,pad=0.15", "facecolor": PAPER, "edgecolor": COLOURS[kind], "alpha": 0.85}
            up = _free(axes, (x, y), LETTER_PT * len(said), labels, above=above)
            axes.annotate(
                said, (x, y), (0, up), textcoords="offset points", ha="center", va="center",
                fontsize=9, color=INK, bbox=box, zorder=11, parse_math=False,
            )  # fmt: skip
            places.append((x, y))
    return places


def _free(
    axes: Any, place: tuple[float, float], wide: float, labels: list[tuple[float, float, float]], *, above: bool
) -> float:
    """Offset of a label from its place, points: above or below, past those that are there; adds it to them."""
    x, y = axes.transData.transform(place) * 72 / axes.figure.dpi
    way = 1 if above else -1
    up = 9.0 * way
    while any(abs(x - a) < (wide + w) / 2 and abs(y + up - b) < LINE_PT for a, b, w in labels):
        up += LINE_PT * way
    labels.append((float(x), float(y + up), wide))
    return up


def _gap(axes: Any, shown: Picture, taken: list[tuple[float, float]]) -> None:
    """Draws the width of the deciding gap, on its side with the most room."""
    for witness in shown.witnesses[:1]:
        postures = (shown.postures[0], shown.postures[witness.posture], shown.postures[-1])
        drawn = [_flat(axes, end) for p in postures for part in p.parts for end in (part.a_m, part.b_m)]
        x, y = _flat(axes, np.mean([witness.near.on_part_m, witness.near.on_thing_m], axis=0))
        ways = [(math.cos(k * math.pi / 8), math.sin(k * math.pi / 8)) for k in range(16)]
        far = AWAY * np.array(ways)
        places = axes.transData.inverted().transform(axes.transData.transform((x, y)) + far * axes.figure.dpi / 72)
        room = [min(math.dist(place, each) for each in (*drawn, *taken)) for place in places]
        colour = COLOURS["witness"]
        axes.annotate(
            f"{witness.contribution.clearance_um / MICRO_PER_MILLI:.0f} mm", (x, y), far[int(np.argmax(room))],
            textcoords="offset points", ha="center", va="center", fontsize=12, fontweight="bold", color=colour,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": PAPER, "edgecolor": colour, "linewidth": 1.1},
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 1.0}, zorder=12,
        )  # fmt: skip


def _short(text: str, limit: int = 24) -> str:
    kept = shown(text)
    return kept if len(kept) <= limit else f"{kept[: limit - 1]}…"


def _legend(figure: Any, plots: Any, shown: Picture) -> None:
    patch = importlib.import_module("matplotlib.patches").Patch
    kinds = [*dict.fromkeys(shown.parts), *dict.fromkeys(body.kind for body in shown.bodies)]
    handles = [
        patch(
            facecolor=COLOURS[kind],
            edgecolor=INK,
            alpha=0.35 if kind == "zone" else 1,
            label={"payload": "held object"}.get(kind, kind),
        )
        for kind in kinds
    ]
    if len(shown.postures) > 1:
        arm = COLOURS["arm"]
        handles += [patch(facecolor=f"{arm}66", edgecolor=FAINT, label="at start and end")]
        handles += [patch(facecolor=f"{arm}1f", edgecolor=FAINT, label="swept path")]
        handles += [plots.Line2D([], [], color=INK, marker="o", mfc=PAPER, label="tool point, from start to end")]
    if shown.witnesses:
        nearest = "nearest points where it decides"
        handles += [plots.Line2D([], [], color=COLOURS["witness"], marker="o", label=nearest)]
    if shown.workspace is not None:
        handles += [plots.Line2D([], [], color=COLOURS["workspace"], linestyle="--", label="workspace")]
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 6), frameon=False, fontsize=10.5)
