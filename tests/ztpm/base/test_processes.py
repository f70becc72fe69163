"""Children: they end with their parent, answer questions, and are not buried in them."""

import io
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest
from ztpm.base.processes import Child, ChildError
from ztpm.preparing import WIPED, Preparing

TOP = Path(__file__).parents[3]


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module with that `main`, which children can run."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(TOP), os.environ.get("PYTHONPATH", "")]))

    def write(text):
        (tmp_path / "a_child.py").write_text("def main():\n" + textwrap.indent(text, "    "))
        return "a_child"

    return write


READY = "import json, sys, time, os\nprint(json.dumps({'ready': True, 'argv': sys.argv[1:]}), flush=True)\n"


def gone(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def until(seen, limit_s=20):
    deadline = time.monotonic() + limit_s
    while not seen():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_the_tether_changes_nothing_for_the_module(module):
    child = Child.start("a child", module(READY + "sys.stdin.read()"), "--an", "argument", environment={})
    try:
        assert child.ready == {"ready": True, "argv": ["--an", "argument"]}
        assert child.alive
    finally:
        child.stop()
    assert not child.alive


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_child_ends_with_its_parent_however_that_ends(module, tmp_path, number):
    module(READY + "time.sleep(100)")
    code = (
        "from ztpm.base.processes import Child; import time\n"
        "child = Child.start('a child', 'a_child', environment={})\n"
        "print(child.popen.pid, flush=True); time.sleep(100)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=tmp_path)
    with parent:
        pid = int(parent.stdout.readline())
        assert not gone(pid)
        parent.send_signal(number)
    until(lambda: gone(pid))


def test_a_parent_that_is_gone_already_starts_nothing():
    done = subprocess.run(
        [sys.executable, "-m", "ztpm.base.parent_watch", "1" if os.getppid() != 1 else "2", "this"],
        capture_output=True,
        timeout=30,
        check=False,
    )
    assert (done.returncode, done.stdout) == (1, b"")


def test_the_wait_for_a_child_ends_when_it_is_told_to(module):
    ended = threading.Event()
    threading.Timer(0.5, ended.set).start()
    started = time.monotonic()
    with pytest.raises(ChildError):
        Child.start("silent", module("import time\ntime.sleep(100)"), environment={}, ended=ended.is_set)
    assert time.monotonic() - started < 10


ANSWERS = READY + (
    "for line in sys.stdin:\n"
    "    asked = json.loads(line)\n"
    "    if asked == 'die': os._exit(3)\n"
    "    print('a word', flush=True)\n"
    "    print(json.dumps({'answer': {'to': asked}}), flush=True)\n"
)


def test_answers_are_no_output_and_output_is_no_answer(module):
    child = Child.start("a child", module(ANSWERS), environment={})
    try:
        assert [child.ask(n, timeout_s=10) for n in (1, 2)] == [{"to": 1}, {"to": 2}]
        until(lambda: list(child.output).count("a word") == 2)
        assert not any("answer" in line for line in child.output)
        assert child.ask("die", timeout_s=0.5) is None
        until(lambda: not child.alive)
        assert child.ask(1, timeout_s=0.1) is None
    finally:
        child.stop()


def test_a_child_that_stands_still_is_asked_once(module):
    child = Child.start("a child", module(ANSWERS), environment={})
    try:
        child.pause()
        assert [child.ask(n, timeout_s=0.01) for n in range(50)] == [None] * 50
        child.resume()
        # The one question that was sent is answered; the next answer is to the next question.
        until(lambda: child.ask("late", timeout_s=5) is not None)
        assert child.ask("now", timeout_s=10) == {"to": "now"}
        assert list(child.output).count("a word") <= 3
    finally:
        child.stop()


REPORTING = (
    "import asyncio, json\n"
    "from ztpm.base.report_server import serve_reports\n"
    "async def never(): await asyncio.sleep(60)\n"
    "async def breaks(): raise KeyError('x')\n"
    "async def stop(): return {'begun': True}\n"
    "print(json.dumps({'ready': True}), flush=True)\n"
    "asyncio.run(serve_reports({'never': never, 'breaks': breaks, 'stop': stop}))\n"
)


@pytest.mark.clause("LIV-2")
def test_a_stop_waits_for_no_report_and_for_none_that_breaks(module):
    child = Child.start("a child", module(REPORTING), environment={})
    try:
        assert child.ask({"report": "breaks"}, timeout_s=10) == {"fault": "KeyError"}
        assert child.ask({"report": "stop"}, timeout_s=0.2) is None, "a report asks for no stop"
        assert child.ask({"stop": True}, timeout_s=10, lane="stop") == {"begun": True}
    finally:
        child.stop()


@pytest.mark.clause("LIV-2")
def test_a_stop_is_answered_while_a_report_takes_long(module):
    child = Child.start("a child", module(REPORTING), environment={})
    try:
        assert child.ask({"report": "never"}, timeout_s=0.1) is None
        assert child.ask({"stop": True}, timeout_s=10, lane="stop") == {"begun": True}
        assert child.ask({"stop": True}, timeout_s=10, lane="stop") == {"begun": True}
    finally:
        child.stop()


def test_a_child_that_falls_silent_before_it_ends_is_not_waited_for(module):
    """The ends of its pipes come before its exit status does, on a loaded machine by much."""
    text = "import os, time\nos.close(1)\nos.close(2)\ntime.sleep(0.5)\nos._exit(3)\n"
    began = time.monotonic()
    with pytest.raises(ChildError):
        Child.start("a child", module(text), environment={})
    assert time.monotonic() - began < 20


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_child_that_prepares_is_waited_for_as_long_as_it_says_so(module, monkeypatch):
    """Its words are shown, and are no output of a child that fails."""
    monkeypatch.setattr("ztpm.base.processes.READY_S", 5.0)
    text = (
        "import json, sys, time\n"
        "for number in range(5):\n"
        "    time.sleep(1.1)\n"
        "    print(json.dumps({'preparing': number}), flush=True)\n"
    )
    stream = Terminal()
    ready = text + "print(json.dumps({'ready': True}), flush=True)\nsys.stdin.read()\n"
    child = Child.start("a child", module(ready), environment={}, preparing=Preparing(stream, clock=lambda: 0.0))
    child.stop()
    assert [each for each in stream.getvalue().split(WIPED) if each] == ["0", "1", "2", "3", "4"]
    with pytest.raises(ChildError) as failed:
        quick = module(text.replace("1.1", "0"))
        Child.start("a child", quick, environment={}, preparing=Preparing(Terminal()))
    assert "preparing" not in str(failed.value)


def test_a_child_that_says_nothing_yet_is_told_of(module, monkeypatch):
    """Its programs are loaded, or the machine is loaded: the display is never silent for long, child after child."""
    began, stream = time.monotonic(), io.StringIO()
    shown = Preparing(stream, clock=lambda: 20 * (time.monotonic() - began))
    silent = module("import time\ntime.sleep(1)\n" + READY + "sys.stdin.read()\n")
    for name in ("one", "other"):
        Child.start(name, silent, environment={}, preparing=shown).stop()
    told = stream.getvalue().splitlines()
    assert {line.rpartition(", ")[0] for line in told} == {"starting the one", "starting the other"}
    assert len(told) >= 4


@pytest.mark.parametrize(
    ("last", "cause", "silent_s"),
    [
        ("os._exit(3)", "status 3", 60.0),
        ("os.kill(os.getpid(), 9)", "SIGKILL", 60.0),
        ("time.sleep(100)", "silent for 4 s", 4.0),
    ],
)
def test_a_child_that_does_not_become_ready_is_told_with_cause_and_how_far_it_was(
    module, monkeypatch, last, cause, silent_s
):
    monkeypatch.setattr("ztpm.base.processes.READY_S", silent_s)
    text = (
        f"import json, os, time\nprint(json.dumps({{'preparing': '7 of 15'}}), flush=True)\ntime.sleep(0.5)\n{last}\n"
    )
    with pytest.raises(ChildError) as failed:
        Child.start("a child", module(text), environment={}, preparing=Preparing(io.StringIO()))
    assert cause in str(failed.value)
    assert "7 of 15" in str(failed.value)
