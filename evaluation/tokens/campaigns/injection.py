"""The other half of campaign A5: hostile text in every text of a token, from an issuer without rules.

A text is either refused, when it is issued or when it is read, or it comes back as the very same text. It never adds a
fact, a rule or a check to a block, and never a hop, an operation or a permission to a chain.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.token import biscuit, block, wire
from capabilities.token.biscuit import Answer, Probe
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain, Sponsor
from capabilities.values.errors import CapabilityError
from capabilities.values.scope import Grant, Limit, Range, Restriction, Scope
from capabilities.values.units import Parameter, Unit
from evaluation.harness.campaign import missed
from evaluation.tokens.campaigns import fields
from evaluation.tokens.campaigns.issuer import AT, CELLS, SPONSOR, Issuer, verified
from evaluation.tokens.campaigns.shapes import SMALL

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities.values.chain import HopGrant

_KEPT: Final = 20
_PLAIN: Final = "plain"

TEXTS: Final = (
    *('"', '\\"', "'", "`", ";", ",", "{", "}", "{{}}", "}{", "{p0}", "{p1}{p2}", "$v0", "$time", "//", "/* x */"),
    *('"); req("r", "fly"); x("', '"), true; allow if true; //', '");\ncheck if true;\nx("', ' or req("r", "fly")'),
    *("check if true", "allow if true", "reject if false", "x <- true", "trusting authority", "trusting previous"),
    *('hop(0, hex:00, hex:00, hex:00, hex:00, "")', "req_ctx(0, 0)", "hex:00", "ed25519/00", "$a.contains(1)"),
    *('","agent":"eve', '"}', "\\u0022}", '{"agent":"eve"}', "[]", "null", "true", "0", "-1", "1e400", "NaN"),
    *("\n", "a\nb", "\r\n", "\t", "\0", "a\0b", "\x7f", "\x1b[2J", "\u200b", "\u202e", "\u2066x\u2069", "\ufeff"),
    *("\u2028", "\ue000", "\U000e0041", "e\u0301", "\u212b", "\u0430dmin", "\uff41", "'; drop table hops; --"),
    "../../etc/passwd",
    "http://a.example/x\nSet-Cookie: y",
)
"""Sixty-four texts that end a string, a statement or a line somewhere, or that two readers take for different ones."""


@dataclass(frozen=True, slots=True)
class InjectionFigures:
    """Figures of the campaign.

    Attributes:
        texts: their number.
        carried, refused: for each place, how many texts came back, and how many were refused.
        injected: texts that did more than be a text.
    """

    texts: int
    carried: dict[str, int]
    refused: dict[str, int]
    injected: tuple[str, ...]

    @property
    def missed(self) -> tuple[str, ...]:
        """Misses of the bar."""
        tried = [self.carried.get(place, 0) + self.refused.get(place, 0) for place in PLACES]
        faults = {
            "a text was not tried in some place": any(count != self.texts for count in tried),
            "hardly any text was carried": not self.carried.get("purpose", 0) > self.texts // 2,
        }
        return missed(faults, {"injected": self.injected})


# --- places ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Made:
    """A token with a text in one place, and where a verified chain shows it."""

    token: bytes
    shown: Callable[[Chain], object]


def _first(
    issuer: Issuer, scope: Scope = SMALL, *, sponsor: Sponsor = SPONSOR, token_id: str = "A" * 22, **hop: Any
) -> bytes:
    """A token of one block that no rule was asked about."""
    holder: HopGrant = replace(issuer.holder("first", sponsor.subject), **hop)
    made = block.AuthorityBlock(token_id, sponsor, 0, holder, scope)
    return biscuit.seal_authority(
        block.fact(made), block.checks(made, None), root=issuer.key("root"), root_key_id=issuer.root_key_id
    )


def _second(issuer: Issuer, restriction: Restriction | None = None, **hop: Any) -> bytes:
    """Token with a hop that no rule was asked about, below one that any agent of a role may receive."""
    parent = replace(SMALL, audiences=frozenset(CELLS), delegates=frozenset({"second", "role:r"}), depth=1)
    first = issuer.mint(parent)
    holder = replace(issuer.holder("second", "first", role="r"), **hop)
    return issuer.forge(first, parent, 1, holder, restriction or Restriction(audiences=frozenset({CELLS[0]})))


def _parameter(name: str) -> Scope:
    return replace(SMALL, grants=(Grant("r", "s", (Limit(Parameter(name, Unit.COUNT), Range(0, 1)),)),))


PLACES: Final[dict[str, Callable[[Issuer, str], Made]]] = {
    "purpose": lambda i, t: Made(_first(i, purpose=t), lambda c: c.leaf.purpose),
    "agent": lambda i, t: Made(_first(i, agent=t), lambda c: c.leaf.agent),
    "role": lambda i, t: Made(_first(i, role=t), lambda c: c.leaf.role),
    "token id": lambda i, t: Made(_first(i, token_id=t), lambda c: c.token_id),
    "subject": lambda i, t: Made(_first(i, sponsor=replace(SPONSOR, subject=t)), lambda c: c.sponsor.subject),
    "method": lambda i, t: Made(_first(i, sponsor=replace(SPONSOR, method=t)), lambda c: c.sponsor.method),
    "issuer": lambda i, t: Made(_first(i, sponsor=replace(SPONSOR, issuer=t)), lambda c: c.sponsor.issuer),
    "object": lambda i, t: Made(_first(i, replace(SMALL, grants=(Grant(t, "s"),))), lambda c: c.scope.grants[0].object),
    "operation": lambda i, t: Made(
        _first(i, replace(SMALL, grants=(Grant("r", t),))), lambda c: c.scope.grants[0].operation
    ),
    "parameter": lambda i, t: Made(_first(i, _parameter(t)), lambda c: c.scope.grants[0].limits[0].parameter.name),
    "audience": lambda i, t: Made(
        _first(i, replace(SMALL, audiences=frozenset({CELLS[0], t}))), lambda c: max(c.scope.audiences - {CELLS[0]})
    ),
    "delegate": lambda i, t: Made(
        _first(i, replace(SMALL, delegates=frozenset({t}))), lambda c: max(c.scope.delegates)
    ),
    "purpose of a hop": lambda i, t: Made(_second(i, purpose=t), lambda c: c.leaf.purpose),
    "agent of a hop": lambda i, t: Made(_second(i, agent=t), lambda c: c.leaf.agent),
    "role of a hop": lambda i, t: Made(_second(i, role=t), lambda c: c.leaf.role),
    "audience of a hop": lambda i, t: Made(
        _second(i, Restriction(audiences=frozenset({t}))), lambda c: c.scope.audiences
    ),
    "delegate of a hop": lambda i, t: Made(
        _second(i, Restriction(delegates=frozenset({t}))), lambda c: c.scope.delegates
    ),
}
"""Every text of a token; evidence kind, units and profile are words of a closed list."""


# --- the run ---------------------------------------------------------------------------------------------------------


def run(seed: int = 1) -> InjectionFigures:
    """The figures of the campaign; the seed is that of the keys."""
    issuer = Issuer(f"injection {seed}")
    carried: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    injected: list[str] = []
    for place, put in PLACES.items():
        likeness = _likeness(put(issuer, _PLAIN).token)
        for text in TEXTS:
            try:
                made = put(issuer, text)
            except CapabilityError:
                refused[place] += 1
                continue
            what = _injected(issuer, made, text, likeness)
            if what:
                injected.append(f"{place} {text!r} {what}" if len(injected) < _KEPT else "")
            accepted = isinstance(verified(issuer.verifier(), made.token), Chain)
            (carried if accepted else refused)[place] += 1
    return InjectionFigures(len(set(TEXTS)), dict(carried), dict(refused), tuple(injected))


def _injected(issuer: Issuer, made: Made, text: str, likeness: list[dict[int, int]]) -> str:
    """Effect of a text beyond being a text; "" for none."""
    if _likeness(made.token) != likeness:
        return "changed the statements of a block"
    opened = biscuit.open_token(made.token, issuer.trust.roots[issuer.root_key_id])
    for probe in _forbidden(text):
        if opened.decide(probe, DEFAULT) is not Answer.REFUSED:
            return "gave a permission"
    chain = verified(issuer.verifier(), made.token)
    if isinstance(chain, Chain) and made.shown(chain) not in (text, frozenset({text})):
        return "came back as another text"
    return ""


def _forbidden(text: str) -> Iterator[Probe]:
    """Requests that no token of this module permits, under any text."""
    for operation in {"fly", text + "x"}:
        yield Probe("r", operation, (), AT, 0)
    yield Probe("r", "s", (), AT + 10_000_000, 0)
    yield Probe("r", "s", (), AT, 1)
    yield Probe("r", "s", (7,), AT, 0)


def _likeness(token: bytes) -> list[dict[int, int]]:
    """Counts for each block: of each field but texts (1), and of the terms of its facts."""
    counted = []
    for signed in wire.read(token).blocks:
        parts = fields.read(signed.payload)
        counts = Counter(part.number for part in parts if part.number != 1)
        terms = [part.number for fact in parts if fact.number == 4 for part in fields.read(fact.inner[0].value)]
        counted.append({**counts, 100: len(terms)})
    return counted
