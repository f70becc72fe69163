"""A module whose process ends with its parent's: `python -m ztpm.tether PARENT MODULE ARGUMENTS...`.

However the parent dies, kill -9 included, the kernel sends SIGTERM here, and the module ends as it does when it is
asked to. So no child of a cell outlives the cell. The kernel counts the *thread* that started the child as its parent:
start children from a thread that lives as long as they may.
"""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys
from typing import Final

PR_SET_PDEATHSIG: Final = 1  # include/uapi/linux/prctl.h


def main() -> None:
    """The module runs as the main program. Exit status 1 when the parent is gone already."""
    parent, module = int(sys.argv[1]), sys.argv[2]
    if ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0) != 0:
        sys.exit("ztpm.tether: the kernel refuses PR_SET_PDEATHSIG")
    # After the call above: a parent that died before it sends nothing.
    if os.getppid() != parent:
        sys.exit("ztpm.tether: the parent is gone")
    sys.argv[:] = sys.argv[2:]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
