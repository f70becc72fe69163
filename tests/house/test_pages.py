"""The pages say what is so: examples run, commands exist, generated pages are as generated."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from docs import generate
from tests.house import pages

README = (pages.TOP / "README.md").read_text("utf-8")


def test_the_readmes_lines_of_the_library_run(tmp_path: Path) -> None:
    """They print what the page shows, with the public names of the core alone."""
    (example, shown) = re.findall(
        r"<!-- lines: library -->\n```python\n(.*?)```\n\n```text\n(.*?)```", README, re.DOTALL
    )[0]
    imported = set(re.findall(r"^(?:from|import) (\w+)", example, re.MULTILINE))
    assert imported - sys.stdlib_module_names == {"capabilities"}
    ran = subprocess.run(
        [sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True
    )
    assert ran.stdout == shown
    assert "permitted" in shown
    assert "refused: LIMIT_EXCEEDED_BY_REQUEST" in shown


def test_the_readme_is_a_page_and_a_half() -> None:
    assert len(README.splitlines()) <= 130


def test_generated_pages_are_as_generated() -> None:
    for file, wanted in generate.generated().items():
        assert file.read_text("utf-8") == wanted, "run: make docs"


WITH_COMMANDS = {"docs/cell.md": 10, "docs/deployment.md": 10, "README.md": 1}
"""The pages that show commands, each with the least number of commands on it."""


@pytest.mark.long
def test_every_command_on_a_page_is_one_of_the_command_line() -> None:
    found = {str(page.relative_to(pages.TOP)): pages.commands(page.read_text("utf-8")) for page in pages.own()}
    for name, least in WITH_COMMANDS.items():
        assert len(found[name]) >= least, name
    for name, said in found.items():
        for words in said:
            try:
                pages.assert_command(words)
            except AssertionError as error:
                pytest.fail(f"{name}: {error}")


def test_lines_of_prose_are_short_on_every_page() -> None:
    """At most 120 characters; where a link leads is not counted."""
    long = [
        f"{page.relative_to(pages.TOP)}: {line[:60]}"
        for page in pages.pages()
        for line in pages.prose(page.read_text("utf-8"))
        if len(re.sub(r"\]\([^)]*\)", "]", line)) > 120
    ]
    assert long == []
