"""First start on a busy machine that has compiled nothing yet: it says how far it is."""

import json
import os
import select
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

SILENT_S = 5.0
READY_S = 900.0  # a shared machine may give a tenth of a core
BUSY = 4
pytestmark = [pytest.mark.e2e, pytest.mark.campaign, pytest.mark.timeout(1200)]


@pytest.fixture
def busy():
    """Others compute as well."""
    with ExitStack() as stack:
        for _ in range(BUSY):
            other = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(other.kill)
        yield


def heard(process):
    """Each piece of output with its stream, and the silence before it, until the process ends or is ready."""
    streams, last = {process.stdout.fileno(): "out", process.stderr.fileno(): "err"}, time.monotonic()
    while streams:
        found, _, _ = select.select(list(streams), [], [], READY_S)
        assert found
        for each in found:
            text = os.read(each, 1 << 16).decode()
            if not text:
                del streams[each]
                continue
            now = time.monotonic()
            yield streams[each], text, now - last
            last = now


@pytest.mark.usefixtures("busy")
def test_a_first_start_is_never_silent_for_long(tmp_path):
    command = [str(Path(sys.executable).with_name("ztpm")), "up", "--data", str(tmp_path / "cell"), "--json"]
    environment = {**os.environ, "ZTPM_PASSPHRASE": "a passphrase for tests", "NUMBA_CACHE_DIR": str(tmp_path / "none")}
    told, silences, ready = "", [], {}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        try:
            for stream, text, silence in heard(process):
                silences.append(silence)
                if stream == "out":
                    ready = json.loads(text)
                    break
                told += text
        finally:
            process.terminate()
            process.communicate(timeout=60)
    assert ready["ready"] is True, told
    assert max(silences) <= SILENT_S, told
    assert "compiling the physics kernel: " in told
