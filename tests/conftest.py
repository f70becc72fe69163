"""Profiles of property tests, the ways to run the suite, and room for tests in which real time passes."""

import ast
import gc
import os
import shutil
import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

import httpcore2
import pytest
from hypothesis import HealthCheck, settings

# Before numpy is loaded, here and in all that is started: a pool of threads that wait for one another in a loop takes a
# thousand times as long where each of them computes only while nobody else does (`polite`, below).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Nothing is effected before it is on record, and a shared machine's disk may take seconds for one record. Files of tests
# are in memory, where there is room and programs may be begun; with the name of another place, or "", they are there.
MEMORY, ROOM = Path("/dev/shm"), 4 << 30  # noqa: S108 - pytest makes a directory of its own in it
if MEMORY.is_dir() and shutil.disk_usage(MEMORY).free >= ROOM and not os.statvfs(MEMORY).f_flag & os.ST_NOEXEC:
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))

# The suite draws the same cases each time, so that it fails by a change alone; campaigns draw others, and more of them.
SUITE = settings(
    deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True, derandomize=True, max_examples=30
)
settings.register_profile("suite", SUITE)
settings.register_profile("campaign", SUITE, derandomize=False, max_examples=1000)
settings.load_profile("suite")
NAMED = 60  # characters
COMPILE_S = 600
"""Longest compilation of the kernel, on a loaded machine."""


def pytest_addoption(parser):
    parser.addoption("--campaign", action="store_true", help="also the tests that take long and say the same again")
    parser.addoption("--postgres", action="store_true", help="identity providers over PostgreSQL instead of SQLite")


def pytest_configure(config):
    """The kernel is compiled once, before several workers would each compile it beside tests in which time passes.

    A worker has a session of its own: the system gives each session an equal share of the processor, and regards the
    scheduling of a thread only within its session.
    """
    if config.pluginmanager.hasplugin("rerunfailures"):
        config.option.rerun_show_tracebacks = True  # the first failure says more than the second
    if config.getoption("campaign"):
        settings.load_profile("campaign")
    if config.getoption("postgres"):
        from tests.ztpm_idp import world

        world.DATABASE[:] = ["postgres"]
    if hasattr(config, "workerinput"):
        os.setsid()
    if getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput"):
        compile_it = "from pep.pit.assessment.readiness import compile_all; compile_all()"
        subprocess.run([sys.executable, "-c", compile_it], cwd=config.rootpath, check=True, timeout=COMPILE_S)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Nothing that is collected is garbage: looking for some took half the time, and later tenths of a second each."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_make_parametrize_id(config, val, argname):  # noqa: ARG001 - pytest's signature
    """Names cases by the beginning of a long text: the rest may be a megabyte, or drawn anew."""
    if isinstance(val, str | bytes) and len(val) > NAMED:
        return f"{argname}: {ascii(val[:NAMED])}"
    return None


WAITING = (
    "tests/pep", "tests/ursim/ports", "tests/ztpm/cli", "tests/e2e/conformance", "tests/e2e/test_tool_gateway.py",
)  # fmt: skip
"""Places of tests in real time that start no whole cell."""


def in_real_time(item):
    """True where an arm moves, or a short limit runs, on the machine's own clock."""
    return any(item.get_closest_marker(name) is not None for name in ("e2e", "real_time"))


SEEDS = 2
"""Number of seeds of a long test that are for the suite.

The others draw more of the same, for campaigns.
"""


def draws_more(item):
    """True where it is a long test once more with another seed."""
    seed = item.callspec.params.get("seed", 0) if hasattr(item, "callspec") else 0
    return item.get_closest_marker("long") is not None and seed >= SEEDS


def parsed_in_peace(*args, parse=ast.parse, **named):
    """The tree of a source, converted while no garbage is collected.

    A finalizer that raises is told with its traceback, which Python 3.11 parses, too: the conversion around it then
    fails with SystemError, "AST constructor recursion depth mismatch".
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        return parse(*args, **named)
    finally:
        if collects:
            gc.enable()


ast.parse = parsed_in_peace


TRUSTED = cache(httpcore2.default_ssl_context)
"""The system's certificates, read once.

    That takes 20 ms, and most clients of tests speak to no server that has one."""


def trusted(*, _trust_env=True, read=httpcore2.default_ssl_context):
    """The certificates that a client trusts where nothing else is said; those that the environment names, read anew."""
    named = _trust_env and (os.environ.get("SSL_CERT_FILE") or os.environ.get("SSL_CERT_DIR"))
    return read() if named else TRUSTED()


httpcore2.default_ssl_context = trusted


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Tests in which real time passes run on two workers, with `--dist loadgroup`; the others have the rest.

    Those of single lines mostly wait, the others start whole cells: together they fit on two processors. Three at once
    changed what steps of the demo saw.

    One that fails is begun once more, and the summary counts it: a shared machine may stand still for longer than an
    arm's watch allows. What fails by itself fails twice; how often deadlines are missed is for campaigns to say.
    """
    for item in items:
        if draws_more(item):
            item.add_marker(pytest.mark.campaign)
    if not config.getoption("campaign"):
        later = [item for item in items if item.get_closest_marker("campaign") is not None]
        items[:] = [item for item in items if item.get_closest_marker("campaign") is None]
        config.hook.pytest_deselected(items=later)
    for item in items:
        if in_real_time(item):
            waits = any(item.path.is_relative_to(config.rootpath / place) for place in WAITING)
            item.add_marker(pytest.mark.xdist_group("lines" if waits else "cells"))
            if config.pluginmanager.hasplugin("rerunfailures"):  # not with `-p no:rerunfailures`
                item.add_marker(pytest.mark.flaky(reruns=1))
    items.sort(key=lambda item: not in_real_time(item))  # they take longest, so they begin first


SHARE = Path("/proc/self/autogroup")
"""Takes the niceness of this session among others, where the system shares the processor among sessions."""


def share(niceness):
    """Sets the share of the processor that this worker's session has, where that can be set."""
    if "PYTEST_XDIST_WORKER" in os.environ and SHARE.exists():
        with suppress(OSError):
            SHARE.write_text(str(niceness))


@pytest.fixture(autouse=True)
def polite(request):
    """Tests that only compute leave the processor to those in which real time passes.

    Several run at once on few cores, and a cell is stopped when its watch comes too late. What they start computes as
    they do. Where the system does not let a thread come back from idle scheduling, batch scheduling is what there is.
    A thread that a test has made go first is an ordinary one again after it.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    if not in_real_time(request.node):
        os.sched_setscheduler(0, os.SCHED_IDLE if os.geteuid() == 0 else os.SCHED_BATCH, os.sched_param(0))
    share(0 if in_real_time(request.node) else 19)
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
