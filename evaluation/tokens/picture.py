"""A run as one picture: decisions and token sizes over the depth of the chain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.picture import sheet
from evaluation.tokens.cell import Kind
from evaluation.tokens.peers.ours import NAME as OURS
from evaluation.tokens.peers.tenuo import NAME as TENUO
from evaluation.tokens.workload import REALISTIC

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from evaluation.harness.bench import Result
    from evaluation.tokens.cell import TokenKey

_STYLE: Final = {
    OURS: ("#0b5cad", "o"),
    TENUO: ("#c8441b", "s"),
    "aip": ("#7a5195", "^"),
    "biscuit": ("#3f8f5b", "D"),
    "macaroons": ("#8c8c8c", "v"),
    "pyjwt-act": ("#b58900", "P"),
}
_OTHER: Final = ("#444444", "x")


def draw(result: Result[TokenKey], file: Path) -> None:
    """The picture of a run, written to `file` as PNG.

    Raises:
        AbsentError: without matplotlib.
    """
    title = (
        f"Capability tokens, {REALISTIC.name} scope: {len(REALISTIC.operations)} operations, {REALISTIC.limits} limits"
    )
    sizes = [size for size in result.more["sizes"] if size["scope"] == REALISTIC.name]
    depths = sorted({size["depth"] for size in sizes})
    with sheet(file, title, result.machine, inches=(14, 5.2), columns=3) as (figure, (cold, warm, size)):
        warm.sharey(cold)
        _durations(cold, result, depths, (Kind.COLD,), "Wire bytes, never seen, to a decision")
        _durations(warm, result, depths, (Kind.WARM, Kind.STREAM), "A further request under a token seen before")
        for peer in result.versions:
            _line(size, depths, {one["depth"]: one["bytes"] for one in sizes if one["peer"] == peer}, peer, peer)
        _label(size, depths, "Token on the wire, before base64", "bytes")
        size.set_ylim(bottom=0)
        lines = {line.get_label(): line for axes in (cold, warm, size) for line in axes.get_lines()}
        shown = [name for name in dict.fromkeys((*_STYLE, *lines)) if name in lines and not name.startswith("_")]
        (hollow,) = size.plot(
            [], [], color="#444444", marker="o", mfc="white", linestyle="--", label="no proof checked"
        )
        figure.legend(
            handles=[*(lines[name] for name in shown), hollow],
            loc="outside lower center",
            ncols=len(shown) + 1,
            frameon=False,
        )


def _durations(axes: Any, result: Result[TokenKey], depths: Sequence[int], kinds: Iterable[Kind], title: str) -> None:
    """Medians over depth, solid with a proof and dashed without, on a logarithmic axis."""
    rows = [row for row in result.rows if row.of.scope == REALISTIC.name]
    for peer in result.versions:
        for kind in kinds:
            for proof in (True, False):
                key = (peer, kind, proof)
                by = {row.of.depth: row.p50_us for row in rows if (row.of.peer, row.of.kind, row.of.proof) == key}
                label = f"{peer}, stream" if kind is Kind.STREAM else peer if proof else f"_{peer}"
                hollow = {} if proof else {"mfc": "white"}
                style = ":" if kind is Kind.STREAM else "-" if proof else "--"
                _line(axes, depths, by, peer, label, linestyle=style, **hollow)
    axes.set_yscale("log")
    _label(axes, depths, title, "median, µs")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:,.0f}" if f"{value:.0e}"[0] in "25" else "")


def _line(axes: Any, depths: Sequence[int], by: dict[Any, Any], peer: str, label: str, **style: Any) -> None:
    """One peer's figures over depth, where there are any."""
    colour, marker = _STYLE.get(peer, _OTHER)
    at = [place for place, depth in enumerate(depths) if by.get(depth) is not None]
    if at:
        width = 2 if peer in {OURS, TENUO} else 1.2
        figures = [by[depths[place]] for place in at]
        axes.plot(at, figures, color=colour, marker=marker, linewidth=width, label=label, **style)


def _label(axes: Any, depths: Sequence[int], title: str, unit: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("hops after the first holder")
    axes.set_ylabel(unit)
    axes.set_xticks(range(len(depths)), [str(depth) for depth in depths])
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.grid(which="both", axis="y", linewidth=0.3)
    axes.spines[["top", "right"]].set_visible(False)
