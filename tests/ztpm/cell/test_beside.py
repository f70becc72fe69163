"""Processes of a cell that begin beside each other: all begin before one is waited for."""

import pytest
from ztpm.base.layout import Layout
from ztpm.base.processes import ChildError
from ztpm.cell.cell import PROCESSES, Cell
from ztpm.cell.setup import Addresses

from ztpm.stage.stage import LEFT

TITLES = {title: name for name, title in PROCESSES.items()}


class Begun:
    """A child that keeps what happens to it in the log of all."""

    def __init__(self, name, log, fails):
        self.name, self._log, self._fails = TITLES[name], log, fails
        log.append(("begin", self.name))

    def until_ready(self):
        self._log.append(("ready", self.name))
        if self.name in self._fails:
            raise ChildError(self.name, "it ended", [])
        return self

    def stop(self):
        self._log.append(("stop", self.name))


@pytest.fixture
def log():
    return []


@pytest.fixture
def cell(tmp_path, log):
    def begin(name, module, *arguments, environment):
        return Begun(name, log, fails)

    fails = set()
    found = Cell(Layout(tmp_path / "cell"), Addresses("127.77.0.13"), b"secret", LEFT, begin_child=begin)
    found.fails = fails
    return found


def test_alone_each_is_ready_before_the_next_begins(cell, log):
    cell.start_idp()
    cell.start_tools()
    assert log == [("begin", "idp"), ("ready", "idp"), ("begin", "tools"), ("ready", "tools")]


def test_beside_each_other_all_begin_and_then_all_are_ready(cell, log):
    with cell.beside():
        cell.start_idp()
        cell.start_enforcement()  # which is for itself beside each other, too
        assert log == [("begin", name) for name in ("idp", "gateway", "tools")]
    assert log[3:] == [("ready", name) for name in ("idp", "gateway", "tools")]
    cell.start_sensor()
    assert log[6:] == [("begin", "sensor"), ("ready", "sensor")], "and afterwards one after another again"


def test_one_that_does_not_become_ready_is_told_and_the_others_can_be_ended(cell, log):
    cell.fails.add("gateway")
    with pytest.raises(ChildError), cell.beside():
        cell.start_gateway()
        cell.start_tools()
    cell.stop()
    assert {name for what, name in log if what == "stop"} == {"gateway", "tools"}


def test_what_breaks_in_between_ends_the_wait_and_leaves_what_was_begun_to_be_ended(cell, log):
    with pytest.raises(RuntimeError), cell.beside():
        cell.start_tools()
        raise RuntimeError("between")
    assert ("ready", "tools") not in log
    cell.stop()
    assert ("stop", "tools") in log
