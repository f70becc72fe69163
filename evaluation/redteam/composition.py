"""Modes of the red team: which primitives are on in the processes of a cell.

Off is no setting of the product. A process of the cell is begun as `evaluation.redteam.composition OFF MODULE
ARGUMENTS...`, which takes the checks of the primitives in OFF out of that process from outside, and then runs MODULE.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any, Final

from policies.primitives.catalog import CATALOG
from ztpm.base.processes import Child

if TYPE_CHECKING:
    from collections.abc import Callable

ALL: Final = frozenset(row.id for row in CATALOG)
TOKENS: Final = frozenset({"AID-1", "AID-2", "AID-3", "AID-4", "AID-5", "CATP-2", "CATP-4", "TEA-1", "TEA-2", "TEA-3"})
"""Primitives that a capability token and its verification answer by themselves."""
PHYSICS: Final = "physics"
"""Computed tiers and the watch: off beside primitives that decide by registered classes and declared rows alone."""
MODES: Final = {
    "tokens": frozenset({*(ALL - TOKENS), PHYSICS}),
    "policy": frozenset({PHYSICS}),
    "all": frozenset[str](),
}
"""What is off in each mode with enforcement."""


def composed(off: frozenset[str]) -> Callable[..., Child]:
    """Beginning of a cell's processes with these off, in place of `Child.begin`."""
    if not off:
        return Child.begin

    def begin(name: str, module: str, *arguments: str, **options: Any) -> Child:
        return Child.begin(name, "evaluation.redteam.composition", ",".join(sorted(off)), module, *arguments, **options)

    return begin


def take_out(off: frozenset[str]) -> None:
    """Takes the checks of these out of this process."""
    raise NotImplementedError(off)


def main() -> Any:
    """Runs a module of a cell without some of its checks."""
    off, module, *arguments = sys.argv[1:]
    take_out(frozenset(off.split(",")))
    sys.argv = [module, *arguments]
    return importlib.import_module(module).main()


if __name__ == "__main__":
    sys.exit(main())
