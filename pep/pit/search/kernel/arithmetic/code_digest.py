"""Digest of the sources of a function's machine code: its instructions, and the values they name.

Prose, line numbers and code that is not called play no part, so machine code outlives their changes.
"""

from __future__ import annotations

import hashlib
import os
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

OPTIONS: Final = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Options of numba with which every function is compiled."""

OURS = "pep."
"""Prefix of modules whose members count.

Of others only the names do, since numba keeps its own version.
"""


def digest_of(function: FunctionType) -> str:
    """SHA-256 (hex) of the function, of all functions that it calls and of all numbers that they name."""
    parts = dict(_parts(function, {}))
    text = "\n".join(f"{name}: {parts[name]}" for name in sorted(parts))
    return hashlib.sha256(f"{os.environ['NUMBA_OPT']} {OPTIONS}\n{text}".encode()).hexdigest()


def _parts(function: FunctionType, seen: dict[int, str], options: object = None) -> Iterator[tuple[str, str]]:
    """Content of each function, by name."""
    seen[id(function)] = name = f"{function.__module__}.{function.__qualname__}"
    told: list[str] = [repr(options), repr(function.__defaults__)]
    names: set[str] = set()
    for code in _codes(function.__code__, function.__doc__, told):
        names.update(code.co_names)
    for each in sorted(names & function.__globals__.keys()):
        value = function.__globals__[each]
        members = [(each, value)]
        if isinstance(value, ModuleType) and value.__name__.startswith(OURS):
            members = [(f"{each}.{member}", vars(value)[member]) for member in sorted(names & vars(value).keys())]
        for called, member in members:
            inner = getattr(member, "py_func", None)
            if isinstance(inner, FunctionType):
                told.append(f"{called} = {inner.__module__}.{inner.__qualname__}")
                if id(inner) not in seen:
                    yield from _parts(inner, seen, member.targetoptions)
            else:
                told.append(f"{called} = {_value(member)}")
    yield name, repr(told)


def _codes(code: CodeType, doc: str | None, told: list[str]) -> Iterator[CodeType]:
    """The code and all code inside of it; the content of each is added to `told`."""
    consts = code.co_consts[1:] if doc is not None and code.co_consts[:1] == (doc,) else code.co_consts
    plain = [const for const in consts if not isinstance(const, CodeType)]
    told += [code.co_code.hex(), repr(code.co_names), repr(code.co_varnames), repr(plain), code.co_exceptiontable.hex()]
    yield code
    for const in consts:
        if isinstance(const, CodeType):
            yield from _codes(const, None, told)


def _value(value: Any) -> str:
    """A number, a text or a type as it enters machine code.

    Raises:
        TypeError: a value of which this knows no text.
    """
    if isinstance(value, tuple):
        return f"({', '.join(map(_value, value))})"
    if value is None or isinstance(value, bool | int | str):
        return repr(value)
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, type):
        return f"{value.__module__}.{value.__qualname__} {getattr(value, '_fields', '')}"
    if isinstance(value, ModuleType):
        return value.__name__
    if callable(value) and hasattr(value, "__qualname__"):
        return f"{value.__module__}.{value.__qualname__}"
    raise TypeError(f"no text for {value!r}")
