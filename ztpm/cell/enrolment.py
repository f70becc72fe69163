"""Enrolment of a cell: its signed registry, compared with the cell's present keys and tools.

A registered part is never registered again without a person: a tool whose definition changed stays refused until a
person has looked at it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.statements import registry
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import CapabilityError
from ztpm.base.layout import write_private
from ztpm.cell.setup import SENSOR_CALIBRATION, SENSOR_TRANSIT_MS
from ztpm_idp.client import direct_http

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.registry import RegistrySnapshot
    from pep.mcp.tool_digest import ToolPin
    from ztpm.cell.cell import Cell
    from ztpm_idp.client import Operator, ProofAuth

TIMEOUT_S: Final = 5.0
RESTORING: Final = '"RESTORING"'
"""Code of a provider that is being restored, as its answer spells it."""


class EnrolmentError(RuntimeError):
    """Registry that cannot be fetched, or not be believed."""


class RestoringError(EnrolmentError):
    """Registry of an identity provider that is being restored, and says nothing yet."""


class Kind(StrEnum):
    """Kind of a part that can differ."""

    PEP = "enforcement point"
    SENSOR = "sensor"
    TOOL = "tool"


class Difference(StrEnum):
    """Way in which a part differs."""

    MISSING = "not registered"
    CHANGED = "registered differently"
    GONE = "registered, and no longer there"


@dataclass(frozen=True, slots=True)
class Differing:
    """One part that the registry states differently from the cell's present one."""

    kind: Kind
    name: str
    how: Difference

    def __str__(self) -> str:
        return f"{self.kind} {self.name}: {self.how}"


def registered(issuer: str, audience: str, trust: TrustBundle, *, auth: ProofAuth) -> RegistrySnapshot:
    """The signed registry for a cell.

    Args:
        issuer: base URL of the identity provider.
        audience: canonical URL of the cell's tool server.
        trust: holds the registry's key.
        auth: signs as a registered party; strangers are told nothing.

    Raises:
        EnrolmentError: when there is no answer, or none that verifies.
    """
    try:
        with direct_http.client(TIMEOUT_S) as http:
            answer = http.get(f"{issuer}/registry", params={"audience": audience}, auth=auth, follow_redirects=False)
        if answer.status_code == 503 and RESTORING in answer.text:
            raise RestoringError("the identity provider is being restored: ztpm idp resume")
        if answer.status_code != 200:
            raise EnrolmentError(f"the registry answers {answer.status_code}")
        snapshot = registry.open(answer.text, trust.registry, CAPS)
    except httpx2.HTTPError as error:
        raise EnrolmentError(f"the registry does not answer: {type(error).__name__}") from error
    except CapabilityError as error:
        raise EnrolmentError(f"the registry is not believed: {error.code}") from error
    if (snapshot.issuer, snapshot.audience) != (issuer, audience):
        raise EnrolmentError("the registry is another's")
    return snapshot


def differences(cell: Cell, snapshot: RegistrySnapshot) -> tuple[Differing, ...]:
    """Differences between the registry and the cell's present enforcement points, sensors and tools.

    Args:
        cell: cell with the present keys.
        snapshot: as registered.
    """
    found, known = [], {entry.id: entry.key for entry in snapshot.peps}
    for name, key in cell.peps.items():
        if known.get(name) != key:
            how = Difference.CHANGED if name in known else Difference.MISSING
            found.append(Differing(Kind.PEP, name, how))
    for name, key in cell.sensors.items():
        sensor = snapshot.sensor(name)
        if sensor is None:
            found.append(Differing(Kind.SENSOR, name, Difference.MISSING))
        elif (sensor.key, sensor.calibration, sensor.transit_ms) != (key, SENSOR_CALIBRATION, SENSOR_TRANSIT_MS):
            found.append(Differing(Kind.SENSOR, name, Difference.CHANGED))
    from pep.mcp.arm_server import tool_definitions

    return (*found, *tool_differences(snapshot, tool_definitions()))


def tool_differences(snapshot: RegistrySnapshot, tools: Iterable[ToolPin]) -> tuple[Differing, ...]:
    """Differences between the registry and the tools as they are defined now.

    Args:
        snapshot: as registered.
        tools: as they are defined now.
    """
    found = []
    served = {tool.name: tool for tool in tools}
    for name, tool in sorted(served.items()):
        known = snapshot.tool(name)
        if known is None:
            found.append(Differing(Kind.TOOL, name, Difference.MISSING))
        elif (known.definition_digest, known.operation, known.base_tier) != (
            tool.definition_digest, tool.operation, tool.base_tier,
        ):  # fmt: skip
            found.append(Differing(Kind.TOOL, name, Difference.CHANGED))
    gone = sorted(tool.name for tool in snapshot.tools if tool.name not in served)
    return (*found, *(Differing(Kind.TOOL, name, Difference.GONE) for name in gone))


def enrol(cell: Cell, admin: Operator, trust: TrustBundle) -> tuple[Differing, ...]:
    """Registers the cell the first time; every other time, its differences from the registration.

    A first time that was cut short goes on where it was cut: only what is missing is registered then. Of a provider
    that is being restored no difference is known.

    Args:
        cell: its identity provider runs.
        admin: the person who registers.
        trust: holds the registry's key.

    Raises:
        EnrolmentError: when the registry cannot be had.
        ztpm_idp.client.ClientError: when the provider refuses.
    """
    try:
        snapshot = registered(cell.addresses.issuer, cell.addresses.audience, trust, auth=admin.auth())
    except RestoringError:
        if cell.layout.enrolled.exists():
            return ()
        raise
    found = differences(cell, snapshot)
    if cell.layout.enrolled.exists():
        return found
    missing = {
        kind: {differing.name for differing in found if (differing.kind, differing.how) == (kind, Difference.MISSING)}
        for kind in Kind
    }
    cell.register_peps(admin, only=missing[Kind.PEP])
    cell.register_sensors(admin, only=missing[Kind.SENSOR])
    cell.register_tools(admin, only=missing[Kind.TOOL])
    write_private(cell.layout.enrolled, b"The cell's parts are registered; nothing registers them again by itself.\n")
    return tuple(differing for differing in found if differing.how is not Difference.MISSING)
