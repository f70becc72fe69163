"""The signed word on conduct: how far edges are trusted, and which agents behave as they should not.

An edge or agent of which nothing was ever said has the policy's prior and no deviation. Clause [STM-8] in docs/spec.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Name, Nonce, Url, Whole, malformed, read, unique
from capabilities.values.form import Form, plain, upto, whole, within

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "conduct"
ENTRIES: Final = 1_024
"""Most edges, and most agents, of one word; the rest is asked for again from `through`."""
DEVIATIONS: Final = 16
"""Most deviations of one agent."""
PERMILLE: Final = 1_000


class EdgeEntry(Form, frozen=True):
    """Trust in one edge: a party to which another lent authority.

    Attributes:
        version: at which this was said.
        delegator, delegate: the edge; the delegator of a first holder is its sponsor.
        score_permille: 0 to 1000.
    """

    version: Whole
    delegator: Name
    delegate: Name
    score_permille: Annotated[int, within(0, PERMILLE)]


class DeviationEntry(Form, frozen=True):
    """One feature of an agent's conduct that left its baseline: which, since when (seconds), how far (thousandths)."""

    feature: Annotated[str, whole("[a-z][a-z ]{0,31}")]
    since: Whole
    score_milli: Whole


class AgentEntry(Form, frozen=True):
    """Behaviour of one agent.

    Attributes:
        version: at which this was said.
        agent: the agent that it is about.
        deviations: not restored by a person; each feature once.
        deviated_at: seconds since the epoch of the newest of them; None for none.
        contracted: it holds the minimum safe set until a person restores it.
        samples: acts in its baseline.
        restored_at: seconds since the epoch at which a person last restored it, or None: an enforcement point's own
            reports up to then count no longer.
    """

    version: Whole
    agent: Name
    deviations: Annotated[tuple[DeviationEntry, ...], upto(DEVIATIONS)]
    deviated_at: Whole | None
    contracted: bool
    samples: Whole
    restored_at: Whole | None


class Conduct(Form, frozen=True):
    """Answer of a feed about trust and behaviour.

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

    issuer: Url
    version: Whole
    since: Whole
    through: Whole
    as_of_ms: Whole
    nonce: Nonce
    edges: Annotated[tuple[EdgeEntry, ...], upto(ENTRIES)]
    agents: Annotated[tuple[AgentEntry, ...], upto(ENTRIES)]


def sign(word: Conduct, key: PrivateKey) -> str:
    """The signed word."""
    return statement_form.seal(KIND, plain(word), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Conduct:  # noqa: A001 - read as conduct.open
    """The word, signed by one of these keys, its edges and agents inside (since, through].

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Conduct:
    word = read(Conduct, claims)
    unique(word.edges, lambda e: (e.delegator, e.delegate), "an edge")
    unique(word.agents, lambda a: a.agent, "an agent")
    for agent in word.agents:
        unique(agent.deviations, lambda d: d.feature, "a feature")
    versions = [*(entry.version for entry in word.edges), *(entry.version for entry in word.agents)]
    inside = all(word.since < version <= word.through for version in versions)
    if not inside or not word.since <= word.through <= word.version:
        raise malformed("entries outside of what was asked, or of what is told")
    return word
