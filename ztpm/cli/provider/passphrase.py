"""The passphrase of a cell's keys: from the environment, or asked for; never stored, never an argument."""

from __future__ import annotations

import os
import sys
from typing import Final

import typer

from ztpm.cli.output import fail

MIN_PASSPHRASE: Final = 12
VARIABLE: Final = "ZTPM_PASSPHRASE"


def ask_passphrase(*, new: bool) -> bytes:
    """The passphrase.

    Args:
        new: whether it is for keys that will be made: it is asked for twice and must be long enough.
        as_json: form of a failure's message.
    """
    passphrase = os.environ.get(VARIABLE, "")
    if not passphrase:
        if not sys.stdin.isatty():
            fail("PASSPHRASE_MISSING", f"{VARIABLE} is not set, and standard input is no terminal")
        passphrase = typer.prompt("Passphrase of the keys", hide_input=True, confirmation_prompt=new, err=True)
    if new and len(passphrase) < MIN_PASSPHRASE:
        fail("PASSPHRASE_TOO_SHORT", f"at least {MIN_PASSPHRASE} characters")
    try:
        return passphrase.encode()
    except UnicodeEncodeError:
        fail("PASSPHRASE_MALFORMED", "not UTF-8")
