"""Registration of a guarded server at an arena's provider, and its guard's configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.keys import keys
from pep import pins
from ztpm.base.layout import new_key
from ztpm.cell.provider_setup import toml

if TYPE_CHECKING:
    from pathlib import Path

    from ztpm.stage.stage import Stage

KEY: Final = "point.key"
FOLDER: Final = "point"
"""Folder of the enforcement point, beside its `guard.toml`."""
JOURNAL: Final = "journal.ndjson"


def registered(stage: Stage, root: Path, *, pep: str, audience: str, server: Any) -> Path:
    """The `guard.toml` of a server whose point and tools a person has registered; the composition was reviewed.

    Args:
        stage: the cell with its people.
        root: where the key, the folder of the point and the configuration are made.
        pep: id of the enforcement point.
        audience: canonical URL of the server.
        server: its tools.
    """
    admin = stage.person("carol")
    (root / FOLDER).mkdir(mode=0o700)
    admin.register_pep(pep, keys.public_raw(new_key(root / KEY, stage.cell.passphrase)), [audience])
    for pin in pins(server):
        admin.register_tool(
            audience=audience,
            name=pin.name,
            definition_digest=pin.definition_digest,
            operation=pin.operation,
            base_tier=int(pin.base_tier),
        )
    stated = {
        "audience": audience,
        "pep_id": pep,
        "issuer": stage.cell.addresses.issuer,
        "trust_file": str(stage.cell.layout.trust),
        "pep_key_file": KEY,
        "folder": FOLDER,
    }
    guard = root / "guard.toml"
    guard.write_bytes(toml(stated))
    return guard
