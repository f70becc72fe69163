"""Compilation: each function once, for all constants, and machine code only for those that Python calls."""

import json
import subprocess
import sys

import numpy as np
from numba.core.caching import NullCache
from pep.pit.search.kernel.arithmetic.compilation import ENTRIES, compiled, entry
from pep.pit.search.kernel.arithmetic.copying import copy_into


@compiled
def inner(numbers, at):
    return numbers[at] * 2.0


@entry
def outer(numbers, at):
    return inner(numbers, 0) + inner(numbers, 1) + inner(numbers, at)


@entry
def copied(wide, narrow):
    copy_into(wide, narrow)


for each in (outer, copied):
    ENTRIES.remove(each)  # an entry of a test, and none of the kernel
    each._cache = NullCache()  # compiled here each time: what is read from disk compiles no inner one


def test_a_function_is_compiled_once_for_all_constants():
    assert outer(np.array([1.0, 2.0, 4.0]), 2) == 14.0
    assert len(inner.overloads) == 1


def test_an_inner_function_becomes_machine_code_in_its_callers_alone():
    outer(np.array([1.0, 2.0, 4.0]), 2)
    (made,) = inner.overloads.values()
    assert made.library.get_pointer_to_function(made.fndesc.llvm_func_name) == 0
    (whole,) = outer.overloads.values()
    assert whole.library.get_pointer_to_function(whole.fndesc.llvm_func_name) != 0


SIGNATURES = """
import json
from pep.pit.search.engine import chosen
from pep.pit.search.kernel.arithmetic.compilation import ENTRIES
chosen()
print(json.dumps({each.py_func.__qualname__: len(each.signatures) for each in ENTRIES}))
"""


def test_every_entry_of_the_kernel_has_one_signature():
    """In a process of its own: tests call entries with arrays of other layouts."""
    told = subprocess.run([sys.executable, "-c", SIGNATURES], capture_output=True, text=True, timeout=280, check=True)
    signatures = json.loads(told.stdout)
    assert len(signatures) > 10
    assert {name: number for name, number in signatures.items() if number != 1} == {}


def test_rows_are_copied_and_those_behind_them_stay():
    for shape in ((3,), (3, 2), (3, 2, 2)):
        wide, narrow = np.zeros((5, *shape[1:])), np.arange(float(np.prod(shape))).reshape(shape)
        copied(wide, narrow)
        assert (wide[:3] == narrow).all()
        assert (wide[3:] == 0).all()
