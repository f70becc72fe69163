"""Forms of compilation for the whole kernel."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar, cast

# Read by numba when it is imported: a higher level took half as long again to compile and made nothing faster.
os.environ.setdefault("NUMBA_OPT", "1")

from llvmlite.binding import parse_assembly
from numba import njit
from numba.core import types
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys

from pep.pit.search.kernel.arithmetic.code_digest import OPTIONS, digest_of

F = TypeVar("F", bound=Callable[..., Any])

NAMED: Final = 16  # characters of a digest in the name of a file
LANES: Final = 8
"""Places that a loop goes through side by side, several of which a processor takes at once.

Such a loop ends at a number that is known only when it runs, or it would be written out instead. It works on flat
arrays in rows of `LANES`: who compiles has to know how far apart they are to know that none is written over another.
"""

ENTRIES: Final[list[Any]] = []
"""All entries for Python, as numba's dispatchers."""

_made: Final = partial(njit, **OPTIONS)


class _NowhereToRun:
    """Stands for the place where machine code runs, of what is never emitted by itself."""

    def set_env(self, name: str, environment: object) -> None:
        """Ignored: nothing is there that would look for its environment."""


class _Part(JITCodeLibrary):
    """The code of a function that only compiled ones call: it becomes machine code as part of them alone.

    Numba itself would optimise and emit each function by itself first, with all that it calls, level by level.
    """

    codegen = _NowhereToRun()

    def get_pointer_to_function(self, name: str) -> int:
        """No address, as of all that Python cannot call."""
        del name
        self._ensure_finalized()
        return 0

    def _get_module_for_linking(self) -> Any:
        """The code, of which each caller takes a copy along; numba itself would copy it once more before."""
        if self._shared_module is None:
            self._ensure_finalized()
            self._shared_module = self._final_module
            for function in self._shared_module.functions:
                if not function.is_declaration and function.linkage.name == "external":
                    function.linkage = "linkonce_odr"
        return self._shared_module

    def _optimize_final_module(self) -> None:
        """Left to who calls it."""

    def _finalize_final_module(self) -> None:
        """Ready to be linked."""
        self._finalize_dynamic_globals()
        self._finalized = True


class _Whole(JITCodeLibrary):
    """The code of a function that Python calls.

    On disk it has its machine code and the names in it. Numba itself would keep all of the code besides, for functions
    that merge it, and read it again at each start; nothing compiled calls these.
    """

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Name, form, and the machine code with a module of the same names."""
        name, form, (machine_code, _) = super().serialize_using_object_code()
        made = self._final_module
        functions = (each.name for each in made.functions if not each.is_declaration)
        variables = (each.name for each in made.global_variables if not each.is_declaration)
        lines = [f'define void @"{each}"() {{ unreachable }}' for each in functions]
        lines += [f'@"{each}" = global i8 0' for each in variables]
        return name, form, (machine_code, parse_assembly("\n".join(lines)).as_bitcode())


@contextmanager
def _parts_beside() -> Iterator[None]:
    """Compilations by numba itself in this block make no machine code of their own either."""
    context = cpu_target.target_context
    context.refresh()
    rtsys.initialize(context)  # emitted: it is called by its address
    codegen = context.codegen()
    codegen._library_class = _Part  # noqa: SLF001 - numba has no other way to say it
    try:
        yield
    finally:
        codegen._library_class = JITCodeLibrary  # noqa: SLF001


class _WholeCompiler(Compiler):
    """Compiles functions that Python calls; of what numba has to compile for them beside, only parts."""

    def compile_extra(self, function: Any) -> Any:
        """As numba's own."""
        with _parts_beside():
            return super().compile_extra(function)

    def define_pipelines(self) -> Any:
        """As numba's own, into a library that becomes machine code."""
        state = self.state
        state.library = _Whole(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class _PartCompiler(Compiler):
    """Compiles functions that only compiled ones call."""

    def define_pipelines(self) -> Any:
        """As numba's own, into a `_Part`."""
        state = self.state
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        return super().define_pipelines()


def _part(function: Callable[..., Any], **options: Any) -> Any:
    """The function for other compiled ones, once for each kind of numbers: a constant is one of its kind."""
    made: Any = _made(no_cpython_wrapper=True, pipeline_class=_PartCompiler, **options)(function)
    template = made.get_call_template
    made.get_call_template = lambda args, kws: template([types.unliteral(arg) for arg in args], kws)
    return made


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
    return cast("F", _part(function))


def lent(function: F) -> F:
    """The same for a function that only uses its array arguments, and neither makes nor returns one.

    It counts no references, which its callers hold: around a call that computes one distance they would cost more than
    the distance. Numba refuses to compile it when it makes an array.
    """
    return cast("F", _part(function, _nrt=False))


def entry(function: F) -> F:
    """The same for a function that Python calls, kept on disk where there is a place for it.

    It runs without the interpreter's lock.
    """
    made: Any = _made(pipeline_class=_WholeCompiler)(function)
    with suppress(RuntimeError):  # nowhere to keep it: compiled anew at each start
        kept: Any = _Kept  # likewise
        made._cache = kept(function)  # noqa: SLF001 - numba has no other way to say it
    ENTRIES.append(made)
    return cast("F", made)
