import os
import subprocess
import sys

import pytest
from ztpm.base.lock import DirectoryLock, LockedError


def test_one_at_a_time_and_the_holder_is_named(tmp_path):
    with DirectoryLock.take(tmp_path / "lock") as held:
        assert held.stale_pid is None
        with pytest.raises(LockedError) as raised:
            DirectoryLock.take(tmp_path / "lock")
        assert raised.value.pid == os.getpid()
    with DirectoryLock.take(tmp_path / "lock") as again:
        assert again.stale_pid is None
    assert (tmp_path / "lock").stat().st_mode & 0o777 == 0o600


def test_a_holder_that_was_killed_leaves_its_pid_and_no_lock(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from ztpm.base.lock import DirectoryLock\n"
        "held = DirectoryLock.take(Path(sys.argv[1])); print('held', flush=True); time.sleep(60)"
    )
    holder = subprocess.Popen([sys.executable, "-c", code, tmp_path / "lock"], stdout=subprocess.PIPE)
    with holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(LockedError) as raised:
            DirectoryLock.take(tmp_path / "lock")
        assert raised.value.pid == holder.pid
        holder.kill()
    with DirectoryLock.take(tmp_path / "lock") as held:
        assert held.stale_pid == holder.pid


@pytest.mark.parametrize("content", [b"", b"\0" * 40, b"not a pid", b"-1"])
def test_rubbish_in_the_file_is_no_pid(tmp_path, content):
    (tmp_path / "lock").write_bytes(content)
    with DirectoryLock.take(tmp_path / "lock") as held:
        assert held.stale_pid is None


def test_a_child_that_has_the_file_open_does_not_hold_it(tmp_path):
    held = DirectoryLock.take(tmp_path / "lock")
    child = os.dup(held._fd)  # as between fork and exec
    held.give_back()
    with DirectoryLock.take(tmp_path / "lock"):
        os.close(child)


def test_children_do_not_hold_it(tmp_path):
    held = DirectoryLock.take(tmp_path / "lock")
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, close_fds=False)
    with child:
        held.give_back()
        with DirectoryLock.take(tmp_path / "lock"):
            pass
        child.communicate(b"\n")
