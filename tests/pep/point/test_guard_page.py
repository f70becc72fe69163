"""The page on guarding one's own tools is executed: its server, its declarations in both forms, its configuration."""

import asyncio
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pep.base.declaration import declared, operation, row_from_toml
from pep.base.errors import PepFault
from pep.base.fact_declaration import FRESH_MOST_MS, FRESH_MS
from pep.mcp.declared_tools import decorated, rows_of
from pep.point.guard_config import GuardConfig
from tests.house.pages import BLOCK, code
from tests.house.pages import rows as rows_of_page
from tests.pep.point.test_guarded_server import written  # noqa: F401 - a fixture

from capabilities.values.units import Unit
from pep import Free, Word, guard, pins

PAGE = (Path(__file__).parents[3] / "docs" / "guard.md").read_text("utf-8")
BLOCKS = BLOCK.findall(PAGE)
PYTHON = next(text for kind, text in BLOCKS if kind == "python")
TABLE, CONFIG = (text for kind, text in BLOCKS if kind == "toml")


@pytest.fixture
def names():
    """Names that the page's module defines."""
    found = {"__name__": "page"}
    exec(compile(PYTHON, "docs/guard.md", "exec"), found)  # noqa: S102 - the page itself
    return found


def test_the_pages_server_is_guarded(names, written):  # noqa: F811
    path = written()
    assert set(tomllib.loads(path.read_text())) == set(tomllib.loads(CONFIG)), "the six lines"
    assert callable(guard(names["server"], path))
    assert [pin.name for pin in pins(names["server"])] == ["open_valve", "search_docs"]


def test_both_forms_of_the_page_are_one_row(names, written):  # noqa: F811
    configured = GuardConfig.read(written(TABLE)).rows()
    served = asyncio.run(names["server"].list_tools())
    rows = rows_of(served, decorated={}, configured=configured)
    assert rows == rows_of(served, decorated=asyncio.run(decorated(names["server"])), configured={})
    assert set(rows) == {"open_valve", "search_docs"}


def test_each_line_of_the_table_of_values_is_one_declaration_in_both_forms(names):
    for annotations, table, _ in rows_of_page(PAGE, "annotation", "in TOML", "values"):
        if "list = " in table:
            continue
        (stated,) = tomllib.loads(f"x = {code(table)[0]}").values()
        wanted = row_from_toml("tool", {"object": "thing", "base_tier": 1, "arguments": {"x": stated}})
        for annotation in code(annotations):
            scope = {"Annotated": Annotated, "Literal": Literal, "Any": Any, "Word": Word, "Free": Free}

            def tool(x): ...

            tool.__annotations__ = {"x": eval(annotation, scope)}  # noqa: S307 - the page itself
            assert declared(operation("thing", base_tier=1)(tool)) == wanted


def test_the_page_has_every_unit_and_every_code_of_the_start():
    (units,) = [row[1] for row in rows_of_page(PAGE, "member", "meaning") if "`unit`" in row[0]]
    assert {word for word in units.split("`") if word in set(Unit)} == set(Unit)
    codes = {
        word
        for row in rows_of_page(PAGE, "code at start", "what is wrong")
        for word in row[0].split("`")
        if "_" in word
    }
    assert codes <= set(PepFault)
    assert {code for code in PepFault if code.startswith("TOOL_")} <= codes


def test_the_pages_fact_is_one_row_in_both_forms(names):
    source = next(text for kind, text in BLOCKS if kind == "python" and "Fact(" in text)
    exec(compile(source, "docs/guard.md", "exec"), names)  # noqa: S102 - the page itself
    line = next(word for word in PAGE.split("`") if word.startswith('"zone-a/people" ='))
    table = tomllib.loads(f'object = "press"\nbase_tier = 1\n[when]\n{line}')
    assert row_from_toml("close_press", table) == declared(names["close_press"])
    assert f"{FRESH_MS} where none is stated" in PAGE
    assert f"1 to {FRESH_MOST_MS}" in PAGE
