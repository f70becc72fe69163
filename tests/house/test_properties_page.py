"""Tests and commands that SECURITY.md and docs/properties.md name exist."""

import re

import pytest
from tests.house import pages

SECURITY = "SECURITY.md"
PROPERTIES = "docs/properties.md"
NODE = re.compile(r"tests/[\w/]+(?:\.py)?(?:::\w+)*")
LEAST = {SECURITY: 60, PROPERTIES: 20}
"""The pages, each with the least number of different tests that it names."""


def text(name: str) -> str:
    return (pages.TOP / name).read_text("utf-8")


@pytest.mark.parametrize("page", LEAST)
def test_every_test_that_a_page_names_exists(page: str) -> None:
    nodes = set(NODE.findall(text(page)))
    assert len(nodes) >= LEAST[page]
    for node in nodes:
        assert not pages.missing(node), node


@pytest.mark.parametrize("page", LEAST)
def test_every_command_that_a_page_names_exists(page: str) -> None:
    """Those of `ztpm` are of the command line, those of `make` are targets."""
    said = pages.commands(text(page))
    assert said
    for words in said:
        pages.assert_command(words)
    targets = re.findall(r"^([a-z-]+):", text("Makefile"), re.MULTILINE)
    for target in re.findall(r"`make ([a-z-]+)", text(page)):
        assert target in targets, target


def test_every_promise_has_a_mechanism_and_a_test() -> None:
    promised = pages.rows(text(SECURITY), "promise", "mechanism", "test that shows it")
    assert len(promised) > 50
    for promise, mechanism, shown in promised:
        assert promise, mechanism
        assert mechanism, promise
        assert NODE.search(shown), promise


def test_every_limit_says_what_follows() -> None:
    for limit, follows in pages.rows(text(SECURITY), "not promised", "what follows for you"):
        assert limit, follows
        assert follows, limit


def test_every_property_is_one_sentence_with_a_command_that_shows_it() -> None:
    claimed = pages.rows(text(PROPERTIES), "claim", "command that shows it")
    assert len(claimed) >= 20
    for claim, shown in claimed:
        assert claim.endswith(".") and ". " not in claim, claim
        command = pages.code(shown)
        assert command, claim
        assert all(piece.startswith(("pytest tests/", "ztpm ", "make ")) for piece in command), claim
