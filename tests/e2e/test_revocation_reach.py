"""Time from the acknowledgement of a revocation to the PEP's view, over real processes, by the hint alone.

The period never ends.

`pytest -s tests/e2e/test_revocation_reach.py` prints the figures.
"""

from __future__ import annotations

import json
import queue
import signal
import statistics
import subprocess
import sys
import threading
import time

import pytest
from tests.ztpm_idp.test_process import Process

from capabilities.keys import keys

pytestmark = pytest.mark.e2e
TIMES = 40
NEVER_S = 3_600.0
DEADLINE_S = 20.0


class Child:
    def __init__(self, *arguments):
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "tests.e2e.follow", *map(str, arguments)], stdout=subprocess.PIPE
        )
        self.lines = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.popen.stdout:
            self.lines.put(json.loads(line))

    def shows(self, revoked):
        """The monotonic instant, in ns, at which so many were first revoked in the view."""
        deadline = time.monotonic() + DEADLINE_S
        while True:
            said = self.lines.get(timeout=max(0.01, deadline - time.monotonic()))
            assert "incident" not in said, said
            if said["revoked"] >= revoked:
                return said["at_ns"]

    def end(self):
        self.popen.kill()
        self.popen.wait(10)
        self.popen.stdout.close()


@pytest.mark.timeout(300)
def test_a_revocation_reaches_the_pep_by_the_hint(tmp_path):
    process = Process(tmp_path).start()
    (tmp_path / "pep").mkdir()
    key = keys.generate()
    (tmp_path / "pep" / "key").write_bytes(key.private_bytes_raw())
    with process.operator() as alice:
        alice.register_pep("cell-1", keys.public_raw(key), ["http://127.0.0.1:8800/mcp"])
    child = Child(process.issuer, tmp_path / "pep", NEVER_S)
    try:
        child.shows(0)
        took_ms, whole_ms = [], []
        with process.operator() as alice:
            for number in range(TIMES):
                asked = time.monotonic_ns()
                alice.revoke("hop", f"{number:032x}", "measure")
                acknowledged = time.monotonic_ns()
                seen = child.shows(number + 1)
                took_ms.append((seen - acknowledged) / 1e6)
                whole_ms.append((seen - asked) / 1e6)
    finally:
        child.end()
        process.end(signal.SIGTERM)
    for name, values in (("acknowledged -> view", took_ms), ("asked -> view", whole_ms)):
        p = statistics.quantiles(values, n=100, method="inclusive")
        print(f"\n{name}: p50 {p[49]:.1f} ms, p99 {p[98]:.1f} ms, max {max(values):.1f} ms ({len(values)} times)")
    assert len(took_ms) == TIMES
