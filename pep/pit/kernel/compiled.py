"""Two ways to compile, for the whole kernel."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, cast

# Read by numba when it is imported: a higher level took half as long again to compile and made nothing faster.
os.environ.setdefault("NUMBA_OPT", "1")

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def _kept(function: F, **how: bool) -> F:
    compile_it = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True, **how)
    try:
        return cast("F", compile_it(cache=True)(function))
    except RuntimeError:  # nowhere to keep it: compiled anew at each start
        return cast("F", compile_it()(function))


def compiled(function: F) -> F:
    """The function as machine code for other compiled functions, kept on disk where there is a place for it.

    Loops that are hot take the arrays out of their named tuples first: each access to one counts references, which
    costs more than what is done with a number of it. Division by zero gives what IEEE 754 says, as in numpy. No
    fast-math: the bounds rest on the order of operations.
    """
    return _kept(function, no_cpython_wrapper=True)


def entry(function: F) -> F:
    """The same for what Python calls. It runs without the interpreter's lock."""
    return _kept(function)
