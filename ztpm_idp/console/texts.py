"""English texts of the console's pages, read once from `texts.toml`: the one file that a translation replaces."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

TEXTS: Final[dict[str, Any]] = tomllib.loads((Path(__file__).parent / "texts.toml").read_text("utf-8"))
"""Texts by page, then by name."""
