"""Configuration of a guarded tool server: `guard.toml`, of five lines or six, read strictly."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from pep.base.declaration import row_from_toml
from pep.base.tcp_place import tcp_place
from pep.journal.budget_store import BUDGETS
from pep.point.config_text import check_url, read_text, spelled
from policies.decision.load import SHIPPED

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.base.operation_row import Operation

OPTIONAL: Final = frozenset({"budgets", "policy", "tool", "sensors", "authzen"})


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
        budgets: store of what is spent, shared by all workers of this audience; None for one in `folder`.
        policy: name of a shipped set, or a path.
        tool: declarations of tools that cannot be decorated, by the tool's name.
        sensors: "HOST:PORT" at which sensors push their frames; "" where no row depends on a fact.
        authzen: whether gateways may ask for evaluations, at the origin of the audience (docs/authzen.md).
    """

    audience: str
    pep_id: str
    issuer: str
    trust_file: Path
    pep_key_file: Path
    folder: Path
    budgets: Path | None = None
    policy: str = "tools"
    tool: Mapping[str, Any] = field(default_factory=dict)
    sensors: str = ""
    authzen: bool = False

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """The configuration of a file.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        return cls.read_as(path, optional=OPTIONAL)

    @classmethod
    def read_as(
        cls, path: Path | str, *, optional: frozenset[str], completed: Callable[[dict[str, Any]], dict[str, Any]] = dict
    ) -> Self:
        """The configuration of a file whose settings are completed before they are checked.

        Args:
            path: of the file.
            optional: settings that may be left out.
            completed: gives the settings with those that follow from them.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        path = Path(path)
        given = completed(spelled(cls, read_text(path), optional=optional))
        home = path.absolute().parent
        if given.get("policy", SHIPPED[0]) not in SHIPPED:
            given["policy"] = str(home / given["policy"])
        config = cls(**{**given, **{name: home / each for name, each in given.items() if isinstance(each, Path)}})
        for name, url in (("audience", config.audience), ("issuer", config.issuer)):
            check_url(name, url)
        if config.sensors:
            config.sensor_address()
        return config

    def sensor_address(self) -> tuple[str, int]:
        """Host and TCP port of `sensors`.

        Raises:
            ConfigError: `CONFIG_INVALID`.
        """
        return tcp_place(self.sensors, name="sensors")

    @property
    def journal_file(self) -> Path:
        """The durable journal."""
        return self.folder / "journal.ndjson"

    @property
    def state_dir(self) -> Path:
        """Directory of all other state over restarts."""
        return self.folder

    @property
    def budget_file(self) -> Path:
        """The durable store of what is spent."""
        return self.folder / BUDGETS if self.budgets is None else self.budgets

    def rows(self) -> dict[str, Operation]:
        """The declared rows, by the name of the tool.

        Raises:
            DeclarationError: naming the tool.
        """
        return {name: row_from_toml(name, table) for name, table in self.tool.items()}
