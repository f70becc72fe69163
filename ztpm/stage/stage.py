"""Stage: the running cell, the people, the agents, and a recorder of its own.

The eyes are separate from everything that is judged: a receive connection of the stage's own to the controller, the
PEP's journal read from disk, HTTP answers as they came over the wire.
"""

from __future__ import annotations

import json
import secrets
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from rtde_receive import RTDEReceiveInterface

from capabilities.keys import keys
from capabilities.keys.trust import TrustBundle
from ztpm.base.layout import new_key, read_key
from ztpm.cell.setup import sensor_keys
from ztpm.cell.simulated_platform import Attestor, workload_id
from ztpm.stage.samples import near
from ztpm_idp.client import Agent, Operator

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ztpm.cell.cell import Cell
    from ztpm.stage.calls import Answer

STILL_RAD_S: Final = 1e-3
"""All joints slower than this is standstill (1 mrad/s)."""
LEFT: Final = (-0.6, -1.62, 1.25, -1.2, -1.57, 0.0)
RIGHT: Final = (0.6, -1.62, 1.25, -1.2, -1.57, 0.0)
"""The two ends of the paper's sweep: left to right, passing through the front (rad)."""


def pose(base_rad: float) -> tuple[float, ...]:
    """Pose of the sweep at another angle of the base joint (rad)."""
    return (base_rad, *LEFT[1:])


SPEED_RAD_S: Final = 0.5
BRING_RAD_S: Final = 1.0
"""Speed of moves to the beginning of a step, by the orchestrator, whose scope allows it."""
BRING_TRIES: Final = 5
"""Tries of a move that sets the stage: on a loaded machine the watch may end one."""
SEND_TRIES: Final = 5
"""Tries of a request whose verdict comes too late on a loaded machine, as its reason advises."""
ACCELERATION_RAD_S2: Final = 1.4
WAIT_S: Final = 15.0
"""Longest wait for an event to become visible."""


class StageError(RuntimeError):
    """Requirement of the story that did not come about."""


class Reasoned(Protocol):
    """Answer with a reason code."""

    @property
    def reason(self) -> str:
        """Code of the reason."""


ReasonedAnswer = TypeVar("ReasonedAnswer", bound=Reasoned)


def in_time(ask: Callable[[], ReasonedAnswer]) -> ReasonedAnswer:
    """Answer to a request that is sent again, as its reason advises, where the verdict came too late."""
    answer = ask()
    for _ in range(SEND_TRIES - 1):
        if answer.reason != "VERDICT_EXPIRED":
            break
        answer = ask()
    return answer


def until(seen: Callable[[], bool], what: str) -> None:
    """Waits until it has been seen.

    Raises:
        StageError: when it was not, for `WAIT_S` seconds.
    """
    deadline = time.monotonic() + WAIT_S
    while not seen():
        if time.monotonic() > deadline:
            raise StageError(f"not seen within {WAIT_S:g} s: {what}")
        time.sleep(0.02)


@dataclass
class Stage:
    """Everything a step may touch.

    Attributes:
        cell: the running processes.
        people: the three operators.
        agents: by name, once registered.
        tokens: by the holder's name.
        eyes: joint angles and speeds over a connection of the stage's own.
        open_ask: id of the deferral that waits for people.
        further_journals: of enforcement points beside the cell's own.
        shown: number of people and of objects in the last scene that each sensor was told.
    """

    cell: Cell
    people: dict[str, Operator]
    agents: dict[str, Agent] = field(default_factory=dict)
    tokens: dict[str, str] = field(default_factory=dict)
    eyes: RTDEReceiveInterface | None = None
    open_ask: object = None
    further_journals: list[Path] = field(default_factory=list)
    journal_at: dict[Path, int] = field(default_factory=dict)
    ledger_at: int = 0
    side: tuple[float, ...] = LEFT
    shown: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def joints(self) -> tuple[float, ...]:
        """The arm's angles now, rad."""
        if self.eyes is None:
            self.eyes = RTDEReceiveInterface(self.cell.addresses.host)
        return tuple(self.eyes.getActualQ())

    @property
    def rounded_joints(self) -> tuple[float, ...]:
        """Angles of the arm now, on the grid of a request: a move to there is none."""
        return tuple(round(angle, 6) for angle in self.joints)

    @property
    def still(self) -> bool:
        """True where every joint stands still."""
        assert self.eyes is not None
        return all(abs(speed) < STILL_RAD_S for speed in self.eyes.getActualQd())

    @property
    def trust(self) -> TrustBundle:
        """The public keys that everything is verified with."""
        return TrustBundle.from_json(self.cell.layout.trust.read_bytes())

    def journal(self, *, since: int | None = None) -> list[dict[str, Any]]:
        """The records of the PEPs since the step began, or since byte `since` of each, read from disk."""
        rows = []
        for journal in self.journals:
            with journal.open("rb") as file:
                file.seek(self.journal_at.get(journal, 0) if since is None else since)
                rows += [json.loads(line) for line in file if line.endswith(b"\n")]
        return rows

    @property
    def journals(self) -> list[Path]:
        """The journals that there are."""
        layout = self.cell.layout
        every = (layout.journal, layout.gateway_journal, *self.further_journals)
        return [journal for journal in every if journal.exists()]

    def approvers_known(self) -> list[str]:
        """Approvers of the last asked act that its recorded evidence names."""
        decided = [row["body"]["evidence"]["approval"] for row in self.journal() if row["kind"] == "decision"]
        return list(decided[-1]["approvers"]) if decided and isinstance(decided[-1], dict) else []

    def answered(self, question: Answer) -> bool:
        """True where the PEP has on record that people answered that deferral."""
        ask_id = question.content["ask_id"]
        return any(row["kind"] == "ask-answered" and row["body"]["ask_id"] == ask_id for row in self.journal())

    def ended_asks(self) -> set[object]:
        """Ids of the deferrals that ended in silence, by the whole journal."""
        return {row["body"]["ask_id"] for row in self.journal(since=0) if row["kind"] == "ask-expired"}

    def begin(self) -> None:
        """Begins a step: earlier records of the journal no longer count."""
        self.journal_at = {journal: journal.stat().st_size for journal in self.journals}

    def new_ledger_kinds(self) -> set[str]:
        """Kinds of the entries that the identity provider's ledger has gained since the last call."""
        lines = self.person("carol").export_ledger().splitlines()[:-1]
        fresh, self.ledger_at = lines[self.ledger_at :], len(lines)
        return {json.loads(line)["kind"] for line in fresh}

    def journal_records(self) -> int:
        """Number of records that both PEPs have on disk."""
        return sum(journal.read_bytes().count(b"\n") for journal in self.journals)

    def exported_pep_records(self) -> int:
        """Number of them that the ledger holds."""
        lines = self.person("carol").export_ledger().splitlines()
        return sum(1 for line in lines if json.loads(line).get("kind") == "pep-record")

    def close(self) -> None:
        """Closes the recorder."""
        if self.eyes is not None:
            self.eyes.disconnect()

    def person(self, name: str) -> Operator:
        """The operator of that name."""
        return self.people[name]

    def new_agent(self, name: str, *, sponsor: str, role: str) -> Agent:
        """A registered agent with a key of its own; the cell's platform vouches for it whenever it attests itself."""
        key = new_key(self.cell.layout.agent_key(name), self.cell.passphrase)
        raw, measurement = keys.public_raw(key), secrets.token_bytes(32)
        self.person(sponsor).register_agent(
            name, raw, software_digest=measurement.hex(), model="scripted", role=role, sponsor=sponsor,
            workload=workload_id(name),
        )  # fmt: skip
        issuer = self.cell.addresses.issuer
        attestor = Attestor(read_key(self.cell.layout.platform_key, self.cell.passphrase), issuer, time.time)
        agent = Agent(name, key, issuer, measurement, workload=attestor.source(name, raw, measurement))
        self.agents[name] = agent
        return agent

    def operator_from_disk(self, name: str) -> Operator:
        """The operator, with the key that `init` stored."""
        return Operator(
            name, read_key(self.cell.layout.operator_key(name), self.cell.passphrase), self.cell.addresses.issuer
        )

    def move(
        self, agent: str, *, token: str | None = None, to: tuple[float, ...] | None = None, speed: float = SPEED_RAD_S
    ) -> Answer:
        """Call of `move_joint` by the agent to the other side, or to `to`."""
        target = to or (RIGHT if self.side == LEFT else LEFT)
        answer = self.ask(
            agent,
            "move_joint",
            {"q_rad": list(target), "speed_rad_s": speed, "acceleration_rad_s2": ACCELERATION_RAD_S2},
            token=token,
        )
        if answer.decision == "PERMIT":
            self.side = target
        return answer

    def place(self, target: tuple[float, ...]) -> None:
        """Puts the arm, once it stands still, elsewhere by hand: no motion, and nothing is decided.

        Raises:
            StageError: the arm does not come to be there.
        """
        until(lambda: near(self.joints, target) or self.still, "the arm stands still")
        if not near(self.joints, target):
            self.cell.robot.tell({"fault": "placed", "joints_rad": target})
            until(lambda: near(self.joints, target), "the arm where it is put")

    def bring(self, target: tuple[float, ...]) -> None:
        """Moves the arm to `target` by the orchestrator, with the usual authority, in several tries if need be.

        Raises:
            StageError: when that is not permitted.
        """
        answer: Answer | None = None
        for _ in range(BRING_TRIES):
            if near(self.joints, target):
                return
            answer = self.move("orchestrator", to=target, speed=BRING_RAD_S)
        if not near(self.joints, target):
            said = None if answer is None else (answer.reason, answer.content)
            raise StageError(f"the arm was not brought to where the step begins: {said}")

    def perception(self) -> str:
        """State of the PEP's view: "fresh", "stale", "missing" or "invalid"."""
        world = self.ask("orchestrator", "read_state", {}).content.get("world") or {}
        return str(world.get("perception"))

    def ask(
        self, agent: str, tool: str, arguments: dict[str, object], *, token: str | None = None, url: str = ""
    ) -> Answer:
        """Call of a tool by the agent with its token, sent again when the verdict came too late.

        Args:
            agent: name of the agent.
            tool: name of the tool.
            arguments: of the call.
            token: None for the one that the agent holds.
            url: of the MCP server; empty for the cell's own.
        """
        from ztpm.stage.calls import call  # with the MCP SDK, whose import takes half a second: `ztpm up` calls nothing

        auth = self.agents[agent].auth(token or self.tokens[agent])
        server = url or self.cell.addresses.audience
        return in_time(lambda: call(server, auth, tool, arguments))

    def scene(
        self,
        *,
        people: list[dict[str, object]] | None = None,
        objects: list[dict[str, object]] | None = None,
        sensor: str | None = None,
    ) -> None:
        """Shows the sensors exactly these people and objects, and waits until the PEP has seen them.

        Args:
            people: in the words of the simulated sensor.
            objects: in the same words.
            sensor: id of the only one that is shown them; None for every sensor of the cell.
        """
        people, objects = people or [], objects or []
        told = sensor_keys(self.cell.layout) if sensor is None else (sensor,)
        scene: dict[str, object] = {"people": people, "objects": objects}
        self.cell.sensor.tell(scene if sensor is None else {**scene, "sensor": sensor})
        self.shown |= dict.fromkeys(told, (len(people), len(objects)))
        expected = tuple(map(sum, zip(*self.shown.values(), strict=True)))  # each sensor's sight counts

        def arrived() -> bool:
            world = self.ask("orchestrator", "read_state", {}).content.get("world") or {}
            return (world.get("people"), world.get("objects")) == expected

        until(arrived, "the new scene at the PEP")
