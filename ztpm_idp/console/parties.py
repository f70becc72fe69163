"""Pages of people and agents: roles, keys and leave-taking; attestation, trust and behaviour."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import Response  # noqa: TC002  the framework reads the annotations

from capabilities.keys.keys import thumbprint
from capabilities.statements.claims import ID
from capabilities.values.units import INT_LIMIT
from ztpm_idp.console import acts, history, plot
from ztpm_idp.console.pages import page, time_of
from ztpm_idp.console.texts import TEXTS
from ztpm_idp.console.tree import may_cut
from ztpm_idp.console.viewing import Viewer, viewer_of
from ztpm_idp.domain.changes import ChangeKind, ChangeState
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, RegisteredPerson, Standing
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.provider import audit
from ztpm_idp.routes.audit import follower_of
from ztpm_idp.routes.caller import provider_of
from ztpm_idp.store.audit import Search

if TYPE_CHECKING:
    from ztpm_idp.domain.changes import Change
    from ztpm_idp.store.transaction import Transaction

router = APIRouter()
RECORDS: Final = 1_000
"""Most decisions, and most outcomes, that the picture of an agent's trust is made of: the newest."""


@dataclass(frozen=True, slots=True)
class PersonRow:
    """A person on the page.

    Attributes:
        person: as registered.
        state: name of the text: active, leaving, or ended.
        signing, passkeys: thumbprints of the keys.
        logins: at other providers.
        waiting: changes of the person that wait for another administrator.
        agents: living agents that the person answers for.
        hops: living first hops: tokens that the person lent.
    """

    person: RegisteredPerson
    state: str
    signing: list[str]
    passkeys: list[str]
    logins: list[str]
    waiting: list[Change]
    agents: int
    hops: int


@dataclass(frozen=True, slots=True)
class WaitingRow:
    """A change that waits, on the page.

    Attributes:
        change: as proposed, with the words on it.
        told: its members with their texts.
        asked: administrators who may answer it.
        may_answer: the viewer is one of them.
    """

    change: Change
    told: dict[str, str]
    asked: list[str]
    may_answer: bool


@dataclass(frozen=True, slots=True)
class AgentRow:
    """An agent on the page.

    Attributes:
        agent: as registered.
        attested_ms: when it was attested last; None: never.
        trust: the least score of an edge into it, in permille.
        conduct: its published behaviour; None where nothing was reported.
    """

    agent: RegisteredAgent
    attested_ms: int | None
    trust: int
    conduct: dict[str, Any] | None

    @property
    def behaviour(self) -> str:
        """Name of the text for its behaviour."""
        if self.conduct is None:
            return "unknown"
        if self.conduct["contracted"]:
            return "contracted"
        return "deviates" if self.conduct["deviations"] else "usual"


@router.get("/console/people", include_in_schema=False)
async def show_people(request: Request) -> Response:
    """People with their roles, keys, passkeys and logins, and who is leaving."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    at_ms, after = provider_of(request).now_ms(), request.query_params.get("after", "")
    async with provider_of(request).store.read() as view:
        rows, waiting = await _people(view, viewer, at_ms), await _waiting(view, viewer, at_ms)
        change = await view.people.change(after) if ID.fullmatch(after) else None
    # A link says nothing by itself: the notice is of a change that has the viewer's own word.
    own = change is not None and viewer.person.id in change.confirmed | change.declined | {change.by}
    return page(
        request,
        "people.html",
        viewer,
        active="people",
        rows=rows,
        waiting=waiting,
        admin=PersonRole.ADMIN in viewer.person.roles,
        roles=[role.value for role in PersonRole],
        notice=None if change is None or not own else (change.change_id, change.state(at_ms).value),
    )


async def _waiting(view: Transaction, viewer: Viewer, at_ms: int) -> list[WaitingRow]:
    """Changes that wait: all for who sees everybody, else those that the viewer proposed or is about."""
    admins, rows = await view.people.administrators(), list[WaitingRow]()
    for change in await view.people.open_changes(at_ms=at_ms):
        if change.state(at_ms) is not ChangeState.OPEN or not (
            viewer.sees(change.person) or change.by == viewer.person.id
        ):
            continue
        asked = sorted(admins - {change.by, change.person} - change.confirmed - change.declined)
        may_answer = PersonRole.ADMIN in viewer.person.roles and viewer.person.id in asked
        rows.append(WaitingRow(change, acts.told(change), asked, may_answer))
    return rows


async def _people(view: Transaction, viewer: Viewer, at_ms: int) -> list[PersonRow]:
    people = [p for p in await view.all_parties("person") if viewer.sees(p.id) and isinstance(p, RegisteredPerson)]
    waiting = [c for c in await view.people.open_changes(at_ms=at_ms) if c.state(at_ms) is ChangeState.OPEN]
    logins, agents = await view.sessions.logins(), await view.all_parties("agent")
    rows = list[PersonRow]()
    for person in people:
        own = [change for change in waiting if change.person == person.id]
        ended = person.standing is Standing.REVOKED
        leaving = any(change.kind is ChangeKind.END for change in own)
        rows.append(
            PersonRow(
                person=person,
                state="ended" if ended else "leaving" if leaving else "active",
                signing=sorted(map(thumbprint, person.keys)),
                passkeys=sorted(map(thumbprint, person.passkey_keys)),
                logins=logins.get(person.id, []),
                waiting=own,
                agents=sum(_living_of(agent, person.id) for agent in agents),
                hops=len(await view.lending.tokens_from(person.id, since_s=at_ms // 1_000)),
            )
        )
    return rows


def _living_of(agent: object, sponsor: str) -> bool:
    return isinstance(agent, RegisteredAgent) and agent.sponsor == sponsor and agent.standing is not Standing.REVOKED


@router.get("/console/agents", include_in_schema=False)
async def show_agents(request: Request) -> Response:
    """Agents with their standing, attestation, least trust, and behaviour."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    async with provider_of(request).store.read() as view:
        rows = await _agents(request, view, viewer, None)
        people = await view.all_parties("person")
    sponsors = sorted(
        person.id
        for person in people
        if isinstance(person, RegisteredPerson)
        and person.standing is Standing.ACTIVE
        and PersonRole.SPONSOR in person.roles
        and may_cut(viewer, person.id)
    )
    return page(request, "agents.html", viewer, active="agents", rows=rows, sponsors=sponsors)


async def _agents(request: Request, view: Transaction, viewer: Viewer, only: str | None) -> list[AgentRow]:
    prior = provider_of(request).rules.policies.parameters.trust_prior_permille
    scores, standings = await view.conduct.everybody()
    attested = await view.attested()
    found = await view.all_parties("agent") if only is None else [await view.party(only)]
    rows = list[AgentRow]()
    for agent in found:
        if isinstance(agent, RegisteredAgent) and viewer.sees(agent.sponsor):
            most = prior if agent.trust_permille is None else min(prior, agent.trust_permille)
            least = min([most, *scores.get(agent.id, {}).values()])
            rows.append(AgentRow(agent, attested.get(agent.id), least, standings.get(agent.id)))
    return rows


@router.get("/console/agents/{id_}", include_in_schema=False)
async def show_agent(request: Request, id_: str) -> Response:
    """One agent: what vouches for it, the trust in it over time, and how it behaves beside its own past."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    provider = provider_of(request)
    async with provider.store.read() as view:
        rows = await _agents(request, view, viewer, id_)
        scores, _ = await view.conduct.everybody()
    if not rows:
        raise PageProblem(IdpCode.NOT_FOUND, "no such agent that you see")
    (row,) = rows
    parameters, now = provider.rules.policies.parameters, provider.now_ms() // 1_000
    lines = await _records(request, id_)
    over_time = history.trust_over_time(lines, id_, parameters, now=now)
    return page(
        request,
        "agent.html",
        viewer,
        active="agents",
        row=row,
        evidence=await _evidence(request, id_),
        edges=sorted(scores.get(id_, {}).items()),
        prior=parameters.trust_prior_permille,
        theta=parameters.trust_theta_permille,
        over_time=sorted(over_time),
        picture=_picture(over_time, prior=parameters.trust_prior_permille, theta=parameters.trust_theta_permille),
        records=len(lines),
        may_cut=may_cut(viewer, row.agent.sponsor),
    )


def _picture(over_time: dict[str, history.Line], *, prior: int, theta: int) -> Any:
    if not over_time:
        return None
    every = [at for line in over_time.values() for at, _ in line]
    words = TEXTS["agent"]
    levels = {words["prior"]: prior, words["theta"]: theta}
    begin, end = time_of(min(every) * 1_000), time_of(max(every) * 1_000)
    now = ", ".join(f"{who} {line[-1][1] / 1_000:.2f}" for who, line in sorted(over_time.items()))
    label = f"{words['picture']} {begin}, {end}: {now}"
    return plot.stairs(dict(sorted(over_time.items())), levels=levels, begin=begin, end=end, label=label)


async def _records(request: Request, agent: str) -> list[bytes]:
    """Newest records of decisions and outcomes of an agent, in order."""
    found = dict[int, bytes]()
    for kind in ("decision", "outcome"):
        asked = Search(kind=kind, agent=agent, before=INT_LIMIT, most=RECORDS)
        part = await audit.search(provider_of(request), follower_of(request), asked, whole=True)
        found |= {row.seq: line for (row, _), line in zip(part.rows, part.lines, strict=True)}
    return [found[seq] for seq in sorted(found)]


async def _evidence(request: Request, agent: str) -> dict[str, Any]:
    """Body of the newest entry by which the agent was attested; empty of none."""
    asked = Search(kind="agent-attested", agent=agent, before=INT_LIMIT, most=1)
    part = await audit.search(provider_of(request), follower_of(request), asked, whole=True)
    return {name: str(value) for name, value in json.loads(part.lines[0])["body"].items()} if part.lines else {}
