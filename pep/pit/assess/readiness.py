"""Compilation of everything that a question about physics needs, before any time is counted."""

from __future__ import annotations

from functools import cache

from pep.pit.search.engine import NUMPY, chosen


@cache
def compile_all() -> None:
    """Compile every function of the kernel, or read what was compiled before."""
    if chosen() is NUMPY:
        return
    from pep.pit.second import compiled_sight

    compiled_sight.compile_all()
