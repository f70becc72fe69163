"""Trees of authority as people see them: what lives of them, and by what the rest is dead. Pure."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ztpm_idp.domain.events import RevocationKind

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from ztpm_idp.store.lending import LentHop

Name = tuple[str, str]
"""Kind and id of what may be revoked."""


@dataclass(slots=True)
class Branch:
    """A hop with all that was lent on from it.

    Attributes:
        hop: as it was made.
        delegator: id of who lent: the agent of the hop above, or the sponsor.
        trust_permille: score of the edge from there to the hop's agent.
        dead_by: what is revoked or suspended, so that it is dead; None: it lives.
        above: its death came down from the hop above.
        names: whose revocation would kill it, apart from those of the hops above.
        below: hops that were lent on from it.
    """

    hop: LentHop
    delegator: str
    trust_permille: int
    dead_by: Name | None
    above: bool
    names: frozenset[Name]
    below: list[Branch] = field(default_factory=list)

    def each(self) -> Iterator[Branch]:
        """It, and every hop below it."""
        yield self
        for branch in self.below:
            yield from branch.each()

    @property
    def trust(self) -> str:
        """Its score for people, between 0 and 1."""
        return f"{self.trust_permille / 1_000:.2f}"

    @property
    def living(self) -> int:
        """Number of living hops, itself included."""
        return sum(branch.dead_by is None for branch in self.each())


@dataclass(frozen=True, slots=True)
class Standings:
    """Facts by which hops stand or fall.

    Attributes:
        dead: every (kind, id) that is revoked, and agents that are suspended.
        keys: thumbprint of each agent's present key.
        former: thumbprints of its former keys, each with the time at which it was replaced, the earliest first.
        scores: trust by agent, then by delegator, in permille, where it is not the prior.
        prior_permille: of all other edges.
    """

    dead: Collection[Name]
    keys: Mapping[str, str]
    former: Mapping[str, list[tuple[int, str]]]
    scores: Mapping[str, Mapping[str, int]]
    prior_permille: int

    def key_of(self, hop: LentHop) -> str:
        """Thumbprint of the key for which the hop was made."""
        former = (key for replaced_ms, key in self.former.get(hop.agent, ()) if hop.made_ms <= replaced_ms)
        return next(former, self.keys.get(hop.agent, ""))


def names_of(hop: LentHop, key: str) -> frozenset[Name]:
    """Every (kind, id) whose revocation kills a hop, apart from those of the hops above."""
    named = {
        (RevocationKind.TOKEN.value, hop.token_id),
        (RevocationKind.HOP.value, hop.hop_id),
        (RevocationKind.AGENT.value, hop.agent),
        (RevocationKind.SPONSOR.value, hop.sponsor),
        (RevocationKind.KEY.value, key),
    }
    return frozenset(named if hop.mandate is None else named | {(RevocationKind.MANDATE.value, hop.mandate)})


def grown(hops: Iterable[LentHop], standings: Standings) -> dict[str, list[Branch]]:
    """First hops by sponsor, the newest first, each with its tree.

    Args:
        hops: each after the one above it; one whose hop above is missing is left out.
        standings: as of the same moment.
    """
    found, roots = dict[str, Branch](), defaultdict[str, list[Branch]](list)
    for hop in hops:
        parent = None if hop.parent is None else found.get(hop.parent)
        if hop.parent is not None and parent is None:
            continue
        delegator = hop.sponsor if parent is None else parent.hop.agent
        names = names_of(hop, standings.key_of(hop))
        own = next((name for name in sorted(names) if name in standings.dead), None)
        trust = standings.scores.get(hop.agent, {}).get(delegator, standings.prior_permille)
        inherited = None if parent is None else parent.dead_by
        made = Branch(hop, delegator, trust, own or inherited, own is None and inherited is not None, names)
        found[hop.hop_id] = made
        (roots[hop.sponsor] if parent is None else parent.below).append(made)
    for trees in roots.values():
        trees.sort(key=lambda root: (-root.hop.made_ms, root.hop.hop_id))
    return dict(roots)


def hit(roots: Iterable[Branch], name: Name) -> Iterator[Branch]:
    """Hops that the revocation of this (kind, id) kills: those that have the name, and all below them."""
    for root in roots:
        if name in root.names:
            yield from root.each()
        else:
            yield from hit(root.below, name)
