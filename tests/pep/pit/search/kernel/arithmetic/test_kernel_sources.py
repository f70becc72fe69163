"""Machine code that is kept is found by what it was made from: by that, and by nothing else."""

import pickle
import types

import pytest
from pep.pit.search.engine import chosen
from pep.pit.search.kernel.arithmetic.code_digest import digest_of
from pep.pit.search.kernel.arithmetic.compilation import ENTRIES, compiled

from pep.pit.search.kernel.arithmetic import code_digest, compilation

SOURCE = '''
"""Prose."""
LIMIT = 1.5
NAMES = ("a", 2)

@compiled
def inner(x):
    """More prose."""
    return x + LIMIT

@compiled
def other(x):
    return x + 7.0

@entry
def outer(x):
    return inner(x) * 2.0 + NAMES[1]
'''


def made(text):
    """The digest of `outer` in a module of this text."""
    module = types.ModuleType("pep.pit.invented")
    vars(module).update(compiled=compiled, entry=lambda function: function)
    exec(compile(text, "invented.py", "exec"), vars(module))  # noqa: S102 - our own text
    return digest_of(module.outer)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("LIMIT = 1.5", "LIMIT = 1.5000000000000002"),
        ("x + LIMIT", "x - LIMIT"),
        ("* 2.0", "* 3.0"),
        ('("a", 2)', '("a", 3)'),
        ("@compiled\ndef inner", "@compiled\ndef inner_", ),
    ],
)  # fmt: skip
def test_whatever_enters_machine_code_changes_its_digest(before, after):
    text = SOURCE.replace(before, after)
    if "inner_" in after:
        text = text.replace("inner(x)", "inner_(x)").replace("inner__", "inner_")
    assert made(text) != made(SOURCE)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('"""Prose."""', '"""Other prose,\n\non more lines."""'),
        ("More prose", "Less"),
        ("x + 7.0", "x + 8.0"),
        ("LIMIT = 1.5", "LIMIT = 1.5  # why"),
    ],
)
def test_prose_lines_and_what_is_not_called_change_nothing(before, after):
    assert made(SOURCE.replace(before, after)) == made(SOURCE)


def test_how_an_inner_function_is_compiled_counts():
    other = SOURCE.replace("@compiled\ndef inner", "@lent\ndef inner").replace(
        "LIMIT = 1.5", "LIMIT = 1.5\nlent = compiled"
    )
    assert made(other) == made(SOURCE)
    text = "from pep.pit.search.kernel.arithmetic.compilation import lent\n" + SOURCE.replace(
        "@compiled\ndef inner", "@lent\ndef inner"
    )
    assert made(text) != made(SOURCE)


def test_how_every_function_is_compiled_counts(monkeypatch):
    before = made(SOURCE)
    monkeypatch.setitem(code_digest.OPTIONS, "error_model", "python")
    assert made(SOURCE) != before


def test_every_entry_of_the_kernel_has_a_digest_of_its_own_and_a_file_named_by_it():
    chosen()
    digests = {each.py_func.__qualname__ + each.py_func.__module__: digest_of(each.py_func) for each in ENTRIES}
    assert len(set(digests.values())) == len(ENTRIES) > 10
    for each in ENTRIES:
        assert digest_of(each.py_func)[:16] in each._cache._cache_file._index_name


def test_a_constant_of_another_module_counts(monkeypatch):
    from pep.pit.search.kernel import straight_halving
    from pep.pit.search.kernel.arithmetic import core_distance

    before = digest_of(straight_halving.examined.py_func)
    monkeypatch.setattr(core_distance, "ROUNDING_M", core_distance.ROUNDING_M * 2)
    assert digest_of(straight_halving.examined.py_func) != before


def test_an_index_of_types_that_are_gone_is_as_none(tmp_path):
    """A named tuple was renamed: code compiled for the old one is compiled anew, and no start fails."""
    files = compilation._Files(cache_path=str(tmp_path), filename_base="entry", source_stamp="digest")
    files.save(("a key",), {"machine": "code"})
    index = tmp_path / "entry.nbi"
    assert files.load(("a key",)) == {"machine": "code"}
    version = index.read_bytes()[: -len(pickle.dumps(("digest", {("a key",): "entry.1.nbc"}), protocol=-1))]
    index.write_bytes(version + b"cpep.pit.search.kernel.arithmetic.compilation\nGone\n.")
    assert files.load(("a key",)) is None
