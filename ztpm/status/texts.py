"""English texts of a running cell's page, read once from `texts.toml`: the one file that a translation replaces."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Final

TEXTS: Final[dict[str, Any]] = tomllib.loads((Path(__file__).parent / "texts.toml").read_text("utf-8"))
"""Texts by part of the page, then by name."""
