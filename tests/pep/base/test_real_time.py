"""A thread that goes before ordinary ones, and what it begins does not."""

import os
import subprocess
import sys
import threading

from pep.base.thread_priority import goes_first

CHILD = "import os; print(os.sched_getscheduler(0))"


def test_only_the_thread_itself_goes_first_and_only_where_that_is_allowed():
    found, before = {}, os.sched_getscheduler(0)

    def look(name):
        found[name] = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK

    def first():
        found["allowed"] = goes_first()
        look("itself")
        thread = threading.Thread(target=look, args=("thread",))
        thread.start()
        thread.join()
        found["child"] = int(subprocess.run([sys.executable, "-c", CHILD], capture_output=True, check=True).stdout)

    thread = threading.Thread(target=first)
    thread.start()
    thread.join()
    assert found["itself"] == (os.SCHED_RR if found["allowed"] else before)
    assert os.SCHED_RR not in (found["thread"], found["child"])
    assert os.sched_getscheduler(0) == before


def test_what_a_thread_begins_goes_first_with_it_where_it_says_so():
    found = {}

    def first():
        found["allowed"] = goes_first(with_all_it_begins=True)
        found["child"] = int(subprocess.run([sys.executable, "-c", CHILD], capture_output=True, check=True).stdout)

    thread = threading.Thread(target=first)
    thread.start()
    thread.join()
    assert (found["child"] == os.SCHED_RR) == found["allowed"]


def test_who_may_not_is_told_so(monkeypatch):
    def refused(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    assert goes_first() is False
