"""The ways to compile, for the whole kernel."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, TypeVar, cast

# Read by numba when it is imported: a higher level took half as long again to compile and made nothing faster.
os.environ.setdefault("NUMBA_OPT", "1")

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

LANES: Final = 8
"""Places that a loop goes through side by side, which a processor then takes several of at once.

Such a loop ends at a number that is known only when it runs, or it would be written out instead. It works on flat
arrays in rows of `LANES`: who compiles has to know how far apart they are to know that none is written over another.
"""

_made: Final = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)


@cache
def _sources() -> str:
    """SHA-256 (hex) of all that machine code of the kernel is made from."""
    room = Path(str(files("pep.pit")))
    texts = [part.read_bytes() for part in sorted(room.rglob("*.py"))]
    return hashlib.sha256(b"".join(hashlib.sha256(text).digest() for text in texts)).hexdigest()


def compiled(function: F) -> F:
    """The function as machine code for other compiled functions, and made anew with whatever calls it.

    What was kept on disk could not be merged into its callers, who would pay more for the call than for what it does.

    Loops that are hot take the arrays out of their named tuples first: each access to one counts references, which
    costs more than what is done with a number of it. Division by zero gives what IEEE 754 says, as in numpy. No
    fast-math: the bounds rest on the order of operations.
    """
    return cast("F", _made(no_cpython_wrapper=True)(function))


def lent(function: F) -> F:
    """The same for what only uses the arrays that it is given, and neither makes nor returns one.

    It counts no references, which its callers hold: around a call that computes one distance they would cost more than
    the distance. Numba refuses to compile it when it makes an array.
    """
    return cast("F", _made(no_cpython_wrapper=True, _nrt=False)(function))


def merged(function: F) -> F:
    """The same again, written out where it is called: for what is called with many arrays, since all are copied."""
    return cast("F", _made(no_cpython_wrapper=True, _nrt=False, inline="always")(function))


def entry(function: F) -> F:
    """The same for what Python calls, kept on disk where there is a place for it.

    It runs without the interpreter's lock. What is kept is of these sources of the whole room: numba itself would look
    at the file of this one function, and run machine code of laws that have changed since.
    """
    try:
        kept: Any = _made(cache=True)(function)
    except RuntimeError:  # nowhere to keep it: compiled anew at each start
        return cast("F", _made()(function))
    kept._cache._cache_file._source_stamp = _sources()  # noqa: SLF001 - numba has no other way to say it
    return cast("F", kept)
