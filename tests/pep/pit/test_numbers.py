"""A number in the physics room stands beside its source: a bare literal is a fault."""

import ast
from pathlib import Path

import pytest

import pep.pit

ROOM = Path(pep.pit.__file__).parent
PLAIN = {0, 1, 2, 3, 4, 0.5}  # structure: signs, halves, squares, space, and the corners of the index


@pytest.mark.parametrize("source", sorted(ROOM.glob("*.py")), ids=lambda p: p.name)
def test_literals_have_a_source(source):
    text = source.read_text()
    lines = text.splitlines()
    bare = [
        (node.lineno, node.value)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, (int, float))
        and not isinstance(node.value, bool)
        and abs(node.value) not in PLAIN
        and "#" not in lines[node.lineno - 1]
    ]
    assert not bare


def test_every_number_of_the_model_has_a_source():
    for line in (ROOM / "robots" / "ur3e.toml").read_text().splitlines():
        if (
            any(c.isdigit() for c in line.split("#")[0].split("=")[-1])
            and "=" in line
            and not line.startswith(("schema", "link", "name", "#"))
        ):
            assert "#" in line, line
