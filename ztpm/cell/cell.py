"""The embedded cell: identity provider, simulated robot and sensors, gateway and tool server, a process each."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Final, Self

from capabilities.keys import keys
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from ztpm.base.layout import Layout, read_key
from ztpm.base.processes import Child
from ztpm.cell.setup import GATEWAY_ID, PEP_ID, SENSOR_CALIBRATION, SENSOR_TRANSIT_MS, Addresses, sensor_keys

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from types import TracebackType

    from pep.pit.robot.model import Model
    from ztpm_idp.client import Operator

PASSPHRASE_VARIABLE = "ZTPM_PASSPHRASE"  # noqa: S105 - the name of the variable, not its value

PROCESSES: Final = {
    "idp": "identity provider",
    "robot": "controller",
    "sensor": "sensor",
    "gateway": "gateway",
    "tools": "tool server",
}
"""The processes of a cell by their attribute, those that others use first."""

REPORTS: Final = "--reports"
"""Option by which the gateway answers the process that starts it (ztpm/base/report_server.py)."""

SIMULATED: Final = frozenset({"robot", "sensor"})
"""Those of them that a cell with a controller and sensors of its own does not have."""


@dataclass
class Cell:
    """Processes of a cell. Each can be started again; the earlier one has then ended.

    Attributes:
        layout: its directory.
        addresses: addresses of the cell.
        passphrase: of its keys.
        joints: the simulated arm's first configuration, 6 angles in rad.
        stop_deceleration_rad_s2: of the simulated arm; the cell's own parameter.
        begin_child: begins a child; `Child.begin` unless a test breaks one.
        arm: as the gateway's configuration states it: a shipped model's name, or a model file.
        simulated: controller and sensors are processes of the cell; else they are there, and none of its processes.
        idp, robot, sensor, gateway, tools: its processes, once started; `sensor` is all sensors of the cell.
    """

    layout: Layout
    addresses: Addresses
    passphrase: bytes
    joints: tuple[float, ...]
    stop_deceleration_rad_s2: float = STOP_DECELERATION_RAD_S2
    begin_child: Callable[..., Child] = Child.begin
    arm: str = "ur3e"
    simulated: bool = True
    idp: Child = field(init=False)
    robot: Child = field(init=False)
    sensor: Child = field(init=False)
    gateway: Child = field(init=False)
    tools: Child = field(init=False)
    _beside: list[Child] | None = None

    @classmethod
    def start(
        cls,
        layout: Layout,
        addresses: Addresses,
        *,
        passphrase: bytes,
        joints: tuple[float, ...],
        begin: Callable[..., Child] = Child.begin,
    ) -> Cell:
        """Starts identity provider, controller and sensor; `start_enforcement` starts the others, after `register`.

        Args:
            layout: made by `ztpm.cell.setup.initialise`.
            addresses: the same as there.
            passphrase: the same as there.
            joints: the simulated arm's first configuration, 6 angles in rad.
            begin: begins a child in place of `Child.begin`.

        Raises:
            ztpm.base.processes.ChildError: when a process does not become ready.
        """
        from ztpm.point.gateway_config import read_gateway_config

        config = read_gateway_config(layout.gateway_config)
        cell = cls(layout, addresses, passphrase, joints, config.cell.stop_deceleration_rad_s2, begin, config.robot)
        try:
            with cell.beside():
                cell.start_idp()
                cell.start_robot()
                cell.start_sensor()
        except BaseException:
            cell.stop()
            raise
        return cell

    @property
    def expected(self) -> dict[str, str]:
        """Those of `PROCESSES` that the cell has."""
        return {name: told for name, told in PROCESSES.items() if self.simulated or name not in SIMULATED}

    @property
    def children(self) -> dict[str, Child]:
        """Processes that were started, by attribute, in the order of `PROCESSES`."""
        return {name: vars(self)[name] for name in PROCESSES if name in vars(self)}

    @contextmanager
    def beside(self) -> Iterator[None]:
        """Processes that are started within begin beside each other; afterwards each is ready.

        Raises:
            ztpm.base.processes.ChildError: when one does not become ready.
        """
        if self._beside is not None:  # the outer one waits
            yield
            return
        begun: list[Child] = []
        self._beside = begun
        try:
            yield
        finally:
            self._beside = None
        for child in begun:
            child.until_ready()

    def _start(self, name: str, module: str, *arguments: str, environment: dict[str, str]) -> None:
        """Starts the process of that attribute anew: ready, unless others begin beside it."""
        self.end(name)
        child = self.begin_child(PROCESSES[name], module, *arguments, environment=environment)
        if self._beside is None:
            child.until_ready()
        else:
            self._beside.append(child)
        vars(self)[name] = child

    def start_idp(self) -> None:
        """Starts the identity provider."""
        self._start(
            "idp",
            "ztpm.point.provider_server",
            "--config",
            str(self.layout.idp_config),
            environment=self._secret,
        )

    def start_robot(self) -> None:
        """Starts the controller with its arm at `joints`; told a fault of `ursim.ports.faults`, it has it.

        Connections to an earlier controller are lost.
        """
        from ztpm.point.cell_config import read_model

        pose = ",".join(repr(angle) for angle in self.joints)
        self._start(
            "robot", "ursim.__main__", "--commands", "--host", self.addresses.host, f"--joints={pose}",
            f"--robot={read_model(self.arm).name}", f"--stop-deceleration={self.stop_deceleration_rad_s2!r}",
            *self._installed(), environment={},
        )  # fmt: skip

    def _installed(self) -> tuple[str, str]:
        """Installation of the controller: the gripper's tool point and weight, as a person would set them up."""
        from pep.rtde.robot.gripper import DRIVEN
        from ztpm.point.cell_config import read_model

        return installation(read_model(self.arm), DRIVEN)

    def start_sensor(self, *options: str) -> None:
        """Starts the sensors, one process for all of the cell; each sees an empty scene.

        Args:
            options: further ones of its command line.
        """
        each = [
            ("--sensor", name, "--key-file", str(file), "--calibration", SENSOR_CALIBRATION)
            for name, file in sensor_keys(self.layout).items()
        ]
        self._start(
            "sensor", "ursim.sensor.sensor", *chain.from_iterable(each),
            "--to", f"{self.addresses.gateway_host}:{self.addresses.perception_port}", *options,
            environment=self._secret,
        )  # fmt: skip

    def start_gateway(self, *options: str) -> None:
        """Starts the robot's gateway, which answers this process, and waits until the tools have the arm.

        Args:
            options: further ones of its command line.
        """
        self._start(
            "gateway", "ztpm.point.gateway_server", "--config", str(self.layout.gateway_config), REPORTS, *options,
            environment=self._secret,
        )  # fmt: skip

    def start_tools(self) -> None:
        """Starts the tool server."""
        self._start(
            "tools",
            "ztpm.point.tool_proxy",
            "--config",
            str(self.layout.cell_config),
            environment=self._secret,
        )

    def start_enforcement(self) -> None:
        """Starts every enforcement point: agents can call the tools, programs can open a lease."""
        with self.beside():
            self.start_gateway()
            self.start_tools()

    @property
    def _secret(self) -> dict[str, str]:
        return {PASSPHRASE_VARIABLE: self.passphrase.decode()}

    def end(self, name: str) -> None:
        """Ends the process of that attribute, if it is running."""
        child = vars(self).pop(name, None)
        if child is not None:
            child.stop()

    def register(self, admin: Operator) -> None:
        """Registers the PEPs, the sensors and the reviewed tool definitions, by a person."""
        self.register_peps(admin)
        self.register_sensors(admin)
        self.register_tools(admin)

    @property
    def peps(self) -> dict[str, bytes]:
        """Raw public keys of the enforcement points by id: each is in front of the same cell."""
        files = {PEP_ID: self.layout.pep_key, GATEWAY_ID: self.layout.gateway_key}
        return {name: keys.public_raw(read_key(file, self.passphrase)) for name, file in files.items()}

    def register_peps(self, admin: Operator, *, only: Collection[str] | None = None) -> None:
        """Registers the enforcement points.

        Args:
            admin: the person who registers.
            only: ids, or None for all.
        """
        for name, key in self.peps.items():
            if only is None or name in only:
                admin.register_pep(name, key, [self.addresses.audience])

    @property
    def sensors(self) -> dict[str, bytes]:
        """Raw public keys of the simulated sensors by id: each watches the same cell, and must be heard."""
        if not self.simulated:
            return {}  # a person registers the sensors that are there (`ztpm enrol sensor`)
        return {
            name: keys.public_raw(read_key(file, self.passphrase)) for name, file in sensor_keys(self.layout).items()
        }

    def register_sensors(self, admin: Operator, *, only: Collection[str] | None = None) -> None:
        """Registers the sensors.

        Args:
            admin: the person who registers.
            only: ids, or None for all.
        """
        for name, key in self.sensors.items():
            if only is None or name in only:
                admin.register_sensor(
                    name,
                    key,
                    calibration=SENSOR_CALIBRATION,
                    transit_ms=SENSOR_TRANSIT_MS,
                    audience=self.addresses.audience,
                )

    def register_tools(self, admin: Operator, *, only: Collection[str] | None = None) -> None:
        """Registers the tools as they are defined now; the caller has reviewed them.

        Args:
            admin: the person who registers.
            only: names, or None for all.
        """
        from pep.mcp.arm_server import tool_definitions

        for tool in tool_definitions():
            if only is None or tool.name in only:
                admin.register_tool(
                    audience=self.addresses.audience,
                    name=tool.name,
                    definition_digest=tool.definition_digest,
                    operation=tool.operation,
                    base_tier=int(tool.base_tier),
                )

    def stop(self) -> None:
        """Ends every process, those that use others first."""
        for child in reversed(self.children.values()):
            child.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def installation(model: Model, tool: str) -> tuple[str, str]:
    """Options of a simulated controller whose installation has the tool's point and weight.

    Args:
        model: of its arm.
        tool: name of one of the model's.

    Raises:
        pep.pit.ModelError: the model has no such tool.
    """
    from pep.pit import Robot

    mounted = Robot.from_model(model, tool=tool).tool
    tcp, payload = (",".join(map(repr, each)) for each in (mounted.tcp_m, (mounted.mass_kg, *mounted.com_m)))
    return f"--tcp={tcp}", f"--payload={payload}"
