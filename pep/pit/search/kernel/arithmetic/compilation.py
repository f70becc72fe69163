"""Forms of compilation for the whole kernel."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar, cast

# Read by numba when it is imported: a higher level took half as long again to compile and made nothing faster.
os.environ.setdefault("NUMBA_OPT", "1")

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

from pep.pit.search.kernel.arithmetic.code_digest import digest_of

F = TypeVar("F", bound=Callable[..., Any])

NAMED: Final = 16  # characters of a digest in the name of a file
LANES: Final = 8
"""Places that a loop goes through side by side, several of which a processor takes at once.

Such a loop ends at a number that is known only when it runs, or it would be written out instead. It works on flat
arrays in rows of `LANES`: who compiles has to know how far apart they are to know that none is written over another.
"""

ENTRIES: Final[list[Any]] = []
"""All entries for Python, as numba's dispatchers."""

_made: Final = partial(njit, nogil=True, error_model="numpy", no_cfunc_wrapper=True)


class _Files(IndexDataCacheFile):
    """Index and machine code of one function; an index of lost types counts as none, and is compiled anew."""

    def _load_index(self) -> Any:
        try:
            found: Any = super()  # numba is not typed
            return found._load_index()  # noqa: SLF001 - numba has no other door
        except Exception:  # noqa: BLE001 - unpickling raises as the types that it names see fit
            return {}


class _Kept(FunctionCache):
    """Machine code on disk, found by the digest of its sources.

    Numba itself would look at the file of the one function, and run machine code of laws that have changed since.
    """

    @property
    def _cache_file(self) -> Any:
        function, place = self._py_func, Path(self._cache_path)
        whose, digest = f"{Path(function.__code__.co_filename).stem}.{function.__qualname__}", digest_of(function)
        name = f"{whose}-{digest[:NAMED]}.py{sys.version_info[0]}{sys.version_info[1]}"
        made: Any = _Files
        return made(cache_path=str(place), filename_base=name, source_stamp=digest)

    @_cache_file.setter
    def _cache_file(self, by_line: Any) -> None:
        """File of numba's own cache, which is not used."""


def compiled(function: F) -> F:
    """The function as machine code for other compiled functions, made anew with each caller.

    Machine code from disk could not be merged into its callers, who would pay more for the call than for its work.

    Hot loops take the arrays out of their named tuples first: each access to one counts references, which costs more
    than the work on one of its numbers. Division by zero follows IEEE 754, as in numpy. No fast-math: the bounds rest
    on the order of operations.
    """
    return cast("F", _made(no_cpython_wrapper=True)(function))


def lent(function: F) -> F:
    """The same for a function that only uses its array arguments, and neither makes nor returns one.

    It counts no references, which its callers hold: around a call that computes one distance they would cost more than
    the distance. Numba refuses to compile it when it makes an array.
    """
    return cast("F", _made(no_cpython_wrapper=True, _nrt=False)(function))


def merged(function: F) -> F:
    """The same again, written out at each call, for functions with many arrays, since all are copied."""
    return cast("F", _made(no_cpython_wrapper=True, _nrt=False, inline="always")(function))


def entry(function: F) -> F:
    """The same for a function that Python calls, kept on disk where there is a place for it.

    It runs without the interpreter's lock.
    """
    made: Any = _made()(function)
    with suppress(RuntimeError):  # nowhere to keep it: compiled anew at each start
        kept: Any = _Kept  # likewise
        made._cache = kept(function)  # noqa: SLF001 - numba has no other way to say it
    ENTRIES.append(made)
    return cast("F", made)
