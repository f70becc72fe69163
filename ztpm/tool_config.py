"""The configuration of a cell's tool server, read strictly; what is insecure or contradictory is refused by name."""

from __future__ import annotations

import ipaddress
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self
from urllib.parse import urlsplit

from capabilities import keys
from capabilities.caps import DEFAULT as CAPS
from capabilities.errors import CapabilityError, FaultCode
from capabilities.statements import cell
from capabilities.trust import TrustBundle
from pep import key_file
from pep.errors import ConfigError, PepFault
from pep.pit import (
    CALIBRATED_UNCERTAINTY_M,
    Calibration,
    CellError,
    CellParameters,
    ModelError,
    Robot,
    SurveyError,
    numbers_only,
    surveyed,
)
from pep.rtde.gripper import DRIVEN
from pep.rtde.stops import JOINT_DECELERATION_LIMIT_RAD_S2
from policies.errors import PolicyError
from policies.load import SHIPPED, load, load_shipped

if TYPE_CHECKING:
    from capabilities.keys import PrivateKey
    from policies.policy import PolicySet

ROBOT_MODEL: Final = "ur3e"
CONFIG_BYTES: Final = 1_048_576
"""Largest configuration; ours."""
CALIBRATION_BYTES: Final = 65_536
"""Largest calibration file that is read at all; the vendor's tool writes about 1000."""
OPTIONAL: Final = frozenset({"calibration_file"})
"""Settings that may be left out."""


@dataclass(frozen=True, slots=True)
class CellConfig:
    """`cell.toml`, checked.

    Attributes:
        audience: canonical URL of this server; also the `htu` of every proof.
        host, port: where it listens.
        pep_id: this PEP's registered id.
        issuer: base URL of the identity provider.
        trust_file: its public trust bundle.
        pep_key_file: this PEP's key, encrypted.
        journal_file: the durable journal.
        state_dir: what is kept over restarts besides.
        robot_host: address of the controller.
        perception_port: where sensors push frames, on `host`.
        policy: name of a shipped set, or a path.
        defer_timeout_s: how long a deferral waits for a person.
        cell_file: what stands in the cell, signed by a person (`ztpm cell sign`).
        cell_signer_key: that person's public key: 32 raw bytes in base64url.
        cell: numbers of the physics engine; what stands in the cell is not among them.
        calibration_file: the arm's own kinematics, as its vendor's tool exports them (PHY-41); None for an arm that is
            reckoned with at its nominal ones, and with more uncertainty.
    """

    audience: str
    host: str
    port: int
    pep_id: str
    issuer: str
    trust_file: Path
    pep_key_file: Path
    journal_file: Path
    state_dir: Path
    robot_host: str
    perception_port: int
    policy: str
    defer_timeout_s: int
    cell_file: Path
    cell_signer_key: str
    cell: CellParameters
    calibration_file: Path | None = None

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """The configuration that a TOML text spells: every key given but `calibration_file`, none unknown.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        try:
            table = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ConfigError(PepFault.CONFIG_INVALID, "not TOML") from error
        names = {field.name for field in fields(cls)}
        for wrong in sorted((names - OPTIONAL - set(table)) | (set(table) - names)):
            raise ConfigError(PepFault.CONFIG_INVALID, f"{wrong} is {'missing' if wrong in names else 'unknown'}")
        given: dict[str, Any] = {}
        for field in fields(cls):
            if field.name not in table:
                continue
            value = table[field.name]
            wanted = {"int": int, "CellParameters": dict}.get(str(field.type), str)
            if type(value) is not wanted or value == "":
                raise ConfigError(PepFault.CONFIG_INVALID, f"{field.name} must be a {wanted.__name__}, and not empty")
            given[field.name] = Path(str(value)) if str(field.type).startswith("Path") else value
        if "calibration_file" in given:
            given["cell"] = {"robot_uncertainty_m": CALIBRATED_UNCERTAINTY_M, **given["cell"]}
        try:
            given["cell"] = numbers_only(given["cell"])
        except CellError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, f"cell: {error.detail}") from error
        config = cls(**given)
        config.check()
        return config

    def check(self) -> None:
        """Nothing in it is insecure.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        for name, url in (("audience", self.audience), ("issuer", self.issuer)):
            check_url(name, url)
        if urlsplit(self.audience).scheme == "http" and not is_loopback(self.host):
            raise ConfigError(PepFault.CONFIG_INVALID, "host: plain HTTP on loopback only")
        for name, port in (("port", self.port), ("perception_port", self.perception_port)):
            check_port(name, port)
        if not 1 <= self.defer_timeout_s <= 3_600:
            raise ConfigError(PepFault.CONFIG_INVALID, "defer_timeout_s must be 1 to 3600")
        try:
            keys.check_raw(keys.unb64u(self.cell_signer_key))
        except CapabilityError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, "cell_signer_key is no public key") from error
        if self.cell.stop_deceleration_rad_s2 > JOINT_DECELERATION_LIMIT_RAD_S2:
            raise ConfigError(PepFault.CONFIG_INVALID, "cell: stop_deceleration_rad_s2 is harder than a stop can be")


def check_url(name: str, url: str) -> None:
    """It is a URL with a path, and a secure one.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    parts = urlsplit(url)
    if (
        parts.scheme not in {"http", "https"}
        or not parts.hostname
        or len(parts.path) < 2
        or parts.query
        or parts.fragment
    ):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name} must be a URL with a path")
    if parts.scheme == "http" and not is_loopback(parts.hostname):
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name}: plain HTTP on loopback only")


def check_port(name: str, port: int) -> None:
    """It is a TCP port.

    Raises:
        ConfigError: `CONFIG_INVALID`, naming the key.
    """
    if not 1 <= port <= 65_535:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{name} is no port")


def is_loopback(host: str) -> bool:
    """Whether the host is this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def read_config(path: Path) -> CellConfig:
    """The configuration at `path`.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    return CellConfig.from_toml(read_text(path))


def read_text(path: Path) -> str:
    """The text of a configuration.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        raw = path.read_bytes()
        if len(raw) > CONFIG_BYTES:
            raise ConfigError(PepFault.CONFIG_INVALID, "too large")
        return raw.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"{path}: {type(error).__name__}") from error


def read_trust(config: CellConfig) -> TrustBundle:
    """The trust bundle of the configured issuer.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        trust = TrustBundle.from_json(config.trust_file.read_bytes())
    except (OSError, CapabilityError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"trust_file: {type(error).__name__}") from error
    if trust.issuer != config.issuer:
        raise ConfigError(PepFault.CONFIG_INVALID, "trust_file is of another issuer")
    return trust


def read_key(config: CellConfig) -> PrivateKey:
    """The PEP's key.

    Raises:
        ConfigError: `CONFIG_INVALID` when it is missing, readable by others, or the passphrase is missing or wrong.
    """
    return key_file.read_key(config.pep_key_file, name="pep_key_file")


def read_policies(config: CellConfig) -> PolicySet:
    """The policy set.

    Raises:
        ConfigError: `CONFIG_INVALID`.
    """
    try:
        if config.policy in SHIPPED:
            return load_shipped(config.policy)
        return load(Path(config.policy).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, PolicyError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"policy: {error}") from error


def read_robot(config: CellConfig, *, tool: str) -> Robot:
    """The arm of the cell with this tool: as it is calibrated where the configuration says how, else nominal.

    Args:
        config: names the calibration.
        tool: what it carries.

    Raises:
        ConfigError: `CONFIG_INVALID`: no such tool; a calibration that cannot be read, is not strictly of the vendor's
            form, or is farther from nominal than any arm of this model.
    """
    try:
        own = None if config.calibration_file is None else _calibration(config.calibration_file)
    except (ModelError, OSError, UnicodeDecodeError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"calibration_file: {_said(error)}") from error
    try:
        nominal = Robot.load(ROBOT_MODEL, tool=tool)
    except ModelError as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"cell_file: {error}") from error
    if own is None:
        return nominal
    try:
        return Robot.load(ROBOT_MODEL, tool=tool, calibration=own)
    except ModelError as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"calibration_file: {_said(error)}") from error


def _calibration(path: Path) -> Calibration:
    with path.open("rb") as opened:
        raw = opened.read(CALIBRATION_BYTES + 1)
    return Calibration.from_yaml(raw.decode("utf-8"))


def _said(error: Exception) -> str:
    """What is wrong, without a path or a text of the file."""
    return error.detail if isinstance(error, ModelError) else type(error).__name__


def read_cell(config: CellConfig, *, at: float) -> cell.Cell:
    """What stands in the cell, by the word of the person that the configuration names.

    Args:
        config: names file and signer.
        at: seconds since the epoch; the file must be in force then.

    Raises:
        ConfigError: `CONFIG_INVALID`: no such file, signed by another key or not at all, for another server, not in
            force, or contradicting itself.
    """
    try:
        text = config.cell_file.read_bytes()[: CAPS.statement_bytes + 1].decode("ascii").strip()
        stated = cell.open(text, frozenset({keys.unb64u(config.cell_signer_key)}), CAPS)
        surveyed(stated, config.cell)
        read_robot(config, tool=stated.tool)
    except CapabilityError as error:
        where = "cell_signer_key" if error.code is FaultCode.STATEMENT_UNTRUSTED else "cell_file"
        raise ConfigError(PepFault.CONFIG_INVALID, f"{where}: {error.code} {error.detail}") from error
    except SurveyError as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"cell_file: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"cell_file: {type(error).__name__}") from error
    if stated.tool != DRIVEN:
        raise ConfigError(PepFault.CONFIG_INVALID, "cell_file: TOOL_NOT_DRIVEN")
    if stated.audience != config.audience:
        raise ConfigError(PepFault.CONFIG_INVALID, "cell_file: WRONG_AUDIENCE")
    if not stated.not_before <= at < stated.not_after:
        raise ConfigError(
            PepFault.CONFIG_INVALID, f"cell_file: {'EXPIRED' if at >= stated.not_before else 'NOT_YET_VALID'}"
        )
    return stated
