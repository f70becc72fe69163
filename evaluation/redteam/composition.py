"""Modes of the red team: which primitives are on in the processes of a cell.

Off is no setting of the product. A process of the cell is begun as `evaluation.redteam.composition OFF MODULE
ARGUMENTS...`, which takes the checks of the primitives in OFF out of that process from outside
(`evaluation.redteam.taken_out`), and then runs MODULE.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any, Final

from evaluation.redteam.taken_out.rows import PHYSICS, concerning, take_out
from policies.primitives.catalog import CATALOG
from ztpm.base.processes import Child

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

ALL: Final = frozenset(row.id for row in CATALOG)
TOKENS: Final = frozenset({"AID-1", "AID-2", "AID-3", "AID-4", "AID-5", "CATP-2", "CATP-4", "TEA-1", "TEA-2", "TEA-3"})
"""Primitives that a capability token and its verification answer by themselves."""
MODES: Final = {
    "tokens": frozenset({*(ALL - TOKENS), PHYSICS}),
    "policy": frozenset({PHYSICS}),
    "all": frozenset[str](),
}
"""Primitives that are off in each mode with enforcement."""


def composed(off: Collection[str], by: Callable[..., Child] = Child.begin) -> Callable[..., Child]:
    """Beginning of processes with these off, in place of `Child.begin`; one that none of them concerns is whole.

    Args:
        off: ids of primitives, and `PHYSICS`.
        by: begins a process.
    """

    def begin(name: str, module: str, *arguments: str, **options: Any) -> Child:
        here = ",".join(sorted(concerning(name, off)))
        if not here:
            return by(name, module, *arguments, **options)
        return by(name, __name__, here, module, *arguments, **options)

    return begin


def main() -> Any:
    """Runs a module of a cell without some of its checks."""
    off, module, *arguments = sys.argv[1:]
    take_out(frozenset(off.split(",")))
    sys.argv = [module, *arguments]
    return importlib.import_module(module).main()


if __name__ == "__main__":
    sys.exit(main())
