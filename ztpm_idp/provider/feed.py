"""Statements that the identity provider publishes: revocations, registry, conduct, answers, and the ledger."""

from __future__ import annotations

import hashlib
import json
from itertools import accumulate
from typing import TYPE_CHECKING, Final, Protocol

import msgspec

from capabilities.statements import checkpoint, conduct, registry, revocation
from capabilities.statements.people import answers
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from capabilities.values.units import INT_LIMIT
from ztpm_idp.domain.asking.asks import ANSWERED_MEMORY_S, AskState
from ztpm_idp.domain.asking.envelope_acts import EnvelopeSigned
from ztpm_idp.domain.asking.latch_acts import ClearingSigned
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import (
    AgentRestored,
    AgentSuspended,
    AskTaken,
    ConductObserved,
    KeyAdded,
    LineBegun,
    OpeningMade,
    PartyRegistered,
    Revoked,
    RolesChanged,
    StoreRestored,
    SuspensionEnded,
    ToolRegistered,
    TrustStated,
    VoteCast,
)
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    RegisteredTool,
    Standing,
)
from ztpm_idp.domain.upkeep.acts import KeyReplaced, PartRestored, PartSuspended, ToolChanged
from ztpm_idp.provider.problems import Problem

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from ztpm_idp.domain.events import Event
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.settings import Settings
    from ztpm_idp.store.conduct import Told
    from ztpm_idp.store.counters import Counters
    from ztpm_idp.store.engine import Store
    from ztpm_idp.store.transaction import Transaction

INDEX_BYTES: Final = 150_000
"""Most bytes of the entries of one index, as JSON.

In base64 and with the rest they stay below the size of a statement (256 KiB).
"""
INDEX_ENTRIES: Final = revocation.ENTRIES
"""Most entries of one index."""
BASE_EPOCHS: Final = 256
"""Epochs between two bases: so many entries at most does a new enforcement point hear of that have ended."""
_ENTRY_BYTES: Final = 60
"""An entry without its id, as JSON, at most."""
_EDGE_BYTES: Final = 80
_STANDING_BYTES: Final = 160
_DEVIATION_BYTES: Final = 100
"""An edge without its names, an agent without its name and deviations, and a deviation, as JSON, at most."""
EXPORT_PAGE: Final = 500
SNAPSHOTS: Final = 64
"""Most audiences whose registry is kept, the oldest of them forgotten first."""
ANSWERS_BYTES: Final = 190_000
"""Texts of one `answers` statement, as JSON: in base64 and with the rest they stay below its size (256 KiB)."""
_ASK_BYTES: Final = 90
"""An ask of an `answers` statement without its votes, as JSON, at most."""
_NO_NONCE: Final = "0" * 16
"""Nonce of a statement that is read back and sent to nobody."""
_QUOTES_BYTES: Final = 3
"""Bytes of JSON that a text costs beside itself."""


class Deployment(Protocol):
    """Parts of a provider from which statements are made."""

    settings: Settings
    keys: IdpKeys
    store: Store
    snapshots: dict[str, tuple[tuple[int, int, int], str]]
    base_heads: BaseHeads

    def now_ms(self) -> int:
        """The wall clock, milliseconds since the epoch."""
        ...


class BaseHeads:
    """Heads of the chain of revocations at bases, each worked out from the one before it."""

    def __init__(self) -> None:
        self._known: tuple[int, int, str] | None = None

    async def at(self, view: Transaction, line: int, epoch: int) -> str:
        """Head of this line at an epoch that was given out."""
        known = self._known
        after, head = (0, revocation.first_head(line))
        if known is not None and known[0] == line and known[1] <= epoch:
            after, head = known[1:]
        head = await view.revocations.chained(head, after=after, through=epoch)
        self._known = line, epoch, head
        return head


async def index_after(provider: Deployment, *, since: int, nonce: str) -> tuple[str, int]:
    """Signed index of the revocations after `since`, and its epoch, of a store that need not commit for it.

    Raises:
        StoreUnavailableError: the store cannot be read.
        Problem: `RESTORING`; `EPOCH_AHEAD` when the caller knows more than the store.
    """
    as_of_ms = provider.now_ms()
    async with provider.store.read() as view:
        await serving(view)
        index = await unsigned_index(provider, view, since=since, as_of_ms=as_of_ms)
        return signed_index(provider, index, nonce=nonce), index.epoch


async def serving(view: Transaction) -> Counters:
    """The counters of a store that is not being restored.

    Raises:
        Problem: `RESTORING`: what it says of revocations, parties and asks is not yet to be acted on.
    """
    if (counters := await view.counters()).restoring:
        raise Problem(IdpCode.RESTORING)
    return counters


async def unsigned_index(
    provider: Deployment, view: Transaction, *, since: int, as_of_ms: int, base: int | None = None
) -> revocation.RevocationIndex:
    """The revocations after `since` as a view has them, for nobody's nonce yet.

    Raises:
        Problem: `EPOCH_AHEAD` when the caller knows more than the store.
    """
    counters = await view.counters()
    if max(since, base or 0) > counters.epoch:
        # A store restored from an older copy: saying so aloud beats signing an index that nobody can accept.
        raise Problem(IdpCode.EPOCH_AHEAD)
    begun = base or counters.epoch - counters.epoch % BASE_EPOCHS
    if base is None or begun == 0:
        found, beginning = await view.revocations.since(since, INDEX_ENTRIES), revocation.NO_BASE
        kept = _that_fit(found)
    else:
        found = await view.revocations.living(since, INDEX_ENTRIES, base=begun, caps=DEFAULT)
        kept = _that_fit(found)
        cut = len(kept) < len(found) or len(found) == INDEX_ENTRIES
        head = await provider.base_heads.at(view, counters.revocation_line, begun)
        beginning = revocation.RevocationBase(begun, head, kept[-1].epoch if cut else counters.epoch)
    return revocation.RevocationIndex(
        issuer=provider.settings.issuer,
        epoch=counters.epoch,
        since=since,
        as_of_ms=as_of_ms,
        nonce=_NO_NONCE,
        registry_version=counters.registry_version,
        entries=kept,
        line=counters.revocation_line,
        head=counters.revocation_head,
        base=beginning,
    )


def signed_index(provider: Deployment, index: revocation.RevocationIndex, *, nonce: str) -> str:
    """The index, signed for this nonce."""
    return revocation.sign(msgspec.structs.replace(index, nonce=nonce), provider.keys.feed)


def _that_fit(found: list[tuple[int, str, str]]) -> tuple[revocation.RevocationEntry, ...]:
    sizes = accumulate(_ENTRY_BYTES + len(id_) for _, _, id_ in found)
    return tuple(
        revocation.RevocationEntry(epoch, kind, id_)
        for (epoch, kind, id_), size in zip(found, sizes, strict=True)
        if size <= INDEX_BYTES
    )


async def conduct_of(provider: Deployment, view: Transaction, *, since: int, nonce: str, as_of_ms: int) -> str:
    """Signed word on the changes of agents' conduct after `since`, as a view has them.

    Raises:
        Problem: `EPOCH_AHEAD` when the caller knows more than the store.
    """
    newest = (await view.counters()).conduct_version
    told = await view.conduct.told(since=since, most=conduct.ENTRIES)
    if since > newest:
        raise Problem(IdpCode.EPOCH_AHEAD)
    # A kind that was cut ends at its last row; newer rows of the other kind are told with the next word.
    cut = [rows[-1].version for rows in _kinds(told) if len(rows) == conduct.ENTRIES]
    through = min([newest, *cut])
    rows = sorted((row for kind in _kinds(told) for row in kind if row.version <= through), key=lambda row: row.version)
    sizes = list(accumulate(map(_size, rows)))
    if sizes and sizes[-1] > INDEX_BYTES:
        rows = rows[: sum(size <= INDEX_BYTES for size in sizes)]
        through = rows[-1].version
    word = conduct.Conduct(
        issuer=provider.settings.issuer,
        version=newest,
        since=since,
        through=through,
        as_of_ms=as_of_ms,
        nonce=nonce,
        edges=tuple(row for row in rows if isinstance(row, conduct.EdgeEntry)),
        agents=tuple(row for row in rows if isinstance(row, conduct.AgentEntry)),
    )
    return conduct.sign(word, provider.keys.feed)


def _kinds(told: Told) -> tuple[tuple[conduct.EdgeEntry | conduct.AgentEntry, ...], ...]:
    return told.edges, told.agents


def _size(row: conduct.EdgeEntry | conduct.AgentEntry) -> int:
    if isinstance(row, conduct.EdgeEntry):
        return _EDGE_BYTES + len(row.delegator) + len(row.delegate)
    return _STANDING_BYTES + len(row.agent) + _DEVIATION_BYTES * len(row.deviations)


async def registry_snapshot(provider: Deployment, *, audience: str) -> str:
    """The signed registry of `audience`: of each version one text, which is kept for the next who asks."""
    as_of_ms, kept = provider.now_ms(), provider.snapshots
    async with provider.store.read() as view:
        counters = await serving(view)
        version = counters.revocation_line, counters.registry_version, provider.keys.bundle_version
        if (known := kept.get(audience)) is not None and known[0] == version:
            return known[1]
        text = await _registry(provider, view, audience=audience, as_of_ms=as_of_ms)
    kept.pop(audience, None)
    while len(kept) >= SNAPSHOTS:
        del kept[next(iter(kept))]
    kept[audience] = version, text
    return text


async def _registry(provider: Deployment, view: Transaction, *, audience: str, as_of_ms: int) -> str:
    counters = await view.counters()
    tools = await view.upkeep.tools_of(audience)
    parts = [*await view.active("sensor", audience=audience), *await view.active("pep")]
    parts = [part for part in parts if part.standing is Standing.ACTIVE]  # the others are suspended
    sensors = [s for s in parts if isinstance(s, RegisteredSensor)]
    people = [p for p in await view.active("person") if isinstance(p, RegisteredPerson)]
    peps = [p for p in parts if isinstance(p, RegisteredPep)]
    snapshot = registry.RegistrySnapshot(
        issuer=provider.settings.issuer,
        version=counters.registry_version,
        audience=audience,
        as_of_ms=as_of_ms,
        tools=tuple(
            registry.ToolEntry(t.name, bytes(t.definition_digest).hex(), t.operation, Tier(t.base_tier)) for t in tools
        ),
        sensors=tuple(registry.SensorEntry(s.id, s.key, s.calibration.hex(), s.transit_ms) for s in sensors),
        trust=tuple(registry.TrustEntry(agent, permille) for agent, permille in await view.trusted()),
        approvers=tuple(
            registry.PartyEntry(p.id, key) for p in people for key in sorted(p.keys) if PersonRole.APPROVER in p.roles
        ),
        peps=tuple(registry.PartyEntry(p.id, p.key) for p in peps if audience in p.audiences),
        suspended=tuple(await view.suspended()),
        passkeys=tuple(
            registry.PartyEntry(p.id, key)
            for p in people
            for key in sorted(p.passkey_keys)
            if PersonRole.APPROVER in p.roles
        ),
    )
    return registry.sign(snapshot, provider.keys.registry)


async def answers_for(provider: Deployment, *, audience: str, nonce: str) -> str:
    """Asks and openings of an audience, signed, with the votes and openings as people signed them.

    `as_of` is taken first: everything acknowledged before it is in the statement. An open or granted ask is always
    in it (`STANDING_ASKS` and `OPENINGS` see to it); of ended asks, as many as fit, the latest first. So an ask that is
    not in the statement is not approved.

    Raises:
        StoreUnavailableError: the store cannot be read.
    """
    as_of_ms = provider.now_ms()
    async with provider.store.read() as view:
        await serving(view)
        return await _answers(provider, view, audience=audience, nonce=nonce, as_of_ms=as_of_ms)


async def _answers(provider: Deployment, view: Transaction, *, audience: str, nonce: str, as_of_ms: int) -> str:
    since_s = as_of_ms // 1_000 - ANSWERED_MEMORY_S
    found = await view.approvals.not_long_over(since_s=since_s, audience=audience)
    openings = await view.approvals.openings(since_s=as_of_ms // 1_000, audience=audience)
    latest = found[::-1]
    # Stable: within each half the latest ask stays first.
    ranked = sorted(latest, key=lambda asked: asked.state(as_of_ms) not in {AskState.OPEN, AskState.GRANTED})
    opened = tuple(opening.text for opening in openings if not opening.over(as_of_ms))
    signed = await view.envelopes.lasting(since_s=as_of_ms // 1_000, audience=audience)
    enveloped = tuple(envelope.text for envelope in signed if not envelope.over(as_of_ms))
    cleared = await view.latches.counting(audience, at_s=as_of_ms // 1_000, most=answers.CLEARINGS)
    room = ANSWERS_BYTES - sum(len(text) + _QUOTES_BYTES for text in (*opened, *enveloped, *cleared))
    sizes = accumulate(_ASK_BYTES + sum(len(vote.text) + _QUOTES_BYTES for vote in asked.votes) for asked in ranked)
    statement = answers.Answers(
        issuer=provider.settings.issuer,
        audience=audience,
        nonce=nonce,
        as_of_ms=as_of_ms,
        asks=tuple(
            answers.AnsweredAsk(asked.ask.ask_id, asked.state(as_of_ms).value, tuple(vote.text for vote in asked.votes))
            for asked, size in zip(ranked[: answers.ASKS], sizes, strict=False)
            if size <= room
        ),
        openings=opened,
        envelopes=enveloped,
        clearings=cleared,
    )
    return answers.sign(statement, provider.keys.registry)


async def read_back(
    provider: Deployment, view: Transaction, events: tuple[Event, ...], *, before: Counters, at_ms: int
) -> None:
    """Signs every statement that these events change, so that its own reader takes it before they are committed.

    Args:
        provider: of the keys.
        view: the transaction in which the events are written already.
        events: those events.
        before: the counters as they were.
        at_ms: now.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for an event that no enforcement point could be told.
    """
    if any(isinstance(event, Revoked | StoreRestored | LineBegun) for event in events):
        index = await unsigned_index(provider, view, since=before.epoch, as_of_ms=at_ms)
        signed_index(provider, index, nonce=_NO_NONCE)
    told = (await view.counters()).conduct_version != before.conduct_version
    if told and any(isinstance(event, ConductObserved | AgentRestored) for event in events):
        await conduct_of(provider, view, since=before.conduct_version, nonce=_NO_NONCE, as_of_ms=at_ms)
    for audience in sorted(frozenset[str]().union(*map(_registries, events))):
        await _registry(provider, view, audience=audience or provider.settings.issuer, as_of_ms=at_ms)
    asked = frozenset(event.ask_id for event in events if isinstance(event, VoteCast))
    voted = [one.ask.audience for one in [await view.approvals.asked(id_) for id_ in sorted(asked)] if one is not None]
    for audience in sorted({*voted, *(found for event in events if (found := _answered(event)))}):
        await _answers(provider, view, audience=audience, nonce=_NO_NONCE, as_of_ms=at_ms)


def _registries(event: Event) -> frozenset[str]:
    """Audiences whose registry an event changes; "" for one that changes all alike."""
    match event:
        case PartyRegistered(party=RegisteredPep(audiences=audiences)):
            return audiences
        case (
            PartyRegistered(party=RegisteredSensor(audience=audience))
            | ToolRegistered(tool=RegisteredTool(audience=audience))
        ):
            return frozenset({audience})
        case PartSuspended() | PartRestored() | KeyReplaced():
            return event.audiences
        case ToolChanged(audience=audience):
            return frozenset({audience})
        case (
            PartyRegistered(party=RegisteredPerson())
            | KeyAdded()
            | RolesChanged()
            | TrustStated()
            | AgentSuspended()
            | SuspensionEnded()
        ):
            return frozenset({""})
        case _:
            return frozenset()


def _answered(event: Event) -> str:
    """The audience that an event is an answer to, or ""."""
    match event:
        case AskTaken(ask=ask):
            return ask.audience
        case OpeningMade(opening=opening):
            return opening.audience
        case EnvelopeSigned(envelope=envelope):
            return envelope.audience
        case ClearingSigned(audience=audience):
            return audience
        case _:
            return ""


async def ledger_export(provider: Deployment, *, first: int = 1, last: int = INT_LIMIT) -> AsyncIterator[bytes]:
    """The ledger's lines from `first` to `last` as of now, and the signed checkpoint that they end in.

    Entries never change, so pages need no snapshot. A checkpoint of a ledger that has gone on since is as of its last
    entry, not as of now: nobody shall take it for the newest.
    """
    as_of_ms = provider.now_ms()
    async with provider.store.read() as view:
        counters = await view.counters()
    size, head, after = counters.ledger_size, counters.ledger_head, first - 1
    through = min(last, size)
    while after < through:
        async with provider.store.read() as view:
            lines = await view.ledger_lines(after=after, through=through, most=EXPORT_PAGE)
        after += len(lines)
        if after == through < size:
            size, head = through, hashlib.sha256(lines[-1]).hexdigest()
            as_of_ms = json.loads(lines[-1])["at_ms"]
        yield b"".join(line + b"\n" for line in lines)
    signed = checkpoint.sign(
        checkpoint.Checkpoint(issuer=provider.settings.issuer, size=size, head=head, as_of_ms=as_of_ms),
        provider.keys.ledger,
    )
    yield b'{"checkpoint":"' + signed.encode() + b'"}\n'
