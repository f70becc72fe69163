"""Surroundings of a policy set: the operations that a tool server declares, and the parties of a registry.

`--guard guard.toml` and `--server MODULE:NAME` say which operations there are, in place of the robot cell's.
`--registry --as NAME` asks the identity provider for the agents, sponsors, tools and sensors that it knows.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.text import Text

from ztpm.cli.output import console, fail, plain
from ztpm.cli.provider.person import CellDirectory, Issuer, KeyFile, grouped, operator, refusals

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.statements.registry import RegistrySnapshot
    from pep.base.operation_row import Operation
    from policies.decision.policy import PolicySet
    from policies.evidence.model import Request
    from policies.explain.advice import Advice, Known, Registered
    from ztpm_idp.client import Operator

ENDED: Final = "revoked"
"""State of an agent that may never act again."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Surroundings of a set, as the options of a command name them.

    Attributes:
        server: MODULE:NAME of a tool server, or "".
        guard: configuration of its guard, or None.
        registry: the identity provider is asked.
        name, directory, issuer, key: who asks it, as of a `ztpm.cli.provider.person.Signer`.
    """

    server: str
    guard: Path | None
    registry: bool
    name: str
    directory: Path | None
    issuer: str
    key: Path | None

    def declared(self) -> tuple[Operation, ...] | None:
        """Declared operations, or None where no tool server is named; a wrong declaration ends the command."""
        from pep.base.errors import PepError
        from pep.mcp import guard as tool_guard
        from pep.mcp.declared_tools import decorated, rows_of
        from pep.point.guard_config import GuardConfig
        from ztpm.cli.mcp import server_of

        if not self.server and self.guard is None:
            return None
        try:
            configured = {} if self.guard is None else GuardConfig.read(self.guard).rows()
            if not self.server:
                if not configured:
                    fail("USAGE", f"{self.guard} declares no tool: give --server, too")
                return tuple(configured.values())
            server = server_of(self.server)
            served = asyncio.run(tool_guard.tools_of(server))
            return tuple(rows_of(served, decorated=asyncio.run(decorated(server)), configured=configured).values())
        except PepError as error:
            fail(error.code, error.detail)

    def misnamed(self, policies: PolicySet, request: Request | None = None) -> tuple[Advice, ...]:
        """Warnings about names of the set, and of the request, that nothing here has; none where nothing was named."""
        from policies.explain.advice import Advice, AdviceCode, misnamed

        declared, registered = self.declared(), self.registered()
        known = () if declared is None else operations(declared)
        found = misnamed(policies, known=known, registered=registered)
        if request is None or declared is None:
            return found
        if any(each.object in ("", request.object) and each.operation == request.operation for each in known):
            return found
        asked = f"no operation {request.operation!r} of {request.object!r} is declared"
        return (Advice(AdviceCode.OPERATION_UNKNOWN, "request", asked), *found)

    def registered(self) -> Registered | None:
        """Parties, tools and sensors that the identity provider knows and that have not ended; None: it is not asked.

        Tools and sensors are asked for where a guard's configuration names the server that they are registered for.
        """
        from policies.explain.advice import Registered

        if not self.registry:
            if self.name or self.directory is not None or self.issuer or self.key is not None:
                fail("USAGE", "--as, --data, --issuer and --key belong to --registry")
            return None
        if not self.name:
            fail("USAGE", "--registry needs --as, too: the identity provider answers a person")
        person = operator(directory=self.directory, name=self.name, issuer=self.issuer, key=self.key)
        with refusals(), person:
            agents = [row for row in person.agents() if row["status"] != ENDED]
            snapshot = None if self.guard is None else _snapshot(person, self.guard)
        return Registered(
            agents=frozenset(row["id"] for row in agents),
            sponsors=frozenset(row["sponsor"] for row in agents),
            tools=None if snapshot is None else frozenset(tool.operation for tool in snapshot.tools),
            sensors=None if snapshot is None else frozenset(sensor.id for sensor in snapshot.sensors),
        )


def _options(
    *,
    server: Annotated[str, typer.Option("--server", help="MODULE:NAME of a tool server of your own.")] = "",
    guard: Annotated[Path | None, typer.Option("--guard", help="Its guard.toml.", dir_okay=False)] = None,
    registry: Annotated[
        bool, typer.Option("--registry", help="Also ask the identity provider whom and what the set names; needs --as.")
    ] = False,
    name: Annotated[str, typer.Option("--as", help="Whose key signs.")] = "",
    directory: CellDirectory = None,
    issuer: Issuer = "",
    key: KeyFile = None,
) -> Surroundings:
    return Surroundings(server, guard, registry, name, directory, issuer, key)


def surrounded(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of `Surroundings` in place of its parameter `surroundings`."""
    return grouped(command, "surroundings", _options)


def operations(declared: tuple[Operation, ...] | None = None) -> tuple[Known, ...]:
    """Every operation that is known: the declared ones, else those of the robot; those of admission, and delegating."""
    from pep.base.operation_row import OperationKind
    from pep.base.operations import OPERATIONS
    from pep.context.admission import OBJECT, OPERATION_OF
    from policies import Point
    from policies.evidence.content_readings import ItemKind
    from policies.explain.advice import Known

    acting, sending = frozenset({Point.TOOL, Point.ACTUATION}), frozenset({Point.ACTUATION})
    where = {ItemKind.INSTRUCTION: Point.OPERATOR, ItemKind.MESSAGE: Point.AGENT}

    def points(row: Operation) -> frozenset[Point]:
        if row.robot is None:
            return frozenset({Point.TOOL})
        return sending if row.arguments is None else acting

    moving = (OperationKind.MOTION, OperationKind.SWITCH, OperationKind.ACT)
    return (
        *(
            Known(
                row.object,
                row.name,
                points(row),
                moves=row.kind in moving,
                sensors=frozenset(fact.sensor for fact in row.facts),
                tool=declared is not None,
            )
            for row in (OPERATIONS if declared is None else declared)
        ),
        *(Known(OBJECT, name, frozenset({where.get(kind, Point.CONTEXT)})) for kind, name in OPERATION_OF.items()),
        Known("", "delegate", frozenset({Point.AGENT})),
    )


def harmless_of(declared: tuple[Operation, ...]) -> frozenset[str]:
    """Names of declared operations that change nothing: of class 0 with any arguments and facts."""

    def changes(row: Operation) -> bool:
        return row.base_tier > 0 or bool(row.facts) or any(limit.tiers for limit in row.limits)

    return frozenset(row.name for row in declared) - frozenset(row.name for row in declared if changes(row))


def plain_advice(warnings: tuple[Advice, ...]) -> list[dict[str, str]]:
    """Warnings as JSON values."""
    return [{"code": str(each.code), "where": each.where, "detail": each.sentence} for each in warnings]


def tell(warnings: tuple[Advice, ...]) -> None:
    """Shows each warning."""
    for warning in warnings:
        told = Text(str(warning.code), style="yellow")
        console.print(told.append(plain(f" {warning.where}: {warning.sentence}"), style="default"))


def _snapshot(person: Operator, guard: Path) -> RegistrySnapshot:
    """The registry for the server of a guard's configuration; the command ends where it cannot be had."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError
    from pep.base.errors import PepError
    from pep.point.guard_config import GuardConfig
    from ztpm.cell import enrolment

    try:
        config = GuardConfig.read(guard)
        trust = TrustBundle.from_json(config.trust_file.read_bytes())
        return enrolment.registered(person.issuer, config.audience, trust, auth=person.auth())
    except enrolment.EnrolmentError as error:
        fail("REGISTRY_UNAVAILABLE", str(error))
    except PepError as error:
        fail(error.code, error.detail)
    except (OSError, CapabilityError) as error:
        fail("CONFIG_INVALID", f"trust_file: {type(error).__name__}")
