"""The whole system: a cell, the admission point, four agents, a process each; and a person who asks them."""

from __future__ import annotations

import itertools
import json
import re
import secrets
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from ipaddress import IPv4Address
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import httpx2
import rfc8785

from capabilities.keys import keys
from capabilities.statements.context import intent as intent_statement
from capabilities.values.scope import Grant, Scope
from cobot_claw import knowledge, roles
from cobot_claw.agent import TASK_S, measurement
from cobot_claw.approving import Approver
from cobot_claw.collector import Collector
from cobot_claw.errors import ClawError
from cobot_claw.models import stated
from cobot_claw.point import CAMERA
from cobot_claw.table import PART, PART_KG, PART_WIDTH_M, Table
from cobot_claw.task import PATIENCE_S
from cobot_claw.telemetry import carried, traced
from cobot_claw.words import COLLECTIONS, REQUEST, in_short
from pep.base.declaration import declared, grant
from pep.rtde.robot.gripper import RobotiqGripper
from ztpm.base.layout import new_key, read_key
from ztpm.base.processes import Child
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.cell.setup import GATEWAY_ID, SENSOR_CALIBRATION
from ztpm.stage.lending import sweep_scope
from ztpm.stage.live import stage
from ztpm_idp.client import ClientError
from ztpm_idp.client.callers import Evidence, issue_request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from ztpm.base.layout import Layout
    from ztpm.stage.stage import Stage
    from ztpm_idp.client import Operator

POINT_PORT: Final = 8810
PERCEPTION_PORT: Final = 8816
AGENT_PORTS: Final = {role: 8811 + place for place, role in enumerate(roles.ROLES)}
"""Ports on the cell's own loopback address."""
PERSON: Final = "alice"
"""The person who asks, and whose authority it is."""
LOOPBACK: Final = "127.0.0.1"
APPROVER: Final = "bob"
"""The person who is asked about what the agents may not do alone."""
LIFETIME_S: Final = 900
POINT_ID: Final = "claw-point"
CAMERA_KEY: Final = "claw-camera.key"
CAMERA_TRANSIT_MS: Final = 60
"""Declared longest transit of a frame: casting and detecting take some 30 ms."""


@dataclass(frozen=True, slots=True)
class Told:
    """Result of one request.

    Attributes:
        text: the orchestrator's words.
        done: False where something was refused or failed.
        trace: id of the trace that all spans of the request belong to.
        seconds: from the request to the answer.
        moved_rad: way of the arm's leading joint meanwhile.
    """

    text: str
    done: bool
    trace: str
    seconds: float
    moved_rad: float


@dataclass
class System:
    """A running system.

    Attributes:
        stage: the cell, with its people and an eye on the arm.
        folder: of the point's and the agents' files.
        children: its processes beside the cell, by name.
        ids: of the agents, by role.
        table: what truly stands there, once it is started.
        approver: a second person, where one answers.
    """

    stage: Stage
    folder: Path
    children: dict[str, Child] = field(default_factory=dict)
    ids: dict[str, str] = field(default_factory=dict)
    table: Table | None = None
    approver: Approver | None = None

    @property
    def host(self) -> str:
        """Loopback address of the cell."""
        return self.stage.cell.addresses.host

    @property
    def point(self) -> str:
        """Canonical URL of the admission point and of the tools beside it."""
        return f"http://{self.host}:{POINT_PORT}/mcp"

    @property
    def person(self) -> Operator:
        """The person who asks."""
        return self.stage.person(PERSON)

    def url(self, role: str) -> str:
        """Base URL of an agent."""
        return f"http://{self.host}:{AGENT_PORTS[role]}"

    # --- start -------------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Registers and starts the point and the agents; a part lies on the table, and the gripper is ready.

        Raises:
            ztpm.base.processes.ChildError: a process does not become ready.
        """
        self._start_point()
        self._start_agents()
        gripper = RobotiqGripper(self.host)
        gripper.activate()  # as a person does after power-on
        self.table = Table(tell=self.stage.cell.sensor.tell, joints=lambda: self.stage.joints, gripper=gripper)
        self.table.lay(PART)
        self.table.start()

    def _start_point(self) -> None:
        layout, admin = self.stage.cell.layout, self.stage.person("carol")
        key = new_key(self.folder / "point.key", self.stage.cell.passphrase)
        admin.register_pep(POINT_ID, keys.public_raw(key), [self.point])
        camera = read_key(layout.root / CAMERA_KEY, self.stage.cell.passphrase)
        admin.register_sensor(
            CAMERA,
            keys.public_raw(camera),
            calibration=SENSOR_CALIBRATION,
            transit_ms=CAMERA_TRANSIT_MS,
            audience=self.point,
        )
        from cobot_claw.config_tools import server
        from pep import pins

        for pin in pins(server):  # the composition is what was reviewed
            admin.register_tool(
                audience=self.point,
                name=pin.name,
                definition_digest=pin.definition_digest,
                operation=pin.operation,
                base_tier=int(pin.base_tier),
            )
        guard = {
            "audience": self.point,
            "pep_id": POINT_ID,
            "issuer": self.stage.cell.addresses.issuer,
            "trust_file": str(layout.trust),
            "pep_key_file": "point.key",
            "folder": "point",
        }
        (self.folder / "point").mkdir(mode=0o700, exist_ok=True)
        (self.folder / "guard.toml").write_text(_toml(guard), "utf-8")
        person = keys.public_raw(self.person._key).hex()  # noqa: SLF001 - the composition made it
        dora, store = new_key(self.folder / "dora.key", self.stage.cell.passphrase), self.folder / "knowledge"
        store.mkdir(mode=0o700)
        for kind in COLLECTIONS:
            signed = knowledge.signed_manifest(kind, dora, at=int(time.time()))
            (store / f"{kind}.jws").write_text(signed, "ascii")
        curator = keys.public_raw(dora).hex()
        words = f'guard = "guard.toml"\nstore = "knowledge"\nperception_port = {PERCEPTION_PORT}\n'
        words += f'[people]\n{PERSON} = "{person}"\n[curators]\n{knowledge.CURATOR} = "{curator}"\n'
        # Whose word on the answers of the arm's tools counts.
        gateway = self.stage.cell.peps[GATEWAY_ID].hex()
        words += f'[answering]\n"{self.stage.cell.addresses.audience}" = "{gateway}"\n'
        (self.folder / "point.toml").write_text(words, "utf-8")
        self.children["point"] = Child.begin(
            "admission point",
            "cobot_claw.point",
            "--config",
            str(self.folder / "point.toml"),
            environment=self._secret,
        )

    def _start_agents(self) -> None:
        mark, software = secrets.token_hex(3), measurement()
        self.ids = {role: f"{role}-{mark}" for role in roles.ROLES}
        for role, id_ in self.ids.items():
            key = new_key(self.folder / f"{role}.key", self.stage.cell.passphrase)
            self.person.register_agent(
                id_, keys.public_raw(key), software_digest=software.hex(), model=stated(), role=role
            )
            config = {
                "id": id_,
                "role": role,
                "key_file": str(self.folder / f"{role}.key"),
                "issuer": self.stage.cell.addresses.issuer,
                "trust_file": str(self.stage.cell.layout.trust),
                "host": self.host,
                "port": AGENT_PORTS[role],
                "point": self.point,
                "cell": self.stage.cell.addresses.audience,
                "spans": str(self.folder / f"{role}.spans.ndjson"),
                "peers": {
                    other: {"id": name, "url": self.url(other)} for other, name in self.ids.items() if other != role
                },
            }
            path = self.folder / f"{role}.json"
            path.write_text(json.dumps(config), "utf-8")
            self.children[role] = Child.begin(
                f"{role} agent", "cobot_claw.agent", "--config", str(path), environment=self._secret
            )
        for child in self.children.values():
            child.until_ready()

    @property
    def _secret(self) -> dict[str, str]:
        return {PASSPHRASE_VARIABLE: self.stage.cell.passphrase.decode()}

    def stop(self) -> None:
        """Ends the agents, then the point; the last lines of each are in its log."""
        if self.approver is not None:
            self.approver.stop()
        if self.table is not None:
            self.table.stop()
        for name, child in reversed(self.children.items()):
            child.stop()
            (self.folder / f"{name}.log").write_text("\n".join(child.output) + "\n", "utf-8")

    # --- a request ---------------------------------------------------------------------------------------------------

    def ask(self, text: str) -> Told:
        """Result of a person's request: signed, lent for, carried out.

        Args:
            text: in natural language.

        Raises:
            ClawError: `AGENT_UNREACHABLE` or `NOT_LENT`; nothing is under way then.
        """
        began, before = time.monotonic(), self.stage.joints
        with traced("request", person=PERSON) as span:
            intent = self._intent(text)
            token = self._lend(intent, text)
            report = self._post("work", {"token": token, "intent": intent})["report"]
            trace = f"{span.get_span_context().trace_id:032x}"
        moved = max(abs(a - b) for a, b in zip(self.stage.joints, before, strict=True))
        return Told(report["text"], report["done"], trace, time.monotonic() - began, moved)

    def _intent(self, text: str) -> str:
        now = int(time.time())
        wish = intent_statement.Intent(
            subject=PERSON,
            schema=REQUEST,
            body=rfc8785.dumps({"text": text}),
            nonce=secrets.token_urlsafe(18),
            at=now,
            not_after=now + LIFETIME_S,
        )
        return intent_statement.sign(wish, self.person._key)  # noqa: SLF001 - the person's own program

    def _lend(self, intent: str, text: str) -> str:
        """A token for the orchestrator, for exactly this intent."""
        purpose = intent_statement.purpose(intent_statement.digest_of(intent), in_short(text))
        scope, id_ = self._scope(), self.ids["orchestrator"]
        request = issue_request(id_, scope, purpose=purpose)
        told = self._post("evidence", {"delegator": PERSON, "request": request})
        try:
            return self.person.issue(Evidence(id_, told["evidence"]), scope, purpose=purpose).token
        except ClientError as error:
            raise ClawError("NOT_LENT", f"orchestrator: {error.code}.") from error

    def _scope(self) -> Scope:
        from cobot_claw import config_tools

        below = frozenset(id_ for role, id_ in self.ids.items() if role != "orchestrator")
        arm = sweep_scope(
            self.stage.cell.addresses.audience, delegates=below, now=int(time.time()), lifetime_s=LIFETIME_S
        )
        tools = config_tools.server._tool_manager.list_tools()  # noqa: SLF001 - the SDK lists them in no other way outside a loop
        beside = [grant(tool.fn) for tool in tools if declared(tool.fn) is not None]
        grants = (*arm.grants, *beside, Grant("memory", "remember"), Grant("part-1", "touch"))
        return replace(
            arm,
            grants=tuple(sorted(grants, key=lambda each: (each.object, each.operation))),
            audiences=arm.audiences | {self.point},
        )

    def _post(self, path: str, body: dict[str, object]) -> dict[str, Any]:
        url = f"{self.url('orchestrator')}/{path}"
        try:
            with httpx2.Client(timeout=TASK_S + 20.0, trust_env=False) as http:
                answer = http.post(url, json=body, headers=carried())
                told = answer.json()
        except (httpx2.HTTPError, ValueError) as error:
            raise ClawError("AGENT_UNREACHABLE", f"orchestrator: {type(error).__name__}.") from error
        if answer.status_code != 200 or not isinstance(told, dict):
            raise ClawError("NOT_LENT", f"orchestrator: {told.get('code')} ({told.get('detail')}).")
        return told

    def spans(self, trace: str) -> list[dict[str, Any]]:
        """Every span of a trace, of all processes, by start."""
        rows = []
        for path in self.folder.rglob("*spans.ndjson"):
            rows += [
                row for line in path.read_text("utf-8").splitlines() if (row := json.loads(line))["trace"] == trace
            ]
        return sorted(rows, key=lambda row: int(row["start_ns"]))


@contextmanager
def system(
    *,
    directory: Path | None = None,
    told: Callable[[str], None] = lambda _: None,
    approves: Callable[[Mapping[str, Any]], bool] | None = None,
) -> Iterator[System]:
    """A running system on a fresh cell, ended afterwards.

    Args:
        directory: kept, with the cell in `cell` and the rest in `claw`; a temporary one by default.
        told: is told what is being started.
        approves: the answer of `APPROVER` to a question that needs a second person; None: nobody answers, which denies.

    Raises:
        ClawError: `DATA_NOT_EMPTY`.
        ztpm.base.processes.ChildError: a process does not become ready; those that began have ended.
    """
    from cobot_claw.telemetry import begin

    def keyed(layout: Layout, passphrase: bytes) -> None:
        new_key(layout.root / CAMERA_KEY, passphrase)
        settings = layout.gateway_config.read_text("utf-8")  # people get as long as an agent is patient
        patient = re.sub(r"(?m)^defer_timeout_s = \d+$", f"defer_timeout_s = {PATIENCE_S:.0f}", settings)
        weighed = f'[[cell.parts]]\nobject = "{PART["id"]}"\nmass_kg = {PART_KG}\nblunt = true\n'
        layout.gateway_config.write_text(patient + weighed, "utf-8")

    told("the cell: identity provider, controller, camera, gateway, tool server")
    with ExitStack() as ending:
        home = directory.absolute() if directory else Path(ending.enter_context(TemporaryDirectory(prefix="claw-")))
        if home.exists() and any(home.iterdir()):
            raise ClawError("DATA_NOT_EMPTY", f"{home} holds something.")
        folder = home / "claw"
        folder.mkdir(mode=0o700, parents=True)
        collector = Collector(folder / "cell.spans.ndjson", LOOPBACK)
        ending.callback(collector.close)
        begin_child = partial(_begin, collector.environment)
        here = System(ending.enter_context(stage(directory=home / "cell", begin=begin_child, prepare=keyed)), folder)
        ending.callback(here.stop)
        begin("person", folder / "person.spans.ndjson")
        told("the admission point and four agents")
        here.start()
        if approves is not None:
            here.approver = Approver(here.stage.person(APPROVER), approves)
            here.approver.start()
        yield here


def _begin(
    beside: Mapping[str, str], name: str, module: str, *arguments: str, environment: Mapping[str, str], **options: Any
) -> Child:
    """Begins a child of the cell, which sends its spans: the camera in place of the simulated sensor."""
    if module == "ursim.sensor.sensor":
        module = "cobot_claw.camera"
        place = dict(itertools.pairwise(arguments))
        host = str(IPv4Address(place["--to"].rpartition(":")[0]) - 1)  # the gateway's is the next one
        key = Path(place["--key-file"]).parents[1] / CAMERA_KEY
        arguments = (*arguments, "--also", f"{host}:{PERCEPTION_PORT}", CAMERA, str(key))
    if module == "ursim.__main__":
        # At this width the fingers of the simulated gripper are stopped whenever they close.
        arguments = (*arguments, f"--gripper-object={PART_WIDTH_M}")
    sends = beside if module.startswith("ztpm.point") else {}
    return Child.begin(name, module, *arguments, environment={**environment, **sends}, **options)


def _toml(settings: dict[str, str]) -> str:
    return "".join(f"{name} = {json.dumps(value)}\n" for name, value in settings.items())
