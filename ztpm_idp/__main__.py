"""`python -m ztpm_idp --config idp.toml`: the identity provider as a process."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import time
from pathlib import Path

from ztpm_idp.keys.key_files import PASSPHRASE_VARIABLE, SettingsError
from ztpm_idp.keys.key_ring import check_current
from ztpm_idp.settings import load_keys, load_platform, load_policies, load_settings

USAGE = 2
"""Exit status for a configuration that is refused."""


def main() -> int:
    """Serves by the configuration; the exit status."""
    parser = argparse.ArgumentParser(prog="ztpm_idp", description="The ZTPM identity provider.")
    parser.add_argument("--config", required=True, type=Path, help="idp.toml")
    config: Path = parser.parse_args().config
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s %(message)s")
    os.umask(0o077)  # the database is nobody else's
    try:
        settings = load_settings(config)
        # Taken out of the environment, so that no child and no dump of it has it.
        keys = load_keys(settings, config.parent, os.environ.pop(PASSPHRASE_VARIABLE, ""))
        check_current(keys, at=time.time())
        platform = load_platform(settings, config.parent, keys)
        policies = load_policies(settings, config.parent)
    except SettingsError as error:
        sys.stderr.write(f"refused to start: {error.setting}: {error.why}\n")
        return USAGE
    from ztpm_idp.server import serve  # a configuration is refused before the web framework is loaded

    # The server hands the signal back when it has ended in order; that is success, not death by signal.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    serve(settings.settings(keys), keys, platform, policies)
    return 0


if __name__ == "__main__":
    sys.exit(main())
