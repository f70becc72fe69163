"""Facts and vectors made by others: they lie in `shared/data` beside the checkout, and tests skip where they are absent."""

from pathlib import Path
from typing import Final

SHARED: Final = Path(__file__).parents[2] / "shared" / "data"
