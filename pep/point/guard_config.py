"""Configuration of a guarded tool server: `guard.toml`, of five lines or six, read strictly."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pep.base.declaration import row_from_toml
from pep.point.config_text import check_url, read_text, spelled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.base.operation_row import Operation

OPTIONAL: Final = frozenset({"policy", "tool"})


@dataclass(frozen=True, slots=True)
class GuardConfig:
    """`guard.toml`, checked. A relative path begins at the folder of the file.

    Attributes:
        audience: canonical URL of the server; its path is where the app answers.
        pep_id: this PEP's registered id.
        issuer: base URL of the identity provider.
        trust_file: its public trust bundle.
        pep_key_file: this PEP's key, encrypted; its passphrase is in `ZTPM_PASSPHRASE`.
        folder: of the journal and of all other state over restarts; it is made where it is missing.
        policy: name of a shipped set, or a path.
        tool: declarations of tools that cannot be decorated, by the tool's name.
    """

    audience: str
    pep_id: str
    issuer: str
    trust_file: Path
    pep_key_file: Path
    folder: Path
    policy: str = "tools"
    tool: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | str) -> GuardConfig:
        """The configuration of a file.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        path = Path(path)
        given = spelled(cls, read_text(path), optional=OPTIONAL)
        home = path.absolute().parent
        config = cls(**{**given, **{name: home / each for name, each in given.items() if isinstance(each, Path)}})
        for name, url in (("audience", config.audience), ("issuer", config.issuer)):
            check_url(name, url)
        return config

    @property
    def journal_file(self) -> Path:
        """The durable journal."""
        return self.folder / "journal.ndjson"

    @property
    def state_dir(self) -> Path:
        """Directory of all other state over restarts."""
        return self.folder

    def rows(self) -> dict[str, Operation]:
        """The declared rows, by the name of the tool.

        Raises:
            DeclarationError: naming the tool.
        """
        return {name: row_from_toml(name, table) for name, table in self.tool.items()}
