"""Ask of a PEP to people: all that an approval would bind, and all that people are shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final

from msgspec import Meta

from capabilities.statements import statement_form
from capabilities.statements.claims import (
    HexDigest,
    HexDigestOrEmpty,
    Id,
    IdOrEmpty,
    Name,
    NameOrEmpty,
    Signed,
    Thumbprint,
    TokenId,
    Url,
    Whole,
    malformed,
    read,
    unique,
)
from capabilities.values import form, strict_json
from capabilities.values.arguments import Argument, kind_given, restated
from capabilities.values.arguments import plain as plain_value
from capabilities.values.bounds import kind_to_json
from capabilities.values.errors import FaultCode, QuantityError
from capabilities.values.form import Form, converted, plain, upto, whole, within, words
from capabilities.values.scope import Tier
from capabilities.values.units import DeclaredUnit, Quantity, Unit, kind_of

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "ask"
NO_ROBOT: Final = "none"
"""Perception of an act that no robot does: nothing is looked at, and nobody has to see a cell."""
PERCEPTIONS: Final = frozenset({"fresh", "stale", "missing", NO_ROBOT})
VALUES: Final = 32
CONTRIBUTORS: Final = 64
REASONS: Final = 16
FACTS: Final = 16
"""Most parameters, contributors, reasons and facts of one ask."""
FACT_STATES: Final = frozenset({"fresh", "stale", "missing", "invalid"})
READ_BYTES: Final = 16_384
"""Most bytes of an ask's values, as canonical JSON: nobody reads more before they vote."""
JOINTS: Final = 6
APPROVERS_OF_TIER: Final = {Tier.SAFETY_CRITICAL: 2}
"""Number of different people that a tier needs; every other tier that asks people needs one."""


class _Value(Form, frozen=True):
    name: Name
    value: Any
    unit: str = ""
    kind: str = ""


def _value(stated: object) -> Quantity | Argument:
    """The value that an ask states."""
    read: _Value = form.read(_Value, stated)
    kind = kind_of(read.unit or read.kind)
    if bool(read.kind) is isinstance(kind, (Unit, DeclaredUnit)) or (read.unit and read.kind):
        raise QuantityError(FaultCode.PARAMETERS_WRONG, "a unit is a quantity's, a kind any other value's")
    return restated(read.name, kind, read.value)


if TYPE_CHECKING:
    Value = Quantity | Argument
else:
    Value = converted(Quantity, _value)
    Value.register(Argument)
_Reason = Annotated[str, whole("[A-Z][A-Z0-9_]{0,63}")]
_IndexMilli = Annotated[int, within(0, 4_000)]


class Contributor(Form, frozen=True):
    """One thing that raised the index: kind, link and object, index in thousandths, clearance and speed there.

    `source` is who says that the object is there: a sensor, or "" for the signed cell file and the robot itself.
    """

    kind: Name
    link: NameOrEmpty
    object: NameOrEmpty
    index_milli: _IndexMilli
    clearance_um: Signed
    speed_um_s: Whole
    source: Name = ""


class AskedFact(Form, frozen=True):
    """Fact of a sensor on which the tier depends ([FCT-2]); value and age are None where nothing is believed.

    `raises` says whether it is why the act is of its tier.
    """

    fact: Name
    state: Annotated[str, words(*FACT_STATES)]
    unit: Unit
    value: Signed | None
    age_ms: Whole | None
    raises: bool

    @property
    def contributor(self) -> tuple[str, str]:
        """Kind and object under which an approval binds it."""
        return ("fact" if self.state == "fresh" else "fact-unseen"), self.fact


class Ask(Form, frozen=True):
    """Ask of a PEP to people, with all that they are shown.

    Attributes:
        ask_id: 32 hex digits, made by the PEP.
        nonce: 32 hex digits, fresh for this ask.
        pep, audience: who asks, and the canonical URL of its server.
        issuer, sponsor: of the chain's human root.
        token_id: of the root token.
        mandate_id: of the mandate that the token was drawn from, or "". An approval of an ask with one outlives the
            token, and counts for no other mandate's.
        agent, agent_key: the chain's leaf and its key's thumbprint (RFC 7638).
        object, operation, values: the typed request, in the operation's order; of a free value size and digest.
        request_digest: SHA-256 (hex) of the request (`policies.evidence.model.Request.digest`).
        start_urad: joint angles from which it was assessed, six integers, or none for an act without motion.
        model_digest, policy_digest, scene_digest: SHA-256 (hex) of robot model, policy set and scene.
        tier, index_milli: as computed.
        reasons: the deferral reasons that an approval would resolve, at least one.
        contributors: ranked, highest index first.
        perception: "fresh", "stale" or "missing", or "none" for an act without a robot; `perception_age_ms` of the
            frame that was used, or None.
        approvers: how many different people must approve, 1 or 2.
        opening_id: the opening that a tier 4 ask rests on, else "".
        asked_at, expires_at: seconds since the epoch.
        facts: of an act without a robot, each once.
        picture_digest: SHA-256 (hex) of the picture that people are shown with it
            (`capabilities.statements.people.picture`), or "" for an act without motion.
    """

    ask_id: Id
    nonce: Id
    pep: Name
    audience: Url
    issuer: Url
    sponsor: Name
    token_id: TokenId
    agent: Name
    agent_key: Thumbprint
    object: Name
    operation: Name
    values: Annotated[tuple[Value, ...], upto(VALUES)]
    request_digest: HexDigest
    start_urad: Annotated[tuple[Signed, ...], upto(JOINTS)]
    model_digest: HexDigest
    policy_digest: HexDigest
    scene_digest: HexDigest
    tier: Tier
    index_milli: _IndexMilli
    reasons: Annotated[tuple[_Reason, ...], Meta(min_length=1, max_length=REASONS)]
    contributors: Annotated[tuple[Contributor, ...], upto(CONTRIBUTORS)]
    perception: Annotated[str, words(*PERCEPTIONS)]
    perception_age_ms: Whole | None
    approvers: Annotated[int, within(1, 2)]
    opening_id: IdOrEmpty
    asked_at: Whole
    expires_at: Whole
    mandate_id: IdOrEmpty = ""
    facts: Annotated[tuple[AskedFact, ...], Meta(min_length=1, max_length=FACTS)] = ()
    picture_digest: HexDigestOrEmpty = ""


NAMES: Final = Ask.__struct_fields__


def sign(ask: Ask, key: PrivateKey) -> str:
    """The ask, signed by the PEP."""
    return statement_form.seal(KIND, claims(ask), key, _read)


def claims(ask: Ask) -> dict[str, object]:
    """The ask's members as plain JSON values."""
    return {**plain(ask), "values": [stated(value) for value in ask.values]}


def stated(value: Quantity | Argument) -> dict[str, object]:
    """A value as an ask states it: its name, its `unit` or else its `kind`, and itself."""
    return {"name": value.name, **kind_to_json(kind_given(value)), "value": plain_value(value)}


def open(text: str, keys: Collection[bytes], caps: Caps) -> Ask:  # noqa: A001 - read as ask.open
    """The ask, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for an ask that ends before it begins, gives no reason, or asks fewer
            people than its tier wants.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Ask:
    ask = read(Ask, claims)
    unique(ask.values, lambda value: value.name, "a parameter")
    unique(ask.reasons, lambda reason: reason, "a reason")
    if len(strict_json.canonical([plain_value(value) for value in ask.values])) > READ_BYTES:
        raise malformed("more than people can read")
    if len(ask.start_urad) not in (0, JOINTS):
        raise malformed("start_urad has not six angles")
    looked = ask.index_milli or ask.start_urad or ask.contributors or ask.perception_age_ms is not None
    if ask.perception == NO_ROBOT and (looked or ask.picture_digest):
        raise malformed("an act without a robot has no physics")
    unique(ask.facts, lambda fact: fact.fact, "a fact")
    if ask.facts and ask.perception != NO_ROBOT:
        raise malformed("facts of an act that a robot does")
    if not ask.asked_at < ask.expires_at:
        raise malformed("it ends before it begins")
    if ask.approvers < APPROVERS_OF_TIER.get(ask.tier, 1):
        raise malformed("it asks fewer people than its tier wants")
    if (ask.tier is Tier.SAFETY_CRITICAL) != (ask.opening_id != ""):
        raise malformed("tier 4, and nothing else, rests on an opening")
    return ask
