"""Ends of commands: one kind of mistake has one code, one status, and one line."""

from __future__ import annotations

import errno
import os
import pty
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ztpm.cli.conftest import PASSPHRASE
from tests.ztpm.cli.test_cell_command import DRAFT
from ztpm.codes.code_table import step_of

from capabilities.keys import keys
from ztpm.base import layout
from ztpm.base.layout import Layout
from ztpm.base.lock import DirectoryLock

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
PIT = ("pit", "--scene", EXAMPLES / "c0-empty.scene.json", "--motion", EXAMPLES / "sweep.motion.json")
MISTAKES = {
    "a file that is missing": (2, "UNREADABLE", "missing", [
        ("cell", "sign", "{tmp}/missing.toml", "--key", "{alice}", "--out", "{tmp}/cell"),
        ("cell", "show", "{tmp}/missing", "--signer", "{signer}"),
        ("policy", "check", "{tmp}/missing.toml"),
        ("token", "inspect", "{tmp}/missing", "--trust", "{cell}/trust.json"),
    ]),
    "a file that is no text": (2, "UNREADABLE", "latin", [
        ("cell", "sign", "{tmp}/latin.toml", "--key", "{alice}", "--out", "{tmp}/cell"),
        ("policy", "check", "{tmp}/latin.toml"),
        ("token", "inspect", "{tmp}/latin.toml", "--trust", "{cell}/trust.json"),
    ]),
    "a passphrase that opens nothing": (2, "PASSPHRASE_WRONG", ".key", [
        ("agent", "list", "--data", "{cell}", "--as", "alice"),
        ("cell", "sign", "{draft}", "--key", "{alice}", "--out", "{tmp}/cell"),
        ("up", "--data", "{cell}"),
    ]),
    "a directory that is no cell": (2, "NOT_A_CELL", "{tmp}", [
        ("agent", "list", "--data", "{tmp}", "--as", "alice"),
        ("keys", "list", "--data", "{tmp}"),
        ("up", "--data", "{tmp}"),
    ]),
    "a place that is taken": (2, "EXISTS", "{cell}", [
        ("init", "--data", "{cell}"),
        ("person", "new-key", "{alice}"),
        ("cell", "sign", "{draft}", "--key", "{alice}", "--out", "{alice}"),
    ]),
    "a place that cannot be written": (2, "UNWRITABLE", "latin.toml", [
        ("init", "--data", "{tmp}/latin.toml"),
        ("up", "--data", "{tmp}/latin.toml"),
        ("person", "new-key", "{tmp}/latin.toml/key"),
        ("cell", "sign", "{draft}", "--key", "{alice}", "--out", "{tmp}/latin.toml/cell"),
    ]),
    "a key file that others can read": (2, "KEYS_UNREADABLE", "bob.key", [
        ("agent", "list", "--data", "{cell}", "--as", "bob"),
        ("cell", "sign", "{draft}", "--key", "{cell}/operators/bob.key", "--out", "{tmp}/cell"),
    ]),
    "a cell that runs": (1, "RUNNING_ALREADY", "{cell}", [
        ("up", "--data", "{cell}"),
    ]),
    "a provider that does not answer": (1, "UNREACHABLE", "127.77.0.9", [
        ("agent", "list", "--data", "{cell}", "--as", "alice"),
        ("approvals", "list", "--data", "{cell}", "--as", "alice"),
        ("person", "list", "--data", "{cell}", "--as", "alice"),
        ("revoke", "agent", "mover", "--reason", "try", "--data", "{cell}", "--as", "alice"),
    ]),
    "words that are no options": (2, "USAGE", "ztpm agent list: ", [
        ("agent", "list", "--as", "alice", "--sponsor"),
        ("agent", "list"),
        ("agent", "list", "alice", "--as", "alice"),
    ]),
}  # fmt: skip
ROWS = [(kind, number) for kind, (*_, commands) in MISTAKES.items() for number in range(len(commands))]


@pytest.fixture
def places(cell, tmp_path):
    copy = Layout(tmp_path / "copy")
    shutil.copytree(cell.root, copy.root)
    copy.operator_key("bob").chmod(0o644)
    for path in copy.root.rglob("*.toml"):  # they name their files whole
        path.write_text(path.read_text().replace(str(cell.root), str(copy.root)))
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "draft.toml").write_text(DRAFT)
    (tmp_path / "work" / "latin.toml").write_bytes("name = 'Müller'".encode("latin-1"))
    return {
        "tmp": tmp_path / "work", "cell": copy.root, "alice": copy.operator_key("alice"),
        "signer": keys.b64u(keys.public_raw(keys.generate())), "draft": tmp_path / "work" / "draft.toml",
    }  # fmt: skip


@pytest.mark.parametrize(("kind", "number"), ROWS)
def test_one_kind_of_mistake_has_one_end(run, places, monkeypatch, kind, number):
    status, code, place, commands = MISTAKES[kind]
    words = [str(word).format(**places) for word in commands[number]]
    if code == "PASSPHRASE_WRONG":
        monkeypatch.setenv("ZTPM_PASSPHRASE", "another one than theirs")
    if kind == "a cell that runs":
        with DirectoryLock.take(Layout(places["cell"]).lock):
            told, by_json = run(*words), run(*words, "--json")
    else:
        told, by_json = run(*words), run(*words, "--json")
    *before, line = told.err.splitlines()
    assert (told.status, line.partition(":")[0]) == (status, code) and before in ([], ["starting the cell"])
    assert told.err.count(code) == 1 and place.format(**places) in line and line.endswith(step_of(code)), told.err
    assert (by_json.status, by_json.json["code"], by_json.json["next"]) == (status, code, step_of(code))
    assert by_json.json["detail"].rstrip(".") in line


@pytest.mark.parametrize(
    "words", [("init", "--data", "{tmp}/new"), ("person", "new-key", "{tmp}/key"), ("up", "--data", "{tmp}/new")]
)
def test_a_disk_that_fills_is_told_as_one(run, places, monkeypatch, words):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    proof = run(*PIT, "--proof", "/dev/full").err.splitlines()[-1]
    assert proof.startswith("DISK_FULL: /dev/full: ") and proof.endswith(step_of("DISK_FULL"))
    monkeypatch.setattr(layout.os, "fsync", full)
    told = run(*(word.format(**places) for word in words))
    assert (told.status, told.err.splitlines()[-1].partition(":")[0]) == (1, "DISK_FULL")
    assert not (places["tmp"] / "new").exists()


def process(*words, environment=None):
    ended = subprocess.run(
        [sys.executable, *map(str, words)], capture_output=True, text=True, timeout=120,
        env=os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE, **(environment or {})}, check=False,
    )  # fmt: skip
    assert "Traceback" not in ended.stderr, ended.stderr
    return ended


def damaged(cell, what):
    match what:
        case "journal of another":
            cell.journal.write_bytes(b"no journal\n")
        case "state that is a file":
            shutil.rmtree(cell.state)
            cell.state.write_text("")
        case "mark":
            (cell.state / "trust.json").write_text("{}")
        case "configuration":
            cell.cell_config.write_text("port = ")
        case "key":
            cell.pep_key.chmod(0o644)


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("what", "status", "code", "place"),
    [
        ("configuration", 2, "CONFIG_INVALID", "cell.toml"),
        ("key", 2, "CONFIG_INVALID", "pep_key_file"),
        ("mark", 1, "STATE_UNREADABLE", "trust.json"),
        ("journal of another", 1, "JOURNAL_CORRUPT", "record 1"),
        ("state that is a file", 1, "STATE_UNREADABLE", "trust.json"),
    ],
)
def test_a_process_of_a_cell_ends_in_one_line(places, what, status, code, place):
    cell = Layout(places["cell"])
    damaged(cell, what)
    ended = process("-m", "ztpm.point.tool_proxy", "--config", cell.cell_config)
    assert (ended.returncode, ended.stdout, ended.stderr.partition(":")[0]) == (status, "", code)
    assert ended.stderr.count("\n") == 1 and place in ended.stderr and ended.stderr.endswith(f"{step_of(code)}\n")


@pytest.mark.e2e
def test_up_ends_with_the_reason_of_its_process(places):
    cell = Layout(places["cell"])
    with sqlite3.connect(cell.database) as connection:
        connection.execute("update alembic_version set version_num = 'f00dfeedf00d'")
    ended = process("-m", "ztpm", "up", "--data", cell.root)
    assert (ended.returncode, ended.stderr.splitlines()[-1].partition(":")[0]) == (1, "DATABASE_NEWER"), ended.stderr
    assert "identity provider" in ended.stderr.splitlines()[-1]


@pytest.mark.e2e
def test_a_simulator_whose_port_is_taken(places):
    with socket.create_server(("127.77.0.19", 30001)):
        ended = process("-m", "ztpm", "rtde", "sim", "--host", "127.77.0.19")
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert ended.stderr.startswith("PORT_UNUSABLE: 127.77.0.19:30001: ")


PROMPTS = {
    "init": ("init", "--data", "{tmp}/new"),
    "up, new": ("up", "--data", "{tmp}/new"),
    "up": ("up", "--data", "{cell}"),
    "a person's key": ("agent", "list", "--data", "{cell}", "--as", "alice"),
    "a new key": ("person", "new-key", "{tmp}/key"),
    "cell sign": ("cell", "sign", "{draft}", "--key", "{alice}", "--out", "{tmp}/cell"),
    "keys prepare": ("keys", "prepare", "feed", "--data", "{cell}"),
}


@pytest.mark.e2e
@pytest.mark.parametrize("name", PROMPTS)
def test_ctrl_c_at_a_prompt_ends_at_once(places, name):
    words = [str(word).format(**places) for word in PROMPTS[name]]
    environment = {name: value for name, value in os.environ.items() if name != "ZTPM_PASSPHRASE"}
    child, terminal = pty.fork()
    if child == 0:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # whatever began the tests in the background has it ignored
        os.execve(sys.executable, [sys.executable, "-m", "ztpm", *words], environment)
    said = b""
    while b"assphrase" not in said:
        said += os.read(terminal, 1024)
    os.write(terminal, b"\x03")
    try:
        while said:
            said = os.read(terminal, 1024)
    except OSError:  # the terminal's other end is closed
        pass
    _, status = os.waitpid(child, 0)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(status) == 128 + signal.SIGINT
    assert not (places["tmp"] / "new").exists()
