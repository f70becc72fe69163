"""Ways to run the tests: README's line, the targets of the Makefile and a bare machine's commands agree."""

import re
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
RUN = (TOP / ".ci" / "run").read_text()
MAKEFILE = (TOP / "Makefile").read_text()
README = (TOP / "README.md").read_text()


def recipe(target: str) -> str:
    """Commands of `make` for a target."""
    found = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", MAKEFILE, re.MULTILINE)
    assert found is not None, target
    return found[1]


def test_readme_and_make_run_the_same_tests_in_the_same_way() -> None:
    """The same number of workers, and groups: otherwise the two see different things."""
    line = README.split("<!-- line: tests -->")[1].split("```")[1]
    (promised,) = re.findall(r"pytest (-q .*)", line)
    assert promised in recipe("test")


@pytest.mark.parametrize("target", re.findall(r"\bmake ([a-z ]+) RUN=", RUN)[0].split())
def test_what_a_bare_machine_makes_is_a_target(target: str) -> None:
    assert recipe(target)


def test_a_bare_machine_judges_everything_once() -> None:
    """README's line runs all tests; beside it only those that are marked for the pinned set, and the demo."""
    assert "<!-- line: tests -->" in RUN
    assert re.findall(r"-m pytest (.*)", RUN) == [
        '-q -m version "${rooms_without_kernel[@]}"',
        "-q --campaign tests/e2e/test_demo.py",
        '-q -m version "${rooms_without_kernel[@]/#/--ignore=}"',  # all others
    ]
    assert (TOP / "tests" / "e2e" / "test_demo.py").exists()


@pytest.mark.parametrize("text", [RUN, MAKEFILE], ids=["a bare machine", "make"])
def test_compiled_modules_are_kept(text: str) -> None:
    """Under any habit of the machine: otherwise each of hundreds of processes compiles all its imports."""
    assert re.search(r"^(unset|unexport) PYTHONDONTWRITEBYTECODE$", text, re.MULTILINE)


def test_while_working_nothing_waits() -> None:
    """`make fast` leaves out where real time passes, and prints its time beside what was promised."""
    assert {"not e2e", "not real_time", "not long"} <= set(re.findall(r"not \w+", recipe("fast")))
    assert "of 90 s" in recipe("fast")
