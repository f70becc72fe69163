"""A number in the physics room stands beside its source: a bare literal is a fault."""

import ast
from pathlib import Path

import pytest

import pep.pit

ROOM = Path(pep.pit.__file__).parent
PLAIN = {0, 1, 2, 3, 4, 0.5}  # structure: signs, halves, squares, space, and the corners of the index
COMPILED = {ROOM / "base/pair_columns.py", ROOM / "second/compiled_sight.py", *(ROOM / "search/kernel").rglob("*.py")}
"""Their integers are the columns and dimensions of arrays; the figures that they compute with come from the other rooms."""
SOURCES = sorted(set(ROOM.rglob("*.py")) - COMPILED)


def bare(text):
    """Line and value of each number that is neither structure, nor an index, nor on a line with a comment."""
    lines, tree = text.splitlines(), ast.parse(text)
    indices = {inner for node in ast.walk(tree) if isinstance(node, ast.Subscript) for inner in ast.walk(node.slice)}
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, (int, float))
        and not isinstance(node.value, bool)
        and abs(node.value) not in PLAIN
        and node not in indices
        and "#" not in lines[node.lineno - 1]
    ]


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: str(path.relative_to(ROOM)))
def test_literals_have_a_source(source):
    assert not bare(source.read_text())


def test_a_literal_without_a_source_is_seen():
    assert {path.relative_to(ROOM).parts[0] for path in SOURCES} >= {
        "assessment",
        "checker",
        "geometry",
        "robot",
        "scene",
    }
    assert bare("limit = 0.25\nrow = table[7]\nreach = 1.3  # m, UR3e\n") == [(1, 0.25)]


@pytest.mark.parametrize("model", sorted((ROOM / "robots").glob("*.toml")), ids=lambda file: file.stem)
def test_every_number_of_a_model_has_a_source(model):
    for line in model.read_text().splitlines():
        if (
            any(c.isdigit() for c in line.split("#")[0].split("=")[-1])
            and "=" in line
            and not line.startswith(("schema", "link", "name", "#"))
        ):
            assert "#" in line, line
