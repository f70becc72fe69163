"""Envelope approval: a person approves beforehand what an agent will do often and alike, inside stated bounds.

It is for a few minutes and a few uses, never above tier 3, and never with anything in view that its author did not
name. Clauses [ENV-1] and [ENV-2].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from msgspec import Meta

from capabilities.statements import statement_form
from capabilities.statements.claims import (
    AgentId,
    HexDigest,
    Id,
    Name,
    NameOrEmpty,
    Signed,
    Thumbprint,
    Url,
    Whole,
    lasting,
    malformed,
    read,
    unique,
)
from capabilities.statements.people.ask import CONTRIBUTORS, JOINTS, REASONS, VALUES
from capabilities.values.form import Form, plain, upto, whole, within
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "envelope"
USES: Final = 10
LIFETIME_S: Final = 600
HIGHEST: Final = Tier.HIGH_CONSEQUENCE
"""Most uses, longest life in seconds, and highest tier of an envelope (DESIGN section 10)."""
SPEED_UM_S: Final = 250_000
"""Highest speed of the tool centre point, 0.25 m/s: no approved motion near people is faster (DESIGN section 6)."""
_INDEX_MILLI: Final = 3_000
"""Highest index of tier 3, in thousandths."""
_Reason = Annotated[str, whole("[A-Z][A-Z0-9_]{0,63}")]


class Side(Form, frozen=True):
    """One side of the box: the least and the greatest value, in the parameter's own unit, that counts."""

    name: Name
    low: Signed
    high: Signed


class Seen(Form, frozen=True):
    """A thing that may contribute to the index: its kind and its object, "" where it has none."""

    kind: Name
    object: NameOrEmpty


class Envelope(Form, frozen=True):
    """A person's approval of all acts inside its bounds.

    Attributes:
        envelope_id: 32 hex digits.
        approver: the person's id.
        audience, sponsor, agent, agent_key, object, operation: for whose acts, of which kind.
        model_digest, policy_digest: SHA-256 (hex) of robot model and policy set.
        reasons: the deferral reasons that it resolves, at least one.
        tier: of the acts, at most 3.
        index_milli, speed_um_s: highest index, and highest speed of the tool centre point.
        box: a side for each parameter of the operation.
        start_urad: least and greatest angle of each joint at the start, six of them, or none without a robot.
        seen: all that may contribute.
        uses: how many acts, 1 to 10.
        not_before, not_after: seconds since the epoch, at most 600 apart.
    """

    envelope_id: Id
    approver: Name
    audience: Url
    sponsor: Name
    agent: AgentId
    agent_key: Thumbprint
    object: Name
    operation: Name
    model_digest: HexDigest
    policy_digest: HexDigest
    reasons: Annotated[tuple[_Reason, ...], Meta(min_length=1, max_length=REASONS)]
    tier: Tier
    index_milli: Annotated[int, within(0, _INDEX_MILLI)]
    speed_um_s: Annotated[int, within(0, SPEED_UM_S)]
    box: Annotated[tuple[Side, ...], upto(VALUES)]
    start_urad: Annotated[tuple[Side, ...], upto(JOINTS)]
    seen: Annotated[tuple[Seen, ...], upto(CONTRIBUTORS)]
    uses: Annotated[int, within(1, USES)]
    not_before: Whole
    not_after: Whole


def sign(envelope: Envelope, key: PrivateKey) -> str:
    """The envelope, signed by the person."""
    return statement_form.seal(KIND, plain(envelope), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Envelope:  # noqa: A001 - read as envelope.open
    """The envelope, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one above tier 3, for over `LIFETIME_S`, or with an empty side.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Envelope:
    envelope = read(Envelope, claims)
    lasting(envelope.not_before, envelope.not_after, LIFETIME_S)
    if envelope.tier > HIGHEST:
        raise malformed("nobody approves beforehand above tier 3")
    unique(envelope.reasons, lambda reason: reason, "a reason")
    unique(envelope.box, lambda side: side.name, "a parameter")
    unique(envelope.start_urad, lambda side: side.name, "a joint")
    unique(envelope.seen, lambda seen: (seen.kind, seen.object), "what may contribute")
    if len(envelope.start_urad) not in (0, JOINTS):
        raise malformed("start_urad has not six joints")
    if not all(side.low <= side.high for side in (*envelope.box, *envelope.start_urad)):
        raise malformed("a side without a value")
    return envelope
