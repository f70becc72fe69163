"""`ztpm audit show --kind` takes each kind that the product writes, and no other word."""

import ast
import json
from pathlib import Path

import pep
import pytest
import ztpm
from ztpm.cli.provider.audit import JOURNAL, LEDGER
from ztpm_idp.domain.changes import Word

from ztpm_idp.domain import entries

PARTIES = ("person", "agent", "pep", "sensor")


def nodes(path):
    return ast.walk(ast.parse(Path(path).read_text()))


def first_words(calls):
    return {call.args[0].value for call in calls if call.args and isinstance(call.args[0], ast.Constant)}


def entry_kinds():
    domain = Path(entries.__file__).parent
    told = [node.value.elts[0] for path in sorted(domain.rglob("entries.py")) for node in nodes(path)
            if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple)]  # fmt: skip
    calls = (node for path in (domain / "asking").glob("*.py") for node in nodes(path) if isinstance(node, ast.Call))
    acts = first_words(call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "Refusing")
    assert len(acts) > 1
    ends = {"-registered": PARTIES, "-refused": acts, "change-": map(str, Word), "tool-": entries.DONE.values()}
    ends |= {"-suspended": PARTIES[2:], "-restored": PARTIES[2:], "-key-replaced": PARTIES[1:]}
    for kind in told:
        if isinstance(kind, ast.Constant):
            yield kind.value
            continue
        if isinstance(kind, ast.IfExp):
            yield from (kind.body.value, kind.orelse.value)
            continue
        ((fixed,),) = ([part.value for part in kind.values if isinstance(part, ast.Constant)],)
        yield from (f"{fixed}{word}" if fixed.endswith("-") else f"{word}{fixed}" for word in ends[fixed])


def record_kinds():
    for package in (pep, ztpm):
        for path in Path(package.__file__).parent.rglob("*.py"):
            calls = (
                node for node in nodes(path) if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
            )
            yield from first_words(
                call
                for call in calls
                if call.func.attr in {"append", "record", "record_all", "_record"} and len(call.args) == 2
            )
            # ... and through a thread: its function comes first
            calls = (node for node in nodes(path) if isinstance(node, ast.Call) and len(node.args) == 3)
            for call in calls:
                write, kind, _ = call.args
                if isinstance(write, ast.Attribute) and write.attr == "append" and isinstance(kind, ast.Constant):
                    yield kind.value


@pytest.mark.long
def test_every_kind_that_is_written_can_be_asked_for_and_no_other():
    assert sorted(set(entry_kinds())) == list(LEDGER)
    assert sorted(set(record_kinds())) == list(JOURNAL)


def test_help_names_the_kinds_and_another_word_is_refused_with_the_near_ones(run, tmp_path):
    file = tmp_path / "journal.ndjson"
    lines = [{"seq": seq, "kind": kind, "at_ms": 1, "body": {}} for seq, kind in enumerate(("decision", "outcome"))]
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    told = run("audit", "show", file, "--kind", "outcome", "--json")
    assert (told.status, told.json["seq"]) == (0, 1)
    told = run("audit", "show", file, "--kind", "decisions", "--json")
    assert (told.status, told.json["code"]) == (2, "USAGE")
    assert "decision" in told.json["detail"].split()
    assert "delegation-refused" in run("audit", "show", file, "--kind", "", "--help").out
    assert run("audit", "show", file, "--kind", "*", "--json").status == 2


@pytest.mark.parametrize("kind", ["agent-suspended", "ask-refused"])
def test_a_kind_of_which_there_is_none_shows_nothing(run, tmp_path, kind):
    file = tmp_path / "journal.ndjson"
    file.write_text('{"seq":1,"kind":"decision","at_ms":1,"body":{}}\n')
    told = run("audit", "show", file, "--kind", kind, "--json")
    assert (told.status, told.out) == (0, "")
