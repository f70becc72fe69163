"""Admission point of a running cell, and the authority that a scenario's agents are lent there."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import httpx2
import jwt

from capabilities.keys import keys
from capabilities.statements.context import manifest
from capabilities.values.scope import Grant, Limit, Range, Restriction, Scope, Words
from capabilities.values.units import Parameter, Unit
from evaluation.redteam.admission.outbox import INSIDE, Outbox
from evaluation.redteam.admission.point import CONTENT_OF, MEMORY, SHELVES
from evaluation.redteam.admission.shelves import MemoryFolder, Shelf
from evaluation.redteam.admission.told import Told, ToolRefusedError, Vouched
from evaluation.redteam.admission.tools import OUTBOX, functions, notes_server, rows
from evaluation.redteam.cast import FASTEST_URAD_S, ROLES, SPONSOR
from evaluation.redteam.guarding import FOLDER, JOURNAL, KEY, registered
from pep.base.declaration import grant
from pep.journal.replay_cache import proof_name
from pep.mcp.mapping import Misfit, to_request
from pep.mcp.provenance import RECEIPT, RESPONSE
from pep.provider.feed_mark import FeedMarkFile
from ztpm.base.layout import new_key, read_key
from ztpm.base.processes import Child
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.cell.provider_setup import toml
from ztpm.stage.calls import call
from ztpm.stage.lending import lent
from ztpm.stage.stage import StageError, in_time, until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey
    from evaluation.redteam.cast import Cast
    from ztpm.stage.stage import Stage

PORT: Final = 8840
PEP: Final = "admission-1"
CONFIGURATION: Final = "point.toml"
PEOPLE: Final = ("alice", "bob")
"""People whose word is an instruction."""
CURATORS: Final = ("dora", "emil")
"""Curators that the point knows; the key of the second one is revoked where a scenario says so."""
ADDRESSES: Final = frozenset(f"{person}{INSIDE}" for person in ("alice", "bob", "carol"))
"""Addresses that the agents are lent notes to, unless a person lends them any."""
WAIT_S: Final = 30.0


@dataclass
class AdmissionRoom:
    """The point, as the people and the hosts of the agents see it.

    Attributes:
        stage: the cell.
        folder: of the point; its writers are no part of the point.
        curators: private keys of the curators.
        notes_to: addresses that the agents are lent notes to; None for any.
    """

    stage: Stage
    folder: Path
    curators: dict[str, PrivateKey]
    notes_to: frozenset[str] | None = ADDRESSES
    _child: Child | None = None
    _lent: int = 0
    _roles: set[str] = field(default_factory=set)
    _revoked: set[str] = field(default_factory=set)

    @property
    def audience(self) -> str:
        """Canonical URL of the point and of its tools."""
        return f"http://{self.stage.cell.addresses.host}:{PORT}/mcp"

    @property
    def outbox(self) -> Outbox:
        """Notes that were sent."""
        return Outbox(self.folder / OUTBOX)

    @property
    def memory(self) -> MemoryFolder:
        """Rows of the memory on disk."""
        return MemoryFolder(self.folder / MEMORY)

    def shelf(self, collection: str) -> Shelf:
        """A collection on disk."""
        return Shelf(self.folder / SHELVES / collection)

    @property
    def public_key(self) -> bytes:
        """Public key of the point, which anyone may know."""
        return keys.public_raw(read_key(self.folder.parent / KEY, self.stage.cell.passphrase))

    def start(self, begin: Callable[..., Child]) -> None:
        """Starts the point's process, in place of the one that runs; it is ready afterwards.

        Args:
            begin: begins it.

        Raises:
            ztpm.base.processes.ChildError: it does not become ready.
        """
        self.stop()
        self._child = begin(
            "admission point",
            "evaluation.redteam.admission.point",
            "--config",
            str(self.folder.parent / CONFIGURATION),
            environment={PASSPHRASE_VARIABLE: self.stage.cell.passphrase.decode()},
        ).until_ready()

    def stop(self) -> None:
        """Stops the point's process, if it runs."""
        if self._child is not None:
            self._child.stop()
        self._child = None

    # --- authority ---------------------------------------------------------------------------------------------------

    def enter(self, cast: Cast) -> None:
        """Lends the cast of a scenario its authority here, once."""
        if self._lent != cast.number:
            self.notes_to = ADDRESSES
            self.lend(cast, purpose="work at the table")

    def lend(self, cast: Cast, *, purpose: str) -> None:
        """Lends the orchestrator arm, notes, plans and memory, and hands the robotic agent its part of it."""
        self._lent, self._roles = cast.number, set()
        orchestrator = cast.called("orchestrator")
        delegates = [cast.name(role) for role in ROLES if role != "orchestrator"]
        issued = self.stage.person(SPONSOR).issue(
            self.stage.agents[orchestrator], self._scope(delegates), purpose=purpose
        )
        self.stage.tokens[orchestrator] = issued.token
        self._roles.add("orchestrator")
        self.holder(cast, "robotic")

    def holder(self, cast: Cast, role: str) -> str:
        """Registered name of a role that holds its part of the authority, now at the latest."""
        self.enter(cast)
        if role not in self._roles:
            cast.hand_down(role, PARTS[role])
            self._roles.add(role)
        return cast.name(role)

    def _scope(self, delegates: list[str]) -> Scope:
        arm, tools = lent(self.stage, *delegates), functions()
        notes = (
            grant(tools["send_note"]) if self.notes_to is None else grant(tools["send_note"], to=Words(self.notes_to))
        )
        grants = (*arm.grants, notes, grant(tools["read_plan"]), grant(tools["set_plan"]), REMEMBER)
        ordered = tuple(sorted(grants, key=lambda each: (each.object, each.operation)))
        return replace(arm, grants=ordered, audiences=arm.audiences | {self.audience})

    # --- questions ---------------------------------------------------------------------------------------------------

    def ask(self, agent: str, question: str, /, **members: object) -> Told:
        """Answer to a question of an agent's host, under the agent's token.

        Args:
            agent: registered name.
            question: its name.
            members: of it.
        """
        parts = urlsplit(self.audience)
        auth = self.stage.agents[agent].auth(self.stage.tokens[agent])
        with httpx2.Client(auth=auth, timeout=WAIT_S, trust_env=False) as http:
            answer = http.post(f"{parts.scheme}://{parts.netloc}/context/{question}", json=members)
        said = answer.json()
        if answer.status_code != 200:
            return Told(admitted=False, reason=str(said.get("code")))
        return Told(
            admitted=said["admitted"],
            reason=said.get("reason", ""),
            value=said.get("value"),
            items=tuple(said.get("items", ())),
            sequence=said.get("sequence", 0),
        )

    def vouched(self, agent: str, tool: str, arguments: dict[str, object]) -> Vouched:
        """Answer of a tool to an agent, with the point's word for it.

        Raises:
            ToolRefusedError: the call was not permitted.
        """
        caller = self.stage.agents[agent]
        auth, asked = caller.auth(self.stage.tokens[agent]), {RECEIPT: True}
        answer = in_time(lambda: call(self.audience, auth, tool, arguments, asked))
        if answer.decision != "PERMIT" or answer.exchange is None:
            raise ToolRefusedError(tool, answer.reason)
        headers = {name.lower(): value for name, value in answer.exchange.headers.items()}
        # The proof was made here, a moment ago; its id is read, not believed.
        jti = jwt.decode(headers["dpop"], options={"verify_signature": False})["jti"]
        request = to_request(rows()[tool], arguments, request_id="0" * 32, audience=self.audience, at=time.time())
        if isinstance(request, Misfit):
            raise StageError(f"{tool}: {request}")
        proof = proof_name(keys.public_raw(caller.key), jti).hex()
        return Vouched(answer.content, _word(answer.exchange.answer), proof, request.digest, tool)

    # --- curators ----------------------------------------------------------------------------------------------------

    def sign(
        self,
        collection: str,
        texts: dict[str, str],
        *,
        by: str = CURATORS[0],
        key: PrivateKey | None = None,
        content: str = "",
        version: int = 1,
        age_s: int = 0,
        life_s: int = 7 * 86_400,
    ) -> str:
        """A curator's manifest of these contents.

        Args:
            collection: its name.
            texts: contents by id.
            by: curator whom it names.
            key: that signs; None for that curator's own.
            content: kind of content that it states; empty for the collection's own.
            version: of it.
            age_s: time since it was signed.
            life_s: from then to its end.
        """
        entries = tuple(manifest.entry_of(id_, texts[id_].encode(), "redteam") for id_ in sorted(texts))
        at = int(time.time()) - age_s
        kind = content or CONTENT_OF[collection.split("-", maxsplit=1)[0]]
        stated = manifest.Manifest(collection, kind, by, version, entries, at, at + life_s)
        return manifest.sign(stated, key or self.curators[by])

    def revoke_curator(self, name: str) -> None:
        """Revokes a curator's key, once; the point knows."""
        if name in self._revoked:
            return
        self._revoked.add(name)
        thumbprint = keys.thumbprint(keys.public_raw(self.curators[name]))
        epoch = self.stage.person("carol").revoke("key", thumbprint, "the curator has left")
        mark, issuer = FeedMarkFile(self.folder / "feed.json"), self.stage.cell.addresses.issuer
        until(lambda: mark.read(issuer).epoch >= epoch, "the revocation at the point")


REMEMBER: Final = Grant("memory", "remember")
_SLOWER: Final = Limit(Parameter("speed", Unit.MICRORADIAN_PER_SECOND), Range(0, FASTEST_URAD_S))
_NOTE, _READ_PLAN, _SET_PLAN = (
    Grant("notes", "send_note"),
    Grant("plans", "read_plan"),
    Grant("plans", "set_plan"),
)
_STATE, _STOP = Grant("ur3e", "read_state"), Grant("ur3e", "stop")
NOBODY: Final[frozenset[str]] = frozenset()
PARTS: Final = {
    "robotic": Restriction(
        (_NOTE, _READ_PLAN, Grant("ur3e", "move_joint", (_SLOWER,)), _STATE, _STOP), delegates=NOBODY
    ),
    "vision": Restriction((REMEMBER, _NOTE, _READ_PLAN, _STATE, _STOP), delegates=NOBODY),
    "config": Restriction((REMEMBER, _NOTE, _READ_PLAN, _SET_PLAN), delegates=NOBODY),
}
"""Part of the orchestrator's authority that each other role is handed, to hand on to nobody."""


def _word(answer: bytes) -> str:
    """The enforcement point's word in the body of an answer."""
    for line in answer.decode("utf-8", "replace").splitlines():
        try:
            return str(json.loads(line.removeprefix("data:"))["result"]["_meta"][RESPONSE])
        except (ValueError, KeyError, TypeError):
            continue
    raise StageError("an answer without its enforcement point's word")


@contextmanager
def admission_room(stage: Stage, *, begin: Callable[..., Child] = Child.begin) -> Iterator[AdmissionRoom]:
    """Room with a running point, ended afterwards.

    Args:
        stage: the cell.
        begin: begins its process in place of `Child.begin`.

    Raises:
        ztpm.base.processes.ChildError: it does not become ready.
    """
    root = stage.cell.layout.root / "admission"
    root.mkdir(mode=0o700)
    folder, secret = root / FOLDER, stage.cell.passphrase
    room = AdmissionRoom(stage, folder, {name: new_key(root / f"{name}.key", secret) for name in CURATORS})
    guard = registered(stage, root, pep=PEP, audience=room.audience, server=notes_server(folder))
    people = {name: keys.public_raw(stage.person(name)._key).hex() for name in PEOPLE}  # noqa: SLF001 - the arena's own
    curators = {name: keys.public_raw(key).hex() for name, key in room.curators.items()}
    tables = b"[people]\n" + toml(people) + b"[curators]\n" + toml(curators)
    (root / CONFIGURATION).write_bytes(toml({"guard": guard.name}) + tables)
    room.start(begin)
    stage.further_journals.append(folder / JOURNAL)
    try:
        yield room
    finally:
        stage.further_journals.remove(folder / JOURNAL)
        room.stop()
