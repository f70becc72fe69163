"""`ztpm idp backup`, `restore`, `mark` and `resume`, `ztpm agent vouch`, on the files of a cell."""

from __future__ import annotations

import shutil
import sqlite3
import stat
from contextlib import closing

import pytest
from capabilities.values.caps import DEFAULT
from pep.provider.feed_mark import FeedMark, FeedMarkFile
from ztpm.base.layout import Layout
from ztpm_idp.client import ClientError

from capabilities.statements import mark

pytestmark = pytest.mark.long


@pytest.fixture
def copied(cell, tmp_path):
    """A cell's directory of one's own."""
    shutil.copytree(cell.root, tmp_path / "cell")
    layout = Layout(tmp_path / "cell")
    for config in (layout.idp_config, layout.gateway_config):
        config.write_text(config.read_text().replace(str(cell.root), str(layout.root)))
    return layout


def test_a_store_is_copied_and_put_back(run, copied, tmp_path):
    copy, where = tmp_path / "copy", ("--data", copied.root, "--json")
    told = run("idp", "backup", copy, *where)
    assert (told.status, told.json["bytes"], stat.S_IMODE(copy.stat().st_mode)) == (0, copy.stat().st_size, 0o600)
    told = run("idp", "backup", copy, *where)
    assert (told.status, told.json["code"]) == (2, "EXISTS")
    with closing(sqlite3.connect(copied.database)) as base:
        base.execute("PRAGMA journal_mode = WAL")
        base.execute("SELECT * FROM ledger").fetchone()
        told = run("idp", "restore", "--from", copy, *where)
        assert (told.status, told.json["code"]) == (1, "STORE_IN_USE")
    told = run("idp", "restore", "--from", copied.trust, *where)
    assert (told.status, told.json["code"]) == (1, "COPY_UNUSABLE")
    signed = tmp_path / "signed"
    config = ("--config", copied.gateway_config)
    assert run("idp", "mark", signed, *config, "--json").json["revoked"] == 0
    told = run("idp", "restore", "--from", copy, "--mark", signed, *where)
    assert (told.status, told.json["code"]) == (3, "STATEMENT_UNTRUSTED"), "of a point that nobody registered"
    told = run("idp", "restore", "--from", copy, *where)
    assert told.status == 0, told.out
    assert (told.json["line"], told.json["before"], told.json["taken_back"]) == (1, "whole", 0)
    again = run("idp", "restore", "--data", copied.root)
    assert again.status == 0, again.err


def test_a_mark_is_what_the_state_directory_holds(run, copied, tmp_path):
    state = copied.gateway_state
    state.mkdir(exist_ok=True)
    issuer = run("keys", "list", "--data", copied.root, "--json").json["issuer"]
    FeedMarkFile(state / "feed.json").write(FeedMark(issuer, 7, 1, 2, "ab" * 32))
    out, config = tmp_path / "signed", ("--config", copied.gateway_config)
    told = run("idp", "mark", out, *config, "--json")
    assert (told.status, told.json["line"], told.json["epoch"]) == (0, 2, 7)
    (text,) = out.read_text().split()
    assert mark.unverified(text, DEFAULT).head == "ab" * 32
    assert run("idp", "mark", out, *config, "--json").json["code"] == "EXISTS"
    (state / "feed.json").write_text("{")
    assert run("idp", "mark", tmp_path / "other", *config, "--json").json["code"] == "STATE_UNREADABLE"
    assert run("idp", "mark", tmp_path / "other", "--config", copied.trust, "--json").json["code"] == "CONFIG_INVALID"


COMMANDS = {
    "resume": (["idp", "resume", "--unheard", "cell-2"], "resume", (["cell-2"],)),
    "vouch": (["agent", "vouch", "mover", "--reason", "seen"], "vouch", ("mover", "seen")),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_an_administrators_acts_are_done_or_refused(run, cell, double, command):
    words, method, given = COMMANDS[command]
    who = ("--data", cell.root, "--as", "alice")
    double.answers = {method: None}
    assert run(*words, *who).status == 0
    assert run(*words, *who, "--json").json["ok"] is True
    assert double.asked == [(method, given, {})] * 2
    double.answers = {method: ClientError("NOT_PERMITTED", 403)}
    told = run(*words, *who, "--json")
    assert (told.status, told.json["code"]) == (3, "NOT_PERMITTED")
