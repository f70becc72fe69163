"""Specification and tests, read both ways: every clause has a test, every test of tokens a clause.

A clause is an id in bold in docs/spec.md; a numbered item of a list below one is a rule of it, `TOK-6.3`. A test names
clauses with `@pytest.mark.clause("TOK-6.3", ...)`, all tests of a module with `pytestmark`. A test that shows none says
why: `clause(reason="...")`.
"""

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

TESTS = Path(__file__).parents[1]
SPEC = (TESTS.parent / "docs" / "spec.md").read_text()
ID = re.compile(r"\*\*\[([A-Z]{3,4}-\d+)\]")
TOKEN_PARTS = ("## 1. ", "## 4. ")
"""Parts 1 to 3: from the first of these headings up to the second."""


# --- the specification -----------------------------------------------------------------------------------------------


def clauses(spec: str) -> list[str]:
    """Ids in order, each rule of a list after the clause that the list is of."""
    found = []
    above = ""
    for line in spec.splitlines():
        if line.startswith("#"):
            above = ""
        for match in ID.finditer(line):
            above = match[1]
            found.append(above)
        rule = re.match(r"(\d+)\. ", line)
        if rule and above:
            found.append(f"{above}.{rule[1]}")
    return found


def demanding(spec: str) -> list[str]:
    """Paragraphs and items of lists with a MUST and no id of their own.

    A rule of a list has the id of its number.
    """
    pieces = re.split(r"\n\n|\n(?=\* )", spec)
    return [piece for piece in pieces if "MUST" in piece and not ID.search(piece) and not re.match(r"\d+\. ", piece)]


# --- the tests -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Named:
    """Clauses that one test names, or its reason for naming none."""

    module: str
    test: str
    ids: tuple[str, ...]
    reasons: tuple[str, ...]


def named(module: str, source: str) -> list[Named]:
    """Every test of a module with what it and its module name."""
    tree = ast.parse(source)
    shared = []
    for node in tree.body:
        if isinstance(node, ast.Assign) and [ast.unparse(each) for each in node.targets] == ["pytestmark"]:
            shared += node.value.elts if isinstance(node.value, ast.List) else [node.value]
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            own = [mark for mark in map(read_mark, node.decorator_list) if mark]
            # A test that says why it names none is no test of what its module names.
            marks = own or [mark for mark in map(read_mark, shared) if mark]
            ids = tuple(name for ids, _ in marks for name in ids)
            found.append(Named(module, node.name, ids, tuple(reason for _, reason in marks if reason)))
    return found


def read_mark(node: ast.expr) -> tuple[tuple[str, ...], str | None] | None:
    """Ids and reason of a `pytest.mark.clause(...)`; None for anything else."""
    if not isinstance(node, ast.Call) or ast.unparse(node.func) != "pytest.mark.clause":
        return None
    ids = tuple(ast.literal_eval(each) for each in node.args)
    reasons = {each.arg: ast.literal_eval(each.value) for each in node.keywords}
    assert set(reasons) <= {"reason"}, ast.unparse(node)
    return ids, reasons.get("reason")


@cache
def everything() -> tuple[Named, ...]:
    return tuple(
        test
        for path in sorted(TESTS.rglob("test_*.py"))
        for test in named(str(path.relative_to(TESTS)), path.read_text())
    )


# --- both ways -------------------------------------------------------------------------------------------------------


def test_every_clause_has_one_place() -> None:
    found = clauses(SPEC)
    assert len(found) == len(set(found))
    assert {f"TOK-{n}" for n in range(1, 13)} <= set(found)
    assert {f"TOK-6.{n}" for n in range(1, 10)} <= set(found)


def test_every_must_of_the_token_parts_has_a_clause() -> None:
    start, end = (SPEC.index(f"\n{heading}") for heading in TOKEN_PARTS)
    assert demanding(SPEC[start:end]) == []


def test_every_clause_is_named_by_a_test() -> None:
    shown = {name for test in everything() for name in test.ids}
    assert [name for name in clauses(SPEC) if name not in shown and not any_rule(name, shown)] == []


def any_rule(name: str, shown: set[str]) -> bool:
    """True where a clause is shown by its rules: then it need not be named as a whole."""
    return any(other.startswith(f"{name}.") for other in shown)


def test_every_name_is_that_of_a_clause() -> None:
    known = set(clauses(SPEC))
    assert [(test.module, test.test, name) for test in everything() for name in test.ids if name not in known] == []


def test_every_test_of_tokens_names_a_clause_or_says_why_not() -> None:
    mute = [
        f"{test.module}: {test.test}"
        for test in everything()
        if test.module.startswith("capabilities/") and not test.ids and not any(map(str.strip, test.reasons))
    ]
    assert mute == []


def test_nobody_names_a_clause_and_says_that_it_names_none() -> None:
    assert [(test.module, test.test) for test in everything() if test.ids and test.reasons] == []


# --- the reading itself ----------------------------------------------------------------------------------------------


def test_the_specification_is_read() -> None:
    spec = "## 1. A\n* **[VAL-1] x** MUST. **[VAL-2]** y\n* MUST z\n\n1. no rule\n\n"
    spec += "**[TOK-6] c.** d:\n\n1. e\n2. f MUST\n\n## 2. B\n1. g\n"
    assert clauses(spec) == ["VAL-1", "VAL-2", "VAL-2.1", "TOK-6", "TOK-6.1", "TOK-6.2"]
    assert demanding(spec) == ["* MUST z"]


MODULE = """
import pytest
pytestmark = {marks}

@pytest.mark.clause("A-1", "A-2")
@pytest.mark.parametrize("x", [1])
def test_one(x): ...

def test_two(): ...

@pytest.mark.clause(reason="r")
def test_three(): ...

class TestMore:
    @pytest.mark.clause("A-3")
    async def test_four(self): ...

@pytest.mark.clause("A-4")
def no_test(): ...
"""


@pytest.mark.parametrize(
    ("marks", "shared"),
    [
        ('pytest.mark.clause("B-1")', (("B-1",), ())),
        ('[pytest.mark.e2e, pytest.mark.clause("B-1", "B-2")]', (("B-1", "B-2"), ())),
        ('pytest.mark.clause(reason="s")', ((), ("s",))),
        ("pytest.mark.e2e", ((), ())),
    ],
)
def test_the_marks_are_read(marks: str, shared: tuple) -> None:
    found = {test.test: (test.ids, test.reasons) for test in named("m", MODULE.format(marks=marks))}
    assert found == {
        "test_one": (("A-1", "A-2"), ()),
        "test_two": shared,
        "test_three": ((), ("r",)),
        "test_four": (("A-3",), ()),
    }
