"""The passphrase of keys: from the environment or the file that it names, or asked for; never an argument."""

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
    from ztpm_idp.keys.key_files import SettingsError
    from ztpm_idp.keys.passphrase import passphrase_of

    try:
        passphrase = passphrase_of(VARIABLE, os.environ)
    except SettingsError as error:
        fail("PASSPHRASE_MALFORMED", f"{error.setting}: {error.why}")
    if not passphrase:
        if not sys.stdin.isatty():
            fail(
                "PASSPHRASE_MISSING",
                f"neither {VARIABLE} nor ZTPM_PASSPHRASE_FILE is set, and standard input is no terminal",
            )
        passphrase = typer.prompt("Passphrase of the keys", hide_input=True, confirmation_prompt=new, err=True)
    if new and len(passphrase) < MIN_PASSPHRASE:
        fail("PASSPHRASE_TOO_SHORT", f"at least {MIN_PASSPHRASE} characters")
    try:
        return passphrase.encode()
    except UnicodeEncodeError:
        fail("PASSPHRASE_MALFORMED", "not UTF-8")
