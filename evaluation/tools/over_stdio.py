"""Process that serves the act over stdio: behind the guard of the configuration it is given, or without one."""

from __future__ import annotations

import sys

from evaluation.tools import act
from pep import guard


def main() -> None:
    """Serves until its standard input ends."""
    if len(sys.argv) > 1:
        guard(act.server(), sys.argv[1]).run_stdio()
    else:
        act.server().run()


if __name__ == "__main__":
    main()
