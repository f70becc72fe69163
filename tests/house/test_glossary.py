"""Words of the product: identifiers keep to docs/glossary.md, and docstrings begin with the thing that they describe."""

import ast
import re
from collections.abc import Iterator

import pytest

from tests.house import pages

PAGE = (pages.TOP / "docs" / "glossary.md").read_text("utf-8")
PRODUCT = ("capabilities", "policies", "pep", "ursim", "ztpm_idp", "ztpm", "evaluation")
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
APPROVED_TEXTS = {"pep/mcp/arm_server.py": "docstrings are tool descriptions, which people approve by their digest"}
"""Module whose docstrings are not held to the rule, with the reason."""
QUESTION = re.compile(r"(?:What|Whether|Who|How|Why|Where|When|Which)\b")
NOBODY = re.compile(r"\b(?:whoever|whatever|somebody|someone|anybody)\b", re.IGNORECASE)
OPENING_WORDS = 20
"""Most words of a docstring's first paragraph, which is one sentence."""
NEVER = {"manager", "helper", "util", "handler", "data", "info", "process", "misc"}
"""These say nothing, wherever they stand; the page may refuse more, not fewer."""

EXCEPTIONS = {
    ("evaluation/decisions/casbin_abac.py", "_enforcer"): "casbin.Enforcer's own name",
    ("ztpm/edge/connection.py", "data"): "asyncio.Protocol's parameter",
    ("ztpm/edge/connection.py", "data_received"): "asyncio.Protocol calls it",
    ("pep/rtde/lease/accepted_connection.py", "data"): "asyncio.Protocol's parameter",
    ("pep/rtde/lease/accepted_connection.py", "data_received"): "asyncio.Protocol calls it",
    ("pep/rtde/lease/lease_connection.py", "data"): "asyncio.Protocol's parameter",
    ("pep/rtde/lease/lease_connection.py", "data_received"): "asyncio.Protocol calls it",
    ("pep/rtde/lease/lease_port.py", "data"): "asyncio.Protocol's parameter",
    ("pep/rtde/lease/lease_port.py", "data_received"): "asyncio.Protocol calls it",
    ("pep/rtde/robot/connections.py", "data"): "asyncio.Protocol's parameter",
    ("pep/rtde/robot/connections.py", "data_received"): "asyncio.Protocol calls it",
    ("ursim/ports/launch.py", "process"): "an operating system's process, which is its name",
    ("ztpm/lease_process.py", "data"): "public keyword of `ztpm.leased`, as the command line's --data",
    ("ztpm/status/picture.py", "data"): "a member of the status page's JSON",
}
"""Module and identifier, with the reason why the name is not ours to choose."""


def words(identifier: str) -> set[str]:
    """The words of an identifier, split at underscores, figures and capitals."""
    return {word.lower() for word in WORD.findall(identifier)}


def bound(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Every name that a module gives: of functions, classes, parameters, variables, and attributes of `self`."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name, node.lineno
            case ast.arg(arg=name) | ast.Name(id=name, ctx=ast.Store()):
                yield name, node.lineno
            case ast.Attribute(attr=name, ctx=ast.Store(), value=ast.Name(id="self")):
                yield name, node.lineno
            case ast.alias(asname=str(name)) | ast.ExceptHandler(name=str(name)):
                yield name, node.lineno
            case ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)) | ast.MatchMapping(rest=str(name)):
                yield name, node.lineno


def refused() -> dict[str, str]:
    """Each refused word, with the word that stands for it."""
    listed = [(each, row[0]) for row in pages.rows(PAGE, "word", "refused words") for each in row[1].split(", ")]
    found = dict(listed)
    assert len(found) == len(listed), "a word is refused twice"
    return found


def docstrings(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Each docstring of a module, class or function, and each text below an assignment, with its line."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        for before, here in zip((None, *node.body), node.body, strict=False):
            match here:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    if before is None or isinstance(before, ast.Assign | ast.AnnAssign):
                        yield text, here.lineno


def fault(text: str) -> str | None:
    """Fault of a docstring, or None."""
    opening = " ".join(text.strip().partition("\n\n")[0].split())
    if QUESTION.match(opening):
        return f"begins with a question word: {opening}"
    if found := NOBODY.search(text):
        return f"has {found.group()!r}: {opening}"
    if len(opening.split()) > OPENING_WORDS:
        return f"opens with over {OPENING_WORDS} words: {opening}"
    return None


@pytest.mark.long
@pytest.mark.parametrize("folder", [*PRODUCT, "tests"])
def test_docstrings_begin_with_the_thing_that_they_describe(folder: str) -> None:
    wrong, excepted, seen = [], set(), 0
    for path in sorted((pages.TOP / folder).rglob("*.py")):
        name = path.relative_to(pages.TOP).as_posix()
        for text, line in docstrings(ast.parse(path.read_text("utf-8"))):
            seen += 1
            if found := fault(text):
                if name in APPROVED_TEXTS:
                    excepted.add(name)
                else:
                    wrong.append(f"{name}:{line}: {found}")
    assert seen > 300
    assert not wrong, "\n".join(wrong)
    assert excepted == {name for name in APPROVED_TEXTS if name.startswith(f"{folder}/")}, "an exception of no use"


def test_every_kind_of_docstring_is_seen() -> None:
    text = '''
"""one"""
A: int = 1
"""two"""
class B:
    """three"""
    C = 1
    """four"""
    async def d(self):
        """five"""
        "six" if C else A
def e():
    """seven"""
    print()
    """no docstring"""
'''
    assert {seen for seen, _ in docstrings(ast.parse(text))} == {"one", "two", "three", "four", "five", "seven"}
    opening = " ".join(["word"] * OPENING_WORDS)
    assert fault(opening) is None
    assert fault(f"{opening} more") is not None
    assert fault("Whether it holds.") is not None
    assert fault("True where it holds.\n\nWhoever asks.") is not None


@pytest.mark.long
def test_no_identifier_has_a_refused_word() -> None:
    wrong, excepted, modules = [], set(), 0
    table = refused()
    assert table.keys() >= NEVER
    for package in PRODUCT:
        for path in sorted((pages.TOP / package).rglob("*.py")):
            modules += 1
            name = path.relative_to(pages.TOP).as_posix()
            for identifier, line in bound(ast.parse(path.read_text("utf-8"))):
                for word in sorted(words(identifier) & table.keys()):
                    if (name, identifier) in EXCEPTIONS:
                        excepted.add((name, identifier))
                    else:
                        wrong.append(f"{name}:{line}: {identifier} has {word!r}; the word is {table[word]}")
    assert modules > 500
    assert not wrong, "\n".join(wrong)
    assert excepted == EXCEPTIONS.keys(), "an exception that nothing needs"


def test_every_kind_of_name_is_seen() -> None:
    text = """
import a as one_data
class TwoData:
    three: int = 1
    def four(self, five, *six, seven=1, **eight):
        self.nine_data, ten = 1, 2
        for eleven in ():
            with a as twelve: pass
        try: pass
        except E as thirteen: pass
        match five:
            case {"k": fourteen, **fifteen}: pass
            case [*sixteen]: pass
        return [seventeen for seventeen in () if (eighteen := 1)], lambda nineteen: data.process
"""
    seen = {identifier for identifier, _ in bound(ast.parse(text))}
    spelled = "one_data TwoData three four five six seven eight nine_data ten eleven twelve thirteen fourteen fifteen"
    assert seen == {*spelled.split(), "sixteen", "seventeen", "eighteen", "nineteen", "self"}
    assert words("_HTTPHandler2info_ofData") == {"http", "handler", "info", "of", "data"}


def test_the_words_stand_in_order_with_one_sentence_each() -> None:
    table = pages.rows(PAGE, "word", "meaning")
    listed = [word for word, _ in table]
    assert listed == sorted(listed, key=lambda word: (word.casefold(), word))
    assert len(set(listed)) == len(listed)
    assert [word for word, meaning in table if not re.fullmatch(r"[A-Z][^!?]*\.", meaning) or ". " in meaning] == []
    assert set(refused().values()) <= {"*none*", *listed}
