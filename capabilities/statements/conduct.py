"""The signed word on conduct: how far edges are trusted, and which agents behave as they should not.

An edge or agent of which nothing was ever said has the policy's prior and no deviation. Clause [STM-8] in docs/spec.md.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.attestation import NONCE
from capabilities.statements.claims import Claims, malformed, unique

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "conduct"
ENTRIES: Final = 1_024
"""Most edges, and most agents, of one word; what does not fit is asked for again from `through`."""
DEVIATIONS: Final = 16
"""Most deviations of one agent."""
PERMILLE: Final = 1_000
_FEATURE: Final = re.compile(r"[a-z][a-z ]{0,31}", re.ASCII)


@dataclass(frozen=True, slots=True)
class EdgeEntry:
    """How far one party is trusted that another lent authority to.

    Attributes:
        version: at which this was said.
        delegator, delegate: the edge; the delegator of a first holder is its sponsor.
        score_permille: 0 to 1000.
    """

    version: int
    delegator: str
    delegate: str
    score_permille: int


@dataclass(frozen=True, slots=True)
class DeviationEntry:
    """One feature of an agent's conduct that left its baseline: which, since when (seconds), how far (thousandths)."""

    feature: str
    since: int
    score_milli: int


@dataclass(frozen=True, slots=True)
class AgentEntry:
    """How an agent behaves.

    Attributes:
        version: at which this was said.
        agent: whose conduct.
        deviations: not restored by a person; each feature once.
        deviated_at: seconds since the epoch of the newest of them; None for none.
        contracted: it holds the minimum safe set until a person restores it.
        samples: acts in its baseline.
        restored_at: seconds since the epoch at which a person last restored it, or None: what an enforcement point saw
            itself up to then counts no longer.
    """

    version: int
    agent: str
    deviations: tuple[DeviationEntry, ...]
    deviated_at: int | None
    contracted: bool
    samples: int
    restored_at: int | None


@dataclass(frozen=True, slots=True)
class Conduct:
    """What a feed answers.

    Attributes:
        issuer: canonical URL of the identity provider.
        version: the newest of its store when `as_of_ms` was read.
        since: the version that was asked for; edges and agents are those that changed after it.
        through: the version up to which this word tells everything; below `version` it is cut, and the rest is to be
            asked for.
        as_of_ms: wall clock of the identity provider before it read the store, milliseconds since the epoch.
        nonce: of the one who asked, echoed.
        edges, agents: each with its newest standing, each once.
    """

    issuer: str
    version: int
    since: int
    through: int
    as_of_ms: int
    nonce: str
    edges: tuple[EdgeEntry, ...]
    agents: tuple[AgentEntry, ...]


def sign(word: Conduct, key: PrivateKey) -> str:
    """The signed word."""
    claims: dict[str, object] = {
        "issuer": word.issuer,
        "version": word.version,
        "since": word.since,
        "through": word.through,
        "as_of_ms": word.as_of_ms,
        "nonce": word.nonce,
        "edges": [
            {"version": e.version, "delegator": e.delegator, "delegate": e.delegate, "score_permille": e.score_permille}
            for e in word.edges
        ],
        "agents": [
            {
                "version": a.version,
                "agent": a.agent,
                "deviations": [
                    {"feature": d.feature, "since": d.since, "score_milli": d.score_milli} for d in a.deviations
                ],
                "deviated_at": a.deviated_at,
                "contracted": a.contracted,
                "samples": a.samples,
                "restored_at": a.restored_at,
            }
            for a in word.agents
        ],
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Conduct:  # noqa: A001 - read as conduct.open
    """The word, signed by one of these keys, its edges and agents inside (since, through].

    Raises:
        StatementError: as `sealed.open`.
    """
    members = statement_form.open(KIND, text, keys, caps)
    claims = Claims(members, "issuer", "version", "since", "through", "as_of_ms", "nonce", "edges", "agents")
    word = Conduct(
        issuer=claims.url("issuer"),
        version=claims.integer("version"),
        since=claims.integer("since"),
        through=claims.integer("through"),
        as_of_ms=claims.integer("as_of_ms"),
        nonce=claims.token("nonce", NONCE),
        edges=unique(claims.each("edges", _edge, most=ENTRIES), lambda e: (e.delegator, e.delegate), "an edge"),
        agents=unique(claims.each("agents", _agent, most=ENTRIES), lambda a: a.agent, "an agent"),
    )
    versions = [*(entry.version for entry in word.edges), *(entry.version for entry in word.agents)]
    inside = all(word.since < version <= word.through for version in versions)
    if not inside or not word.since <= word.through <= word.version:
        raise malformed("entries outside of what was asked, or of what is told")
    return word


def _edge(value: object) -> EdgeEntry:
    claims = Claims(value, "version", "delegator", "delegate", "score_permille")
    return EdgeEntry(
        version=claims.integer("version"),
        delegator=claims.name("delegator"),
        delegate=claims.name("delegate"),
        score_permille=claims.integer("score_permille", high=PERMILLE),
    )


def _agent(value: object) -> AgentEntry:
    names = ("version", "agent", "deviations", "deviated_at", "contracted", "samples", "restored_at")
    claims = Claims(value, *names)
    return AgentEntry(
        version=claims.integer("version"),
        agent=claims.name("agent"),
        deviations=unique(claims.each("deviations", _deviation, most=DEVIATIONS), lambda d: d.feature, "a feature"),
        deviated_at=_time_or_none(claims, "deviated_at"),
        contracted=claims.boolean("contracted"),
        samples=claims.integer("samples"),
        restored_at=_time_or_none(claims, "restored_at"),
    )


def _deviation(value: object) -> DeviationEntry:
    claims = Claims(value, "feature", "since", "score_milli")
    return DeviationEntry(
        feature=claims.token("feature", _FEATURE),
        since=claims.integer("since"),
        score_milli=claims.integer("score_milli"),
    )


def _time_or_none(claims: Claims, name: str) -> int | None:
    return None if claims.raw(name) is None else claims.integer(name)
