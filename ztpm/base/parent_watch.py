"""Main program whose process ends with its parent's: `python -m ztpm.base.parent_watch PARENT MODULE ARGUMENTS...`.

However the parent dies, kill -9 included, the kernel sends SIGTERM here, and the module ends as it does when it is
asked to. So no child of a cell outlives the cell. The kernel counts the *thread* that started the child as its parent:
start children from a thread that lives as long as they may. A signal can be lost in a module that is just busy with
another end; so this looks for its parent as well, and does not wait for ever.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import os
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

PR_SET_PDEATHSIG: Final = 1  # include/uapi/linux/prctl.h

LOOK_S: Final = 0.5
END_S: Final = 12.0
"""Longest wait for the module's own end.

The arm's stop takes 5 s at most, and its connections as long again.
"""


def ends_with_parent() -> Callable[[], None]:
    """Asks the kernel for SIGTERM at the parent's death; for a child before it becomes its program."""
    libc = ctypes.CDLL(None)  # loaded here: between fork and exec nothing may be

    def tie() -> None:
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)

    return tie


def _follow(parent: int) -> None:
    """Ends the process soon after its parent, in spite of the module's own signal handling."""
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(END_S)
    os._exit(1)


def main() -> None:
    """Runs the module's `main` as the main program. Exit status 1 when the parent is gone already."""
    parent, module = int(sys.argv[1]), sys.argv[2]
    if ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0) != 0:
        sys.exit("ztpm.base.parent_watch: the kernel refuses PR_SET_PDEATHSIG")
    # After the call above: a parent that died before it sends nothing.
    if os.getppid() != parent:
        sys.exit("ztpm.base.parent_watch: the parent is gone")
    threading.Thread(target=_follow, args=(parent,), name="tether", daemon=True).start()
    sys.argv[:] = sys.argv[2:]
    gc.disable()  # nothing that is imported is garbage: looking for some took a seventh of a start
    program = importlib.import_module(module).main
    gc.freeze()
    gc.enable()
    sys.exit(program())


if __name__ == "__main__":
    main()
