"""Python's collector of garbage, which looks at all that a process has built at start again and again."""

from __future__ import annotations

import gc
from functools import cache


@cache
def spare_what_stands() -> None:
    """Leaves all objects that there are now out of later collections; once in a process.

    All that an enforcement point loads and builds at start stays as long as it does. A full collection over it took
    60 ms to 135 ms in a tool server, and takes 4 ms since (docs/benchmarks.md). Garbage is collected before. A process
    whose collector is off is left as it is.
    """
    if gc.isenabled():
        gc.collect()
        gc.freeze()
