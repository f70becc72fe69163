"""A run as one picture: decisions and token sizes over the depth of the chain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.absent import package
from evaluation.tokens.cell import Kind
from evaluation.tokens.peers.ours import NAME as OURS
from evaluation.tokens.peers.tenuo import NAME as TENUO
from evaluation.tokens.workload import REALISTIC

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from evaluation.tokens.bench import Result

_STYLE: Final = {
    OURS: ("#0b5cad", "o"),
    TENUO: ("#c8441b", "s"),
    "aip": ("#7a5195", "^"),
    "biscuit": ("#3f8f5b", "D"),
    "macaroons": ("#8c8c8c", "v"),
    "pyjwt-act": ("#b58900", "P"),
}
_OTHER: Final = ("#444444", "x")


def plot(result: Result, file: Path) -> None:
    """The picture of a run, written to `file` as PNG.

    Raises:
        AbsentError: without matplotlib.
    """
    matplotlib, _ = package("matplotlib", "matplotlib")
    matplotlib.use("Agg")
    plots, _ = package("matplotlib.pyplot", "matplotlib")
    figure, (cold, warm, size) = plots.subplots(1, 3, figsize=(14, 5.2), constrained_layout=True)
    warm.sharey(cold)
    depths = sorted({one.depth for one in result.sizes})
    _durations(cold, result, depths, (Kind.COLD,), "Wire bytes, never seen, to a decision")
    _durations(warm, result, depths, (Kind.WARM, Kind.STREAM), "A further request under a token seen before")
    _sizes(size, result, depths)
    lines = {line.get_label(): line for axes in (cold, warm, size) for line in axes.get_lines()}
    known = [name for name in (*_STYLE, *lines) if name in lines and not name.startswith("_")]
    shown = list(dict.fromkeys(known))
    hollow = plots.Line2D([], [], color="#444444", marker="o", mfc="white", linestyle="--", label="no proof checked")
    figure.legend(
        handles=[lines[name] for name in shown] + [hollow],
        loc="outside lower center",
        ncols=len(shown) + 1,
        frameon=False,
    )
    machine = result.machine
    figure.suptitle(
        f"Capability tokens, {REALISTIC.name} scope: {len(REALISTIC.operations)} operations, {REALISTIC.limits} limits"
        f"\n{machine['processor']}, {machine['cores']} cores, Python {machine['python']}",
        fontsize=11,
    )
    figure.savefig(file, dpi=150)
    plots.close(figure)


def _durations(axes: Any, result: Result, depths: Sequence[int], kinds: tuple[Kind, ...], title: str) -> None:
    """Medians over depth, solid with a proof and dashed without, on a logarithmic axis."""
    of_scope = [row for row in result.rows if row.scope == REALISTIC.name and row.p50_us is not None]
    for peer in result.versions:
        colour, marker = _STYLE.get(peer, _OTHER)
        for kind in kinds:
            for proof in (True, False):
                by = {r.depth: r.p50_us for r in of_scope if (r.peer, r.kind, r.proof) == (peer, kind, proof)}
                at = [depths.index(depth) for depth in depths if depth in by]
                style = ":" if kind is Kind.STREAM else "-" if proof else "--"
                label = f"{peer}, stream" if kind is Kind.STREAM else peer if proof else f"_{peer}"
                if at:
                    axes.plot(
                        at,
                        [by[depths[i]] for i in at],
                        color=colour,
                        marker=marker,
                        mfc=colour if proof else "white",
                        linestyle=style,
                        linewidth=2 if peer in {OURS, TENUO} else 1.2,
                        label=label,
                    )
    axes.set_yscale("log")
    _label(axes, depths, title, "median, µs")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:,.0f}" if f"{value:.0e}"[0] in "25" else "")


def _sizes(axes: Any, result: Result, depths: Sequence[int]) -> None:
    for peer in result.versions:
        colour, marker = _STYLE.get(peer, _OTHER)
        of_peer = {s.depth: s.bytes for s in result.sizes if (s.peer, s.scope) == (peer, REALISTIC.name)}
        at = [i for i, depth in enumerate(depths) if of_peer.get(depth) is not None]
        width = 2 if peer in {OURS, TENUO} else 1.2
        axes.plot(at, [of_peer[depths[i]] for i in at], color=colour, marker=marker, linewidth=width, label=peer)
    _label(axes, depths, "Token on the wire, before base64", "bytes")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.set_ylim(bottom=0)


def _label(axes: Any, depths: Sequence[int], title: str, unit: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("hops after the first holder")
    axes.set_ylabel(unit)
    axes.set_xticks(range(len(depths)), [str(depth) for depth in depths])
    axes.grid(which="both", axis="y", linewidth=0.3)
    axes.spines[["top", "right"]].set_visible(False)
