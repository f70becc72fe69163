"""Campaign A5: random chains and requests at their boundaries; no child permits more than one of its parents.

Every chain is of real tokens, and `verify` with `check_request` answers for each holder in it. Three opinions have to
be one: theirs, the twin's, and, for a part of the requests, that of Biscuit's own authorizer. Beside that, hops are
forged with the attester's real key: `verify` accepts those that narrow and no other.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from capabilities.token import biscuit, block, hop_rules
from capabilities.token.biscuit import Answer, Probe
from capabilities.values.arguments import is_of, measured
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from capabilities.values.text import ROLE_PREFIX
from evaluation.harness.campaign import missed
from evaluation.harness.work import keep, seeds_of, shares, together, total
from evaluation.tokens.campaigns import requests, twin
from evaluation.tokens.campaigns.families import FORGED, HOPS, family, lay_over, too_much, whole
from evaluation.tokens.campaigns.issuer import CELLS, LEASE_MS, VIEW, Issuer, verified
from evaluation.tokens.campaigns.requests import ACTING, DIMENSIONS
from evaluation.tokens.campaigns.twin import Lend

if TYPE_CHECKING:
    from capabilities.token.verify import Verifier
    from evaluation.tokens.campaigns.families import Family
    from evaluation.tokens.campaigns.twin import TriedAct

COUNT: Final = 200_000
LEAST_PER_DIMENSION: Final = 8_000
"""Least pairs of a dimension for `COUNT` pairs; fewer pairs need so many fewer."""
EACH: Final = 600
"""Requests for each chain: signatures are dear."""
_BY_BISCUIT: Final = 10
_BY_ISSUING: Final = 40
"""One in so many requests goes through Biscuit's authorizer, or through a real delegation."""
_LEAST_SPLIT: Final = 0.1
"""Part of the pairs of a dimension that some holders of the chain must be allowed and others not."""


@dataclass(slots=True)
class AttenuationTally:
    """Tally of one run.

    Attributes:
        chains: by number of hops.
        pairs: by the dimension whose boundary they are at.
        split: pairs that some holders of the chain are allowed and others not.
        widened: pairs in which a child was allowed a request that one of its parents was not.
        parted: pairs in which the verifier and the twin part, or Biscuit and the twin.
        by_biscuit, by_issuing: answers of Biscuit's authorizer; hops that were asked for of the real issuer.
        forged: hops signed past the rules, by their excess; "fair" ones narrow.
        wrong: forged hops that were accepted and had to be refused, or the other way round.
    """

    chains: Counter[int] = field(default_factory=Counter)
    pairs: Counter[str] = field(default_factory=Counter)
    split: Counter[str] = field(default_factory=Counter)
    widened: list[str] = field(default_factory=list)
    parted: list[str] = field(default_factory=list)
    by_biscuit: int = 0
    by_issuing: int = 0
    forged: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class AttenuationFigures:
    """Figures of the campaign.

    Attributes:
        count: pairs that were wanted.
        tally: of all of them.
    """

    count: int
    tally: AttenuationTally

    @property
    def missed(self) -> tuple[str, ...]:
        """Misses of the bar; none when all wanted pairs meet it, on both sides of every line."""
        found = self.tally
        least = max(1, LEAST_PER_DIMENSION * self.count // COUNT)
        one_sided = [each for each in DIMENSIONS if found.split[each] < found.pairs[each] * _LEAST_SPLIT]
        faults = {
            f"{sum(found.pairs.values())} pairs": sum(found.pairs.values()) != self.count,
            f"a dimension with less than {least} pairs": any(found.pairs[each] < least for each in DIMENSIONS),
            f"on one side of the line: {', '.join(one_sided)}": bool(one_sided),
            "nothing asked of Biscuit, or of the issuer": not (found.by_biscuit and found.by_issuing),
            "nothing of one kind forged": not all(found.forged[each] for each in (*FORGED, "fair")),
        }
        failures = {
            "widened": found.widened,
            "opinions parted": found.parted,
            "forged hops judged wrong": found.wrong,
        }
        return missed(faults, failures)


# --- answers of the library ------------------------------------------------------------------------------------------


def may_act(verifier: Verifier, token: bytes, act: TriedAct) -> bool:
    """True where the library permits a request to the holder of a token: steps 1 to 9, 11 and 12."""
    chain = verifier.verify(token, at=act.at, audience=act.audience, view=VIEW, lease_ms=LEASE_MS)
    if isinstance(chain, Fault):
        return False
    refused = verifier.check_request(
        chain, object=act.object, operation=act.operation, values=act.values, base_tier=act.base_tier, at=act.at
    )
    return refused is None


def may_lend(issuer: Issuer, chain: Chain, lend: Lend) -> bool:
    """True where the library's rules of a hop permit it; nothing is signed."""
    added = block.HopBlock(
        len(chain.hops), issuer.holder(lend.agent, chain.leaf.agent, role=lend.role), whole(lend.scope)
    )
    try:
        block.well_formed(added, DEFAULT)
        hop_rules.next_hop(chain.hops, added, reserved=issuer.trust.all_keys, caps=DEFAULT)
    except CapabilityError:
        return False
    return True


def does_lend(issuer: Issuer, token: bytes, chain: Chain, lend: Lend) -> bool | None:
    """True where the library issues that hop and the token then verifies; None when it would be too large."""
    hop = issuer.holder(lend.agent, chain.leaf.agent, role=lend.role)
    try:
        token = issuer.delegate(token, chain, hop, whole(lend.scope))
    except CapabilityError as error:
        return None if error.code is FaultCode.TOKEN_TOO_LARGE else False
    at, audience = lend.scope.not_before, min(lend.scope.audiences)
    return isinstance(verified(issuer.verifier(), token, at=at, audience=audience), Chain)


def biscuit_says(issuer: Issuer, token: bytes, act: TriedAct) -> bool:
    """True where Biscuit's own authorizer permits the act: all but the audience."""
    opened = biscuit.open_token(token, issuer.trust.roots[issuer.root_key_id])
    probe = Probe(act.object, act.operation, tuple(measured(each) for each in act.values), act.at, int(act.base_tier))
    return opened.decide(probe, DEFAULT) is Answer.ALLOWED


# --- one process -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Asked:
    """One family under way: who issued it, who verifies it, where draws come from and findings go."""

    issuer: Issuer
    verifier: Verifier
    of: Family
    chance: random.Random
    found: AttenuationTally


def explore(issuer: Issuer, count: int, seed: int, each: int) -> AttenuationTally:
    """Tally of so many pairs, so many of them of each chain; the dimensions take turns."""
    chance = random.Random(seed)  # noqa: S311 - draws, no secrets
    found = AttenuationTally()
    number = 0
    while number < count:
        verifier = issuer.verifier()
        of = family(issuer, verifier, chance.choice((1, 2, 3, 4, 5, 6, 7, HOPS)), chance)
        found.chains[len(of.blocks) - 1] += 1
        asked = _Asked(issuer, verifier, of, chance, found)
        for _ in range(min(each, count - number)):
            dimension = DIMENSIONS[number % len(DIMENSIONS)]
            pair = _pair_of_act if dimension in ACTING else _pair_of_lend
            pair(asked, dimension, number // len(DIMENSIONS))
            number += 1
        for what in FORGED:
            _forge(asked, what)
    return found


def _pair_of_act(asked: _Asked, dimension: str, turn: int) -> None:
    of, found = asked.of, asked.found
    act = requests.act(of, dimension, asked.chance)
    answers = [may_act(asked.verifier, token, act) for token in of.tokens]
    _compare(dimension, act, answers, twin.acts(of.blocks, act), found)
    if turn % _BY_BISCUIT == 0 and _plain(of, act):
        says = [biscuit_says(asked.issuer, token, act) for token in of.tokens]
        found.by_biscuit += len(says)
        # Biscuit is not told the audience: that line is drawn by a statement. Every chain has the first one.
        if says != twin.acts(of.blocks, replace(act, audience=CELLS[0])):
            keep(found.parted, f"Biscuit {act}")


def _plain(of: Family, act: TriedAct) -> bool:
    """True where the parameters are the operation's own: Biscuit knows no names and kinds, only places."""
    return any(
        [each.name for each in act.values] == [limit.parameter.name for limit in grant.limits]
        and all(is_of(limit.parameter.kind, each) for limit, each in zip(grant.limits, act.values, strict=True))
        for grant in of.blocks[0].grants or ()
        if (grant.object, grant.operation) == (act.object, act.operation)
    )


def _pair_of_lend(asked: _Asked, dimension: str, turn: int) -> None:
    of, found = asked.of, asked.found
    lend = requests.lend(of, dimension, asked.chance)
    expected = twin.lends(of.blocks, [hop.agent for hop in of.chains[-1].hops], lend)
    _compare(dimension, lend, [may_lend(asked.issuer, chain, lend) for chain in of.chains], expected, found)
    if turn % _BY_ISSUING == 0:
        pairs = zip(of.tokens, of.chains, strict=True)
        does = [does_lend(asked.issuer, token, chain, lend) for token, chain in pairs]
        found.by_issuing += sum(each is not None for each in does)
        if any(each is not None and each is not may for each, may in zip(does, expected, strict=True)):
            keep(found.parted, f"issuing {lend}")


def _compare(dimension: str, asked: object, answers: list[bool], expected: list[bool], found: AttenuationTally) -> None:
    found.pairs[dimension] += 1
    found.split[dimension] += len(set(answers)) > 1
    if answers != sorted(answers, reverse=True):  # once refused, refused to everybody below
        keep(found.widened, f"{dimension} {answers} {asked}")
    if answers != expected:
        keep(found.parted, f"{dimension} {answers} {expected} {asked}")


def _forge(asked: _Asked, what: str) -> None:
    """Forges a hop with too much, and a fair one, below one of the holders, and compares verification's answers."""
    chain = asked.chance.choice([each for each in asked.of.chains if each.scope.depth] or asked.of.chains[-1:])
    at = len(chain.hops) - 1
    agents = chain.scope.delegates - {hop.agent for hop in chain.hops}
    named = min((agent for agent in agents if not agent.startswith(ROLE_PREFIX)), default="")
    for name in (what, "fair"):
        restriction = too_much("stranger" if name == "fair" else what, chain.scope, asked.chance)
        lend = Lend("nobody" if name == "stranger" else named or "nobody", "", lay_over(chain.scope, restriction))
        may = twin.lends(asked.of.blocks[: at + 1], [hop.agent for hop in chain.hops], lend)[-1]
        hop = asked.issuer.holder(lend.agent, chain.leaf.agent)
        token = asked.issuer.forge(asked.of.tokens[at], chain.scope, len(chain.hops), hop, restriction)
        if len(token) > DEFAULT.token_bytes:
            continue  # refused for another reason than its content
        does = isinstance(verified(asked.issuer.verifier(), token, at=lend.scope.not_before), Chain)
        asked.found.forged[name] += 1
        if does != may or (may and name != "fair"):
            keep(asked.found.wrong, f"{name} {does} {may} {lend}")


# --- all of it -------------------------------------------------------------------------------------------------------


def _share(issuer_seed: str, count: int, seed: int, each: int) -> AttenuationTally:
    return explore(Issuer(issuer_seed), count, seed, each)


def run(count: int = COUNT, seed: int = 1, *, processes: int = 2, each: int = EACH) -> AttenuationFigures:
    """The figures of the campaign.

    Args:
        count: pairs.
        seed: of every draw.
        processes: that share the work; with 1 it is done here.
        each: requests for each chain.
    """
    seeds = seeds_of(seed, processes)
    parts = zip(shares(count, processes), seeds, strict=True)
    work = [(f"attenuation {own}", share, own, each) for share, own in parts]
    return AttenuationFigures(count, total(together(_share, work)))
