"""Numbers copied from one array to another, of any shape.

Assigning to a slice would do, and bring with it the text of its error message, which takes longer to compile than the
search that it stands in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.pit.search.kernel.arithmetic.compilation import compiled

if TYPE_CHECKING:
    from typing import Any


@compiled
def copy_into(wide: Any, narrow: Any) -> None:
    """The first rows of `wide` are all rows of `narrow`, which has the same shape but for their number."""
    to, of = wide.flat, narrow.flat
    for at in range(narrow.size):
        to[at] = of[at]
