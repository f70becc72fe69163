import subprocess
import sys

ENDS_BEFORE_ITS_INPUT = """
import threading
from pathlib import Path
from ztpm import lease_process

reader = threading.Thread(target=lease_process._give_up_with_input, args=(bool,), daemon=True)
reader.start()
state = Path(f"/proc/self/task/{reader.native_id}/stat")
while state.read_text().rpartition(")")[2].split()[0] != "S":
    pass
"""


def test_lease_that_is_over_before_its_program_ends_its_process_cleanly() -> None:
    """The thread that waits for the end of the input is then still waiting."""
    begun = [sys.executable, "-c", ENDS_BEFORE_ITS_INPUT]
    with subprocess.Popen(begun, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stderr is not None
        told = child.stderr.read()  # to its end, which comes while the input is still open
        assert (child.wait(30), told) == (0, b"")
