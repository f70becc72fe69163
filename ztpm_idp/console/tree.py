"""Pages of the tree: sponsors, the agents that they lent to, and each hop with what it may do."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import Response  # noqa: TC002  the framework reads the annotations

from capabilities.statements.claims import ID
from capabilities.statements.people import mandate as mandate_statement
from capabilities.values.errors import CapabilityError
from capabilities.values.scope_json import scope_from_json
from ztpm_idp.console import forest
from ztpm_idp.console.pages import page
from ztpm_idp.console.viewing import Viewer, viewer_of
from ztpm_idp.domain.asking.asks import AskState
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.lending import allowances
from ztpm_idp.domain.lending.mandates import MandateState, standing
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson
from ztpm_idp.domain.state import Wanted
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.oauth.assent_page import in_words
from ztpm_idp.provider.ask_page import TIERS
from ztpm_idp.routes.audit import follower_of
from ztpm_idp.routes.caller import provider_of
from ztpm_idp.store.audit import Search

if TYPE_CHECKING:
    from capabilities.values.scope import Budget, Grant, Scope
    from ztpm_idp.console.forest import Branch
    from ztpm_idp.domain.state import MandateRecord, State
    from ztpm_idp.store.transaction import Transaction

router = APIRouter()
HOPS: Final = 4_096
"""Most hops of one page, the newest tokens first: as many as one token's tree may have."""
_MADE: Final = frozenset({"token-issued", "token-drawn", "token-delegated"})
"""Kinds of entries that state a hop's scope."""
_ENTRIES: Final = 1_000


@dataclass(frozen=True, slots=True)
class Promise:
    """A mandate beside a sponsor's trees.

    Attributes:
        record: as the store has it.
        state: how it stands.
        purpose: sentence of its sponsor, or "".
        budgets: each with the act that it counts.
    """

    record: MandateRecord
    state: MandateState
    purpose: str
    budgets: list[tuple[str, Budget]]


@dataclass(frozen=True, slots=True)
class SponsorTrees:
    """Authority that one sponsor lent.

    Attributes:
        sponsor: the person's id.
        name: as registered.
        mandates: those that are not over, the newest first.
        roots: first hops, the newest first.
        may_cut: the viewer may take it back.
    """

    sponsor: str
    name: str
    mandates: list[Promise]
    roots: list[Branch]
    may_cut: bool

    @property
    def living(self) -> int:
        """Number of living hops."""
        return sum(root.living for root in self.roots)


@dataclass(frozen=True, slots=True)
class Forest:
    """All trees that a viewer sees.

    Attributes:
        trees: by sponsor, those with hops or mandates.
        more: there are older tokens that are left out.
    """

    trees: list[SponsorTrees]
    more: bool

    @property
    def roots(self) -> list[Branch]:
        """First hops of all sponsors."""
        return [root for tree in self.trees for root in tree.roots]


def may_cut(viewer: Viewer, sponsor: str) -> bool:
    """True where the viewer takes back what this sponsor lent: its own as a sponsor, all as an administrator."""
    roles = viewer.person.roles
    return PersonRole.ADMIN in roles or (PersonRole.SPONSOR in roles and viewer.person.id == sponsor)


async def forest_of(request: Request, viewer: Viewer) -> Forest:
    """The trees that this person sees, as of now."""
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        return await _forest(view, viewer, at_ms, provider.rules.policies.parameters.trust_prior_permille)


async def _forest(view: Transaction, viewer: Viewer, at_ms: int, prior_permille: int) -> Forest:
    people = [p for p in await view.all_parties("person") if viewer.sees(p.id) and isinstance(p, RegisteredPerson)]
    names = {person.id: person.name for person in people}
    hops = await view.lending.living_hops(sorted(names), at_s=at_ms // 1_000, most=HOPS + 1)
    promised = await view.lending.mandates_of(None if viewer.sees_all else viewer.person.id)
    promised = [m for m in promised if m.sponsor in names and at_ms < m.not_after * 1_000]
    concerned = {hop.agent for hop in hops} | {m.agent for m in promised} | {m.sponsor for m in promised}
    state = await view.load(Wanted(parties=frozenset(concerned)), young_ms=at_ms)
    keys = {id_: party.thumbprint for id_, party in state.parties.items()}
    former = await view.upkeep.former_keys_of(sorted({hop.agent for hop in hops}))
    named = {name for hop in hops for name in forest.names_of(hop, keys.get(hop.agent, ""))}
    named |= {("key", key) for replaced in former.values() for _, key in replaced}
    scores, _ = await view.conduct.everybody()
    standings = forest.Standings(await view.dead_of(frozenset(named)), keys, former, scores, prior_permille)
    roots = forest.grown(hops[:HOPS], standings)
    trees = [
        SponsorTrees(
            sponsor,
            names[sponsor],
            [_promise(state, m, at_ms) for m in promised if m.sponsor == sponsor],
            roots.get(sponsor, []),
            may_cut(viewer, sponsor),
        )
        for sponsor in sorted(names)
    ]
    return Forest([tree for tree in trees if tree.roots or tree.mandates], len(hops) > HOPS)


def _promise(state: State, record: MandateRecord, at_ms: int) -> Promise:
    promised = mandate_statement.read_again(record.text)
    budgets = [(_act(grant), budget) for grant in promised.scope.grants for budget in grant.budgets]
    return Promise(record, standing(state, record, at_ms), promised.purpose, budgets)


@router.get("/console/tree", include_in_schema=False)
async def show_tree(request: Request) -> Response:
    """The trees that this person sees: mandates, tokens, hops, and the trust of each edge."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    found = await forest_of(request, viewer)
    return page(request, "tree.html", viewer, active="tree", forest=found, at_ms=provider_of(request).now_ms())


@router.get("/console/tree/sponsors/{id_}", include_in_schema=False)
async def show_allowances(request: Request, id_: str) -> Response:
    """Amounts of each thing that a sponsor has, and may have."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        if not viewer.sees(id_) or not isinstance(await view.party(id_), RegisteredPerson):
            raise PageProblem(IdpCode.NOT_FOUND)
        asked = await view.approvals.standing("", since_s=at_ms // 1_000)
        waiting = sum(1 for one in asked if one.ask.sponsor == id_ and one.state(at_ms) is AskState.OPEN)
        used = await view.using.shown(id_, at_ms=at_ms, asks=waiting)
    most = provider.rules.allowances.of(id_)
    rows = [(name, getattr(used, name), getattr(most, name)) for name in allowances.names()]
    return page(request, "allowances.html", viewer, active="tree", sponsor=id_, rows=rows)


@router.get("/console/tree/hops/{hop_id}", include_in_schema=False)
async def show_hop(request: Request, hop_id: str) -> Response:
    """One hop: its way from the sponsor, what it may do, how often, and by what it was attested."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    provider = provider_of(request)
    async with provider.store.read() as view:
        found = await view.lending.hops(Wanted(hop=hop_id)) if ID.fullmatch(hop_id) else {}
    way = list(found.values())[::-1]
    if not way or not viewer.sees(way[-1].sponsor):
        raise PageProblem(IdpCode.NOT_FOUND, "no such hop of what you see")
    body = await _made(request, way[-1].token_id, hop_id)
    roots = (await forest_of(request, viewer)).roots
    branch = next((each for root in roots for each in root.each() if each.hop.hop_id == hop_id), None)
    scope = _scope(body)
    return page(
        request,
        "hop.html",
        viewer,
        active="tree",
        way=way,
        branch=branch,
        body=body,
        scope=scope,
        grants=[] if scope is None else [_grant(grant) for grant in scope.grants],
        ceiling="" if scope is None else f"{int(scope.ceiling)} ({TIERS[scope.ceiling]})",
        may_cut=branch is not None and branch.dead_by is None and may_cut(viewer, way[-1].sponsor),
    )


async def _made(request: Request, token_id: str, hop_id: str) -> dict[str, Any]:
    """Body of the entry by which a hop was made; empty where the ledger has none of that form."""
    provider = provider_of(request)
    through = await follower_of(request).through()
    async with provider.store.read() as view:
        rows = await view.audit.search(Search(token=token_id, through=through, most=_ENTRIES))
        lines = await view.audit.lines(row.seq for row, _, _ in rows if row.kind in _MADE)
    bodies = (json.loads(line)["body"] for line in lines.values())
    return next((body for body in bodies if body.get("hop_id") == hop_id), {})


def _scope(body: dict[str, Any]) -> Scope | None:
    try:
        return scope_from_json(body.get("scope"))
    except CapabilityError:
        return None


def _grant(grant: Grant) -> dict[str, object]:
    return {
        "act": _act(grant),
        "limits": [in_words(limit) for limit in grant.limits],
        "budgets": grant.budgets,
    }


def _act(grant: Grant) -> str:
    return f"{grant.operation} of {grant.object}"
