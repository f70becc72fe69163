"""`ztpm idp`: the identity provider as its operators run it, with or without a cell.

The commands of a running one's store (backup, restore, resume, mark, recover) join the group in `ztpm/cli/__init__.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ztpm.cli.serve import become

app = typer.Typer(
    no_args_is_help=True, help="The identity provider: serve it, restore its store, recover an administrator."
)


@app.command("serve")
def serve(
    config: Annotated[Path, typer.Option("--config", help="Its configuration, idp.toml.", exists=True, dir_okay=False)],
) -> None:
    """Serve the identity provider; the passphrase of its keys comes from ZTPM_PASSPHRASE."""
    become("ztpm.point.provider_server", "--config", str(config))
