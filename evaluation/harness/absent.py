"""Packages of peers, imported when they are measured and not before."""

from __future__ import annotations

import importlib
from importlib import metadata
from typing import Any


class AbsentError(Exception):
    """A peer's package is not installed; the text says how to get it."""


def package(module: str, distribution: str) -> tuple[Any, str]:
    """The module and the version of its distribution.

    Raises:
        AbsentError: when it is not installed.
    """
    try:
        return importlib.import_module(module), metadata.version(distribution)
    except (ImportError, metadata.PackageNotFoundError):
        raise AbsentError(f"not installed: {distribution} (pip install 'ztpm[bench]')") from None
