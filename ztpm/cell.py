"""The embedded cell: identity provider, simulated controller, tool server and simulated sensor, a process each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from capabilities import keys
from ztpm.layout import Layout, read_key
from ztpm.processes import Child
from ztpm.setup import PEP_ID, SENSOR_CALIBRATION, SENSOR_ID, SENSOR_TRANSIT_MS, Addresses

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from ztpm_idp.client import Operator

PASSPHRASE_VARIABLE = "ZTPM_PASSPHRASE"  # noqa: S105 - the name of the variable, not its value


@dataclass
class Cell:
    """A running cell.

    Attributes:
        layout: its directory.
        addresses: where it listens.
        passphrase: of its keys.
        idp, robot, sensor, tools: its processes.
        start_child: starts a child; `Child.start` unless a test breaks one.
    """

    layout: Layout
    addresses: Addresses
    passphrase: bytes
    idp: Child
    robot: Child
    sensor: Child
    tools: Child | None = None
    start_child: Callable[..., Child] = Child.start

    @classmethod
    def start(
        cls,
        layout: Layout,
        addresses: Addresses,
        *,
        passphrase: bytes,
        joints: tuple[float, ...],
        start: Callable[..., Child] | None = None,
    ) -> Cell:
        """Identity provider, controller and sensor run; the tool server comes with `start_tools`, after `register`.

        Args:
            layout: made by `ztpm.setup.initialise`.
            addresses: the same as there.
            passphrase: the same as there.
            joints: the simulated arm's first configuration, 6 angles in rad.
            start: starts a child in place of `Child.start`.

        Raises:
            ztpm.processes.ChildError: when a process does not become ready.
        """
        secret = {PASSPHRASE_VARIABLE: passphrase.decode()}
        started: list[Child] = []
        start = start or Child.start
        try:
            started.append(
                start("identity provider", "ztpm_idp", "--config", str(layout.idp_config), environment=secret)
            )
            pose = ",".join(repr(angle) for angle in joints)
            started.append(start("controller", "pep.sim", "--host", addresses.host, f"--joints={pose}", environment={}))
            started.append(
                start(
                    "sensor", "pep.sim.sensor", "--key-file", str(layout.sensor_key), "--sensor", SENSOR_ID,
                    "--calibration", SENSOR_CALIBRATION, "--to", f"{addresses.host}:{addresses.perception_port}",
                    environment=secret,
                )
            )  # fmt: skip
        except BaseException:
            for child in reversed(started):
                child.stop()
            raise
        idp, robot, sensor = started
        return cls(layout, addresses, passphrase, idp, robot, sensor, start_child=start)

    def register(self, admin: Operator) -> None:
        """The PEP, the sensor and the reviewed tool definitions are registered by a person."""
        from pep.mcp.arm import tool_definitions

        admin.register_pep(
            PEP_ID, keys.public_raw(read_key(self.layout.pep_key, self.passphrase)), [self.addresses.audience]
        )
        admin.register_sensor(
            SENSOR_ID,
            keys.public_raw(read_key(self.layout.sensor_key, self.passphrase)),
            calibration=SENSOR_CALIBRATION,
            transit_ms=SENSOR_TRANSIT_MS,
            audience=self.addresses.audience,
        )
        for tool in tool_definitions():
            admin.register_tool(
                audience=self.addresses.audience,
                name=tool.name,
                definition_digest=tool.definition_digest,
                operation=tool.operation,
                base_tier=int(tool.base_tier),
            )

    def start_tools(self) -> None:
        """The tool server runs."""
        secret = {PASSPHRASE_VARIABLE: self.passphrase.decode()}
        self.tools = self.start_child(
            "tool server", "ztpm.tool_server", "--config", str(self.layout.cell_config), environment=secret
        )

    def stop(self) -> None:
        """Every process has ended, those that use others first."""
        for child in (self.tools, self.sensor, self.robot, self.idp):
            if child is not None:
                child.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
