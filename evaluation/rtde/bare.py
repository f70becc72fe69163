"""Gateway whose streams ask no physics: the cost of reading, judging and writing a value without it.

    python -m evaluation.rtde.bare --config gateway.toml --robot HOST

Everything else is the gateway's own: the lease and its carriage, the line, grants and limits of each value, the watch.
It moves a simulated arm through anything.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pep.world.cell_stream import Judged, Shown
from ztpm.point import gateway_server

if TYPE_CHECKING:
    from collections.abc import Sequence

NOTHING = Judged(0, (), 0.0, 0.0)


class Unjudged:
    """Stream without physics, in place of `pep.world.cell_stream.CellStream`."""

    def __init__(self, **_: Any) -> None:
        pass

    def see(self, q_rad: Sequence[float]) -> Shown:  # noqa: ARG002 - the signature of the replaced method
        """View that is always fresh."""
        return Shown(0, None)

    def judge(self, *_: Any, **__: Any) -> Judged:
        """No impact."""
        return NOTHING

    def strays(self, *_: Any) -> str:
        """Nothing is above a bound."""
        return ""


def main() -> None:
    """Command line of the gateway that judges nothing."""
    gateway_server.main(Unjudged)


if __name__ == "__main__":
    main()
