"""Start of a leased Python program, before its own first line: its calls to ur_rtde are made patient.

Python imports the module of this name that it finds first. One that the program's Python has of its own is imported
next.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from patient_calls import make_patient_when_imported  # type: ignore[import-not-found]  # beside this file

VARIABLE = "ZTPM_ROBOT"
HERE = Path(__file__).resolve().parent


def _next() -> None:
    """Imports the module of this name that would have been found without us."""
    sys.path[:] = [place for place in sys.path if not place or Path(place).resolve() != HERE]
    own = sys.modules.pop("sitecustomize")
    try:
        import sitecustomize  # type: ignore[import-not-found]  # noqa: F401 - another one
    except ImportError:
        sys.modules["sitecustomize"] = own


make_patient_when_imported(os.environ.get(VARIABLE, ""))
_next()
