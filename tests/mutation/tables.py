"""Mutants of what stands outside functions, where mutmut changes nothing: tables, constants, and members of classes."""

import ast
import subprocess
import sys

from tests.mutation.sources import PYTEST, TESTS, path_of

ENOUGH_S = 300
"""Longest run of the tests, seconds."""


def places(tree):
    """Values of assignments in the module and in its classes."""
    for node in tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        for each in inside:
            if isinstance(each, (ast.Assign, ast.AnnAssign)) and each.value is not None:
                name = ast.unparse(each.target if isinstance(each, ast.AnnAssign) else each.targets[0])
                yield f"{node.name}.{name}" if isinstance(node, ast.ClassDef) else name, each


def changes(node):
    """Every change of one node: what to call it, and the members that it gives other values."""
    match node:
        case ast.Dict(keys=keys, values=values):
            for n, (key, value) in enumerate(zip(keys, values, strict=True)):
                yield f"without {ast.unparse(key or value)}", {"keys": less(keys, n), "values": less(values, n)}
                other = values[(n + 1) % len(values)]
                if key is not None and ast.dump(other) != ast.dump(value):
                    yield (
                        f"{ast.unparse(key)} is {ast.unparse(other)}",
                        {"values": [*values[:n], other, *values[n + 1 :]]},
                    )
        case ast.Set(elts=elements) | ast.List(elts=elements) | ast.Tuple(elts=elements):
            for n, element in enumerate(elements):
                if len(elements) > 1 or not isinstance(node, ast.Set):  # an empty display would be a dict
                    yield f"without {ast.unparse(element)}", {"elts": less(elements, n)}
        case ast.Constant(value=bool(value)):
            yield f"{not value}", {"value": not value}
        case ast.Constant(value=int(value)):
            for other in {value + 1, max(0, value - 1)} - {value}:
                yield f"{other} for {value}", {"value": other}


def less(entries, n):
    return [*entries[:n], *entries[n + 1 :]]


def mutants(source):
    """Change and changed source of the module, one after the other."""
    tree = ast.parse(source)
    for name, assignment in places(tree):
        for node in ast.walk(assignment.value):
            for said, members in list(changes(node)):
                before = {member: getattr(node, member) for member in members}
                vars(node).update(members)
                yield f"{name}: {said}", ast.unparse(tree)
                vars(node).update(before)


def tried(tree, module, source):
    """Result of the tests with this source in place of the module's, in the copy `tree`."""
    path = tree / path_of(module)
    original = path.read_text("utf-8")
    path.write_text(source, "utf-8")
    tests = [test for test in TESTS if (tree / test).exists()]
    try:
        run = subprocess.run(
            [sys.executable, "-m", "pytest", "-x", "-q", *PYTEST, *tests],
            cwd=tree,
            capture_output=True,
            timeout=ENOUGH_S,
        )
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        path.write_text(original, "utf-8")
    return {0: "survived", 1: "killed", 2: "killed"}[run.returncode]  # 2: the module itself cannot be imported
