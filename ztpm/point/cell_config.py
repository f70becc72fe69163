"""Configuration of a robot and its cell, read strictly; an insecure or contradictory one is refused by name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self

from capabilities.keys import keys
from capabilities.statements import cell
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import CapabilityError, FaultCode
from pep.base.errors import ConfigError, PepFault
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
from pep.pit.robot.calibration import calibrated, nominal_error_m
from pep.pit.robot.model import Model
from pep.pit.scene.cell import TRACKING_M
from pep.point.config_text import check_url, is_loopback, read_key, read_policies, read_text, read_trust, spelled
from pep.rtde.command.stop_rules import JOINT_DECELERATION_LIMIT_RAD_S2
from pep.rtde.robot.gripper import DRIVEN
from ztpm.point.point_config import TLS, PointConfig, check_port

__all__ = [
    "ROBOT_MODEL",
    "CellConfig",
    "check_port",
    "check_url",
    "is_loopback",
    "read_cell",
    "read_key",
    "read_policies",
    "read_robot",
    "read_text",
    "read_trust",
]

ROBOT_MODEL: Final = "ur3e"
CALIBRATION_BYTES: Final = 65_536
"""Largest calibration file that is read at all; the vendor's tool writes about 1000."""
MODEL_BYTES: Final = 1_048_576
"""Largest model file that is read at all; the shipped ones have about 12 000."""
MODEL_FILE: Final = ".toml"
STOP: Final = "stop_deceleration_rad_s2"
OPTIONAL: Final = frozenset({"calibration_file", "robot"}) | TLS
"""Settings that may be left out."""


@dataclass(frozen=True, slots=True)
class CellConfig(PointConfig):
    """The keys of every enforcement point, and these of the robot, its cell and its people, checked.

    Attributes:
        robot_host: address of the controller.
        perception_port: TCP port for sensors' frames, on `host`.
        defer_timeout_s: time for which a deferral waits for a person.
        cell_file: surveyed objects, signed by a person (`ztpm cell sign`).
        cell_signer_key: that person's public key: 32 raw bytes in base64url.
        cell: numbers of the physics engine; what stands in the cell is not among them.
        calibration_file: the arm's own kinematics, as its vendor's tool exports them (PHY-41); None for an arm that is
            reckoned with at its nominal ones, and with more uncertainty.
        robot: name of a shipped model, or the path of a model file (`ztpm robot fit`); the controller has to say the
            same of its arm.
    """

    robot_host: str
    perception_port: int
    defer_timeout_s: int
    cell_file: Path
    cell_signer_key: str
    cell: CellParameters
    calibration_file: Path | None = None
    robot: str = ROBOT_MODEL

    @classmethod
    def from_toml(cls, text: str) -> Self:
        """The configuration that a TOML text spells: every key given but those of `OPTIONAL`, none unknown.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        given = spelled(cls, text, optional=OPTIONAL)
        if "calibration_file" in given:
            given["cell"] = {"robot_uncertainty_m": CALIBRATED_UNCERTAINTY_M, **given["cell"]}
        if given.get("robot", ROBOT_MODEL) != ROBOT_MODEL:
            given["cell"] = _of_another_arm(given["robot"], given["cell"])
        try:
            given["cell"] = numbers_only(given["cell"])
        except CellError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, f"cell: {error.detail}") from error
        config = cls(**given)
        config.check()
        return config

    def placed(self, folder: Path) -> Self:
        """See `PointConfig.placed`; a model file likewise begins in the folder."""
        config = PointConfig.placed(self, folder)
        return replace(config, robot=str(folder / self.robot)) if self.robot.endswith(MODEL_FILE) else config

    def check(self) -> None:
        """Checks that nothing in it is insecure.

        Raises:
            ConfigError: `CONFIG_INVALID`, naming the key.
        """
        PointConfig.check(self)  # a class with slots is another one than `super()` knows
        check_port("perception_port", self.perception_port)
        if not 1 <= self.defer_timeout_s <= 3_600:
            raise ConfigError(PepFault.CONFIG_INVALID, "defer_timeout_s must be 1 to 3600")
        try:
            keys.check_raw(keys.unb64u(self.cell_signer_key))
        except CapabilityError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, "cell_signer_key is no public key") from error
        if self.cell.stop_deceleration_rad_s2 > JOINT_DECELERATION_LIMIT_RAD_S2:
            raise ConfigError(PepFault.CONFIG_INVALID, "cell: stop_deceleration_rad_s2 is harder than a stop can be")


def read_robot(config: CellConfig, *, tool: str) -> Robot:
    """Arm of the cell with this tool: calibrated where the configuration says so, else nominal.

    Args:
        config: names the calibration.
        tool: the mounted tool.

    Raises:
        ConfigError: `CONFIG_INVALID`: no such tool; a calibration that cannot be read, is not strictly of the vendor's
            form, or is farther from nominal than any arm of this model.
    """
    try:
        own = None if config.calibration_file is None else _calibration(config.calibration_file)
    except (ModelError, OSError, UnicodeDecodeError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"calibration_file: {_said(error)}") from error
    model = read_model(config.robot)
    try:
        nominal = Robot.from_model(model, tool=tool)
    except ModelError as error:
        known = ", ".join(each.name for each in model.tools)
        raise ConfigError(PepFault.CONFIG_INVALID, f"cell_file: {error}; {model.name} has {known}") from error
    if own is None:
        return nominal
    try:
        return Robot.from_model(calibrated(model, own), tool=tool)
    except ModelError as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"calibration_file: {_said(error)}") from error


def read_model(stated: str) -> Model:
    """Model of this name, or in this file.

    Raises:
        ConfigError: `CONFIG_INVALID`: no such model, or a file that is refused.
    """
    try:
        if not stated.endswith(MODEL_FILE):
            return Model.shipped(stated)
        with Path(stated).open("rb") as opened:
            raw = opened.read(MODEL_BYTES + 1)
        if len(raw) > MODEL_BYTES:
            raise ConfigError(PepFault.CONFIG_INVALID, f"robot: a file of more than {MODEL_BYTES} bytes")
        return Model.from_toml(raw.decode("utf-8"))
    except (ModelError, OSError, UnicodeDecodeError) as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"robot: {_said(error)}") from error


def _of_another_arm(stated: str, cell: dict[str, object]) -> dict[str, object]:
    """Numbers of a cell whose arm is not the default one.

    Its stop has to be stated: the default was chosen for the UR3e, and a heavier arm with its full load may not stop as
    hard.
    """
    if STOP not in cell:
        raise ConfigError(
            PepFault.CONFIG_INVALID,
            f"cell: state {STOP} of a {Path(stated).stem}: what its joints can do with its load",
        )
    return {"robot_uncertainty_m": nominal_error_m(read_model(stated)) + TRACKING_M, **cell}


def _calibration(path: Path) -> Calibration:
    with path.open("rb") as opened:
        raw = opened.read(CALIBRATION_BYTES + 1)
    return Calibration.from_yaml(raw.decode("utf-8"))


def _said(error: Exception) -> str:
    """Message of an error, without a path or a text of the file."""
    return error.detail if isinstance(error, ModelError) else type(error).__name__


def read_cell(config: CellConfig, *, at: float) -> cell.Cell:
    """Survey of the cell, by the word of the person that the configuration names.

    Args:
        config: names file and signer.
        at: seconds since the epoch; the file must be in force then.

    Raises:
        ConfigError: `CONFIG_INVALID`: no such file, signed by another key or not at all, for another server, not in
            force, or contradicting itself.
    """
    try:
        text = config.cell_file.read_bytes()[: CAPS.statement_bytes + 1].decode("utf-8-sig").strip()
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
